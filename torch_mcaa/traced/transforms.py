"""Decisions inside vmap, grad and other transforms of functions, as decisions on the tensors behind those that the transforms show."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Any

import torch
from torch import Tensor

from torch_mcaa.traced.decisions import Choice, Decision, Level
from torch_mcaa.traced.inside import functorch, transformed


def behind(tensor: Tensor) -> Tensor:
    """The tensor behind that of a transform; axes that vmap hides come first, and the graph is that outside the transforms."""
    while functorch.is_functorch_wrapped_tensor(tensor):
        mapped = functorch.maybe_get_bdim(tensor)
        tensor = functorch.get_unwrapped(tensor)
        if mapped >= 0:
            tensor = tensor.movedim(mapped, 0)
    return tensor


def held(tensor: Tensor) -> Tensor:
    """The tensor behind that of a transform as it was given to it, axes that vmap hides where they are."""
    while functorch.is_functorch_wrapped_tensor(tensor):
        tensor = functorch.get_unwrapped(tensor)
    return tensor


def outside(decision: Decision) -> Decision:
    """The decision for code that runs `beyond` the transforms, where nothing can be computed from what is inside."""
    codes = behind(decision.codes)
    if isinstance(decision, Choice):
        values = behind(decision.values)
        return Choice(codes, values, decision.dim + values.ndim - decision.values.ndim)
    if decision.margin is None:
        return Level(codes, None)
    with torch.enable_grad():
        margin = behind(decision.margin().expand(decision.codes.shape))
    return Level(codes, _given(margin))


def _given(margin: Tensor) -> Callable[[], Tensor]:
    return lambda: margin


def beyond() -> AbstractContextManager[Any]:
    """No transform is active inside."""
    if not transformed():
        return nullcontext()
    from torch._functorch.pyfunctorch import temporarily_clear_interpreter_stack

    return temporarily_clear_interpreter_stack()
