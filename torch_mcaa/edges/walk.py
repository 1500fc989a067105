"""Thin pieces followed over lines: foretold from the last two, on many at once, and bisected where they are found."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from torch_mcaa.edges.bisect import Crossings, joined
from torch_mcaa.edges.few import Arrays, Brackets, Colours, Few, Floats, Integers, Mask, uneven
from torch_mcaa.edges.pieces import SAME, Known, Numbered, Pieces, inside, place_of

STEEPEST = 3.0
"""Px a px: pieces that change their place faster from line to line are not followed along it."""
_WITHIN = 2.0**-10
"""Px: how far off its ends may be where the last two lines foretell them."""
_STRIDE = 64
"""The most lines that a piece is foretold on at once."""
_TWICE = 5e-4
"""Px: crossings of one jump closer than this are one that was found twice."""


@dataclass(frozen=True)
class _Ends(Arrays):
    """The two ends of pieces on lines, by number: brackets (2, N), colours (C, 2, N)."""

    line: Integers
    across: Floats
    low: Floats
    high: Floats
    before: Colours
    after: Colours

    @property
    def place(self) -> Floats:
        return (self.low + self.high) / 2


class Walk:
    """Pieces followed over lines; it gathers what it finds."""

    def __init__(self, few: Few, grid: Numbered, known: Known, wanted: Mask, origin: tuple[int, int], finest: float) -> None:
        self.grid, self.known, self.wanted, self.origin = grid, known, wanted, origin
        self.few, self.finest, self.axis = few, finest, grid.axis
        self.found: list[_Ends] = []
        self._reached: list[Integers] = []

    def reached(self, pieces: Pieces) -> Mask:
        """Which pieces a walk ended at."""
        mask = np.zeros(len(pieces), dtype=np.bool_)
        for index in self._reached:
            mask[index] = True
        return mask

    def follow(self, pieces: Pieces, direction: int, behind: Integers) -> Mask:
        """Follow pieces towards higher (+1) or lower (-1) lines; which of them were found on the next line."""
        # the slopes (2, N) of both ends, in px a line, from the piece on the line behind or from one close by
        ends, slope = np.stack([pieces.first, pieces.second]), np.zeros((2, len(pieces)))
        old = behind >= 0
        there = self.known.pieces.take(behind[old])
        slope[:, old] = ends[:, old] - np.stack([there.first, there.second])
        fresh = np.flatnonzero(~old)
        alive = np.ones(len(pieces), dtype=np.bool_)
        if len(fresh):
            near = pieces.take(fresh)
            step = 0.2 * np.minimum(near.width, 1 / self.grid.count)
            ok, found = self._meet(near, near.line, self.grid.across_of(near.line) + direction * step, ends[:, fresh], 0.6)
            slope[:, fresh[ok]] = (found.place - ends[:, fresh[ok]]) / (self.grid.count * step[ok])
            alive[fresh[~ok]] = False
        alive &= np.abs(slope).min(0) * self.grid.count <= STEEPEST
        moved = np.zeros_like(alive)
        index = np.flatnonzero(alive)
        current, slope = pieces.take(index), slope[:, index]
        # as many lines at once as went on as they were foretold
        stride, begun = np.ones_like(index), False
        while len(index):
            walk = np.arange(len(index)).repeat(stride)
            ahead = 1 + np.arange(len(walk)) - (stride.cumsum() - stride)[walk]
            like = current.take(walk)
            line = like.line + direction * ahead
            ends, across = np.stack([like.first, like.second]) + ahead * slope[:, walk], self.grid.across_of(line)
            go = (ends[1] - ends[0] > 1e-3) & inside(self.wanted, self.origin, self.axis, ends.mean(0), across)
            met = np.where(go, self.known.at(line, *ends, like.inside, like.tolerance, 0.05), -1)
            clear = _until(~go | (met >= 0), walk, ahead, stride)
            asked = np.flatnonzero(ahead <= clear[walk])
            walked, found = self._next(
                like.take(asked), line[asked], across[asked], ends[:, asked], walk[asked], ahead[asked], clear
            )
            self.found.append(found)
            arrived = (met >= 0) & (walked == clear)[walk] & (ahead == 1 + clear[walk])
            self._reached.append(self.known.order[met[arrived]])
            if not begun:
                moved[index[walked > 0]] = True
                moved[index[walk[arrived]]] = True
                begun = True
            on = walked > 0
            on[walk[arrived]] = False
            # what was found is on the lines walked, one after another
            last, lines = found.take((walked.cumsum() - 1)[on]), walked[on]
            index, before = index[on], current.take(on)
            slope = (last.place - np.stack([before.first, before.second])) / lines
            stride = np.where(lines == stride[on], np.minimum(2 * lines, _STRIDE), lines)
            colour = (last.after[:, 0] + last.before[:, 1]) / 2
            first, second = last.place
            current = Pieces(last.line, first, second, last.before[:, 0], colour, last.after[:, 1])
        return moved

    def _next(
        self, like: Pieces, line: Integers, across: Floats, ends: Floats, walk: Integers, ahead: Integers, most: Integers
    ) -> tuple[Integers, _Ends]:
        """How many lines each walk (W,) goes on for, and the pieces' ends there.

        Of pieces foretold at `ends` (2, N) on the lines that are `ahead` (N,) of each `walk` (N,), up to the first that is not within `_WITHIN`
        of it; on the next line they are looked for as `_meet` does, too.
        """
        first, second = ends
        inner = np.minimum((second - first) / 4, _WITHIN)
        # the brackets of a straight edge would else err alike on all lines
        outer = _WITHIN * (0.75 + 0.5 * uneven(line))
        places = np.stack([first - outer, first + inner, second - inner, second + outer])
        values = self.few.at(places, across)
        told = np.stack([like.before, like.inside, like.inside, like.after], 1)
        close = (np.abs(values - told).max(0) <= like.tolerance).all(0)
        where = np.flatnonzero(ahead <= _until(~close, walk, ahead, most)[walk])
        ok, found = self._ends(line[where], across[where], places[:, where], values[:, :, where])
        there = np.zeros_like(close)
        there[where[ok]] = True
        far = np.flatnonzero(~close & (ahead == 1))
        if len(far):
            again, more = self._meet(like.take(far), line[far], across[far], ends[:, far], 0.3)
            there[far[again]] = True
            found = _Ends.joined([found, more]).take(np.argsort(np.concatenate([where[ok], far[again]]), kind="stable"))
        walked = _until(~there, walk, ahead, most)
        return walked, found.take((ahead <= walked[walk])[there])

    def _meet(self, like: Pieces, line: Integers, across: Floats, ends: Floats, margin: float) -> tuple[Mask, _Ends]:
        """Find the ends of pieces foretold at `ends` (2, N): which were (N,), and those."""
        first, second = ends
        width, middle = second - first, (first + second) / 2
        places = np.stack([first - margin * width, middle, middle, second + margin * width])
        values = self.few.at(places[[0, 1, 3]], across)
        a, b, c = values.swapaxes(0, 1)
        ok = np.abs(b - like.inside).max(0) <= like.tolerance
        # each outer end must be of the colour beside the piece
        ok &= np.abs(a - like.before).max(0) <= np.abs(a - like.inside).max(0)
        ok &= np.abs(c - like.after).max(0) <= np.abs(c - like.inside).max(0)
        where = np.flatnonzero(ok)
        both, found = self._ends(line[where], across[where], places[:, where], values[:, :, where][:, [0, 1, 1, 2]])
        ok[where[~both]] = False
        return ok, found

    def _ends(self, line: Integers, across: Floats, places: Floats, values: Colours) -> tuple[Mask, _Ends]:
        """Bisect the two ends of pieces, [places[0], places[1]] and [places[2], places[3]], with `values` (C, 4, N): which are clear, and those."""
        shape, channels = (2, len(line)), len(values)
        wide = Brackets(
            places[[0, 2]].ravel(), places[[1, 3]].ravel(), *(values[:, some].reshape(channels, -1) for some in ([0, 2], [1, 3]))
        )
        lines, phase = (np.tile(each, 2) for each in (line, self.grid.phase_of(line)))
        single, found = self.few.narrowed(lines, np.tile(across, 2), phase, wide, self.finest)
        one, two = single.reshape(shape)
        both = one & two
        low, high = found.low.reshape(shape), found.high.reshape(shape)
        before, after = found.before.reshape(channels, *shape), found.after.reshape(channels, *shape)
        return both, _Ends(line, across, low, high, before, after).take(both)

    def with_found(self, crossings: Crossings) -> Crossings:
        """The crossings and those found, of a crossing found twice only one."""
        found = _Ends.joined(self.found) if self.found else None
        if found is None or not len(found.line):
            return crossings
        everything = joined([crossings, self._crossings(found)])
        place = place_of(self.grid.number(everything.across), everything.place)
        order = torch.argsort(place)
        width = everything.width[order]
        same = (place[order][1:] - place[order][:-1] < (_TWICE + (width[1:] + width[:-1]) / 2)) & (
            (everything.jump[:, order][:, 1:] - everything.jump[:, order][:, :-1]).abs().amax(0)
            < SAME * everything.jump[:, order][:, 1:].abs().amax(0)
        )
        new = torch.ones(len(order), dtype=torch.bool, device=order.device)
        new[1:] = ~same
        return everything.take(order[new])

    def _crossings(self, found: _Ends) -> Crossings:
        """First and second ends one after the other."""
        both = np.tile(np.stack([found.across, self.grid.phase_of(found.line)]), 2)
        planes = both[0], found.place.ravel(), (found.high - found.low).ravel()
        colours = (each.reshape(len(each), -1) for each in (found.before, found.after))
        numbers = (*planes, *colours, both[1], np.zeros(both.shape[1], dtype=np.int64))
        return Crossings(self.axis, *(torch.from_numpy(each).to(self.grid.device) for each in numbers))


def _until(end: Mask, walk: Integers, ahead: Integers, most: Integers) -> Integers:
    """(W,): how many lines of each walk come before its first `end` (N,), at most `most` (W,)."""
    until = most.copy()
    np.minimum.at(until, walk[end], ahead[end] - 1)
    return until
