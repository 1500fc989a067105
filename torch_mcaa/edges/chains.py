"""Edges from line to line: their crossings where no difference of samples stands out, f changing as much as it jumps."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from torch_mcaa.edges.bisect import Crossings, ask_on, bisect, joined
from torch_mcaa.edges.candidates import Segments, brackets
from torch_mcaa.edges.few import Brackets, Colours, Few, Floats, Integers, Mask, on_host, uneven
from torch_mcaa.edges.lines import Ask, Lines
from torch_mcaa.edges.pieces import SHORT, Numbered, inside, pieces_of, place_on
from torch_mcaa.picking import pick

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


class _Order:
    """Places (N,) on lines, by number, in order."""

    def __init__(self, line: Integers, place: Floats) -> None:
        places = place_on(line, place)
        self.order = np.argsort(places, kind="stable")
        self.places = places[self.order]

    def nearest(self, line: Integers, place: Floats, within: float | Floats) -> Integers:
        """(N,) the index of that nearest to each place on a line, -1 where there is none so near."""
        target = place_on(line, place)
        after = self.places.searchsorted(target)
        index = np.stack([after - 1, after]).clip(0, len(self.places) - 1)
        before, behind = np.abs(self.places[index] - target)
        best = self.order[np.where(behind <= before, index[1], index[0])]
        return np.where(np.minimum(before, behind) > within, -1, best)

    def alone(self) -> Mask:
        """(N,) which have no other close by on their line: the parts of a steep step and the sides of a thin piece are no edges of their own."""
        apart = np.diff(self.places) > _PART
        alone = np.ones(len(self.places), dtype=np.bool_)
        alone[self.order[1:]] &= apart
        alone[self.order[:-1]] &= apart
        return alone


def linked(crossings: Crossings, grid: Numbered, *directions: int) -> list[Integers]:
    """For each direction the crossing (N,) of the same edge on the next line, or -1."""
    line, place, jump = (on_host(each) for each in (grid.number(crossings.across), crossings.place, crossings.jump))
    order, found = _Order(line, place), []
    alone = order.alone()
    for direction in directions:
        other = order.nearest(line + direction, place, _STEEPEST / grid.count)
        same = alone & alone[other] & (other >= 0) & _alike(jump, jump[:, other])
        found.append(np.where(same, other, -1))
    return found


def _alike(one: Colours, other: Colours) -> Mask:
    """(N,) whether jumps (C, N) may be those of one edge."""
    return np.abs(one - other).max(0) <= _ALIKE * np.maximum(np.abs(one), np.abs(other)).max(0)


def continued(
    ask: Ask, crossings: Crossings, lines: Lines, wanted: Tensor, origin: tuple[int, int], finest: float, seed: int
) -> Crossings:
    """The crossings with those of their edges on the lines beyond, as far as these can be followed.

    wanted: bool (R, Q), the pixels from `origin` (row, col) inside which edges are followed.
    """
    if len(crossings) < 2:
        return crossings
    grid, area = Numbered(lines, crossings.axis), on_host(wanted)
    above, below = linked(crossings, grid, 1, -1)
    more = _followed(ask, crossings, grid, 1, above, below, area, origin, finest, seed)
    if more is not None:
        crossings = joined([crossings, more])
        above, below = linked(crossings, grid, 1, -1)
    more = _followed(ask, crossings, grid, -1, below, above, area, origin, finest, seed)
    return crossings if more is None else joined([crossings, more])


def _first(line: Integers, place: Floats, within: float) -> Mask:
    """(N,) whether no other place lies just before on the same line."""
    at = place_on(line, place)
    order = np.argsort(at, kind="stable")
    first = np.ones(len(line), dtype=np.bool_)
    first[order[1:]] = np.diff(at[order]) > within
    return first


def _followed(
    ask: Ask,
    known: Crossings,
    grid: Numbered,
    direction: int,
    ahead: Integers,
    behind: Integers,
    wanted: Mask,
    origin: tuple[int, int],
    finest: float,
    seed: int,
) -> Crossings | None:
    """The crossings beyond the last ones of edges, towards higher (+1) or lower (-1) lines; `ahead` and `behind` (N,) as `linked` has them."""
    last = (ahead < 0) & (behind >= 0)
    if not last.any():
        return None
    lines, places, jumps = (on_host(each) for each in (grid.number(known.across), known.place, known.jump))
    order, few = _Order(lines, places), Few(ask, grid.axis, grid.device, wanted.size)
    # thin pieces are followed as such
    pieces, ends = pieces_of(known, grid)
    one, two = jumps[:, ends[:, 0]], jumps[:, ends[:, 1]]
    back = np.abs(one + two).max(0) <= _ALIKE * np.maximum(np.abs(one).max(0), np.abs(two).max(0))
    last[ends[back & (pieces.width < SHORT)]] = False
    index = np.flatnonzero(last)
    line, place, jump, gone = lines[index], places[index], jumps[:, index], np.ones_like(index)
    slope = place - places[behind[index]]
    found: list[tuple[Any, ...]] = []
    within = max(_WITHIN, 2 * finest)
    for _ in range(_LINES):
        number = line + direction * gone
        target, across = place + slope * gone, grid.across_of(number)
        here = order.nearest(number, target, _NEAR)
        go = inside(wanted, origin, known.axis, target, across) & (np.abs(slope) * grid.count < _STEEPEST)
        go &= (here < 0) | (ahead[here] < 0)
        line, place, slope, gone, number, target, across, jump, here = (
            each[..., go] for each in (line, place, slope, gone, number, target, across, jump, here)
        )
        if len(line) == 0:
            break
        there = here >= 0
        if there.any():
            # a crossing that stood out alone: the edge goes on beyond it
            slope = np.where(there, (places[here] - place) / gone, slope)
            place, jump = np.where(there, places[here], place), np.where(there, jumps[:, here], jump)
            line, gone = np.where(there, number, line), np.where(there, 1, gone)
            continue
        met, part = _met(few, number, across, grid.phase_of(number), target, jump, within)
        change = part.after - part.before
        met &= _alike(jump, change)
        middle = np.where(met, (part.low + part.high) / 2, target)
        new = met & (order.nearest(number, middle, (part.high - part.low) / 2 + _TWICE) < 0)
        new[new] = _first(number[new], middle[new], within)
        found.append((across[new], *part.take(new).each, grid.phase_of(number[new]), number[new]))
        jump, slope = np.where(met, change, jump), np.where(met, (middle - place) / gone, slope)
        place, line, gone = np.where(met, middle, place), np.where(met, number, line), np.where(met, 1, gone + 1)
        on = new | (~met & (gone <= 1 + _FADED))
        line, place, slope, gone, jump = (each[..., on] for each in (line, place, slope, gone, jump))
    if not any(len(each[0]) for each in found):
        return None
    # all at once: a walk of many lines would else ask f a few places at a time
    every = (torch.from_numpy(np.concatenate(each, -1)).to(grid.device) for each in zip(*found, strict=True))
    across, low, high, before, after, phase, number = every
    segments = brackets(known.axis, across, low, high, before, after, phase, number)
    got = bisect(ask, segments, finest, seed)
    single = torch.bincount(got.segment, minlength=len(segments)) == 1
    return got.take(pick(single, got.segment))


def _met(
    few: Few, line: Integers, across: Floats, phase: Floats, target: Floats, like: Colours, within: float
) -> tuple[Mask, Brackets]:
    """Which edges were met (N,) about places on lines, by number, and in which brackets, as jumps `like` have it.

    A bracket is about 2 `within` wide; those of edges that were not met say nothing.
    """
    left = _further(line)
    low, high, before, after = np.zeros_like(target), np.zeros_like(target), np.zeros_like(like), np.zeros_like(like)
    clear = np.zeros(len(line), dtype=np.bool_)
    for width in (within, _WIDER * within):
        rest = np.flatnonzero(~clear)
        if len(rest) == 0:
            break
        places = target[rest] + width * np.stack([-3 * left[rest], -left[rest], np.ones(len(rest)), np.full(len(rest), 3.0)])
        values = few.at(places, across[rest])
        change = np.abs(values[:, 1:] - values[:, :-1]).max(0)
        sizes = np.sort(change, 0)
        least = 64 * np.finfo(values.dtype).eps * np.abs(values).max((0, 1))
        some = np.flatnonzero((sizes[-1] > _CLEAR * sizes[-2]) & (sizes[-1] > least))
        at, part = rest[some], change.argmax(0)[some]
        clear[at] = True
        low[at], high[at] = places[part, some], places[part + 1, some]
        before[:, at], after[:, at] = values[:, part, some], values[:, part + 1, some]
    part = Brackets(low, high, before, after)
    wide = np.flatnonzero(clear & (high - low > 3 * within))
    if len(wide):
        clear[wide], narrow = few.narrowed(line[wide], across[wide], phase[wide], part.take(wide), 2 * within)
        for values, those in zip(part.each, narrow.each, strict=True):
            values[..., wide] = those
    return clear, part


def _further(line: Integers) -> Floats:
    """(N,) so many times as far brackets go to the left: no two alike, or the middles of the last ones would all err alike."""
    return 1 + 0.25 * uneven(line)


def between(ask: Ask, known: Crossings, old: Lines, lines: Lines, found: Segments) -> Segments:
    """Brackets on `lines` about places that edges foretell whose crossings on the `old` ones are `known`.

    But for those in segments already `found`. Two evaluations for each.
    """
    across, place, number = _told(known, Numbered(old, known.axis), Numbered(lines, known.axis))
    if len(found) and len(place):
        grid = Numbered(lines, known.axis)
        order = _Order(*(on_host(each) for each in (grid.number(found.across), (found.low + found.high) / 2)))
        rest = torch.from_numpy(order.nearest(on_host(number), on_host(place), 0.5 + _WITHIN) < 0).to(place.device)
        across, place, number = across[rest], place[rest], number[rest]
    low = place - _WITHIN / 2 * torch.from_numpy(_further(on_host(number))).to(place.device)
    high = place + _WITHIN / 2
    values = ask_on(ask, known.axis, torch.cat([low, high]), across.repeat(2)) if len(place) else found.before[:, :0]
    before, after = values.split(len(place), 1) if len(place) else (values, values)
    return brackets(known.axis, across, low, high, before, after, Numbered(lines, known.axis).phase(number), number)


def _told(known: Crossings, old: Numbered, new: Numbered) -> tuple[Tensor, Tensor, Tensor]:
    """The lines between two old ones that an edge crosses, the places on them where it does, and their numbers."""
    if len(known) == 0:
        return known.across, known.place, known.segment
    other = torch.from_numpy(linked(known, old, 1)[0]).to(known.place.device)
    start = (other >= 0).nonzero()[:, 0]
    stop = other[start]
    first, height = known.across[start], known.across[stop] - known.across[start]
    nearest = ((first - new.across(torch.zeros_like(start))) * new.count).ceil().long()
    number = nearest + torch.arange(-(-new.count // old.count) + 1, device=first.device)[:, None]
    share = (new.across(number) - first) / height
    place = torch.lerp(known.place[start].expand_as(share), known.place[stop].expand_as(share), share)
    inside = (share >= 0) & (share < 1)
    return new.across(number)[inside], place[inside], number[inside]
