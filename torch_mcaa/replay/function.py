"""The node of autograd's graph behind a picture."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from torch_mcaa.errors import McaaError
from torch_mcaa.replay.gradients import Replay
from torch_mcaa.replay.of_texels import OfTexels
from torch_mcaa.traced.inside import functorch


class Replayed(torch.autograd.Function):
    """The picture, whose backward pass is a `Replay`, or an `OfTexels`: `apply(replay, picture, *replay.parameters)`."""

    @staticmethod
    def forward(ctx: Any, replay: Replay | OfTexels, picture: Tensor, *parameters: Tensor) -> Tensor:
        ctx.replay = replay
        # autograd refuses to go on if one of them is changed in place before the backward pass
        ctx.save_for_backward(picture, *parameters)
        return picture

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> Any:
        picture, *parameters = ctx.saved_tensors
        (grad,) = grads
        if functorch.is_legacy_batchedtensor(grad) or functorch.is_functorch_wrapped_tensor(grad):
            raise McaaError(
                "a picture's backward pass takes one gradient at a time, received a batch of them, by is_grads_batched=True, vectorize=True or "
                "vmap: ask for one after the other"
            )
        with torch.no_grad(), torch.autocast(grad.device.type, enabled=False):
            found = ctx.replay.gradients(grad, picture)
        if torch.is_grad_enabled():
            found = _Once.apply(len(found), grad, *parameters, *found)
        return None, None, *found


class _Once(torch.autograd.Function):
    """Gradients as they are, that have none themselves."""

    @staticmethod
    def forward(ctx: Any, count: int, grad: Tensor, *rest: Tensor | None) -> tuple[Tensor | None, ...]:
        return tuple(rest[len(rest) - count :])

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> Any:
        raise McaaError(
            "a picture's gradient has no gradient itself: second derivatives through the layer are not there; "
            "take differences of first ones"
        )
