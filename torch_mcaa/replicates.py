"""What two rounds tell of each other: their points are independent, so no model of f is needed to learn how far their mean is off."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torch_mcaa.estimators import Estimate
from torch_mcaa.estimators.base import box3
from torch_mcaa.estimators.lattice.audit import tile_means

_TILE = 8
"""Px: over how much of the screen the rounds' disagreement is compared with what they reported."""
_OUTGROWN = 0.25
_ONE_OBSERVATION = 2.0
"""What the square of one difference is multiplied by: a tone errs alike over the whole picture, and then there is no other."""
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
    so the largest is taken of the pixel's own, its neighbours' mean, and what was reported times the ratio of both over the tile, or over it
    and its neighbours: a pixel that stands out in the report stands out in the result. And never less than what the rounds
    are `blind` to, (C, h, w), as far as points off their lattices tell: two lattices may err alike.
    Where they are `doubted`, more than was reported if they are at odds: one of them saw nothing of what is there, and reports little.
    """
    seen = torch.nan_to_num(difference.square() * (share * (1 - share)))
    known = reported.isfinite()
    finite = torch.where(known, reported, 0)
    disagreed, claimed = (torch.stack([tile_means(plane, _TILE, _TILE) for plane in planes]) for planes in (seen, finite))
    around = box3(disagreed) / box3(claimed).clamp_min(torch.finfo(claimed.dtype).tiny)
    ratio = torch.maximum(disagreed / claimed.clamp_min(torch.finfo(claimed.dtype).tiny), around).clamp_max(1)

    def spread(tiles: Tensor) -> Tensor:
        return tiles.repeat_interleave(_TILE, 1).repeat_interleave(_TILE, 2)[:, : seen.shape[1], : seen.shape[2]]

    own = _ONE_OBSERVATION * torch.maximum(seen, box3(seen))
    told = torch.maximum(own, finite * spread(ratio))
    if blind is not None:
        told = torch.maximum(told, blind)
    told = torch.minimum(told, finite)
    if doubted:
        at_odds = spread(disagreed * (disagreed > _AT_ODDS * claimed))
        told = torch.where(at_odds > 0, torch.maximum(told, torch.maximum(own, at_odds)), told)
    return torch.where(known, told, reported)
