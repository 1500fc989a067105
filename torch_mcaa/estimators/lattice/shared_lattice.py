"""A round of the shared lattice: one evaluation of f serves every pixel whose filter covers it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch
from torch import Tensor

from torch_mcaa import rng
from torch_mcaa.compiling import NotCompiled
from torch_mcaa.estimators.base import Estimate, Round, Task, pooled, settled, unseen
from torch_mcaa.estimators.lattice.audit import Audit, Seen
from torch_mcaa.estimators.lattice.fused import Fused
from torch_mcaa.estimators.lattice.lattice_weights import Geometry, LatticeWeights
from torch_mcaa.estimators.lattice.poles import Poles
from torch_mcaa.estimators.lattice.splat import Splat, Sums
from torch_mcaa.estimators.located.sides import sides
from torch_mcaa.grid import Cell
from torch_mcaa.patterns.lattice import CHARACTER_RATIO, NOISE_RATIO, Lattice

_SHIFT = 0x5F1F7
_SPLATS = 4
"""Shapes of cells whose weights are remembered."""
Look = Callable[[Geometry, slice, Sequence[Tensor]], None]
"""Shown some planes of samples, each channel (strips, planes, columns); where f is followed the codes of `Task.coded` are one more."""


@dataclass(frozen=True)
class Measured:
    """What a lattice tells of a cell, before the floor for what no sample met.

    Attributes:
        value, variance: (C, h, w); the variance is 0 without `contrast`.
        invalid: (h, w) int32.
        heavy: (C, h, w) bool, where f has no second moment, or None.
        blind: (C, h, w) the part of the variance that is the audit's, or None if it saw nothing.
    """

    value: Tensor
    variance: Tensor
    invalid: Tensor
    heavy: Tensor | None
    blind: Tensor | None


class LatticeRound(Round):
    """One lattice rule over the screen. With `contrast` it brings its variance: character sums, audit and floor; without, values only.

    With `lines` its points lie on lines along both axes, 1 px apart, as many lines a pixel as points. Without `audited` there is no audit.
    With `chosen`, (period, count, generator), it is that lattice. A strip begins at the row `begin`.
    """

    def __init__(
        self,
        task: Task,
        spp: float,
        number: int,
        replicate: int = 0,
        contrast: bool = True,
        lines: bool = False,
        audited: bool = True,
        chosen: tuple[int, int, int] | None = None,
        begin: int = 0,
    ) -> None:
        sx, sy = (float(rng.uniform(task.seed, _SHIFT, number, replicate, axis, dtype=torch.float64)) for axis in (0, 1))
        self.task = task
        audited = audited and contrast
        # rounds are compared with one another: what one is blind to the next should see
        self.strip = Lattice().strip(
            spp, replicate, audited, (sx, sy), lines, number % 2 == 1, task.once(sides) if lines else None, chosen
        )
        self.contrast, self.origin = contrast, begin % self.strip.period
        # a strip without a point to spare has no audit
        audited = audited and self.strip.count < spp * self.strip.period
        self.audit = Audit(task, self.strip, number) if audited else None
        counts = self.strip.row_counts()
        if self.audit is not None:
            counts[self.audit.row()] += 1
        self.counts = torch.from_numpy(counts).to(torch.int32)
        self.per_pixel = float(counts.sum()) / self.strip.period
        self.weights = LatticeWeights(task, self.strip)
        self.order = np.argsort(self.strip.y)
        self._splats: dict[tuple[int, ...], Splat] = {}
        self._fused: Fused | None = None

    def points(self, cell: Cell) -> int:
        return int(self.row_points(cell).sum()) * cell.width

    def row_points(self, cell: Cell) -> Tensor:
        return self.counts[(torch.arange(cell.row, cell.row + cell.height) - self.origin) % self.strip.period]

    def asked(self, cell: Cell) -> tuple[Cell, Tensor]:
        """Where f is asked for a cell: in it, about it, and in the rest of the strips that begin there; how often in a pixel of each row."""
        at, period = self.weights.geometry(self._from_origin(cell)), self.strip.period
        return Cell(at.strip * period + self.origin, at.col, at.strips * period, at.cols), self.counts.repeat(at.strips)

    def _from_origin(self, cell: Cell) -> Cell:
        """The same with its rows counted from a strip's first."""
        return replace(cell, row=cell.row - self.origin)

    def estimate(self, cell: Cell) -> Estimate:
        found = self.measured(cell)
        variance, floor = found.variance, None
        if self.contrast:
            floor = unseen(found.value, self.per_pixel)
            variance = settled(variance, found.value, floor)
        if found.heavy is not None:
            variance.masked_fill_(found.heavy, torch.inf)
        points = self.row_points(cell).to(self.task.device)[:, None].expand(cell.height, cell.width)
        return Estimate(
            found.value,
            variance,
            points,
            found.invalid,
            heavy=None if found.heavy is None else found.heavy.any(0),
            unseen=floor,
            blind=found.blind,
        )

    def measured(self, cell: Cell, look: Look | None = None, ratio: float = CHARACTER_RATIO) -> Measured:
        """Evaluate f in and around `cell` and weigh the samples, which `look` is shown too: from plane 0 on again where some are not finite.

        ratio: what the squares of the character sums are expected to be over the variance, but for noise.
        """
        task = self.task
        if task.compiled and not task.integrand.refused and look is None:
            found = self._by_graph(cell, ratio)
            if found is not None:
                return found
        at = self.weights.geometry(self._from_origin(cell))
        splat = self._splat(cell, at)
        poles = Poles(task, cell, self.per_pixel, self.order)
        value, power, seen, left, invalid = self._sums(cell, at, splat, None, poles, look)
        if invalid is not None:
            # samples that are not finite count as 0; each pixel learns what share of its weights, or of their moduli, is left
            weights = LatticeWeights(task, self.strip, absolute=task.integrand.nonfinite == "propagate")
            masks = Splat(weights, self._from_origin(cell), at, contrast=False)
            poles = Poles(task, cell, self.per_pixel, self.order)
            value, power, seen, left, invalid = self._sums(cell, at, splat, masks, poles, look)
        variance, blind = (torch.zeros_like(value), None) if power is None else _variance(power, seen, ratio)
        if left is not None:
            if task.integrand.nonfinite == "propagate":
                value = torch.where(left > 1 - 1e-5, value, torch.nan)
            else:
                value, variance = torch.where(left > 1e-3, value / left, torch.nan), variance / left.square().clamp_min(1e-6)
        if splat.norm is not None:
            value, variance = value / splat.norm, variance / splat.norm.square()
        heavy = poles.heavy(partial(self._row, cell, at))
        if invalid is None:
            invalid = torch.zeros(cell.height, cell.width, dtype=torch.int32, device=task.device)
        return Measured(value, variance, invalid, heavy, blind)

    def _by_graph(self, cell: Cell, ratio: float) -> Measured | None:
        """The same by the compiled graph; None if there is none, or f is not finite everywhere."""
        task, at = self.task, self.weights.geometry(cell)
        if self._fused is None:
            # the first cell is as large as any
            self._fused = Fused(self.weights, self.audit, cell.height, cell.width)
        try:
            found = self._fused.weigh(cell, at)
        except NotCompiled as reason:
            task.integrand.refused = str(reason)
            return None
        if not math.isfinite(found.norms.sum().item()):
            return None
        audit = self.audit
        seen = [] if audit is None else [audit.seen(cell, at, v, h) for v, h in zip(found.audited, found.held, strict=True)]
        variance, blind = _variance(found.power, seen, ratio)
        poles = Poles(task, cell, self.per_pixel, self.order)
        for channel in range(len(found.norms)):
            poles.note(channel, found.norms[channel])
        heavy = poles.heavy(partial(self._row, cell, at))
        invalid = torch.zeros(cell.height, cell.width, dtype=torch.int32, device=task.device)
        return Measured(found.value, variance, invalid, heavy, blind)

    def _splat(self, cell: Cell, at: Geometry) -> Splat:
        """The weights for this cell, kept for the cells of the same shape and phase where the boundary does not cut them."""
        cell = self._from_origin(cell)
        key = (cell.height, cell.width, cell.row % self.strip.period)
        if self.task.boundary != "extend":
            return Splat(self.weights, cell, at, self.contrast)
        if key not in self._splats:
            if len(self._splats) >= _SPLATS:
                self._splats.pop(next(iter(self._splats)))
            self._splats[key] = Splat(self.weights, cell, at, self.contrast)
        self._splats[key].moved(cell, at)
        return self._splats[key]

    def _sums(
        self, cell: Cell, at: Geometry, splat: Splat, masks: Splat | None, poles: Poles, look: Look | None
    ) -> tuple[Tensor, Tensor | None, list[Seen], Tensor | None, Tensor | None]:
        """Values (C, h, w), squared character sums (C, h, w), what the audit sees, share of weights left (h, w), and counts.

        Without `masks` the first sample that is not finite ends the work, and the counts are a tensor without content. With them such
        samples are 0, and the weights of the others and of all are summed too.
        """
        task, strip = self.task, self.strip
        asked = task.screen.coordinate_dtype(cell, task.dtype)
        cols = torch.arange(at.col, at.col + at.cols, dtype=torch.float64)
        rows = torch.arange(at.strip, at.strip + at.strips, dtype=torch.float64) * strip.period
        sums: list[Sums] = []
        held: list[dict[int, Tensor]] = []
        counts = torch.zeros(at.strips * strip.period, at.cols, dtype=torch.int32, device=task.device) if masks else None

        def evaluate(col: Tensor, row: Tensor, shape: tuple[int, ...]) -> tuple[list[Tensor], Tensor | None]:
            x = task.screen.x_of(col).to(task.device, asked)
            y = task.screen.y_of(self._on_screen(row + self.origin)).to(task.device, asked)
            values = (task.integrand if look is None else task.coded)(x.expand(shape), y)
            bad = None if task.integrand.nonfinite == "raise" else task.integrand.invalid(values)
            if bad is not None and masks is not None:
                values = [value.masked_fill(bad, 0) for value in values]
            return values, bad

        finite, full = (None, None) if masks is None else (masks.start(), masks.start())
        for number, batch in enumerate(splat.batches):
            for group, first in enumerate(range(0, batch.count, splat.group)):
                planes = slice(batch.start + first, batch.start + min(first + splat.group, batch.count))
                x, y = torch.from_numpy(strip.x[planes]), torch.from_numpy(strip.y[planes])
                shape = (at.strips, len(x), at.cols)
                values, bad = evaluate(cols[None, :] + x[:, None], (rows[:, None] + y)[:, :, None], shape)
                if bad is not None and counts is None:
                    return values[0], None, [], None, torch.empty(0)
                if bad is not None and counts is not None:
                    places = (torch.arange(at.strips)[:, None] * strip.period + y.long()).flatten().to(task.device)
                    counts.index_add_(0, places, bad.flatten(0, 1).to(torch.int32))
                if masks is not None and finite is not None and full is not None:
                    ones = torch.ones(shape, dtype=task.dtype, device=task.device)
                    masks.weigh(full, masks.batches[number], group, ones)
                    masks.weigh(finite, masks.batches[number], group, ones if bad is None else ones.masked_fill(bad, 0))
                if look is not None:
                    look(at, planes, values)
                for channel, value in enumerate(values[: task.integrand.channels]):
                    if len(sums) <= channel:
                        sums.append(splat.start())
                        held.append({})
                    poles.add(channel, value)
                    splat.weigh(sums[channel], batch, group, value)
                    if self.audit is not None:
                        for plane in self.audit.planes:
                            if planes.start <= plane < planes.stop:
                                held[channel][plane] = value[:, plane - planes.start].clone()
            for channel in sums:
                splat.add(channel, batch)
            if masks is not None and finite is not None and full is not None:
                masks.add(full, masks.batches[number])
                masks.add(finite, masks.batches[number])
        seen: list[Seen] = []
        if self.audit is not None:
            values, bad = evaluate(*self.audit.places(at), (at.strips, at.cols))
            values = values[: task.integrand.channels]
            if bad is not None and counts is None:
                return values[0], None, [], None, torch.empty(0)
            if bad is not None and counts is not None:
                counts[self.audit.row() :: strip.period] += bad.to(torch.int32)
            seen = [self.audit.seen(self._from_origin(cell), at, v, h) for v, h in zip(values, held, strict=True)]
        finished = [splat.finish(s) for s in sums]
        powers = [power for _, power in finished if power is not None]
        if counts is not None:
            top, left = cell.row - self.origin - at.strip * strip.period, cell.col - at.col
            counts = counts[top : top + cell.height, left : left + cell.width]
        left = None
        if masks is not None and finite is not None and full is not None:
            left = masks.finish(finite)[0] / masks.finish(full)[0]
        return torch.stack([value for value, _ in finished]), torch.stack(powers) if powers else None, seen, left, counts

    def _row(self, cell: Cell, at: Geometry, strips: Tensor, planes: Tensor, channel: int) -> tuple[Tensor, Tensor, Tensor]:
        """Some rows of samples again, for `Poles`: kept, they would be all of them."""
        task = self.task
        asked = task.screen.coordinate_dtype(cell, task.dtype)
        col = torch.arange(at.col, at.col + at.cols, dtype=torch.float64) + torch.from_numpy(self.strip.x)[planes][:, None]
        row = ((at.strip + strips) * self.strip.period + self.origin + torch.from_numpy(self.strip.y)[planes])[:, None]
        integrand = replace(task.integrand, nonfinite="ignore")
        x, y = task.screen.x_of(col).to(task.device, asked), task.screen.y_of(self._on_screen(row)).to(task.device, asked)
        values = integrand(x, y)[channel]
        task.integrand.evaluations += integrand.evaluations
        return values.masked_fill(~values.isfinite(), 0), row, col

    def _on_screen(self, row: Tensor) -> Tensor:
        """Rows of strips that reach over a screen outside which f is not asked; their weights are 0."""
        if self.task.boundary == "extend":
            return row
        return row.clamp(0, self.task.screen.height * (1 - 2.0**-50))


def _variance(power: Tensor, seen: list[Seen], ratio: float) -> tuple[Tensor, Tensor | None]:
    """That of the values (C, h, w), from the squared character sums and what an audit, if there is one, saw of each channel; and its part of it."""
    variance = pooled(power)
    if not seen:
        return variance.mul_(1 / ratio), None
    for channel, s in zip(variance, seen, strict=True):
        channel.mul_(s.by_pixel(1 / ratio + (1 / NOISE_RATIO - 1 / ratio) * s.noise))
    if not any(bool((s.blind > 0).any()) for s in seen):
        return variance, None
    blind = torch.stack([s.by_pixel(s.blind).expand(variance.shape[1:]) for s in seen])
    return variance.add_(blind), blind


class ReplicatedRound(Round):
    """R >= 2 independent lattices with other generators; the variance is that between them, or its 3 x 3 neighbours' mean where larger."""

    def __init__(self, task: Task, spp: int, number: int, replicates: int) -> None:
        self.rounds = [LatticeRound(task, spp // replicates, number, r, contrast=False) for r in range(replicates)]
        self.per_pixel = sum(r.per_pixel for r in self.rounds)

    def points(self, cell: Cell) -> int:
        return sum(r.points(cell) for r in self.rounds)

    def estimate(self, cell: Cell) -> Estimate:
        estimates = [r.estimate(cell) for r in self.rounds]
        values = torch.stack([e.value for e in estimates])
        spread = values.var(0) / len(values)
        value = values.mean(0)
        points = torch.stack([e.points for e in estimates]).sum(0, dtype=torch.int32)
        invalid = torch.stack([e.invalid for e in estimates]).sum(0, dtype=torch.int32)
        floor = unseen(value, self.per_pixel)
        variance = settled(pooled(spread), value, floor)
        variance.masked_fill_(torch.stack([e.variance.isinf() for e in estimates]).any(0), torch.inf)
        heavy = [e.heavy for e in estimates if e.heavy is not None]
        return Estimate(value, variance, points, invalid, heavy=torch.stack(heavy).any(0) if heavy else None, unseen=floor)
