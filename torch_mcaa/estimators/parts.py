"""Parts of a cell, each estimated in its own way: by a plain lattice, or by one that is corrected for its jumps."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from torch_mcaa import rng
from torch_mcaa.edges.correction import Window
from torch_mcaa.edges.lines import Samples
from torch_mcaa.estimators.base import MANY, Estimate, Task, dilated, settled, unseen
from torch_mcaa.estimators.counted import Counted, Precision
from torch_mcaa.estimators.jump_corrector import BLOCK, Corrector, windows_of
from torch_mcaa.estimators.shared_lattice import LatticeRound
from torch_mcaa.filters import SeparableFilter
from torch_mcaa.grid import Cell

MODELS = ("lattice", "jumps located", "jumps located on a finer lattice", "no jumps to locate: more samples")
PLAIN, LOCATED, FINER, SAMPLED = range(4)
_STREAM, _MORE = 0x6A756D70, 0x4D0
_SHARE = 0.72
"""Of the evaluations a pixel, what the lattice may take: the rest is for bisection."""
_FEWEST = 3
"""Lines."""
_COLUMNS = 16
"""A lattice's columns come in so many: the last few of a product of matrices have other last bits under other numbers of threads."""
_SMALL = 1e-4
"""A standard error, in ranges of the part's values, below which no more samples are taken where nothing jumps."""


def located(model: Tensor) -> bool:
    """Whether jumps were located in any pixel."""
    return bool(((model == LOCATED) | (model == FINER)).any())


def lines_for(spp: float) -> int:
    """Points, and lines, a pixel of the lattice whose jumps are to be located with `spp` evaluations; odd."""
    count = max(3, int(_SHARE * spp + 0.5))
    return count - 1 + count % 2


@dataclass(frozen=True)
class Part:
    """What one part of a cell gave; as `Estimate`, but without the floor.

    `density`, a number or (h, w), is the lattice's points a pixel, which the floor depends on.
    """

    value: Tensor
    variance: Tensor
    points: Tensor
    invalid: Tensor
    heavy: Tensor | None
    model: Tensor
    density: float | Tensor
    blind: Tensor | None = None

    @property
    def spent(self) -> int:
        """Evaluations."""
        return int(self.points.sum())

    def estimate(self) -> Estimate:
        """With the floor for what its lattice did not meet."""
        floor = unseen(self.value, self.density)
        variance = settled(self.variance, self.value, floor)
        heavy = None
        if self.heavy is not None:
            variance.masked_fill_(self.heavy, torch.inf)
            heavy = self.heavy.any(0)
        return Estimate(
            self.value,
            variance,
            self.points.to(torch.int32),
            self.invalid.to(torch.int32),
            heavy=heavy,
            unseen=floor,
            model=self.model.to(torch.uint8),
            blind=self.blind,
        )


class Parts:
    """The parts of one round; `number` is the round's. `audited`: lattices whose jumps are located have points off them, too."""

    def __init__(self, task: Task, number: int, audited: bool) -> None:
        self.task, self.number, self.audited = task, number, audited
        self.seed = int(rng.bits(task.seed, _STREAM, number))
        self.random = False
        self._lattices: dict[tuple[int, bool], LatticeRound] = {}
        self._precision = Precision()

    def ask(self, cell: Cell, budget: int) -> Counted:
        """f at places of a part of the screen."""
        return Counted(self.task, cell, budget, self._precision)

    def sampled(self, cell: Cell, spp: int, budget: int) -> Part:
        """A plain lattice of at most `spp` evaluations a pixel and `budget` in all."""
        lattice = self._lattice(spp, False)
        while spp > 1 and lattice.points(cell) > budget:
            # a cut pattern can hold more than its share
            spp -= 1
            lattice = self._lattice(spp, False)
        whole = cell
        if self.task.boundary == "extend":
            whole = Cell(cell.row, cell.col, cell.height, -(-cell.width // _COLUMNS) * _COLUMNS)
        found = lattice.measured(whole)
        inner = (..., slice(0, cell.height), slice(0, cell.width))
        points = lattice.row_points(cell).to(found.value.device, torch.int64)[:, None].expand(cell.height, cell.width)
        model = torch.full((cell.height, cell.width), SAMPLED, dtype=torch.uint8, device=found.value.device)
        heavy = None if found.heavy is None else found.heavy[inner]
        blind = None if found.blind is None else found.blind[inner]
        return Part(found.value[inner], found.variance[inner], points, found.invalid[inner], heavy, model, spp, blind)

    def located(self, cell: Cell, count: int, budget: int, steps: int) -> Part:
        """A lattice of `count` points a pixel corrected for its jumps, with at most `budget` evaluations in all.

        steps: how often a segment of 1 px is halved, at most.
        """
        task = self.task
        assert isinstance(task.filter, SeparableFilter)
        pixels = cell.height * cell.width
        while count > _FEWEST and (count + self.audited) * pixels > budget:
            count -= 2
        if (count + self.audited) * pixels > budget:
            return self.sampled(cell, max(1, budget // pixels), budget)
        lattice = self._lattice(count, True)
        around = self._around(cell)
        found = lattice.measured(around, keep=True)
        top, left = cell.row - around.row, cell.col - around.col
        inner = (..., slice(top, top + cell.height), slice(left, left + cell.width))
        value, variance, invalid = found.value[inner], found.variance[inner], found.invalid[inner]
        heavy = None if found.heavy is None else found.heavy[inner]
        assert found.samples is not None
        x, y = (torch.from_numpy(places).to(task.device) for places in (lattice.strip.x, lattice.strip.y))
        every = torch.ones(found.at.strips, found.at.cols, dtype=torch.bool, device=task.device)
        base = Samples(x, y, found.at.strip, found.at.col, found.samples, every, 0)
        sampled = count + self.audited
        ask = self.ask(cell, budget - sampled * pixels)
        allowed = self._allowed(cell, found.invalid, inner) & (not self.random)
        if heavy is not None:
            allowed &= ~heavy.any(0)
        result = Corrector(ask, cell, task.filter, self.seed, base, value, allowed, steps).run()
        near = result.near
        if bool(ask.invalid.any()):
            near = near & ~dilated(ask.invalid > 0, Window.halo_of(task.filter))
        value = torch.where(near, result.value.to(task.dtype), value)
        if result.variance is not None:
            variance = torch.where(near, result.variance.to(task.dtype), variance)
        model = torch.where(near, torch.where(result.fine, FINER, LOCATED), PLAIN)
        blind = None if found.blind is None else found.blind[inner] * ~near
        part = Part(value, variance, ask.points + sampled, invalid + ask.invalid, heavy, model, count, blind)
        return self._sampled_further(cell, part, near, ask.left)

    def _lattice(self, spp: int, lines: bool) -> LatticeRound:
        if (spp, lines) not in self._lattices:
            # the plain one is pooled with the other, so it must be independent
            number = self.number if lines else self.number + _MORE
            audited = self.audited or not lines
            self._lattices[spp, lines] = LatticeRound(self.task, spp + (lines and audited), number, lines=lines, audited=audited)
        return self._lattices[spp, lines]

    def _around(self, cell: Cell) -> Cell:
        """The cell and at least a pixel around it, in which segments may begin that reach into its pixels' filters; not beyond a closed screen."""
        if self.task.boundary == "extend":
            return Cell(cell.row - 1, cell.col - 1, cell.height + 2, -(-(cell.width + 2) // _COLUMNS) * _COLUMNS)
        top, left = max(0, cell.row - 1), max(0, cell.col - 1)
        bottom = min(self.task.screen.height, cell.row + cell.height + 1)
        right = min(self.task.screen.width, cell.col + cell.width + 1)
        return Cell(top, left, bottom - top, right - left)

    def _allowed(self, cell: Cell, invalid: Tensor, inner: tuple[Any, ...]) -> Tensor:
        """(h, w) the pixels that may be corrected: all that their filter covers is finite, and on the screen if that ends f.

        invalid: of the cell and a pixel around it, of which `inner` is the cell.
        """
        assert isinstance(self.task.filter, SeparableFilter)
        halo = Window.halo_of(self.task.filter)
        allowed = ~dilated(invalid > 0, halo)[inner]
        if self.task.boundary != "extend":
            rows = torch.arange(cell.row, cell.row + cell.height, device=allowed.device)
            cols = torch.arange(cell.col, cell.col + cell.width, device=allowed.device)
            height, width = self.task.screen.height, self.task.screen.width
            allowed &= ((rows >= halo) & (rows < height - halo))[:, None] & (cols >= halo) & (cols < width - halo)
        return allowed

    def _sampled_further(self, cell: Cell, part: Part, near: Tensor, left: int) -> Part:
        """More samples in the blocks whose pixels were not corrected, unless they are known well enough."""
        value, variance, points, invalid, model = part.value, part.variance, part.points, part.invalid, part.model
        blind = torch.zeros_like(variance) if part.blind is None else part.blind
        finite = value.nan_to_num(0.0, 0.0, 0.0)
        span = (finite.amax((1, 2)) - finite.amin((1, 2)))[:, None, None]
        known = _SMALL * span + 64 * torch.finfo(value.dtype).eps * finite.abs().amax((1, 2), keepdim=True)
        poor = (variance.sqrt() > known).any(0) & ~near
        blocks = [window for window in windows_of(cell) if bool(poor[window].any())]
        rest = left // max(1, sum(poor[window].numel() for window in blocks))
        if not blocks or rest < 1:
            return part
        if len(blocks) * BLOCK * BLOCK >= cell.height * cell.width:
            blocks = [(slice(0, cell.height), slice(0, cell.width))]
        for rows, cols in blocks:
            here = Cell(cell.row + rows.start, cell.col + cols.start, rows.stop - rows.start, cols.stop - cols.start)
            more = self.sampled(here, rest, left)
            left -= more.spent
            at = (slice(None), rows, cols)
            free = ~near[rows, cols]
            share = free * _share(variance[at] * free, part.density, more.variance * free, rest)
            value[at] += (more.value - value[at]) * share
            variance[at] = variance[at] * (1 - share) ** 2 + more.variance * share**2
            blind[at] = blind[at] * (1 - share) ** 2 + (0 if more.blind is None else more.blind * share**2)
            points[rows, cols] += more.points
            invalid[rows, cols] += more.invalid
            model[rows, cols] = torch.where(free, SAMPLED, model[rows, cols])
        return Part(value, variance, points, invalid, part.heavy, model, part.density, blind)


def _share(first: Tensor, had: float | Tensor, second: Tensor, more: int) -> float:
    """The weight of a second lattice of `more` points a pixel beside a first of `had`, from the means of their variances over a block.

    Of few pixels, or where the variances have no mean, from their numbers of points: so few say too little.
    """
    mine, theirs = (float(v.to(torch.float64).mean()) for v in (first, second))
    if first[0].numel() < MANY or not 0 < mine + theirs < math.inf:
        mine, theirs = float(more) ** 1.5, float(had) ** 1.5
    return mine / (mine + theirs)
