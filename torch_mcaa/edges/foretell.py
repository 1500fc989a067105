"""Where the crossings of neighbouring lines foretell one, so that a short bracket about that place stands for most of the bisection."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from torch_mcaa import rng
from torch_mcaa.edges.bisect import Crossings, ask_on
from torch_mcaa.edges.candidates import Segments
from torch_mcaa.edges.lines import Ask

_STREAM = 0xF0E7
_WITHIN = 2.0**-9
"""Px either side: an edge of a radius of 3 px bends less between lines of a fifth of a pixel."""
_FAR = 2.0**24


def narrowed(ask: Ask, segments: Segments, known: Crossings, apart: float, seed: int) -> Segments:
    """The segments, short brackets in the place of those in which one of `known` on a line either side foretells the only crossing.

    Two evaluations for each that is tried. `apart`: lines further than that, in px, foretell nothing.
    """
    if len(known) == 0 or len(segments) == 0:
        return segments
    place, found = _foretold(segments, known, apart)
    tried = (found & ~segments.single & (place > segments.low + 2 * _WITHIN) & (place < segments.high - 2 * _WITHIN)).nonzero()[
        :, 0
    ]
    if len(tried) == 0:
        return segments
    some, place = segments.take(tried), place[tried]
    # no two brackets alike: the middles of the last ones must not err alike
    shape = _WITHIN * (1 + 0.25 * rng.uniform(seed, _STREAM, some.axis, *some.key.unbind(1), dtype=torch.float64))
    low, high = place - shape, place + _WITHIN
    values = ask_on(ask, some.axis, torch.cat([low, high]), some.across.repeat(2))
    before, after = values[:, : len(place)], values[:, len(place) :]
    right = (((before - some.before).abs() <= some.least) & ((after - some.after).abs() <= some.least)).all(0)
    tried, low, high, before, after = tried[right], low[right], high[right], before[:, right], after[:, right]
    return replace(
        segments,
        low=segments.low.index_copy(0, tried, low),
        high=segments.high.index_copy(0, tried, high),
        before=segments.before.index_copy(1, tried, before),
        after=segments.after.index_copy(1, tried, after),
    )


def _foretold(segments: Segments, known: Crossings, apart: float) -> tuple[Tensor, Tensor]:
    """(S,): where the known crossings nearest above and below would have theirs on the segment's line, and whether there are such."""
    # by column of pixels along the line, then by line
    place = known.place.floor() * _FAR + known.across
    order = torch.argsort(place)
    place = place[order]
    sides = []
    for step in (0, -1):
        nearest = torch.full_like(segments.across, -1).to(torch.int64)
        distance = torch.full_like(segments.across, apart)
        for shift in (-1, 0, 1, 2):
            target = (segments.low.floor() + shift) * _FAR + segments.across
            index = (torch.searchsorted(place, target, right=step == 0) + step).clamp(0, len(place) - 1)
            one = order[index]
            off = (known.across[one] - segments.across).abs()
            fits = (known.place[one].floor() == segments.low.floor() + shift) & (off < distance)
            fits &= (known.across[one] >= segments.across) if step == 0 else (known.across[one] <= segments.across)
            alike = (known.jump[:, one] - (segments.after - segments.before)).abs() <= segments.least
            fits &= (alike | segments.least.isinf()).all(0)
            nearest, distance = torch.where(fits, one, nearest), torch.where(fits, off, distance)
        sides.append((nearest, distance))
    (above, up), (below, down) = sides
    found = (above >= 0) & (below >= 0)
    share = torch.where(up + down > 0, down / (up + down).clamp_min(1e-12), 0.5)
    return known.place[below.clamp_min(0)] * (1 - share) + known.place[above.clamp_min(0)] * share, found
