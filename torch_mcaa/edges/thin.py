"""Thin pieces, which a line's samples hit only now and then: followed from line to line, so that every line they cross has them.

A piece A|B|C of a line is found for certain where it is longer than the samples' distance. A shorter one is found with probability chord / h,
and to correct it only where it was found would be worse than nothing. From a piece that was found its neighbours on the next lines are foretold
and bisected, until a piece that the samples found, or its tip, is met.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from torch_mcaa.edges.bisect import BRACKET, Crossings, bisect, joined, sharpened
from torch_mcaa.edges.candidates import brackets
from torch_mcaa.edges.few import Few, Integers, Mask, on_host
from torch_mcaa.edges.lines import Ask, Lines
from torch_mcaa.edges.pieces import SHORT, Known, Numbered, Pieces, inside, pieces_of, place_of
from torch_mcaa.edges.walk import STEEPEST, Walk

_PROBES, _PROBES_APART = 7, 0.2
"""Places inside a short piece where it is asked if it is one piece, unless it is shorter than the second, in px."""
_LINE = 16
"""Evaluations that it takes to find the ends of a piece on the next line."""
_THINNEST = 1e-3


def complete(
    ask: Ask,
    crossings: Crossings,
    lines: Lines,
    wanted: Tensor,
    origin: tuple[int, int],
    finest: float,
    seed: int,
) -> Crossings:
    """The crossings with those of the thin pieces on the lines between them, and without those that cannot be followed.

    wanted: bool (R, Q), the pixels from `origin` (row, col) inside which pieces are followed.
    """
    if len(crossings) < 2:
        return crossings
    grid, area = Numbered(lines, crossings.axis), on_host(wanted)

    def short(pieces: Pieces) -> Mask:
        """Which pieces are to be followed."""
        return (pieces.width < SHORT) & _within(area, origin, grid, pieces)

    pieces, ends = pieces_of(crossings, grid)
    sharper = _narrowed(ask, crossings, ends[short(pieces)], grid, finest, seed)
    if sharper is not crossings:
        crossings = sharper
        pieces, ends = pieces_of(crossings, grid)
    few = Few(ask, grid.axis, grid.device, area.size)
    more = _opened(few, pieces.take(short(pieces)), grid, finest, seed)
    if more is not None:
        crossings = joined([crossings, more])
        pieces, ends = pieces_of(crossings, grid)
    known, start = Known(pieces), short(pieces)
    # a parallel piece close by is another one: what continues this one overlaps it, or nearly
    slack = np.minimum(pieces.width / 2, STEEPEST / grid.count)
    work = Walk(few, grid, known, area, origin, finest)
    lonely, unmet = start.copy(), start.copy()
    for direction in (1, -1):
        beside = known.at(pieces.line + direction, pieces.first, pieces.second, pieces.inside, pieces.tolerance, slack)
        alone = start & (beside < 0)
        lonely &= alone
        if direction < 0:
            # what was followed from above has been joined from below
            alone &= ~work.reached(pieces)
        where = np.flatnonzero(alone)
        if len(where):
            some = pieces.take(where)
            other = known.at(some.line - direction, some.first, some.second, some.inside, some.tolerance, slack[where])
            moved = work.follow(some, direction, other)
            unmet[where[moved]] = False
    drop = _held(pieces, grid) & lonely & unmet & (pieces.width < 1) & ~work.reached(pieces)
    # what lies between two pieces close by has their ends
    firm = np.zeros(len(crossings), dtype=np.bool_)
    firm[ends[start & ~drop]] = True
    drop &= ~firm[ends].any(1)
    return work.with_found(_without(crossings, ends[drop]))


def thin_pieces(crossings: Crossings, lines: Lines) -> bool:
    """Whether there is a piece that samples may miss."""
    return bool((pieces_of(crossings, Numbered(lines, crossings.axis))[0].width < SHORT).any())


def unfollowed(
    crossings: Crossings, lines: Lines, wanted: Tensor, origin: tuple[int, int], foretold: bool = False
) -> tuple[Crossings, Crossings, float]:
    """The crossings without those of the thin pieces that samples have hit, which are then sampled; of those the ones in pixels that are
    `wanted`, as in `complete`; and what following these would take.

    Samples hit a piece of width d with probability d. Of those that are `foretold` most have been found already, and take nothing.
    """
    grid = Numbered(lines, crossings.axis)
    pieces, ends = pieces_of(crossings, grid)
    thin = pieces.width < 1
    hit = _held(pieces, grid) & thin
    within = _within(on_host(wanted), origin, grid, pieces)
    known = np.count_nonzero((thin if foretold else hit) & within)
    cost = _LINE * max(0.0, float((1 / np.maximum(pieces.width[hit & within], _THINNEST)).sum()) - known)
    met = torch.from_numpy(ends[hit & within].ravel()).to(grid.device)
    return _without(crossings, ends[hit]), crossings.take(met), cost


def beside(crossings: Crossings, others: Crossings, grid: Numbered) -> Tensor:
    """bool (N,): which crossings lie on an edge that `others`, on lines along the other axis, have on the line next to them.

    An edge that is followed along those is no more than half a distance of lines times `STEEPEST` off on the nearest one.
    """
    places = place_of(grid.number(others.across), others.place).sort().values
    line, reach = grid.number(crossings.place), STEEPEST / (2 * grid.count)
    last, first = (torch.searchsorted(places, place_of(line, crossings.across + end), right=end > 0) for end in (reach, -reach))
    return last > first


def _held(pieces: Pieces, grid: Numbered) -> Mask:
    """Which pieces a sample lies in."""
    phase = grid.phase_of(pieces.line)
    return np.floor(pieces.second - phase) > np.floor(pieces.first - phase)


def _within(wanted: Mask, origin: tuple[int, int], grid: Numbered, pieces: Pieces) -> Mask:
    """Which pieces have their middles in pixels that are `wanted`, as `inside`."""
    return inside(wanted, origin, grid.axis, (pieces.first + pieces.second) / 2, grid.across_of(pieces.line))


def _without(crossings: Crossings, ends: Integers) -> Crossings:
    """The crossings but for those at the ends (P, 2) of pieces."""
    kept = np.ones(len(crossings), dtype=np.bool_)
    kept[ends] = False
    return crossings.take(torch.from_numpy(np.flatnonzero(kept)).to(crossings.place.device))


def _narrowed(ask: Ask, crossings: Crossings, ends: Integers, grid: Numbered, finest: float, seed: int) -> Crossings:
    """With the ends of short pieces known as exactly as their slopes, over a part of their width, ask for."""
    short = np.zeros(len(crossings), dtype=np.bool_)
    short[ends] = True
    blunt = (crossings.width > 2 * finest) & (crossings.width <= BRACKET) & torch.from_numpy(short).to(grid.device)
    if not bool(blunt.any()):
        return crossings
    some = crossings.take(blunt.nonzero()[:, 0])
    sharp = sharpened(ask, some, grid.number(some.across), finest, seed, kind=2)
    return joined([crossings.take((~blunt).nonzero()[:, 0]), sharp])


def _opened(few: Few, pieces: Pieces, grid: Numbered, finest: float, seed: int) -> Crossings | None:
    """The crossings hidden in short pieces: where two thin pieces lie close by, the ends of one and the other look like one piece."""
    pieces = pieces.take(pieces.width > _PROBES_APART)
    if len(pieces) == 0:
        return None
    apart, across = pieces.width / (_PROBES + 1), grid.across_of(pieces.line)
    places = pieces.first + apart * np.arange(_PROBES + 2)[:, None]
    places[0] += 1e-3
    places[-1] -= 1e-3
    values = few.at(places[1:-1], across)
    values = np.concatenate([pieces.inside[:, None], values, pieces.inside[:, None]], 1)
    probe, piece = np.nonzero(np.abs(values[:, 1:] - values[:, :-1]).max(0) > pieces.tolerance)
    if len(probe) == 0:
        return None
    line, both = pieces.line[piece], (probe, probe + 1)
    ends = (places[some, piece] for some in both), (values[:, some, piece] for some in both)
    numbers = across[piece], *ends[0], *ends[1], grid.phase_of(line), line
    segments = brackets(grid.axis, *(torch.from_numpy(each).to(grid.device) for each in numbers), kind=1)
    return bisect(few.ask, segments, finest, seed)
