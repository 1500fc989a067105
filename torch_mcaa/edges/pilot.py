"""A look at a few candidates: do they hold jumps, is f merely steep there, or is it noise?"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import torch
from torch import Tensor

from torch_mcaa import rng
from torch_mcaa.edges.bisect import Crossings, ask_on, bisect
from torch_mcaa.edges.candidates import Segments
from torch_mcaa.edges.lines import Ask

_PILOT = 0x91107
_FINEST = 2.0**-8
_STEEP = 1 / 8
"""Px: a continuous step no wider than this is treated as a jump, or several."""
_THINNEST = 0.01
"""Px, of what is taken for the width of a thin piece."""
_FEW, _MISPREDICTED = 0.05, 0.2


class Verdict(IntEnum):
    """What the candidates of a part of the screen are."""

    NONE = 0
    CONTINUOUS = 1
    NOISE = 2
    JUMPS = 3


@dataclass(frozen=True)
class Judged:
    """Of each part of the screen, (parts,).

    Attributes:
        verdict: int64 `Verdict`.
        crossings: for each axis, the candidates, but for those of thin pieces.
        lines: lines that cross thin pieces, as far as the pieces that samples hit tell: those hits over their probability.
    """

    verdict: Tensor
    crossings: tuple[Tensor, Tensor]
    lines: Tensor


def judge(ask: Ask, found: list[Segments], part: list[Tensor], parts: int, most: int, seed: int) -> Judged:
    """Judge each part of the screen: at most `most` candidates of it are bisected eight times.

    Then f is foretold at one fresh random place in each from the jumps found. Fewer than 5 % of the candidates with a jump: f is
    continuous. More than 20 % foretold wrong: noise, which always "has a jump" in one half, so that counting jumps cannot tell.

    Args:
        part: for each axis the part (S,) of its segments.
    """
    tried, jumped, wrong = (torch.zeros(parts, dtype=torch.int64, device=part[0].device) for _ in range(3))
    crossed, lines = [], torch.zeros(parts, dtype=torch.float64, device=part[0].device)
    for segments, where in zip(found, part, strict=True):
        crossed.append(torch.bincount(where[~segments.single], minlength=parts))
        if len(segments) == 0:
            continue
        hits = torch.bincount(where[segments.single], minlength=parts).to(torch.float64) / 2
        order = torch.argsort(rng.bits(seed, _PILOT, segments.axis, *segments.key.unbind(1)))
        order = order[torch.argsort(where[order], stable=True)]
        counts = torch.bincount(where, minlength=parts)
        rank = torch.arange(len(order), device=order.device) - (counts.cumsum(0) - counts)[where[order]]
        chosen = order[rank < most // 2]
        some, where = segments.take(chosen), where[chosen]
        size = len(some)
        crossings = bisect(ask, some, _FINEST, seed)
        steep = crossings.jump.abs().amax(0) > 0.5 * (some.after - some.before).abs().amax(0)[crossings.segment]
        has = torch.zeros(size, dtype=torch.bool, device=order.device)
        has[crossings.segment[steep]] = True
        has |= _steep(some, crossings, where, parts)
        # a sample in a thin piece lies half its width from either end, on average
        end = torch.minimum(crossings.place - some.low[crossings.segment], some.high[crossings.segment] - crossings.place)
        thin = steep & some.single[crossings.segment]
        known = torch.bincount(where[crossings.segment[thin]], minlength=parts)
        total = torch.bincount(where[crossings.segment[thin]], weights=end[thin], minlength=parts)
        lines += hits / torch.where(known > 0, 2 * total / known.clamp_min(1), 1).clamp(_THINNEST, 1)
        place = some.low + rng.uniform(seed, _PILOT, segments.axis, *some.key.unbind(1), 1, dtype=torch.float64) * (
            some.high - some.low
        )
        value = ask_on(ask, segments.axis, place, some.across)
        told = some.before.clone()
        passed = crossings.place < place[crossings.segment]
        told.index_add_(1, crossings.segment[passed], crossings.jump[:, passed])
        off = (value - told).abs().amax(0) > 0.35 * (some.after - some.before).abs().amax(0)
        for total, seen in ((tried, None), (jumped, has), (wrong, off & has)):
            total += torch.bincount(where if seen is None else where[seen], minlength=parts)
    verdict = torch.full_like(tried, Verdict.JUMPS)
    verdict[wrong > _MISPREDICTED * jumped] = Verdict.NOISE
    verdict[jumped < _FEW * tried] = Verdict.CONTINUOUS
    verdict[tried == 0] = Verdict.NONE
    return Judged(verdict, (crossed[0], crossed[1]), lines)


def _steep(segments: Segments, crossings: Crossings, where: Tensor, parts: int) -> Tensor:
    """Which segments (S,) hold a continuous step that is to be treated as a jump, or several: a short one, and not the end of a ramp."""
    size = (segments.after - segments.before).abs().amax(0)
    largest = size.new_zeros(parts).scatter_reduce_(0, where, size, "amax")[where]
    change = torch.zeros_like(segments.before).index_add_(1, crossings.segment, crossings.jump).abs().amax(0)
    first = torch.full_like(segments.low, torch.inf).scatter_reduce_(0, crossings.segment, crossings.place, "amin")
    last = torch.full_like(segments.low, -torch.inf).scatter_reduce_(0, crossings.segment, crossings.place, "amax")
    return (change > 0.5 * size) & (size > 0.5 * largest) & (last - first <= _STEEP)
