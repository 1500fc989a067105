"""Where the crossings of neighbouring lines foretell one, so that a short bracket about that place stands for most of the bisection."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torch_mcaa import rng
from torch_mcaa.edges.bisect import Crossings, placed
from torch_mcaa.edges.candidates import Segments
from torch_mcaa.edges.lines import Ask
from torch_mcaa.integrand import width_of
from torch_mcaa.picking import numbers, pick

_STREAM = 0xF0E7
_WITHIN = 2.0**-9
"""Px either side: an edge of a radius of 3 px bends less between lines of a fifth of a pixel."""
_FAR = 2.0**24
_AT_ONCE = 1 << 12
"""Segments whose neighbours a CPU holds at a time."""


def narrowed_all(ask: Ask, parts: Sequence[Segments], known: Sequence[Crossings], apart: float, seed: int) -> list[Segments]:
    """The segments, short brackets in the place of those in which one of `known` on a line either side foretells the only crossing.

    Two evaluations for each that is tried. `apart`: lines further than that, in px, foretell nothing.
    """
    tries = [_Try.of(segments, crossings, apart, seed) for segments, crossings in zip(parts, known, strict=True)]
    places = [
        placed(part.axis, torch.cat([t.low, t.high]), part.across[t.index].repeat(2)) for part, t in zip(parts, tries, strict=True)
    ]
    sizes = [2 * len(t.index) for t in tries]
    if sum(sizes) == 0:
        return list(parts)
    values = ask(*(torch.cat(axis) for axis in zip(*places, strict=True))).split(sizes, 1)
    return [_short(part, t, value) for part, t, value in zip(parts, tries, values, strict=True)]


def foretold(segments: Segments, known: Crossings, apart: float) -> Tensor:
    """bool (S,): whether `known` foretell a crossing inside the segment."""
    if len(known) == 0 or len(segments) == 0:
        return torch.zeros_like(segments.single)
    place, found = _foretold(segments, known, apart)
    return found & (place > segments.low) & (place < segments.high)


@dataclass(frozen=True)
class _Try:
    """The segments at `index` may be short: from `low` to `high`."""

    index: Tensor
    low: Tensor
    high: Tensor

    @classmethod
    def of(cls, segments: Segments, known: Crossings, apart: float, seed: int) -> _Try:
        if len(known) == 0 or len(segments) == 0:
            none = segments.low[:0]
            return cls(none.long(), none, none)
        place, found = _foretold(segments, known, apart)
        inside = (place > segments.low + 2 * _WITHIN) & (place < segments.high - 2 * _WITHIN)
        index = numbers(found & ~segments.single & inside)
        place = pick(place, index)
        # no two brackets alike: the middles of the last ones must not err alike
        shape = _WITHIN * (1 + 0.25 * rng.uniform(seed, _STREAM, segments.axis, segments.stream[index]).to(torch.float64))
        return cls(index, place - shape, place + _WITHIN)


def _short(segments: Segments, tried: _Try, values: Tensor) -> Segments:
    """With short brackets where f has the segment's colours at both ends of them."""
    index = tried.index
    before, after = values.split(len(index), 1) if len(index) else (values, values)
    least = pick(segments.least, index)
    right = ((before - pick(segments.before, index)).abs() <= least) & ((after - pick(segments.after, index)).abs() <= least)
    right = numbers(right.all(0))
    index, low, high, before, after = (pick(each, right) for each in (index, tried.low, tried.high, before, after))
    return replace(
        segments,
        low=segments.low.index_copy(0, index, low),
        high=segments.high.index_copy(0, index, high),
        before=segments.before.index_copy(1, index, before),
        after=segments.after.index_copy(1, index, after),
    )


def _foretold(segments: Segments, known: Crossings, apart: float) -> tuple[Tensor, Tensor]:
    """(S,): where the known crossings nearest above and below would have theirs on the segment's line, and whether there are such."""
    # by column of pixels along the line, then by line
    place = known.place.floor() * _FAR + known.across
    order = torch.argsort(place)
    place = pick(place, order)
    across, where = (pick(each, order) for each in (known.across, known.place))
    jump, column = pick(known.jump, order), where.floor()
    change, own = segments.after - segments.before, segments.low.floor()
    # columns before, at and after the segment's own, and the nearest line above and below in each: (sides, columns, S)
    found: list[tuple[Tensor, Tensor]] = []
    step = _AT_ONCE * width_of(place.device)
    for at in (slice(start, start + step) for start in range(0, len(segments), step)):
        beside, least, changes = segments.across[at], segments.least[:, None, None, at], change[:, None, None, at]
        columns = own[at] + torch.arange(-1, 3, device=own.device)[:, None]
        target = columns * _FAR + beside
        one = torch.stack([torch.searchsorted(place, target, right=True), torch.searchsorted(place, target) - 1])
        flat = one.clamp_(0, len(place) - 1).view(-1)
        off = pick(across, flat).view(one.shape) - beside
        off[1].neg_()
        fits = (pick(column, flat).view(one.shape) == columns) & (off < apart) & (off >= 0)
        fits &= (((pick(jump, flat).view(-1, *one.shape) - changes).abs() <= least) | least.isinf()).all(0)
        distance, which = off.masked_fill_(~fits, apart).min(1)
        above, below = one.gather(1, which[:, None])[:, 0]
        up, down = distance
        share = torch.where(up + down > 0, down / (up + down).clamp_min(1e-12), 0.5)
        there = pick(where, below) * (1 - share) + pick(where, above) * share
        found.append((there, (distance < apart).all(0)))
    places, good = zip(*found, strict=True)
    return torch.cat(places), torch.cat(good)
