"""Edges from line to line: their crossings where no difference of samples stands out, f changing as much as it jumps."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torch_mcaa import rng
from torch_mcaa.edges.bisect import Crossings, ask_on, bisect, joined
from torch_mcaa.edges.candidates import Segments, brackets
from torch_mcaa.edges.candidates import joined as together
from torch_mcaa.edges.lines import Ask, Lines
from torch_mcaa.edges.pieces import SHORT, Numbered, inside, pieces_of, place_of
from torch_mcaa.picking import numbers, pick

_STREAM = 0xC4A1
_STEEPEST = 1.7
"""Px a px: edges that change their place faster from line to line are for the lines along the other axis."""
_ALIKE = 0.5
"""How much a jump may change from line to line, in parts of the larger."""
_WITHIN = 2.0**-8
_WIDER = 16
"""Px, and so many times that: the parts in which an edge is looked for about the place that the last lines foretell."""
_CLEAR = 3.0
"""A part that changes so many times as much as the two others holds the edge."""
_FADED = 2
"""Lines on which an edge may not be found, its jump passing through 0, before it is given up."""
_PART = 1 / 16
"""Px."""
_LINES = 400
_NEAR = 2.0**-6
_TWICE = 5e-4
"""Px: crossings closer than this are one that was found twice."""


@dataclass(frozen=True)
class _Order:
    """Crossings by line and place."""

    keys: Tensor
    order: Tensor

    @classmethod
    def of(cls, line: Tensor, place: Tensor) -> _Order:
        keys, order = torch.sort(place_of(line, place), stable=True)
        return cls(keys, order)

    def nearest(self, line: Tensor, place: Tensor, within: float | Tensor) -> Tensor:
        """(N,) the index of the crossing nearest to each place on a line, -1 where there is none so near."""
        target = place_of(line, place)
        after = torch.searchsorted(self.keys, target)
        index = torch.stack([after - 1, after]).clamp_(0, len(self.keys) - 1)
        before, behind = (self.keys[index] - target).abs_()
        best = self.order[torch.where(behind <= before, index[1], index[0])]
        return best.masked_fill_(torch.minimum(before, behind) > within, -1)


def linked(crossings: Crossings, grid: Numbered, *directions: int) -> list[Tensor]:
    """For each direction the crossing (N,) of the same edge on the next line, or -1."""
    line, alone = grid.number(crossings.across), _alone(crossings, grid)
    order, found = _Order.of(line, crossings.place), []
    for direction in directions:
        other = order.nearest(line + direction, crossings.place, _STEEPEST / grid.count)
        there = other.clamp_min(0)
        same = alone & pick(alone, there) & (other >= 0) & _alike(crossings.jump, pick(crossings.jump, there))
        found.append(torch.where(same, other, -1))
    return found


def _alone(crossings: Crossings, grid: Numbered) -> Tensor:
    """(N,) which have no other close by on their line: the parts of a steep step and the sides of a thin piece are no edges of their own."""
    keys, order = torch.sort(place_of(grid.number(crossings.across), crossings.place), stable=True)
    apart = keys[1:] - keys[:-1] > _PART
    alone = torch.ones_like(crossings.place, dtype=torch.bool)
    alone[order[1:]] &= apart
    alone[order[:-1]] &= apart
    return alone


def _alike(one: Tensor, other: Tensor) -> Tensor:
    """(N,) whether jumps (C, N) may be those of one edge."""
    return (one - other).abs().amax(0) <= _ALIKE * torch.maximum(one.abs(), other.abs()).amax(0)


def _first(line: Tensor, place: Tensor, some: Tensor, within: float) -> Tensor:
    """(N,) whether no other of `some` places lies just before on the same line."""
    keys, order = torch.sort(torch.where(some, place_of(line, place), torch.inf), stable=True)
    first = torch.ones_like(some)
    first[order[1:]] = keys[1:] - keys[:-1] > within
    return first


def continued(
    ask: Ask, crossings: Crossings, lines: Lines, wanted: Tensor, origin: tuple[int, int], finest: float, seed: int
) -> Crossings:
    """The crossings with those of their edges on the lines beyond, as far as these can be followed.

    wanted: bool (R, Q), the pixels from `origin` (row, col) inside which edges are followed.
    """
    if len(crossings) < 2:
        return crossings
    grid = Numbered(lines, crossings.axis)
    above, below = linked(crossings, grid, 1, -1)
    more = _followed(ask, crossings, grid, 1, above, below, wanted, origin, finest, seed)
    if more:
        crossings = joined([crossings, *more])
        above, below = linked(crossings, grid, 1, -1)
    return joined([crossings, *_followed(ask, crossings, grid, -1, below, above, wanted, origin, finest, seed)])


def _followed(
    ask: Ask,
    known: Crossings,
    grid: Numbered,
    direction: int,
    ahead: Tensor,
    behind: Tensor,
    wanted: Tensor,
    origin: tuple[int, int],
    finest: float,
    seed: int,
) -> list[Crossings]:
    """The crossings beyond the last ones of edges, towards higher (+1) or lower (-1) lines; `ahead` and `behind` (N,) as `linked` has them."""
    last = (ahead < 0) & (behind >= 0)
    if not bool(last.any()):
        return []
    line_of = grid.number(known.across)
    order = _Order.of(line_of, known.place)
    # thin pieces are followed as such
    pieces, ends = pieces_of(known, grid)
    one, two = known.jump[:, ends[:, 0]], known.jump[:, ends[:, 1]]
    back = (one + two).abs().amax(0) <= _ALIKE * torch.maximum(one.abs().amax(0), two.abs().amax(0))
    last[ends[back & (pieces.width < SHORT)].flatten()] = False
    index = last.nonzero()[:, 0]
    line, place = line_of[index], known.place[index]
    slope, gone, jump = place - known.place[behind[index]], torch.ones_like(line), known.jump[:, index]
    found: list[Segments] = []
    within = max(_WITHIN, 2 * finest)
    for _ in range(_LINES):
        target, across = place + slope * gone, grid.across(line + direction * gone)
        go = inside(wanted, origin, known.axis, target, across)
        here = order.nearest(line + direction * gone, target, _NEAR)
        go &= ((here < 0) | (ahead[here] < 0)) & (slope.abs() * grid.count < _STEEPEST)
        line, place, slope, gone, target, across, jump, here = (
            t[..., go] for t in (line, place, slope, gone, target, across, jump, here)
        )
        if len(line) == 0:
            break
        there = here >= 0
        if bool(there.any()):
            # a crossing that stood out alone: the edge goes on beyond it
            slope = torch.where(there, (known.place[here] - place) / gone, slope)
            place, jump = torch.where(there, known.place[here], place), torch.where(there, known.jump[:, here], jump)
            line, gone = torch.where(there, line + direction * gone, line), torch.where(there, 1, gone)
            continue
        met, low, high, before, after = _met(ask, known.axis, grid, across, target, jump, within, seed)
        met &= _alike(jump, after - before)
        middle = torch.where(met, (low + high) / 2, target)
        number = line + direction * gone
        new = met & (order.nearest(number, middle, (high - low) / 2 + _TWICE) < 0)
        new &= _first(number, middle, new, within)
        found.append(brackets(known.axis, across, low, high, before, after, grid.phase(number), number).take(new))
        jump = torch.where(met, after - before, jump)
        slope = torch.where(met, (middle - place) / gone, slope)
        place, line = torch.where(met, middle, place), torch.where(met, number, line)
        gone = torch.where(met, 1, gone + 1)
        on = new | (~met & (gone <= 1 + _FADED))
        line, place, slope, gone, jump = (t[..., on] for t in (line, place, slope, gone, jump))
    if not found:
        return []
    # all at once: a walk of many lines would else ask f a few places at a time
    every = together(found)
    got = bisect(ask, every, finest, seed)
    single = torch.bincount(got.segment, minlength=len(every)) == 1
    return [got.take(pick(single, got.segment))]


def _met(
    ask: Ask, axis: int, grid: Numbered, across: Tensor, target: Tensor, like: Tensor, within: float, seed: int
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Which edges were met (N,) about places on lines, in brackets from low to high (N,), with f before and after (C, N), as jumps `like` have it.

    A bracket is about 2 `within` wide; those of edges that were not met say nothing.
    """
    lines = grid.number(across)
    shape = _shape(axis, lines, target, seed)
    low, high = (torch.zeros_like(target) for _ in range(2))
    before, after = (torch.zeros_like(like) for _ in range(2))
    clear = torch.zeros_like(target, dtype=torch.bool)
    for width in (within, _WIDER * within):
        left = (~clear).nonzero()[:, 0]
        if len(left) == 0:
            break
        sides = torch.tensor([-3.0, -1.0, 1.0, 3.0], dtype=target.dtype, device=target.device)[:, None]
        places = target[left] + width * sides * torch.where(sides < 0, shape[left], 1)
        values = ask_on(ask, axis, places.flatten(), across[left].repeat(4)).unflatten(1, places.shape)
        change = (values[:, 1:] - values[:, :-1]).abs().amax(0)
        sizes, part = change.sort(0, descending=True)
        part, some = (
            part[0],
            (sizes[0] > _CLEAR * sizes[1]) & (sizes[0] > 64 * torch.finfo(values.dtype).eps * values.abs().amax((0, 1))),
        )
        at, where, part = left[some], some.nonzero()[:, 0], part[some]
        clear[at] = True
        low[at], high[at] = places[part, where], places[part + 1, where]
        before[:, at], after[:, at] = values[:, part, where], values[:, part + 1, where]
    wide = numbers(clear & (high - low > 3 * within))
    if len(wide):
        segments = brackets(axis, across, low, high, before, after, grid.phase(lines), lines).take(wide)
        got = bisect(ask, segments, 2 * within, seed)
        got = got.take(pick(torch.bincount(got.segment, minlength=len(wide)) == 1, got.segment))
        clear[wide] = False
        at = pick(wide, got.segment)
        clear[at] = True
        low[at], high[at] = got.place - got.width / 2, got.place + got.width / 2
        before[:, at], after[:, at] = got.before, got.after
    return clear, low, high, before, after


def _shape(axis: int, line: Tensor, place: Tensor, seed: int) -> Tensor:
    """How far brackets go to the left: no two alike, or the middles of the last ones would all err alike."""
    return 1 + 0.25 * rng.uniform(seed, _STREAM, axis, line, (place * 2**20).long()).to(torch.float64)


def between(ask: Ask, known: Crossings, old: Lines, lines: Lines, found: Segments, seed: int) -> Segments:
    """Brackets on `lines` about places that edges foretell whose crossings on the `old` ones are `known`.

    But for those in segments already `found`. Two evaluations for each.
    """
    across, place, number = _told(known, Numbered(old, known.axis), Numbered(lines, known.axis))
    if len(found) and len(place):
        grid = Numbered(lines, known.axis)
        taken = _Order.of(grid.number(found.across), (found.low + found.high) / 2).nearest(number, place, 0.5 + _WITHIN)
        across, place, number = across[taken < 0], place[taken < 0], number[taken < 0]
    low = place - _WITHIN / 2 * _shape(known.axis, number, place, seed)
    high = place + _WITHIN / 2
    values = ask_on(ask, known.axis, torch.cat([low, high]), across.repeat(2)) if len(place) else found.before[:, :0]
    before, after = values.split(len(place), 1) if len(place) else (values, values)
    return brackets(known.axis, across, low, high, before, after, Numbered(lines, known.axis).phase(number), number)


def _told(known: Crossings, old: Numbered, new: Numbered) -> tuple[Tensor, Tensor, Tensor]:
    """The lines between two old ones that an edge crosses, the places on them where it does, and their numbers."""
    if len(known) == 0:
        return known.across, known.place, known.segment
    (other,) = linked(known, old, 1)
    start = (other >= 0).nonzero()[:, 0]
    stop = other[start]
    first, height = known.across[start], known.across[stop] - known.across[start]
    nearest = ((first - new.across(torch.zeros_like(start))) * new.count).ceil().long()
    number = nearest + torch.arange(-(-new.count // old.count) + 1, device=first.device)[:, None]
    share = (new.across(number) - first) / height
    place = torch.lerp(known.place[start].expand_as(share), known.place[stop].expand_as(share), share)
    inside = (share >= 0) & (share < 1)
    return new.across(number)[inside], place[inside], number[inside]
