"""The pieces of one colour between neighbouring crossings of a line, and how to find them again from another line."""

from __future__ import annotations

from dataclasses import dataclass, fields

import torch
from torch import Tensor

from torch_mcaa.edges.bisect import Crossings, placed
from torch_mcaa.edges.lines import Lines
from torch_mcaa.picking import numbers, pick

SHORT = 1.5
"""Px: longer pieces than this are on the next line for certain, unless they end."""
SAME = 0.35
"""A colour is that of the piece within this share of the smaller jump at its ends."""


@dataclass(frozen=True)
class Pieces:
    """Pieces [first, second] of lines, `line` counted over the screen; colours (C, P) before, in, and after each."""

    line: Tensor
    first: Tensor
    second: Tensor
    before: Tensor
    inside: Tensor
    after: Tensor

    def __len__(self) -> int:
        return len(self.line)

    def take(self, index: Tensor) -> Pieces:
        """The pieces at `index`, integers or bool."""
        index = numbers(index)
        return Pieces(*(pick(getattr(self, field.name), index) for field in fields(self)))

    @property
    def width(self) -> Tensor:
        """(P,) px."""
        return self.second - self.first

    @property
    def tolerance(self) -> Tensor:
        """(P,) how far a colour may be from the piece's."""
        jumps = ((self.inside - self.before).abs().amax(0), (self.after - self.inside).abs().amax(0))
        return SAME * torch.minimum(*jumps)


class Numbered:
    """The lines of a lattice along one axis, counted in order."""

    def __init__(self, lines: Lines, axis: int) -> None:
        self.axis, self.count = axis, lines.count
        across, phase = (lines.y, lines.x) if axis == 0 else (lines.x, lines.y)
        order = torch.argsort(across)
        self._across, self._phase = across[order], phase[order]

    def number(self, across: Tensor) -> Tensor:
        """The number of the line at `across`."""
        return ((across - self._across[0]) * self.count).round().long()

    def across(self, number: Tensor) -> Tensor:
        return self._across[number % self.count] + torch.div(number, self.count, rounding_mode="floor")

    def phase(self, number: Tensor) -> Tensor:
        return self._phase[number % self.count]


class Known:
    """Pieces by place: is there one of a colour about an interval of a line?"""

    def __init__(self, pieces: Pieces) -> None:
        self.order = torch.argsort(place_of(pieces.line, pieces.first))
        self.pieces = pieces.take(self.order)
        self._places = place_of(self.pieces.line, self.pieces.first)

    def at(self, line: Tensor, first: Tensor, second: Tensor, inside: Tensor, tolerance: Tensor, slack: float | Tensor) -> Tensor:
        """(N,) the known piece that meets [first - slack, second + slack] on the line, or -1."""
        found = torch.full_like(line, -1)
        if len(self.pieces) == 0:
            return found
        last = torch.searchsorted(self._places, place_of(line, second + slack), right=True) - 1
        for back in range(4):
            index = (last - back).clamp_min(0)
            piece = self.pieces.take(index)
            fits = (last - back >= 0) & (piece.line == line) & (piece.second >= first - slack)
            # samples of two pieces may hide what is between them: that is a longer piece, and another one
            fits &= ((piece.second - piece.first) - (second - first)).abs() <= 0.5 * torch.maximum(
                piece.second - piece.first, second - first
            )
            fits &= (piece.inside - inside).abs().amax(0) <= tolerance
            found = torch.where(fits & (found < 0), index, found)
        return found


def inside(wanted: Tensor, origin: tuple[int, int], axis: int, along: Tensor, across: Tensor) -> Tensor:
    """(N,) which places on lines along `axis` lie in pixels that are `wanted`, bool (R, Q), the first of which is `origin` (row, col)."""
    x, y = placed(axis, along, across)
    row, col = y.floor().long() - origin[0], x.floor().long() - origin[1]
    height, width = wanted.shape
    within = (row >= 0) & (row < height) & (col >= 0) & (col < width)
    return within & wanted[row.clamp(0, height - 1), col.clamp(0, width - 1)]


def place_of(line: Tensor, along: Tensor) -> Tensor:
    return line.to(torch.float64) * 2.0**21 + along


def pieces_of(crossings: Crossings, grid: Numbered) -> tuple[Pieces, Tensor]:
    """The pieces between neighbouring crossings of a line, and the index (P, 2) of their crossings."""
    line = grid.number(crossings.across)
    order = torch.argsort(place_of(line, crossings.place))
    ordered, line = crossings.take(order), pick(line, order)
    place, width, jump = ordered.place, ordered.width, ordered.jump.abs().amax(0)
    between = (ordered.after[:, :-1] - ordered.before[:, 1:]).abs().amax(0)
    apart = place[1:] - place[:-1]
    # the leaves of one steep step touch each other
    gap = apart - (width[:-1] + width[1:]) / 2
    good = (line[:-1] == line[1:]) & (gap > torch.minimum(width[:-1], width[1:]))
    good &= (between <= SAME * torch.minimum(jump[:-1], jump[1:])) | (apart > SHORT)
    a = numbers(good)
    first, second = ordered.take(a), ordered.take(a + 1)
    inside = (first.after + second.before) / 2
    pieces = Pieces(pick(line, a), first.place, second.place, first.before, inside, second.after)
    return pieces, torch.stack([pick(order, a), pick(order, a + 1)], 1)
