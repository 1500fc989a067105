"""The discrete decisions of f, recorded while it runs: a signature of each point, and the margin of a decision when it is asked for.

Two points between which f is continuous have equal signatures, unless a part of f is hidden from PyTorch. Where the signatures of two points
close to each other differ, the first decision that differs, in the order in which f takes them, is the cause: all before it is
continuous there, so that its margin is, and crosses zero.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode

from torch_mcaa.errors import HOMES, McaaError
from torch_mcaa.traced.decisions import ESCAPES, Choice, Decision, Level, in_place
from torch_mcaa.traced.inside import transformed
from torch_mcaa.traced.ruling import rule_of, unruled
from torch_mcaa.traced.steps import called
from torch_mcaa.traced.transforms import beyond, outside

if TYPE_CHECKING:
    from torch_mcaa.traced.program import Program


@dataclass(frozen=True)
class Site:
    """A decision as the probe met it: `name` of the operation, `where` in the user's code, `axis` of its codes along which the points lie.

    The axis is None for a decision that is the same at all points, or cannot be laid out by points. `tensors` and `decisions`: the tensors that
    want a gradient, and the earlier decisions, on which it depends, a bit each.
    """

    name: str
    where: str
    axis: int | None
    tensors: int
    decisions: int

    @property
    def moves(self) -> bool:
        """Whether its edge does, with some tensor; the others' edges stay where they are, and have no part in any derivative."""
        return self.tensors != 0


class Watch(TorchFunctionMode):
    """While it is active, `visit(number, decision)` is called for each decision, in f's order; with `bends` where f bends, too."""

    follows = True
    """By which `watched` knows it, without this file."""

    def __init__(self, visit: Callable[[int, Decision, Any], None], bends: bool = False) -> None:
        super().__init__()
        self._visit, self._bends = visit, bends
        self.number = 0

    def __torch_function__(self, func: Any, types: Any, args: Sequence[Any] = (), kwargs: dict[str, Any] | None = None) -> Any:
        kwargs = kwargs or {}
        rule = rule_of(func, self._bends)
        if rule is None:
            if getattr(func, "__name__", "") in ESCAPES and args and args[0].requires_grad:
                # an array of a tensor with a gradient is refused, and f may never have been given one
                args = [args[0].detach(), *args[1:]]
            result = func(*args, **kwargs)
            return self._met(unruled(func, args, kwargs, result), func, result)
        given = args if args else [kwargs["input"]] if "input" in kwargs else []
        if in_place(func) or "out" in kwargs:
            # the margin is of what was there before
            given = [a.clone() if isinstance(a, Tensor) else a for a in given]
        result = called(func, args, kwargs)
        return self._met(rule(given, kwargs, result) or unruled(func, args, kwargs, result), func, result)

    def _met(self, decision: Decision | None, func: Any, result: Any) -> Any:
        """The result, after a visit of the decision, if it is one."""
        if decision is not None:
            decision = outside(decision) if transformed() else decision
            with beyond():
                self._visit(self.number, decision, func)
            self.number += 1
        return result


class Traced:
    """f, with its decisions shown to `visit` as (points, lanes): an integrand for points in one row.

    Attributes:
        changed: None, or what was met where another decision was expected.
    """

    def __init__(
        self, function: Callable[[Tensor, Tensor], Any], program: Program, visit: Callable[[int, Lanes, Site], None]
    ) -> None:
        self.function, self.sites, self.bends, self.visit = function, program.sites, program.bends, visit
        self.points = 0
        self.changed: str | None = None

    def __call__(self, x: Tensor, y: Tensor) -> Any:
        self.points = len(x)
        with eagerly(), Watch(self._decided, self.bends) as watch:
            result = self.function(x, y)
        if watch.number != len(self.sites) and self.changed is None:
            last = self.sites[watch.number].where if watch.number < len(self.sites) else "its end"
            self.changed = f"{watch.number} decisions where there had been {len(self.sites)}, up to {last}"
        return result

    def _decided(self, number: int, decision: Decision, func: Any) -> None:
        if self.changed is not None:
            return
        site = self.sites[number] if number < len(self.sites) else None
        name = func.__name__
        if site is None or site.name != name:
            self.changed = f"{name} ({where()}) where there had been {'nothing' if site is None else f'{site.name} ({site.where})'}"
        elif site.axis is not None:
            if decision.codes.shape[site.axis] != self.points:
                self.changed = f"{name} on {tuple(decision.codes.shape)} for {self.points} points ({site.where})"
            else:
                self.visit(number, Lanes(decision, site.axis), site)


class Lanes:
    """A decision laid out by points: several at once where it has more axes."""

    def __init__(self, decision: Decision, axis: int) -> None:
        self.decision, self.axis = decision, axis

    @property
    def blind(self) -> bool:
        """Whether nothing is known that crosses zero where the codes change."""
        return isinstance(self.decision, Level) and self.decision.margin is None

    def codes(self) -> Tensor:
        """(points, lanes) bool, or whole numbers of any type."""
        return self._by_point(self.decision.codes)

    def margin(self, point: Tensor, branch: Tensor, graph: bool) -> Tensor:
        """(M,): the margin at points (M,) for `branch` (M, 3), the lane and the two codes between which it lies."""
        lane, low, high = branch.unbind(1)
        decision = self.decision
        with torch.set_grad_enabled(graph):
            if isinstance(decision, Choice):
                # of as many groups as there are lanes over choices in a lane
                values = self._by_point(decision.values.movedim(decision.dim, -1), self._chosen_axis(), 1)
                group = lane // decision.codes.shape[decision.dim]
                return values[point, group, high] - values[point, group, low]
            assert decision.margin is not None
            return self._by_point(decision.margin().expand(decision.codes.shape))[point, lane]

    def _chosen_axis(self) -> int:
        assert isinstance(self.decision, Choice)
        return self.axis - (self.decision.dim < self.axis)

    def _by_point(self, tensor: Tensor, axis: int | None = None, kept: int = 0) -> Tensor:
        if isinstance(self.decision, Choice) and kept == 0:
            tensor, axis = tensor.movedim(self.decision.dim, -1), self._chosen_axis()
        tensor = tensor.movedim(self.axis if axis is None else axis, 0)
        return tensor.reshape(len(tensor), -1, *tensor.shape[tensor.ndim - kept :] if kept else ())


def eagerly() -> AbstractContextManager[Any]:
    """Compiled code runs uncompiled inside, so that its decisions are seen; where nothing is compiled no compiler is imported."""
    return torch.compiler.set_stance("force_eager") if "torch._dynamo" in sys.modules else nullcontext()


def changed_program(what: str) -> McaaError:
    return McaaError(
        f"f took other decisions than before: {what}; its Python control flow depends on values, or on how many points there are (as "
        "vmap's chunk_size does): write it with torch.where, so that every call runs the same operations, and a loop of a fixed number of steps"
    )


def where() -> str:
    """file:line of the innermost frame of code that is neither PyTorch's nor ours."""
    frame = sys._getframe(1)
    while frame is not None:
        name = frame.f_code.co_filename
        if not name.startswith(HOMES) and not name.startswith("<"):
            return f"{name}:{frame.f_lineno}"
        frame = frame.f_back
    return "(no line of Python)"
