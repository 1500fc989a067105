"""From what the rounds so far found to the numbers of evaluations of the next: an allocation at work on a picture."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_mcaa.allocation import Allocation, dense
from torch_mcaa.errors import McaaError
from torch_mcaa.estimators import Estimate
from torch_mcaa.estimators.base import pooled

_CAP = 64
"""What one pixel may be given by an estimated variance, in evaluations over the mean: a tail that was met once does not draw them all."""


def shared_out(allocation: Allocation, picture: Estimate | None, inside: Tensor, total: int, floor: int) -> tuple[Tensor, float]:
    """(H, W) int64 evaluations of the pixels `inside`, adding up to `total`, and what the allocation predicts of them.

    Raises:
        McaaError: variances that are known, but for another picture.
    """
    known: Tensor | None = getattr(allocation, "known", None)
    if known is not None and known.shape != inside.shape:
        raise McaaError(f"the known variances of {allocation} have shape {tuple(known.shape)}, the picture {tuple(inside.shape)}")
    cap = None
    if known is None:
        assert picture is not None
        known = _variance(picture, allocation.unseen)
        cap = _CAP * -(-total // int(inside.sum()))
    variance = known.to(inside.device)[inside][None]
    counts = torch.zeros_like(inside, dtype=torch.int64)
    counts[inside] = dense(allocation.counts(variance, total, floor, cap)[0])
    return counts, allocation.predicted(variance, total)


def _variance(picture: Estimate, unseen: float) -> Tensor:
    """(H, W) float64: the variance of one evaluation, the mean over the channels, as far as the rounds so far tell.

    Pooled over 3 x 3 pixels, and with one more observation, of weight `unseen`, of the variance that half the range of the values would have:
    a flat pilot of n points says that the variance is small, not that it is 0.
    """
    assert picture.diagnostics is not None
    n, value = picture.points.to(torch.float64), picture.value.to(torch.float64).nan_to_num(nan=0.0, posinf=0.0, neginf=0.0)
    half = ((value.amax((1, 2)) - value.amin((1, 2))) / 2).square()[:, None, None] * unseen
    own = picture.diagnostics.predicted.to(torch.float64) * n
    return ((9 * n * pooled(own) + half) / (9 * n + 1)).mean(0)
