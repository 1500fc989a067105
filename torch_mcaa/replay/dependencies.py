"""What an integrand depends on: the tensors whose gradients a replayed evaluation of f can give.

A closure does not say what it uses. f is run twice on a few points, and every argument of a PyTorch operation that requires a gradient is
noted; what is noted in both runs was not made by f, so it comes from outside. The graph of f's values tells what operations that
cannot be seen, such as custom ones and scripted code, have used beside.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor, enable_grad
from torch.autograd.graph import Node, get_gradient_edge, saved_tensors_hooks
from torch.overrides import TorchFunctionMode
from torch.utils._pytree import tree_map_only

from torch_mcaa.errors import McaaError
from torch_mcaa.integrand import Function, Integrand
from torch_mcaa.traced.nested import tensors_in
from torch_mcaa.traced.steps import called, lacks_derivative
from torch_mcaa.traced.trace import eagerly
from torch_mcaa.traced.transforms import held

_SEVERING = {"item", "tolist", "__float__", "__int__", "__bool__", "__index__", "__complex__"}


@dataclass(frozen=True)
class Dependencies:
    """Tensors outside f that it uses and that require a gradient.

    Attributes:
        tensors: all of them, each once.
        stand_ins: by which f is differentiated in their place; themselves unless one was computed from another.
        smooth: whether f's values have a gradient, as far as autograd knows.
        own: how many leaves of their graph f makes itself, as for a slope inside it.
        steps: whether f uses steps whose slope of 0 autograd does not know.
        severed: the methods by which f turns a tensor that requires a gradient into a number, where no gradient passes.
    """

    tensors: tuple[Tensor, ...]
    stand_ins: tuple[Tensor, ...]
    smooth: bool
    own: int
    steps: bool = False
    severed: frozenset[str] = frozenset()

    def apart(self, f: Function) -> Function:
        """f with the stand-ins where it uses the tensors."""
        others = {id(a): b for a, b in zip(self.tensors, self.stand_ins, strict=True) if a is not b}
        if not others:
            return f

        def apart(x: Tensor, y: Tensor) -> object:
            with eagerly(), _StandingIn(others):
                return f(x, y)

        return apart


def dependencies(integrand: Integrand, x: Tensor, y: Tensor) -> Dependencies:
    """Find what f depends on at some points.

    Raises:
        McaaError: f uses a tensor that was computed from others outside it, in a way that cannot be seen, or one of another device.
    """
    runs: list[_Noting] = []
    graphs: list[Sequence[Tensor]] = []
    with enable_grad(), unheard():
        for _ in range(2):
            runs.append(_Noting())
            try:
                graphs.append(replace(integrand, function=runs[-1].during(integrand.function))(x, y))
            except McaaError as error:
                for tensor in runs[-1].noted.values():
                    if tensor.device != x.device:
                        raise McaaError(
                            f"the layer's pictures are on {x.device}, and f uses a tensor of shape {tuple(tensor.shape)} on "
                            f"{tensor.device}; move one by layer.to() or tensor.to()"
                        ) from error
                raise
    outside = {key: tensor for key, tensor in runs[0].noted.items() if key in runs[1].noted}
    for tensor in outside.values():
        if tensor.is_inference():
            raise McaaError(
                f"f uses a tensor of shape {tuple(tensor.shape)} that requires a gradient and was made under torch.inference_mode(), "
                "where there is no graph for one; make it, or the module that holds it, outside"
            )
    (nodes, leaves), (others, others_leaves) = (_walk(values, outside.values()) for values in graphs)
    _check_seen(nodes & others)
    common = {key: leaf for key, leaf in leaves.items() if key in others_leaves}
    smooth = any(value.requires_grad for value in graphs[1])
    own, severed = len(others_leaves) - len(common), frozenset(runs[1].severed)
    tensors = tuple({**outside, **common}.values())
    found = Dependencies(tensors, _stand_ins(tensors), smooth, own, runs[1].steps, severed)
    if any(a is not b for a, b in zip(tensors, found.stand_ins, strict=True)):
        with enable_grad(), unheard():
            values = replace(integrand, function=found.apart(integrand.function))(x, y)
        # where it cannot be seen, f goes on using what they stand for
        _check_seen({edge.node for edge in map(get_gradient_edge, tensors)} & _walk(values, found.stand_ins)[0])
    return found


def _check_seen(nodes: set[Node]) -> None:
    """Refuse what was computed outside f, of which f's values are seen to be a function."""
    hidden = sorted(node.name() for node in nodes if not _is_leaf(node))
    if hidden:
        raise McaaError(
            f"f uses a tensor that was computed outside it ({', '.join(hidden)}) in a custom operation or scripted code, or inside a transform "
            "of torch.func that it is an argument of, where it cannot be found; let f use it in an operation of PyTorch first, as in 1 * tensor"
        )


def _stand_ins(tensors: Sequence[Tensor]) -> tuple[Tensor, ...]:
    """The tensors, or leaves that share their memory in the place of those that were computed from others of them.

    A gradient by such another one would count what passes through them, which autograd passes on itself.
    """
    nodes = [get_gradient_edge(tensor).node for tensor in tensors]
    reached = [_walk([tensor], ())[0] - {node} for tensor, node in zip(tensors, nodes, strict=True)]
    return tuple(
        tensor.detach().requires_grad_() if below & set(nodes) else tensor for tensor, below in zip(tensors, reached, strict=True)
    )


def unheard() -> AbstractContextManager[Any]:
    """Hooks for saved tensors that are set outside, such as a checkpoint's, do not hear of what is inside."""
    # where there are any, torch.func.grad inside f refuses to work
    some = torch._C._autograd._top_saved_tensors_default_hooks(True)  # pyright: ignore[reportAttributeAccessIssue]
    return saved_tensors_hooks(Tensor.detach, lambda kept: kept) if some else nullcontext()


def check_reached(values: Sequence[Tensor], known: Dependencies) -> None:
    """Refuse values whose gradient would reach a tensor that is not known: it would be lost.

    Raises:
        McaaError: f uses a tensor here that it had not used before.
    """
    _, leaves = _walk(values, known.stand_ins)
    if len(leaves) > known.own:
        shapes = ", ".join(str(tuple(leaf.shape)) for leaf in leaves.values())
        raise McaaError(
            f"f uses tensors that require a gradient (of shape {shapes}) at some points and had not used them at the first ones it was "
            "asked for; let it use the same tensors at each call, with weights of 0 where they do not matter"
        )


class _Noting(TorchFunctionMode):
    """Notes arguments that require a gradient, and the methods that lose it."""

    def __init__(self) -> None:
        super().__init__()
        # the tensors are held, so that no other gets an identity of theirs
        self.noted: dict[int, Tensor] = {}
        self.severed: set[str] = set()
        self.steps = False

    def during(self, f: Function) -> Function:
        def noted(x: Tensor, y: Tensor) -> object:
            with eagerly(), self:
                return f(x, y)

        return noted

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        for argument in map(held, tensors_in((args, kwargs or {}))):
            if argument.requires_grad:
                self.noted[id(argument)] = argument
                if getattr(func, "__name__", "") in _SEVERING:
                    self.severed.add(func.__name__)
        self.steps |= lacks_derivative(func)
        return called(func, args, kwargs or {})


class _StandingIn(TorchFunctionMode):
    """Has other tensors in the place of some, by their identity."""

    def __init__(self, others: dict[int, Tensor]) -> None:
        super().__init__()
        self.others = others

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        args, kwargs = tree_map_only(Tensor, lambda tensor: self.others.get(id(tensor), tensor), (args, kwargs or {}))
        return func(*args, **kwargs)


def _walk(values: Iterable[Tensor], stops: Iterable[Tensor]) -> tuple[set[Node], dict[int, Tensor]]:
    """The nodes of the graph of the values as far as the tensors `stops`, and the leaves met beside those, by their identity."""
    ends = {edge[:2] for edge in map(get_gradient_edge, stops)}
    ahead = [edge[:2] for edge in (get_gradient_edge(value) for value in values if value.requires_grad)]
    nodes: set[Node] = set()
    leaves: dict[int, Tensor] = {}
    while ahead:
        edge = ahead.pop()
        node = edge[0]
        if edge in ends or node in nodes:
            continue
        nodes.add(node)
        if _is_leaf(node):
            leaf: Tensor = node.variable  # pyright: ignore[reportAttributeAccessIssue]
            leaves[id(leaf)] = leaf
        ahead.extend((following, number) for following, number in node.next_functions if following is not None)
    return nodes, leaves


def _is_leaf(node: Node) -> bool:
    return node.name() == "torch::autograd::AccumulateGrad"
