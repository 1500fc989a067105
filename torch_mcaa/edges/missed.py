"""What samples on a line miss of a filter that is not a product."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_mcaa.edges.bisect import placed
from torch_mcaa.filters.base import Filter


def missed(filter: Filter, axis: int, along: Tensor, across: Tensor, points: Tensor, spacing: float) -> Tensor:
    """(K, K, N), rows and columns: what a sum of w over points `spacing` px apart misses of its integral beyond places on lines along `axis`.

    What it misses of the whole line is shared out over the filter's width, smoothly: a place that no filter reaches misses nothing, and the
    sum over the lines of what was shared out is as near to 0 as their mean is to the integral.

    Args:
        along, across: (K, N) px, the places from the centres of the pixels around.
        points: (M, N) or (M, 1) px, those of the samples that reach a pixel from its centre, along the line.
    """
    radius, side = filter.radius[axis], across[:, None]
    weight = spacing * filter(*placed(axis, points[:, None], across[None]))
    past = (points[:, None] > along[None]).to(weight.dtype)
    beyond = filter.beyond(*placed(axis, along[None], side), axis)
    whole = filter.beyond(*placed(axis, along.new_full((1, 1, 1), -radius), side), axis)
    place = ((along / radius + 1) / 2).clamp(0, 1)
    left = 1 - place**3 * (10 - 15 * place + 6 * place.square())
    found = beyond - torch.einsum("mkn,mln->kln", weight, past) - (whole - weight.sum(0)[:, None]) * left
    return found if axis == 0 else found.transpose(0, 1).contiguous()
