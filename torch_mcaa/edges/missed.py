"""What samples on a line miss of a filter that is not a product."""

from __future__ import annotations

from torch import Tensor

from torch_mcaa.filters.base import Filter


def missed(filter: Filter, axis: int, along: Tensor, across: Tensor, points: Tensor, spacing: float) -> Tensor:
    """(N, K, K), rows and columns: what a sum of w over points `spacing` px apart misses of its integral beyond places on lines along `axis`.

    What it misses of the whole line is shared out over the filter's width, smoothly: a place that no filter reaches misses nothing, and the
    sum over the lines of what was shared out is as near to 0 as their mean is to the integral.

    Args:
        along, across: (N, K) px, the places from the centres of the pixels around.
        points: (N, M) or (1, M) px, those of the samples that reach a pixel from its centre, along the line.
    """

    def ordered(t: Tensor, s: Tensor) -> tuple[Tensor, Tensor]:
        return (t, s) if axis == 0 else (s, t)

    radius, side = filter.radius[axis], across[:, :, None]
    weight = spacing * filter(*ordered(points[:, None], side))
    past = (points[:, None] > along[..., None]).to(weight.dtype)
    beyond = filter.beyond(*ordered(along[:, None], side), axis)
    whole = filter.beyond(*ordered(along.new_full((1, 1, 1), -radius), side), axis)
    place = ((along / radius + 1) / 2).clamp(0, 1)
    left = 1 - place**3 * (10 - 15 * place + 6 * place.square())
    found = beyond - weight @ past.mT - (whole - weight.sum(2, keepdim=True)) * left[:, None]
    return found if axis == 0 else found.mT.contiguous()
