"""What two rounds tell of each other: their points are independent, so no model of f is needed to learn how far their mean is off."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torch_mcaa.estimators import Estimate
from torch_mcaa.estimators.audit import tile_means
from torch_mcaa.estimators.base import box3

_TILE = 8
"""Px: over how much of the screen the rounds' disagreement is compared with what they reported."""
_OUTGROWN = 0.25
_AT_ODDS = 4.0
"""How many times what was reported a tile's rounds may disagree by before they cannot both be right."""


@dataclass(frozen=True)
class Latest:
    """A cell's last round: what it found, its evaluations a pixel, and its weight."""

    found: Estimate
    points: float
    weight: float

    def outgrows(self, new: Tensor, mean: Tensor) -> bool:
        """Whether a `new` round agrees so much better with it than with the `mean` of all (C, h, w) that those before it only spoil that.

        Where the error falls as n^-1.5 or slower the mean is nearer; a lattice that has become fine enough for a smooth f is exact.
        """
        near, far = (float((new - old).square().mean(dtype=torch.float64)) for old in (self.found.value, mean))
        return near < _OUTGROWN * far


def agreed(difference: Tensor, reported: Tensor, share: float, blind: Tensor | None, doubted: bool) -> Tensor:
    """(C, h, w): the variance of the mean of two rounds of which one has the weight `share`: what they `reported` together, or less.

    share (1 - share) difference^2 has the mean's variance for its expectation where the weights are the inverse variances. It is one observation,
    so the largest is taken of the pixel's own, its neighbours' mean, and what was reported times the ratio of both over the tile, or a
    neighbouring one, that disagrees most: a pixel that stands out in the report stands out in the result. And never less than what the rounds
    are `blind` to, (C, h, w), as far as points off their lattices tell: two lattices may err alike.
    Where they are `doubted`, more than was reported if they are at odds: one of them saw nothing of what is there, and reports little.
    """
    seen = torch.nan_to_num(difference.square() * (share * (1 - share)))
    known = reported.isfinite()
    finite = torch.where(known, reported, 0)
    ratio = torch.stack(
        [
            tile_means(s, _TILE, _TILE) / tile_means(r, _TILE, _TILE).clamp_min(torch.finfo(r.dtype).tiny)
            for s, r in zip(seen, finite, strict=True)
        ]
    )
    at_odds = (ratio > _AT_ODDS) & doubted
    ratio = torch.nn.functional.max_pool2d(torch.where(at_odds, ratio, ratio.clamp_max(1)), 3, 1, 1)
    spread = ratio.repeat_interleave(_TILE, 1).repeat_interleave(_TILE, 2)[:, : seen.shape[1], : seen.shape[2]]
    told = torch.maximum(torch.maximum(seen, box3(seen)), finite * spread)
    if blind is not None:
        told = torch.maximum(told, blind)
    return torch.where(known, torch.minimum(told, finite * spread.clamp_min(1)), reported)
