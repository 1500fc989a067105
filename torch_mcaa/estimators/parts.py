"""Parts of a cell, each estimated in its own way: by a plain lattice, or by one that is corrected for its jumps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torch_mcaa import rng
from torch_mcaa.edges.candidates import Finder
from torch_mcaa.edges.correction import Window
from torch_mcaa.edges.lines import Everywhere, Lines
from torch_mcaa.estimators.base import Estimate, Task, dilated, settled, unseen
from torch_mcaa.estimators.lattice.lattice_weights import Geometry, reach_of
from torch_mcaa.estimators.lattice.shared_lattice import LatticeRound, Look
from torch_mcaa.estimators.located.counted import Counted, Precision
from torch_mcaa.estimators.located.jump_corrector import Corrector
from torch_mcaa.estimators.located.jump_level import FEWEST_LINES, odd
from torch_mcaa.estimators.located.owner import Owner
from torch_mcaa.estimators.narrow import SOME, held
from torch_mcaa.grid import Cell
from torch_mcaa.integrand import width_of
from torch_mcaa.patterns.lattice import CHARACTER_RATIO
from torch_mcaa.patterns.turned import FEWEST as SUITED
from torch_mcaa.patterns.turned import turned
from torch_mcaa.tolerance import FEW_SHIFTS, Tolerance

MODELS = (
    "lattice",
    "jumps located",
    "jumps located on a finer lattice",
    "no jumps to locate: more samples",
    "more jumps than are located: more samples",
    "texels, exactly",
    "points drawn from the filter",
)
PLAIN, LOCATED, FINER, SAMPLED, CROWDED, EXACT, DRAWN = range(7)
_STREAM, _MORE = 0x6A756D70, 0x4D0
_SHARE = 0.72
"""Of the evaluations a pixel, what the lattice may take: the rest is for bisection."""
_STEP = 0.25
"""Evaluations a pixel: lattices that are chosen by directions come in such steps."""
_LATTICES = 2
"""Those that are remembered for the next cell."""
_SIDE, _LARGE, _LARGER = 512, 1 << 22, 1024
"""Pixels along the side of a cell, and of those of pictures of so many pixels: a cell's jumps are located in calls that take as long for few as for
several of them, but without several cells nothing is seen of a picture before its end."""
_CROSSED = 1 << 14
"""The lines that an edge may cross in a cell: what is kept of it grows with them."""


def located(model: Tensor) -> Tensor:
    """In which pixels jumps were located."""
    return (model == LOCATED) | (model == FINER)


def cell_of(task: Task, spp: int, adaptive: bool) -> tuple[int, int]:
    """The cells of estimators that keep a cell's crossings: smaller where there are many lines."""
    side = _LARGER if task.screen.height * task.screen.width >= _LARGE else _SIDE
    width = width_of(task.device)
    while side > 64 and (side * spp > _CROSSED or (adaptive and side > 128)):
        side //= 2
    side *= math.isqrt(width)
    return side, side


def lines_for(spp: float) -> int:
    """Points, and lines, a pixel of the lattice whose jumps are to be located with `spp` evaluations; odd."""
    return odd(max(FEWEST_LINES, int(_SHARE * spp + 0.5)))


@dataclass(frozen=True)
class Part:
    """What one part of a cell gave; as `Estimate`, but without the floor, and without what was asked of f, which `Counted` has.

    `density`, a number or (h, w), is the lattice's points a pixel, which the floor depends on.
    """

    value: Tensor
    variance: Tensor
    heavy: Tensor | None
    model: Tensor
    density: float | Tensor
    blind: Tensor | None = None

    def cut(self, at: tuple[slice, slice]) -> Part:
        """A rectangle of it, whose planes are parts of these."""
        heavy, blind = (None if plane is None else plane[:, *at] for plane in (self.heavy, self.blind))
        density = torch.as_tensor(self.density).expand(self.model.shape)[at]
        return Part(self.value[:, *at], self.variance[:, *at], heavy, self.model[at], density, blind)

    def estimate(self, ask: Counted) -> Estimate:
        """With the floor for what its lattice did not meet, and all that was asked."""
        density = self.density
        floor = unseen(self.value, density.to(self.value.dtype) if isinstance(density, Tensor) else density)
        variance = settled(self.variance, self.value, floor)
        heavy = None
        if self.heavy is not None and bool(self.heavy.any()):
            variance.masked_fill_(self.heavy, torch.inf)
            heavy = self.heavy.any(0)
        return Estimate(
            self.value,
            variance,
            ask.points.to(torch.int32),
            ask.invalid.to(torch.int32),
            heavy=heavy,
            unseen=floor,
            model=self.model.to(torch.uint8),
            blind=self.blind,
        )


class Parts:
    """The parts of one round; `number` is the round's. `audited`: lattices whose jumps are located have points off them, too.

    `fewest`: the points of a lattice, of which a narrow filter holds enough.
    """

    def __init__(self, task: Task, number: int, audited: bool) -> None:
        self.task, self.number, self.audited = task, number, audited
        self.fewest = max(1, math.ceil(SOME / held(task, 1)))
        self.seed = int(rng.bits(task.seed, _STREAM, number))
        self.random = False
        self.reach = reach_of(task.filter)
        self._lattices: dict[tuple[float, bool, tuple[int, int, int] | None, int], LatticeRound] = {}
        self._precision = Precision()

    def ask(self, cell: Cell, budget: int) -> Counted:
        """f at places of a part of the screen."""
        return Counted(self.task, cell, budget, self._precision)

    def sampled(
        self, ask: Counted, cell: Cell, spp: float, budget: int, edges: np.ndarray | None = None, continuous: bool = False
    ) -> tuple[Part, int]:
        """A part by a plain lattice of at most `spp` evaluations a pixel and `budget` in all, and what it took, as counted in `ask`.

        The lattice that suits the `edges`, as in `turned`, if given, whose standard error knows that, if f is `continuous`: where it has
        detail on every scale, this has no directions.
        """
        step = 1 if edges is None or spp < SUITED else _STEP
        spp = math.floor(spp / step) * step
        part = cell != ask.cell
        lattice, ratio = self._suited(spp, edges, cell, part)
        while spp > 1 and ask.inside(*lattice.asked(cell)) > budget:
            # a cut pattern can hold more than its share
            spp = max(1, spp - step)
            lattice, ratio = self._suited(spp, edges, cell, part)
        found = lattice.measured(cell, ratio=ratio if continuous else CHARACTER_RATIO)
        took = ask.include_rows(*lattice.asked(cell))
        ask.invalid[cell.within(ask.cell)] += found.invalid
        model = torch.full((cell.height, cell.width), SAMPLED, dtype=torch.uint8, device=found.value.device)
        planes = found.value, found.variance, found.heavy, model, spp, found.blind
        return Part(*planes), took

    def located(
        self,
        whole: Counted,
        rectangles: list[Cell],
        count: int,
        budget: int,
        steps: int,
        jumping: Tensor,
        wanted: Tolerance | None = None,
        more: int = 0,
    ) -> tuple[list[tuple[Cell, Part]], int]:
        """Rectangles of a cell by one lattice of `count` points a pixel corrected for its jumps, with at most `budget` evaluations in all.

        And `more` where that does not come to what is `wanted`. And what they took, as counted in `whole`, of the cell.

        steps: how often a segment of 1 px is halved, at most.
        jumping: bool (blocks,), those of the cell that are known to jump.
        """
        task, cell = self.task, whole.cell
        # a pixel more, in which segments may begin that reach into their filters
        around = [task.around(each, 1) for each in rectangles]

        def taken() -> int:
            return sum(whole.inside(*lattice.asked(each)) for each in around)

        fewest = max(FEWEST_LINES, self.fewest)
        lattice = self._lattice(count, True)
        while count - 2 >= fewest and taken() > budget:
            count -= 2
            lattice = self._lattice(count, True)
        if taken() > budget:
            spp = budget * (count + self.audited) // taken()
            parts = [(each, *self.sampled(whole, each, max(1, spp), spp * self.area(whole, each))) for each in rectangles]
            return [(each, part) for each, part, _ in parts], sum(took for _, _, took in parts)
        x, y = (torch.from_numpy(places).to(task.device) for places in (lattice.strip.x, lattice.strip.y))
        owner = Owner(rectangles, [lattice.weights.geometry(each) for each in around], task.device)
        ask = self.ask(cell, budget - taken())
        allowed = torch.zeros(cell.height, cell.width, dtype=torch.bool, device=task.device)
        plain: list[tuple[Cell, Part]] = []
        finder = Finder()
        for number, (each, region) in enumerate(zip(rectangles, around, strict=True)):
            begun = finder.looks

            def look(at: Geometry, planes: slice, values: Sequence[Tensor], number: int = number, begun: int = begun) -> None:
                if planes.start == 0:
                    # samples that are not finite are 0 the second time
                    finder.forget(begun)
                finder.look(self._seen(at, x[planes], y[planes], values), planes.start, partial(owner.those_of, number))

            part, usable = self._plain(whole, lattice, each, region, look)
            plain.append((each, part))
            allowed[each.within(cell)] = usable
        part = self.joined(cell, plain)
        # what lies in none of them must not widen the range of the values
        inside, any_of_them = torch.as_tensor(part.density) > 0, part.value[:, *plain[0][0].within(cell)][:, :1, :1]
        value = torch.where(inside, part.value, any_of_them)
        enough = None if wanted is None else wanted.allowed(value.to(torch.float64)) / FEW_SHIFTS[0]
        corrector = Corrector(ask, self.seed, Lines(x, y, 0), value, allowed & (not self.random), steps, jumping, enough, more)
        result = corrector.run(finder)
        if result is not None:
            rows, cols, kept = result.rows, result.cols, slice(None)
            if bool(ask.invalid.any()):
                kept = ~dilated(ask.invalid > 0, Window.halo_of(task.filter))[rows, cols]
            at = rows[kept], cols[kept]
            part.value[:, *at] = result.value[:, kept].to(task.dtype)
            known = result.variance[:, kept].to(task.dtype)
            part.variance[:, *at] = torch.where(known.isnan(), part.variance[:, *at], known)
            part.model[at] = torch.where(result.fine, FINER, LOCATED).to(torch.uint8)[kept]
            if part.blind is not None:
                part.blind[:, *at] = 0
        whole.include(ask)
        return [(each, part.cut(each.within(cell))) for each in rectangles], taken() + int(ask.points.sum())

    def _seen(self, at: Geometry, x: Tensor, y: Tensor, values: Sequence[Tensor]) -> Everywhere:
        """Some planes of a lattice's samples."""
        channels = self.task.integrand.channels
        codes = torch.stack(list(values[channels:])) if self.task.followed else None
        return Everywhere(x, y, 0, at.strip, at.col, torch.stack(list(values[:channels])), codes=codes)

    def _plain(self, ask: Counted, lattice: LatticeRound, cell: Cell, around: Cell, look: Look) -> tuple[Part, Tensor]:
        """A rectangle by a lattice alone, and which of its pixels may be corrected; `look` is shown the samples in and around it."""
        found, count = lattice.measured(around, look), lattice.strip.count
        top, left = cell.row - around.row, cell.col - around.col
        inner = (..., slice(top, top + cell.height), slice(left, left + cell.width))
        heavy = None if found.heavy is None else found.heavy[inner]
        allowed = self._allowed(cell, found.invalid, inner)
        if heavy is not None:
            allowed &= ~heavy.any(0)
        blind = None if found.blind is None else found.blind[inner]
        ask.include_rows(*lattice.asked(around))
        ask.invalid[cell.within(ask.cell)] += found.invalid[inner]
        model = torch.full_like(allowed, PLAIN, dtype=torch.uint8)
        return Part(found.value[inner], found.variance[inner], heavy, model, count, blind), allowed

    def _suited(self, spp: float, edges: np.ndarray | None, cell: Cell, part: bool) -> tuple[LatticeRound, float]:
        """A lattice for a part, and what the squares of its character sums are over its variance."""
        # strips that begin where the filter's reach does cover a part with fewest points; those of a closed screen begin with it
        begin = cell.row - self.reach if part and self.task.boundary == "extend" else 0
        if edges is None or spp < SUITED:
            return self._lattice(spp, False, begin=begin), CHARACTER_RATIO
        chosen, ratio = turned(spp, edges, cell.height + 2 * self.reach)
        return self._lattice(spp, False, chosen, begin), ratio

    def _lattice(self, spp: float, lines: bool, chosen: tuple[int, int, int] | None = None, begin: int = 0) -> LatticeRound:
        key = spp, lines, chosen, begin
        if key not in self._lattices:
            if len(self._lattices) >= _LATTICES:
                # their weights are as large as a cell's samples
                self._lattices.pop(next(iter(self._lattices)))
            # the plain one is pooled with the other, so it must be independent
            number = self.number if lines else self.number + _MORE
            audited = self.audited or not lines
            points = spp + (lines and audited)
            self._lattices[key] = LatticeRound(self.task, points, number, lines=lines, audited=audited, chosen=chosen, begin=begin)
        return self._lattices[key]

    def area(self, ask: Counted, part: Cell) -> int:
        """The pixels of the cell in which a part's samples lie."""
        shared = part.grown(self.reach).overlap(ask.cell)
        return shared.height * shared.width

    def _allowed(self, cell: Cell, invalid: Tensor, inner: tuple[Any, ...]) -> Tensor:
        """(h, w) the pixels that may be corrected: all that their filter covers is finite, and on the screen if that ends f.

        invalid: of the cell and a pixel around it, of which `inner` is the cell.
        """
        halo = Window.halo_of(self.task.filter)
        allowed = ~dilated(invalid > 0, halo)[inner]
        if self.task.boundary != "extend":
            rows = torch.arange(cell.row, cell.row + cell.height, device=allowed.device)
            cols = torch.arange(cell.col, cell.col + cell.width, device=allowed.device)
            height, width = self.task.screen.height, self.task.screen.width
            allowed &= ((rows >= halo) & (rows < height - halo))[:, None] & (cols >= halo) & (cols < width - halo)
        return allowed

    def joined(self, cell: Cell, parts: list[tuple[Cell, Part]]) -> Part:
        """Parts of a cell as one, all planes its own.

        What is in none of them has no samples, and a variance of +inf.
        """
        shape = self.task.integrand.channels, cell.height, cell.width
        plane = torch.zeros(shape, dtype=self.task.dtype, device=self.task.device)
        value, variance, heavy = plane, torch.full_like(plane, torch.inf), torch.zeros_like(plane, dtype=torch.bool)
        model, density = torch.zeros_like(plane[0], dtype=torch.uint8), torch.zeros_like(plane[0], dtype=torch.float64)
        blind = torch.zeros_like(plane)
        for where, part in parts:
            at = where.within(cell)
            value[:, *at], variance[:, *at] = part.value, part.variance
            model[at], density[at] = part.model, part.density
            if part.heavy is not None:
                heavy[:, *at] = part.heavy
            if part.blind is not None:
                blind[:, *at] = part.blind
        return Part(value, variance, heavy, model, density, blind)
