"""The pieces of one colour between neighbouring crossings of a line, and how to find them again from another line; in NumPy, for `few` of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from torch_mcaa.edges.bisect import Crossings
from torch_mcaa.edges.few import Arrays, Colours, Floats, Integers, Mask, on_host
from torch_mcaa.edges.lines import Lines

SHORT = 1.5
"""Px: longer pieces than this are on the next line for certain, unless they end."""
SAME = 0.35
"""A colour is that of the piece within this share of the smaller jump at its ends."""
_LINE = 2.0**21
"""So much further is a place on the next line, in one order of all."""


@dataclass(frozen=True)
class Pieces(Arrays):
    """Pieces [first, second] of lines, `line` counted over the screen; colours (C, P) before, in, and after each."""

    line: Integers
    first: Floats
    second: Floats
    before: Colours
    inside: Colours
    after: Colours

    def __len__(self) -> int:
        return len(self.line)

    @property
    def width(self) -> Floats:
        """(P,) px."""
        return self.second - self.first

    @property
    def tolerance(self) -> Colours:
        """(P,) how far a colour may be from the piece's."""
        return SAME * np.minimum(np.abs(self.inside - self.before).max(0), np.abs(self.after - self.inside).max(0))


class Numbered:
    """The lines of a lattice along one axis, counted in order."""

    def __init__(self, lines: Lines, axis: int) -> None:
        self.axis, self.count = axis, lines.count
        across, phase = (lines.y, lines.x) if axis == 0 else (lines.x, lines.y)
        order = torch.argsort(across)
        self._across, self._phase = across[order], phase[order]
        self.device, self._host = across.device, (on_host(self._across), on_host(self._phase))

    def number(self, across: Tensor) -> Tensor:
        """The number of the line at `across`."""
        return ((across - self._across[0]) * self.count).round().long()

    def across(self, number: Tensor) -> Tensor:
        return self._across[number % self.count] + torch.div(number, self.count, rounding_mode="floor")

    def phase(self, number: Tensor) -> Tensor:
        return self._phase[number % self.count]

    def across_of(self, number: Integers) -> Floats:
        """`across`, in NumPy."""
        return self._host[0][number % self.count] + number // self.count

    def phase_of(self, number: Integers) -> Floats:
        """`phase`, in NumPy."""
        return self._host[1][number % self.count]


class Known:
    """Pieces by place: is there one of a colour about an interval of a line?"""

    def __init__(self, pieces: Pieces) -> None:
        self.order = np.argsort(place_on(pieces.line, pieces.first), kind="stable")
        self.pieces = pieces.take(self.order)
        self._places = place_on(self.pieces.line, self.pieces.first)

    def at(
        self, line: Integers, first: Floats, second: Floats, inside: Colours, tolerance: Colours, slack: float | Floats
    ) -> Integers:
        """(N,) the known piece that meets [first - slack, second + slack] on the line, or -1."""
        if len(self.pieces) == 0:
            return np.full_like(line, -1)
        known, last = self.pieces, self._places.searchsorted(place_on(line, second + slack), side="right") - 1
        # the last ones that begin before
        index = last - np.arange(4)[:, None]
        there = np.maximum(index, 0)
        begin, end = known.first[there], known.second[there]
        fits = (index >= 0) & (known.line[there] == line) & (end >= first - slack)
        # samples of two pieces may hide what is between them: that is a longer piece, and another one
        width, own = end - begin, second - first
        fits &= np.abs(width - own) <= 0.5 * np.maximum(width, own)
        fits &= np.abs(known.inside[:, there] - inside[:, None]).max(0) <= tolerance
        return np.where(fits.any(0), there[fits.argmax(0), np.arange(len(line))], -1)


def inside(wanted: Mask, origin: tuple[int, int], axis: int, along: Floats, across: Floats) -> Mask:
    """(N,) which places on lines along `axis` lie in pixels that are `wanted` (R, Q), the first of which is `origin` (row, col)."""
    x, y = (along, across) if axis == 0 else (across, along)
    row, col = np.floor(y).astype(np.int64) - origin[0], np.floor(x).astype(np.int64) - origin[1]
    height, width = wanted.shape
    within = (row >= 0) & (row < height) & (col >= 0) & (col < width)
    return within & wanted[row.clip(0, height - 1), col.clip(0, width - 1)]


def place_of(line: Tensor, along: Tensor) -> Tensor:
    """(N,) places on lines in one order."""
    return line.to(torch.float64) * _LINE + along


def place_on(line: Integers, along: Floats) -> Floats:
    """`place_of`, in NumPy."""
    return line * _LINE + along


def pieces_of(crossings: Crossings, grid: Numbered) -> tuple[Pieces, Integers]:
    """The pieces between neighbouring crossings of a line, and the index (P, 2) of their crossings."""
    line, place, width = (on_host(each) for each in (grid.number(crossings.across), crossings.place, crossings.width))
    before, after = on_host(crossings.before), on_host(crossings.after)
    order = np.argsort(place_on(line, place), kind="stable")
    line, place, width = line[order], place[order], width[order]
    apart = place[1:] - place[:-1]
    # the leaves of one steep step touch each other
    gap = apart - (width[:-1] + width[1:]) / 2
    start = np.flatnonzero((line[:-1] == line[1:]) & (gap > np.minimum(width[:-1], width[1:])))
    jump = np.abs(after - before).max(0)
    one, two = order[start], order[start + 1]
    same = np.abs(after[:, one] - before[:, two]).max(0) <= SAME * np.minimum(jump[one], jump[two])
    start = start[same | (apart[start] > SHORT)]
    one, two = order[start], order[start + 1]
    colour = (after[:, one] + before[:, two]) / 2
    return Pieces(line[start], place[start], place[start + 1], before[:, one], colour, after[:, two]), np.stack([one, two], 1)
