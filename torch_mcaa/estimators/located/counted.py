"""Asking f at single places under a budget."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from torch_mcaa import rng
from torch_mcaa.errors import McaaError
from torch_mcaa.estimators.base import Task
from torch_mcaa.grid import Cell
from torch_mcaa.integrand import BLOCK, width_of

if TYPE_CHECKING:
    from torch_mcaa.traced.asked import Asked

_STREAM, _TWICE = 0x2A5C, 16
_ROUNDED, _AGAIN = 0x20D, 48
_OFF, _DIGITS, _SURE = 1 / 64, 64, 2
"""What rounding changes no f by that is not another one by it, in its range and in its last digits; and how many places have to say so: one may
lie on an edge."""
_HELD = 1 << 14
"""Places that are counted at once."""


class Spent(Exception):
    """There are not enough evaluations left, or no time; none was made."""


@dataclass
class Precision:
    """The dtype of the places that f is asked at: float64, in which jumps are located, unless f cannot take it, or is another one in it."""

    dtype: torch.dtype = torch.float64


class Counted:
    """f at float64 screen columns and rows (N,): (C, N), as `torch_mcaa.edges` asks it.

    Attributes:
        left: how many evaluations are left, `kept` of which are not for now.
        invalid: (h, w) int64, how many of them were not finite; those count as 0.
    """

    def __init__(self, task: Task, cell: Cell, budget: int, precision: Precision) -> None:
        self.task, self.cell, self.precision = task, cell, precision
        self.left, self.kept = budget, 0
        self._points, self.invalid = (torch.zeros(cell.height, cell.width, dtype=torch.int64, device=task.device) for _ in range(2))
        self._places: list[tuple[Tensor, Tensor]] = []
        self._held = 0

    @contextmanager
    def keeping(self, share: float) -> Iterator[None]:
        """Keep a share of what is left from those who ask inside."""
        self.kept = int(share * self.left)
        try:
            yield
        finally:
            self.kept = 0

    def beside(self, cell: Cell) -> Counted:
        """Another one, for a part of the cell, with no budget to speak of."""
        return Counted(self.task, cell, 1 << 62, self.precision)

    def include(self, other: Counted) -> None:
        """Count what another one, of a part of the cell, was asked."""
        at = other.cell.within(self.cell)
        self.points[at] += other.points
        self.invalid[at] += other.invalid

    def include_rows(self, around: Cell, counts: Tensor) -> int:
        """Count so many evaluations in each pixel of the rows of a part of the screen, those of them that lie in the cell; how many these are."""
        shared, inside = self._inside(around, counts)
        self._points[shared.within(self.cell)] += inside.to(self._points)[:, None]
        return int(inside.sum()) * shared.width

    def inside(self, around: Cell, counts: Tensor) -> int:
        """How many these would be."""
        shared, inside = self._inside(around, counts)
        return int(inside.sum()) * shared.width

    def _inside(self, around: Cell, counts: Tensor) -> tuple[Cell, Tensor]:
        """What a part of the screen shares with the cell, and its rows' counts there."""
        shared = around.overlap(self.cell)
        return shared, counts[shared.within(around)[0]]

    def cut(self, cell: Cell) -> Counted:
        """The same for a part of the cell, with what was asked there so far."""
        other, at = self.beside(cell), cell.within(self.cell)
        other._points += self.points[at]
        other.invalid += self.invalid[at]
        return other

    @property
    def points(self) -> Tensor:
        """(h, w) int64, the evaluations so far in each pixel of the cell."""
        self._counted()
        return self._points

    @cached_property
    def decisions(self) -> Asked:
        """f, followed, asked under the same budget."""
        from torch_mcaa.traced.asked import Asked

        task = self.task
        assert task.followed is not None

        def tally(col: Tensor, row: Tensor) -> None:
            self._note(col, row)
            task.integrand.evaluations += len(col)

        asked = Asked(task.followed.function, task.screen, task.followed.program, task.dtype, task.device, tally)
        asked.precision = self.precision.dtype
        return asked

    def _note(self, col: Tensor, row: Tensor) -> None:
        """Count the places that f is to be asked at."""
        cell = self.cell
        inside = (row >= cell.row) & (row < cell.row + cell.height) & (col >= cell.col) & (col < cell.col + cell.width)
        self._spend(int(inside.count_nonzero()))
        # counted later: of few places a call is dearer than they are
        self._places.append((col, row))
        self._held += len(col)
        if self._held > _HELD * width_of(col.device):
            self._counted()

    def coded(self, col: Tensor, row: Tensor) -> Tensor:
        """As when called, with the codes of `Task.coded` as the last channel, (C + 1, N)."""
        return self(col, row, coded=True)

    def sampled(self, col: Tensor, row: Tensor) -> Tensor:
        """As when called, in the dtype in which a lattice asks f."""
        return self(col, row, dtype=self.task.screen.coordinate_dtype(self.cell, self.task.dtype))

    def __call__(self, col: Tensor, row: Tensor, *, coded: bool = False, dtype: torch.dtype | None = None) -> Tensor:
        """Raises Spent rather than ask more than the budget."""
        task = self.task
        if len(col) == 0:
            # f may not know what to do with no points
            return torch.zeros(task.integrand.channels + coded, 0, dtype=task.dtype, device=col.device)
        self._note(col, row)
        block, x, y = BLOCK * width_of(col.device), col, row
        if task.boundary != "extend":
            # no pixel that is corrected reaches beyond the screen, so what is told there does not matter
            x, y = col.clamp(0, task.screen.width * (1 - 2.0**-50)), row.clamp(0, task.screen.height * (1 - 2.0**-50))
        parts = [
            torch.stack(self._asked(task.screen.x_of(c), task.screen.y_of(r), task.coded if coded else task.integrand, dtype))
            for c, r in zip(x.split(block), y.split(block), strict=True)
        ]
        values = parts[0] if len(parts) == 1 else torch.cat(parts, 1)
        bad = self._bad(values)
        if bad is not None:
            self._count(self.invalid, col[bad], row[bad])
            values = values.masked_fill(bad, 0)
        return values

    def everywhere(self, x: float, y: float, around: Cell) -> Tensor:
        """f (C, height, width) at one offset in each pixel of a part of the screen, in the dtype that a lattice asks it in.

        Where f is followed the codes are one channel more.

        Raises Spent rather than ask more than the budget.
        """
        task, (rows, cols) = self.task, around.window
        shared = around.overlap(self.cell)
        self._spend(shared.height * shared.width)
        self._points[shared.within(self.cell)] += 1
        dtype = task.screen.coordinate_dtype(self.cell, task.dtype)
        across = task.screen.x_of(torch.arange(cols.start, cols.stop, dtype=torch.float64) + x).to(task.device, dtype)
        down = task.screen.y_of(torch.arange(rows.start, rows.stop, dtype=torch.float64) + y).to(task.device, dtype)
        values = torch.stack(task.coded(across.expand(around.height, around.width), down[:, None]))
        bad = self._bad(values)
        if bad is not None:
            at, here = bad.nonzero().unbind(1)
            self._count(self.invalid, here + around.col + x, at + around.row + y)
            values = values.masked_fill(bad, 0)
        return values

    def check(self, count: int) -> None:
        """Raises Spent if fewer evaluations are left, or no time."""
        if count > self.left - self.kept or self.task.late:
            raise Spent

    def _spend(self, count: int) -> None:
        self.check(count)
        self.left -= count

    def _bad(self, values: Tensor) -> Tensor | None:
        """Where values (C, ...) are not finite; None where all are, or it has been looked at."""
        if self.task.integrand.nonfinite == "raise":
            return None
        bad = ~values.isfinite().all(0)
        return bad if bool(bad.any()) else None

    def _counted(self) -> None:
        if self._places:
            self._count(self._points, *(torch.cat(axis) for axis in zip(*self._places, strict=True)))
        self._places, self._held = [], 0

    def _count(self, plane: Tensor, col: Tensor, row: Tensor) -> None:
        """Add one to the plane at each place in the cell, in place: a place takes far less time than a plane."""
        cell = self.cell
        i, j = row.floor().to(torch.int64) - cell.row, col.floor().to(torch.int64) - cell.col
        flat = (i * cell.width + j)[(i >= 0) & (i < cell.height) & (j >= 0) & (j < cell.width)]
        plane.view(-1).index_add_(0, flat, torch.ones_like(flat))

    def _asked(
        self, x: Tensor, y: Tensor, integrand: Callable[[Tensor, Tensor], list[Tensor]], dtype: torch.dtype | None
    ) -> list[Tensor]:
        """f at float64 coordinates; an f that takes the picture's dtype alone, such as a network, gets that from then on."""
        dtype = dtype or self.precision.dtype
        try:
            return integrand(x.to(dtype), y.to(dtype))
        except McaaError as error:
            # what f raised itself is chained
            if dtype == self.task.dtype or error.__cause__ is None:
                raise
            values = integrand(x.to(self.task.dtype), y.to(self.task.dtype))
            self.precision.dtype = self.task.dtype
            return values


def is_random(ask: Counted, seed: int) -> bool:
    """Whether f answers differently when it is asked twice, at 16 random places of the cell; noted in the integrand."""
    cell = ask.cell
    col, row = cell.places(_TWICE, seed, _STREAM, cell.row, cell.col, device=ask.invalid.device)
    try:
        first, second = ask(col, row), ask(col, row)
    except Spent:
        return False
    if torch.equal(first, second):
        return False
    ask.task.integrand.random = True
    return True


def hold_to_rounding(ask: Counted, x: float, y: float, row: int, col: int, values: Tensor, seed: int) -> None:
    """Ask f in the picture's dtype from now on if rounding makes another f of it, as of one that hashes: what float64 tells of is not in the picture.

    values: (C, h, w) as `Counted.everywhere` has told of them, of the same places; some of them are asked for again, in float64.
    """
    task, (height, width) = ask.task, values.shape[1:]
    if ask.precision.dtype == task.screen.coordinate_dtype(ask.cell, task.dtype):
        return
    at = rng.bits(seed, _ROUNDED, torch.arange(_AGAIN, device=values.device)) % (height * width)
    down, across = at // width, at % width
    before = values[:, down, across].to(torch.float64)
    try:
        off = (ask(across + (col + x), down + (row + y), coded=task.followed is not None).to(torch.float64) - before).abs()
    except Spent:
        return
    # of what is flat there, no more than its digits
    spread = torch.maximum(_OFF * (before.amax(1) - before.amin(1)), _DIGITS * torch.finfo(task.dtype).eps * before.abs().amax(1))
    if int((off > spread[:, None]).any(0).count_nonzero()) >= _SURE:
        ask.precision.dtype = task.dtype


def on_screen(task: Task, row: int, col: int, shape: tuple[int, int]) -> Tensor:
    """bool `shape`: the pixels from (row, col) in which f may be asked: all of them unless the boundary closes the screen."""
    rows, cols = (torch.arange(first, first + size, device=task.device) for first, size in zip((row, col), shape, strict=True))
    if task.boundary == "extend":
        return torch.ones(shape, dtype=torch.bool, device=task.device)
    return ((rows >= 0) & (rows < task.screen.height))[:, None] & (cols >= 0) & (cols < task.screen.width)
