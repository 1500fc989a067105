"""A derivative that exists once: the second one would leave terms out, and is refused."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from torch_mcaa.errors import McaaError


def zero_with_gradient(margin: Tensor) -> Tensor:
    """margin less itself: 0 everywhere, with margin's gradient; its second derivative raises McaaError."""
    return _Zero.apply(margin)  # pyright: ignore[reportReturnType]


def refuse_second(gradient: Tensor, through: Tensor) -> Tensor:
    """`gradient` as it is; to differentiate it raises McaaError. through: a tensor with a graph to what might be differentiated by."""
    return _Refused.apply(gradient, through)  # pyright: ignore[reportReturnType]


class _Zero(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, margin: Tensor) -> Tensor:
        ctx.save_for_backward(margin)
        return torch.zeros_like(margin)

    @staticmethod
    def backward(ctx: Any, *grad_outputs: Tensor) -> Tensor:
        (margin,) = ctx.saved_tensors
        return refuse_second(grad_outputs[0], margin) if torch.is_grad_enabled() else grad_outputs[0]


class _Refused(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, gradient: Tensor, through: Tensor) -> Tensor:
        return gradient.clone()

    @staticmethod
    def backward(ctx: Any, *grad_outputs: Tensor) -> Tensor:
        raise McaaError(
            "a second derivative was asked for through the edges of f, where only first ones are right: got create_graph=True and a "
            "derivative of the gradient; use a first-order method, or discontinuities=False to leave the edges out"
        )
