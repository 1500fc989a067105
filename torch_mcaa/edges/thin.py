"""Thin pieces, which a line's samples hit only now and then: followed from line to line, so that every line they cross has them.

A piece A|B|C of a line is found for certain where it is longer than the samples' distance. A shorter one is found with probability chord / h,
and to correct it only where it was found would be worse than nothing. From a piece that was found its neighbours on the next lines are foretold
and bisected, until a piece that the samples found, or its tip, is met.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torch_mcaa.edges.bisect import BRACKET, Crossings, ask_on, bisect, joined, sharpened
from torch_mcaa.edges.candidates import brackets
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
    grid = Numbered(lines, crossings.axis)

    def short(pieces: Pieces) -> Tensor:
        """Which pieces are to be followed."""
        return (pieces.width < SHORT) & inside(
            wanted, origin, grid.axis, (pieces.first + pieces.second) / 2, grid.across(pieces.line)
        )

    pieces, ends = pieces_of(crossings, grid)
    for mended in (_narrowed, _opened):
        some = short(pieces)
        before, crossings = crossings, mended(ask, crossings, pieces.take(some), ends[some], grid, finest, seed)
        if crossings is not before:
            pieces, ends = pieces_of(crossings, grid)
    known, start = Known(pieces), short(pieces)
    # a parallel piece close by is another one: what continues this one overlaps it, or nearly
    slack = torch.minimum(pieces.width / 2, torch.full_like(pieces.first, STEEPEST / grid.count))
    work = Walk(ask, grid, known, wanted, origin, finest, seed)
    lonely = start.clone()
    unmet = start.clone()
    for direction in (1, -1):
        beside = known.at(pieces.line + direction, pieces.first, pieces.second, pieces.inside, pieces.tolerance, slack)
        alone = start & (beside < 0)
        lonely &= alone
        if direction < 0:
            # what was followed from above has been joined from below
            alone &= ~work.reached_mask(pieces)
        where = alone.nonzero()[:, 0]
        if len(where):
            other = known.at(pieces.line - direction, pieces.first, pieces.second, pieces.inside, pieces.tolerance, slack)[where]
            moved = work.follow(pieces.take(where), direction, other)
            unmet[where[moved]] = False
    drop = _held(pieces, grid) & lonely & unmet & (pieces.width < 1) & ~work.reached_mask(pieces)
    # what lies between two pieces close by has their ends
    firm = torch.zeros(len(crossings), dtype=torch.bool, device=drop.device)
    firm[ends[start & ~drop].flatten()] = True
    drop &= ~firm[ends].any(1)
    return work.with_found(crossings.take(_without(len(crossings), ends[drop])))


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
    within = inside(wanted, origin, crossings.axis, (pieces.first + pieces.second) / 2, grid.across(pieces.line))
    known = int(((thin if foretold else hit) & within).count_nonzero())
    cost = _LINE * max(0.0, float((1 / pieces.width[hit & within].clamp_min(_THINNEST)).sum()) - known)
    return crossings.take(_without(len(crossings), ends[hit])), crossings.take(ends[hit & within].flatten()), cost


def beside(crossings: Crossings, others: Crossings, grid: Numbered) -> Tensor:
    """bool (N,): which crossings lie on an edge that `others`, on lines along the other axis, have on the line next to them.

    An edge that is followed along those is no more than half a distance of lines times `STEEPEST` off on the nearest one.
    """
    places = place_of(grid.number(others.across), others.place).sort().values
    line, reach = grid.number(crossings.place), STEEPEST / (2 * grid.count)
    last, first = (torch.searchsorted(places, place_of(line, crossings.across + end), right=end > 0) for end in (reach, -reach))
    return last > first


def _held(pieces: Pieces, grid: Numbered) -> Tensor:
    """Which pieces a sample lies in."""
    phase = grid.phase(pieces.line)
    return torch.floor(pieces.second - phase) > torch.floor(pieces.first - phase)


def _without(count: int, ends: Tensor) -> Tensor:
    """The indices of `count` crossings but for those at the ends (P, 2) of pieces."""
    kept = torch.ones(count, dtype=torch.bool, device=ends.device)
    kept[ends.flatten()] = False
    return kept.nonzero()[:, 0]


def _narrowed(ask: Ask, crossings: Crossings, _: Pieces, ends: Tensor, grid: Numbered, finest: float, seed: int) -> Crossings:
    """With the ends of short pieces known as exactly as their slopes, over a part of their width, ask for."""
    blunt = torch.zeros(len(crossings), dtype=torch.bool, device=crossings.place.device)
    blunt[ends] = True
    blunt &= (crossings.width > 2 * finest) & (crossings.width <= BRACKET)
    if not bool(blunt.any()):
        return crossings
    some = crossings.take(blunt.nonzero()[:, 0])
    sharp = sharpened(ask, some, grid.number(some.across), finest, seed, kind=2)
    return joined([crossings.take((~blunt).nonzero()[:, 0]), sharp])


def _opened(ask: Ask, crossings: Crossings, pieces: Pieces, _: Tensor, grid: Numbered, finest: float, seed: int) -> Crossings:
    """With the crossings hidden in short pieces: where two thin pieces lie close by, the ends of one and the other look like one piece."""
    pieces = pieces.take(pieces.width > _PROBES_APART)
    if len(pieces) == 0:
        return crossings
    apart, across = pieces.width / (_PROBES + 1), grid.across(pieces.line)
    places = pieces.first + apart * torch.arange(_PROBES + 2, device=apart.device)[:, None]
    places[0] += 1e-3
    places[-1] -= 1e-3
    values = ask_on(ask, crossings.axis, places[1:-1].flatten(), across.repeat(_PROBES)).unflatten(1, (_PROBES, -1))
    values = torch.cat([pieces.inside[:, None], values, pieces.inside[:, None]], 1)
    changed = (values[:, 1:] - values[:, :-1]).abs().amax(0) > pieces.tolerance
    probe, piece = changed.nonzero().unbind(1)
    line = pieces.line[piece]
    segments = brackets(
        crossings.axis,
        across[piece],
        places[probe, piece],
        places[probe + 1, piece],
        values[:, probe, piece],
        values[:, probe + 1, piece],
        grid.phase(line),
        line,
        kind=1,
    )
    return joined([crossings, bisect(ask, segments, finest, seed)])
