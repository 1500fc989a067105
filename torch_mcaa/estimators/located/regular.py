"""Whether half of a lattice's lines foretell what the other half shows: edges do, detail on every scale does not."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_mcaa.edges.bisect import Crossings
from torch_mcaa.edges.candidates import Segments
from torch_mcaa.edges.foretell import foretold
from torch_mcaa.estimators.located.blocks import blocks_of, by_pixel, shape_of
from torch_mcaa.grid import Cell

_SEEN, _FORETOLD, _PARTS = 48, 0.75, 2
"""Segments of a block from which on it is lost if a smaller share is foretold; unless segments have as many parts."""
_MOSTLY = 0.75
"""The share of segments that hold a jump from which on all are worth a look."""


def regular(
    cell: Cell, segments: list[Segments], others: list[Segments], known: list[Crossings], apart: float
) -> tuple[list[Segments], Tensor]:
    """The segments that are worth a look, for either axis, and the pixels (h, w) of the blocks that are lost.

    A block is lost if the `others`, whose crossings are `known`, do not foretell enough of it: no more segments are expected to hold a jump than
    of the others did. If that is few of them, only those that are foretold are worth a look: edges are followed over the other lines. Thin pieces,
    and steps of which bisection finds many parts, are not foretold and say nothing.
    """
    size = shape_of(cell)
    where, beside = ([blocks_of(cell, s) for s in some] for some in (segments, others))
    right = [foretold(s, c, apart) for s, c in zip(segments, known, strict=True)]
    every, met, tried, held = (torch.zeros(size[0] * size[1], dtype=torch.float64, device=known[0].place.device) for _ in range(4))
    for some, other, crossings, block, near, told in zip(segments, others, known, where, beside, right, strict=True):
        if len(crossings) < _PARTS * (int(crossings.segment.max()) + 1 if len(crossings) else 0):
            jumped = torch.zeros_like(other.single)
            jumped[crossings.segment] = True
            for total, counted in (
                (every, block[~some.single]),
                (met, block[~some.single & told]),
                (tried, near[~other.single]),
                (held, near[~other.single & jumped]),
            ):
                total += torch.bincount(counted, minlength=len(total))
    share = torch.where(tried > 0, held / tried.clamp_min(1), 1)
    lost = (every >= _SEEN) & (met < _FORETOLD * share * every)
    whole = (share >= _MOSTLY) | (tried < _SEEN)
    kept = [s.take(~lost[block] & (whole[block] | s.single | told)) for s, block, told in zip(segments, where, right, strict=True)]
    return kept, by_pixel(lost.view(size), cell)
