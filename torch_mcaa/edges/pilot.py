"""A look at a few candidates: do they hold jumps, is f merely steep there, or is it noise?"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import torch
from torch import Tensor

from torch_mcaa import rng
from torch_mcaa.edges.bisect import Crossings, bisect_all, placed
from torch_mcaa.edges.candidates import Segments
from torch_mcaa.edges.lines import Ask
from torch_mcaa.picking import ranked
from torch_mcaa.sums import add_at

_PILOT = 0x91107
_FINEST = 2.0**-8
_STEEP = 1 / 4
"""Px: a continuous step no wider than this is treated as a jump, or several."""
_SIDES = 5
"""Continuous steps that a part of the screen must show along an axis to be one edge."""
_THINNEST = 0.01
"""Px, of what is taken for the width of a thin piece."""
_FEW, _MISPREDICTED, _UNSEEN, _ALONE = 0.05, 0.2, 0.15, 0.05
_CHANCE = 2
"""Candidates that may be foretold wrong beside: near few hairlines close by some are."""
_BROKEN, _TESTED, _PEAKED, _HELD = 0.25, 10, 0.22, 0.5
_CHAINED = 3
"""Lines between hits of one thin piece: of a slope of a half every other line's samples hit it, or none's, of a third every third's."""
_WIDE = 1 << 20
"""Columns or rows of a cell: more than there are."""
_NEAR, _OFF = 1 / 8, 1 / 4
"""Px: how far from a jump it is looked at whether it is an edge."""


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
        tried: int64, how many candidates were looked at.
        crossings: for each axis, the candidates, but for those of thin pieces.
        lines: lines that cross thin pieces, as far as the pieces that samples hit tell: those hits over their probability, and of these no more
            in a part than can be; what that leaves is in the parts without candidates, in equal shares.
        told: the share of its candidates in which f is seen to decide.
        detail: float64, the shares of the jumps beside which f is not what one edge would have it be, of three kinds: 0 on edges, about 1 in noise.
        slow: bool, whether next to no candidate holds a jump, or there is none: but for detail f is continuous.
        sharp: for each axis the jumps that were found, but for those of thin pieces, and the part (N,) that each lies in; on their device.
    """

    verdict: Tensor
    tried: Tensor
    crossings: tuple[Tensor, Tensor]
    lines: Tensor
    told: Tensor
    detail: Tensor
    slow: Tensor
    sharp: tuple[tuple[Crossings, Tensor], ...] = ()

    def cpu(self) -> Judged:
        first, second = self.crossings
        crossings = first.cpu(), second.cpu()
        lines, told, detail = self.lines.cpu(), self.told.cpu(), self.detail.cpu()
        return Judged(self.verdict.cpu(), self.tried.cpu(), crossings, lines, told, detail, self.slow.cpu(), self.sharp)


def judge(ask: Ask, found: list[Segments], part: list[Tensor], parts: int, side: int, most: int, seed: int) -> Judged:
    """Judge each part of the screen: at most `most` candidates of it are bisected eight times.

    Then f is foretold at one fresh random place in each from the jumps found. Fewer than 5 % of the candidates with a jump: f is
    continuous. More than 20 % foretold wrong, and of few candidates two more: noise, which always "has a jump" in one half, so that counting
    jumps cannot tell. More than 15 %, likewise, of those foretold wrong that lie in the next segment, where no jump was seen: detail finer
    than the samples, which is noise too; beside thin pieces, which like company, 20 %.
    More than 25 % of the jumps, of 10 or more, that are no edge: detail on every scale, of which bisection finds one jump of many. Where an
    edge is straight two points opposite each other about a place on it have the colours of its two sides, whatever its direction; about a
    thin piece's they may both have the one outside it.
    Along the axis that shows most of them at least half of the candidates have to change in a few places: where f changes between samples
    as much as it jumps, those that stand out are few of an edge's, and samples do as well.
    And f is continuous where single samples that stick out without a jump change it by over 22 % of what jumps do.

    Args:
        part: for each axis the part (S,) of its segments.
        side: px, of a part.
    """
    tried = torch.zeros(parts, dtype=torch.int64, device=part[0].device)
    change, jumped, wrong, beside, unseen, peaks, alone = (
        torch.zeros(parts, dtype=torch.float64, device=part[0].device) for _ in range(7)
    )
    crossed = [torch.bincount(where[~segments.single], minlength=parts) for segments, where in zip(found, part, strict=True)]
    lines, missed = torch.zeros(parts, dtype=torch.float64, device=part[0].device), 0.0
    tested, more, less, shown, held = (torch.zeros_like(tried) for _ in range(5))
    looks = [_Look.at(segments, where, parts, most // 2, seed) for segments, where in zip(found, part, strict=True)]
    sharp: tuple[tuple[Crossings, Tensor], ...] = ()
    if any(len(look.where) for look in looks):
        bisected = bisect_all(ask, [look.some for look in looks], _FINEST, seed)
        edges = [look.sharp(crossings) for look, crossings in zip(looks, bisected, strict=True)]
        sharp = tuple((clear, look.where[clear.segment]) for look, clear in zip(looks, edges, strict=True))
        jumps = [look.jumped(crossings, parts) for look, crossings in zip(looks, bisected, strict=True)]
        asked = [look.asked(crossings) for look, crossings in zip(looks, bisected, strict=True)]
        x, y = zip(*(placed(look.some.axis, *places) for look, places in zip(looks, asked, strict=True)), strict=True)
        values = ask(torch.cat(x), torch.cat(y)).split([4 * len(look.where) for look in looks], 1)
        for look, crossings, clear, has, four in zip(looks, bisected, edges, jumps, values, strict=True):
            value, next_, one, other = four.unflatten(1, (4, -1)).unbind(1)
            where = look.where
            edge = torch.zeros_like(look.some.single)
            edge[clear.segment] = True
            tested += torch.bincount(where[edge], minlength=parts)
            shown, held = (torch.maximum(*pair) for pair in zip((shown, held), look.held(crossings, parts), strict=True))
            bent = look.bent(one, other)
            for way, total in ((1, more), (-1, less)):
                total += torch.bincount(where[edge & (bent == way)], minlength=parts)
            told, most_lines = look.lines(crossings, parts, side)
            lines += torch.minimum(told, most_lines)
            missed += float((told - most_lines).clamp_min(0).sum())
            tried += torch.bincount(where, minlength=parts)
            # the foot of a smooth step looks like a jump to a candidate that sees no more of it: each counts by its change
            size = look.size.to(torch.float64)
            wrongly, still = has & look.mistold(crossings, value), has & (look.some.quiet != 0)
            for total, seen in (
                (change, size),
                (jumped, size * has),
                (wrong, size * wrongly),
                (beside, size * still),
                (unseen, size * (still & look.surprised(next_))),
                (peaks, size * (~has & look.some.single)),
                (alone, size * (still & look.some.single)),
            ):
                total += add_at(torch.zeros_like(total), where, seen)
    verdict = torch.full_like(tried, Verdict.JUMPS)
    chance = _CHANCE / torch.bincount(torch.cat(part), minlength=parts).clamp_min(1)
    noise = (wrong > (_MISPREDICTED + chance) * jumped) | (unseen > (_UNSEEN + chance) * beside + _ALONE * alone)
    verdict[noise] = Verdict.NOISE
    # both outside of a thin piece have always less, or always more
    broken = 2 * torch.minimum(more, less)
    verdict[(broken > _BROKEN * tested) & (tested >= _TESTED)] = Verdict.NOISE
    slow = jumped <= _FEW * change
    verdict[(jumped < _FEW * change) | (peaks > _PEAKED * jumped) | (held < _HELD * shown)] = Verdict.CONTINUOUS
    verdict[tried == 0] = Verdict.NONE
    none = verdict == Verdict.NONE
    lines += none * (missed / none.count_nonzero().clamp_min(1))
    tiny = torch.finfo(torch.float64).tiny
    detail = wrong / jumped.clamp_min(tiny) + (unseen - _ALONE * alone).clamp_min(0) / beside.clamp_min(tiny)
    detail += broken / tested.clamp_min(_TESTED)
    return Judged(verdict, tried, (crossed[0], crossed[1]), lines, torch.zeros_like(lines), detail, slow, sharp)


@dataclass(frozen=True)
class _Look:
    """Some segments along one axis, the part each lies `where`, a random place in it, and one `beside` it in the next on its quiet side.

    And two random numbers (2, S) each, `drawn`. `hits` (parts,), how many thin pieces samples hit, and how many `rows` of hits there are, from line
    to line one beside the other, as of a piece that lies along the other axis.
    """

    some: Segments
    where: Tensor
    place: Tensor
    beside: Tensor
    drawn: Tensor
    hits: Tensor
    rows: Tensor

    @classmethod
    def at(cls, segments: Segments, where: Tensor, parts: int, most: int, seed: int) -> _Look:
        """At most so many of each part, at random."""
        single, here = segments.take(segments.single), where[segments.single]
        hits, rows = (torch.bincount(some, minlength=parts).to(torch.float64) / 2 for some in (here, here[~_goes_on(single, here)]))
        order, rank, _ = ranked(where, rng.bits(seed, _PILOT, segments.axis, segments.stream))
        chosen = order[rank < most]
        some = segments.take(chosen)
        which = torch.arange(1, 5, device=some.low.device)[:, None]
        one, two, *more = rng.uniform(seed, _PILOT, some.axis, which, some.stream, dtype=torch.float64)
        length = some.high - some.low
        return cls(
            some, where[chosen], some.low + one * length, some.low + (two + some.quiet) * length, torch.stack(more), hits, rows
        )

    def asked(self, crossings: Crossings) -> tuple[Tensor, Tensor]:
        """The random places, those beside, and two opposite each other about the jump: along the lines, and across them."""
        some, sharp = self.some, self._steep(crossings)
        middle = self.place.clone()
        middle[crossings.segment[sharp]] = crossings.place[sharp]
        turn, off = self.drawn
        off, turn = _NEAR + (_OFF - _NEAR) * off, 2 * torch.pi * turn
        along, across = off * turn.cos(), off * turn.sin()
        return torch.cat([self.place, self.beside, middle + along, middle - along]), torch.cat(
            [some.across, some.across, some.across + across, some.across - across]
        )

    def held(self, crossings: Crossings, parts: int) -> tuple[Tensor, Tensor]:
        """(parts,) the number of segments, but for those of thin pieces, and how many of them change in a few places."""
        has = torch.zeros_like(self.some.single)
        has[crossings.segment] = True
        whole = ~self.some.single
        return torch.bincount(self.where[whole], minlength=parts), torch.bincount(self.where[whole & has], minlength=parts)

    def sharp(self, crossings: Crossings) -> Crossings:
        """The jumps of over half their segment's change, but for those of thin pieces."""
        return crossings.take(self._steep(crossings) & ~self.some.single[crossings.segment])

    def bent(self, one: Tensor, other: Tensor) -> Tensor:
        """1 or -1 where two opposite values (C, S) have more or less than the sum of those at the segment's ends, else 0.

        What f bends where it is steep does not count.
        """
        off = one + other - self.some.before - self.some.after
        bent = off.abs().amax(0) > 0.35 * torch.maximum(self.size, (one - other).abs().amax(0))
        return off.sum(0).sign() * bent

    @property
    def size(self) -> Tensor:
        """By how much f changes over each segment."""
        return (self.some.after - self.some.before).abs().amax(0)

    def jumped(self, crossings: Crossings, parts: int) -> Tensor:
        """Which segments hold a jump of over half their change, or a step that is treated as some."""
        has = torch.zeros(len(self.where), dtype=torch.bool, device=self.where.device)
        has[crossings.segment[self._steep(crossings)]] = True
        # a peak's sides are steep, too, as wide as what is between them, and few
        steep = _steep(self.some, crossings, self.where, parts) & ~self.some.single
        return has | (steep & (torch.bincount(self.where[steep], minlength=parts) >= _SIDES)[self.where])

    def _steep(self, crossings: Crossings) -> Tensor:
        return crossings.jump.abs().amax(0) > 0.5 * self.size[crossings.segment]

    def lines(self, crossings: Crossings, parts: int, side: int) -> tuple[Tensor, Tensor]:
        """(parts,) the lines across thin pieces, a sample in one lying half its width from either end, on average; and how many there can be.

        All the lines of a part cross what lies along the other axis, whether its samples hit it on all of them or on none: what the hits tell
        beyond that is in other parts, in which there are none.
        """
        low, high = self.some.low[crossings.segment], self.some.high[crossings.segment]
        end = torch.minimum(crossings.place - low, high - crossings.place)
        thin = self._steep(crossings) & self.some.single[crossings.segment]
        where = self.where[crossings.segment[thin]]
        known, total = torch.bincount(where, minlength=parts), add_at(end.new_zeros(parts), where, end[thin])
        return self.hits / torch.where(known > 0, 2 * total / known.clamp_min(1), 1).clamp(_THINNEST, 1), self.rows * side

    def surprised(self, value: Tensor) -> Tensor:
        """Where f beside a segment is not what it is at the segment's end."""
        return (value - torch.where(self.some.quiet < 0, self.some.before, self.some.after)).abs().amax(0) > 0.35 * self.size

    def mistold(self, crossings: Crossings, value: Tensor) -> Tensor:
        """Where f at the random place is not what the jumps before it tell."""
        told = self.some.before.clone()
        passed = crossings.place < self.place[crossings.segment]
        add_at(told, crossings.segment[passed], crossings.jump[:, passed])
        return (value - told).abs().amax(0) > 0.35 * self.size


def _goes_on(single: Segments, where: Tensor) -> Tensor:
    """bool (S,): whether one of the next lines has such a segment, in the same part, no further along than it is across."""
    if len(single) == 0:
        return single.single
    place = single.key[:, 1:] - single.key[:, 1:].amin(0)
    line, along = place.unbind(1) if single.axis == 0 else place.flip(1).unbind(1)
    off = [(across, aside) for across in range(1, _CHAINED + 1) for aside in range(-across, across + 1)]
    near = torch.tensor([across * _WIDE + aside for across, aside in off], device=along.device)
    place = (where * _WIDE + line) * _WIDE + along
    return torch.isin(place + near[:, None], place).any(0)


def _steep(segments: Segments, crossings: Crossings, where: Tensor, parts: int) -> Tensor:
    """Which segments (S,) hold a continuous step that is to be treated as a jump, or several: a short one, and not the end of a ramp."""
    size = (segments.after - segments.before).abs().amax(0)
    largest = size.new_zeros(parts).scatter_reduce_(0, where, size, "amax")[where]
    change = add_at(torch.zeros_like(segments.before), crossings.segment, crossings.jump).abs().amax(0)
    first = torch.full_like(segments.low, torch.inf).scatter_reduce_(0, crossings.segment, crossings.place, "amin")
    last = torch.full_like(segments.low, -torch.inf).scatter_reduce_(0, crossings.segment, crossings.place, "amax")
    return (change > 0.5 * size) & (size > 0.5 * largest) & (last - first <= _STEEP)
