"""What f does, found by running it on two handfuls of points: its decisions in order, and what no trace of it will see."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from torch_mcaa.errors import McaaError
from torch_mcaa.grid import Screen
from torch_mcaa.integrand import as_channels
from torch_mcaa.traced.decisions import ESCAPES, Choice, Decision, Level, in_place, made_like, name_of
from torch_mcaa.traced.nested import tensors_in
from torch_mcaa.traced.trace import Site, Watch, changed_program, eagerly, where
from torch_mcaa.traced.transforms import held

_PROBE = 0x960BE
_COUNTS = 13, 17
"""Two numbers of points: the axis that grows with them is the points'."""
_POINT, _PARAMETER = 1, 2
_FIRST = 2
"""The bit of the first tensor that wants a gradient; that of the first decision is the next one, and so on by turns."""
_OURS = ("aten", "prim", "prims", "quantized", "torchvision")
_SELDOM = frozenset(
    [
        "div",
        "divide",
        "true_divide",
        "truediv",
        "rdiv",
        "rtruediv",
        "reciprocal",
        "pow",
        "rpow",
        "float_power",
        "tan",
        "atan2",
        "arctan2",
        "angle",
    ]
)
"""What has a pole or a branch cut, where a parameter hardly ever is."""


@dataclass(frozen=True)
class Program:
    """The decisions of f in order; sentences about what the trace cannot follow, each with a line of the user's code; how many channels.

    bends: what bends f counts among the decisions, as f takes derivatives.
    """

    sites: tuple[Site, ...]
    problems: tuple[str, ...]
    channels: int
    bends: bool

    @property
    def moves(self) -> bool:
        """Whether any edge depends on a tensor that wants a gradient."""
        return any(site.moves and site.axis is not None for site in self.sites)

    def all_moving(self) -> Program:
        """With all decisions taken for such."""
        return replace(self, sites=tuple(replace(site, tensors=site.tensors or 1) for site in self.sites))


def _runs(
    counts: tuple[int, int],
    function: Callable[[Tensor, Tensor], Any],
    screen: Screen,
    dtype: torch.dtype,
    device: torch.device,
    bends: bool = False,
) -> tuple[_Probe, _Probe]:
    first, second = (_Probe(count, bends) for count in counts)
    for run in (first, second):
        run.call(function, screen, dtype, device)
    return (first, second) if first.bends == bends else _runs(counts, function, screen, dtype, device, True)


@dataclass(frozen=True)
class _Met:
    name: str
    where: str
    shape: tuple[int, ...]
    dim: int | None
    depends: int
    seldom: bool


def probe(function: Callable[[Tensor, Tensor], Any], screen: Screen, dtype: torch.dtype, device: torch.device) -> Program:
    """Run f on 13 and on 17 random points of the screen, or on 256 times as many where it refuses, in `dtype`.

    Raises:
        McaaError: f raised (chained), or its decisions are not the same in both runs.
    """
    try:
        first, second = _runs(_COUNTS, function, screen, dtype, device)
    except McaaError:
        # some functions fold their points into whole rows
        first, second = _runs((256 * _COUNTS[0], 256 * _COUNTS[1]), function, screen, dtype, device)
    if [(m.name, len(m.shape)) for m in first.met] != [(m.name, len(m.shape)) for m in second.met]:
        raise changed_program(f"{len(first.met)} decisions at {first.points} points, {len(second.met)} at {second.points}")
    problems = [*first.problems]
    # with them, tensors whose size follows the number of points, made by nothing that PyTorch could show
    hidden = [*first.hidden, *first.lost, *(text for place, text in first.strangers.items() if place in second.strangers)]
    # who declares a jump knows of the code that hides it, but not that the declared one does not move
    declared = [met for met in first.met if met.name == "level_set"]
    if not declared:
        problems += hidden
    elif not any(met.depends & _PARAMETER for met in declared):
        problems += first.lost
    sites = []
    for one, two in zip(first.met, second.met, strict=True):
        axes = [k for k, (a, b) in enumerate(zip(one.shape, two.shape, strict=True)) if (a, b) == (first.points, second.points)]
        axis = axes[0] if len(axes) == 1 and axes[0] != one.dim else None
        sites.append(Site(one.name, one.where, axis, _every_other(one.depends >> _FIRST), _every_other(one.depends >> _FIRST + 1)))
        if axis is None and one.seldom:
            continue
        if axis is None and one.depends & _POINT:
            problems.append(
                f"{one.where}: {one.name} mixes points, or takes some of them only, so that it has no margin at a point"
            )
        elif axis is None and one.depends & _PARAMETER and (one.dim is None or one.name.startswith("arg")):
            # what is sorted or chosen by its own value is continuous
            problems.append(f"{one.where}: {one.name} decides on parameters alone, and jumps for all points at once")
    return Program(tuple(sites), tuple(dict.fromkeys(problems)), first.channels, first.bends)


def _every_other(bits: int) -> int:
    return sum((bits >> 2 * k & 1) << k for k in range(bits.bit_length() // 2 + 1))


class _Probe(Watch):
    """Follows which tensors depend on the points and on parameters, and which came from nowhere."""

    def __init__(self, points: int, bends: bool) -> None:
        super().__init__(self._decided, bends)
        self.points, self.bends = points, bends
        self.channels = 1
        self.met: list[_Met] = []
        self.problems: list[str] = []
        self.hidden: list[str] = []
        self.lost: list[str] = []
        self.strangers: dict[tuple[int, int], str] = {}
        self._depends: dict[int, int] = {}
        self._stores: dict[object, int] = {}
        self._alive: list[Tensor] = []
        self._calls = 0
        self._tensors = 0
        self._now = 0
        self._leaves: tuple[Tensor, ...] = ()

    def call(self, function: Callable[[Tensor, Tensor], Any], screen: Screen, dtype: torch.dtype, device: torch.device) -> None:
        col, row = screen.whole.places(self.points, 0, _PROBE)
        with torch.enable_grad():
            self._leaves = tuple(t.to(device, dtype).requires_grad_() for t in (screen.x_of(col), screen.y_of(row)))
            x, y = (leaf.clone() for leaf in self._leaves)
            for tensor in (x, y):
                self._note(tensor, _POINT)
            try:
                with eagerly(), self:
                    returned = function(x, y)
            except Exception as error:
                raise McaaError(f"f raised {type(error).__name__}: {error}; it was asked for {self.points} points") from error
            self.channels = len(as_channels(returned, x))
            for tensor in tensors_in(returned):
                self._origin(tensor, "what f returns")

    def __torch_function__(self, func: Any, types: Any, args: Sequence[Any] = (), kwargs: dict[str, Any] | None = None) -> Any:
        kwargs = kwargs or {}
        self._calls += 1
        given = list(tensors_in((args, kwargs)))
        stranger = bool(given) and _store(given[0]) not in self._stores
        depends, name = 0, getattr(func, "__name__", "")
        made = made_like(func)
        for place, tensor in enumerate(given):
            origin = self._origin(tensor, name_of(func))
            depends |= 0 if made and place == 0 else origin
        if stranger and in_place(func) and name != "requires_grad_":
            self.problems.append(
                f"{where()}: {name} changes a tensor in place that f did not make, so that every call finds another one (statistics of a "
                "module in training, such as BatchNorm's: call its eval())"
            )
        self.bends |= func is torch.autograd.grad
        if name in ESCAPES:
            self._escaped(name, depends)
        if depends & _POINT and _custom(func):
            self.hidden.append(f"{where()}: {func} is a kernel that the trace cannot see into")
        self._now, number = depends, self.number
        result = super().__torch_function__(func, types, args, kwargs)
        if self.number > number:
            depends |= 1 << _FIRST + 1 + 2 * number
        changed = given[:1] if in_place(func) else []
        for tensor in (*tensors_in(result), *changed):
            self._note(tensor, depends)
        return result

    def _escaped(self, name: str, depends: int) -> None:
        if depends & _POINT and name == "__bool__":
            self.problems.append(
                f"{where()}: {name} lets Python's control flow depend on the points, which torch.where does in PyTorch"
            )
        elif depends & _POINT:
            self.hidden.append(f"{where()}: {name} takes values of the points out of PyTorch")
        elif depends & _PARAMETER:
            self.lost.append(f"{where()}: {name} takes a parameter's value out of PyTorch, and its gradient is lost")

    def _decided(self, number: int, decision: Decision, func: Any) -> None:
        codes = decision.codes
        dim = decision.dim if isinstance(decision, Choice) else None
        if (
            func.__name__ == "level_set"
            and isinstance(decision, Level)
            and decision.margin
            and bool(decision.margin().isnan().all())
        ):
            self.problems.append(f"{where()}: level_set is given NaN everywhere, and declares nothing")
        self.met.append(_Met(func.__name__, where(), tuple(codes.shape), dim, self._now, name_of(func) in _SELDOM))

    def _note(self, tensor: Tensor, depends: int) -> None:
        self._depends[id(tensor)] = self._depends.get(id(tensor), 0) | depends
        # an id is one tensor's only while that lives
        self._alive.append(tensor)
        self._stores[_store(tensor)] = self._depends[id(tensor)]

    def _origin(self, tensor: Tensor, user: str) -> int:
        """What a tensor depends on; one that f did not make is a parameter, a constant, or made where nothing is seen."""
        known = self._depends.get(id(tensor))
        if known is not None:
            return known
        # what a transform shows, and what it returns, is another tensor on the same storage
        known = self._stores.get(_store(tensor))
        if known is not None:
            self._note(tensor, known)
            return known
        plain = held(tensor)
        if plain is not tensor:
            self._note(tensor, self._origin(plain, user))
            return self._depends[id(tensor)]
        depends = 0
        if tensor.requires_grad:
            depends = _PARAMETER | 1 << _FIRST + 2 * self._tensors
            self._tensors += 1
        if tensor.grad_fn is not None and _reaches(tensor, self._leaves):
            depends |= _POINT
            self.hidden.append(
                f"{where()}: {user} takes a tensor from code that the trace cannot see (scripted, compiled, or a kernel)"
            )
        elif not tensor.requires_grad:
            for axis, size in enumerate(tensor.shape):
                if size == self.points:
                    text = f"{where()}: {user} takes a tensor from code that the trace cannot see (numpy, or a kernel)"
                    self.strangers[self._calls, axis] = text
        self._note(tensor, depends)
        return depends


def _store(tensor: Tensor) -> object:
    """What tells whose memory a tensor is in."""
    plain = held(tensor)
    return plain.untyped_storage() if plain.layout == torch.strided else plain


def _custom(func: Any) -> bool:
    """Whether a function is an operator that was registered with PyTorch by somebody else."""
    name = getattr(func, "_qualified_op_name", None) or (func.name() if isinstance(func, torch._ops.OpOverload) else "")
    return "::" in name and name.split("::")[0] not in _OURS


def _reaches(tensor: Tensor, leaves: Sequence[Tensor]) -> bool:
    """Whether the graph behind a tensor holds one of the leaves."""
    seen, stack = set(), [tensor.grad_fn]
    while stack:
        node = stack.pop()
        if node is None or node in seen:
            continue
        seen.add(node)
        if any(getattr(node, "variable", None) is leaf for leaf in leaves):
            return True
        stack.extend(parent for parent, _ in node.next_functions)
    return False
