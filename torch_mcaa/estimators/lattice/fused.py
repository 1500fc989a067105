"""The shared lattice in one compiled graph: f, the weights along x, and the four sums along y, without a pass over memory for each.

The planes of samples are sorted along y, so that those which reach a row of pixels are a window of the strips' planes one after another.
Windows of one length begin at equal steps inside a strip, so one loop serves all rows; what they hold beyond a filter's reach weighs 0.
The four cosets of the lattice's double are what the value and the three characters are sums of, in four signs: the first character
alternates from plane to plane, the second from column to column and by plane, the third is their product. So the samples of even and of odd
k weighed along x are kept as their sum and as their difference in the planes' signs, and even and odd planes of a window are summed apart:
each sample is weighed along y once.
Samples, sums and differences are results of the graph, which keeps it from evaluating f again for every pixel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from types import FunctionType
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torch_mcaa.compiling import Compiled
from torch_mcaa.estimators.base import Task
from torch_mcaa.estimators.lattice.audit import Audit
from torch_mcaa.estimators.lattice.lattice_weights import Geometry, LatticeWeights
from torch_mcaa.filters import SeparableFilter
from torch_mcaa.grid import Cell
from torch_mcaa.integrand import Function, channels_of


@dataclass(frozen=True)
class Weighed:
    """What the graph returns for a cell.

    Attributes:
        value, power: (C, h, w) the estimate, and the sum of its squared characters.
        norms: (C, strips, planes) of the rows of samples.
        audited, held: C of f at the audit's points (strips, columns), and of the planes of samples that it needs; none without one.
    """

    value: Tensor
    power: Tensor
    norms: Tensor
    audited: list[Tensor]
    held: list[dict[int, Tensor]]


_APART = 4
"""Planes of a window that are weighed before one sum waits for another, on a CPU; even. A GPU has other sums to do meanwhile."""


class Fused:
    """One strip lattice's graph for cells of one shape.

    Args:
        weights: of a task that `unfit` has no objection to.
        audit: whose points are asked in the same graph.
        height, width: of a cell in pixels; those that the screen cuts are worked on as whole ones.
    """

    def __init__(self, weights: LatticeWeights, audit: Audit | None, height: int, width: int) -> None:
        task, strip, self.reach = weights.task, weights.strip, weights.reach
        assert isinstance(task.filter, SeparableFilter)
        self.task, self.strip, self.audit = task, strip, audit
        # a window goes down a column: where rows lie a multiple of many cache lines apart, few of its samples fit into the cache
        self.width = width = (-(-width // 8) | 1) * 8
        self.order = np.argsort(strip.y)
        self.place = np.argsort(self.order)
        period, count = strip.period, strip.count
        # a cell begins anywhere in a strip
        blocks, self.lead = -(-(height + period - 1) // period), -(-self.reach // period)
        step, start, length = _windows(count, period, max(task.filter.radius))
        apart = _APART if task.device.type == "cpu" else 1
        # whole strips above and below that hold the windows of a strip's rows
        below = start + (period - 1) * step + length - count
        self.lead = max(self.lead, -(start // count), -(-below // count))
        start += self.lead * count
        around = torch.arange(-self.lead, self.lead + 1)
        places = (around[:, None] * period + torch.from_numpy(strip.y[self.order])).flatten()
        weight = task.filter.profile(places - (torch.arange(period)[:, None] + 0.5))
        self.strips = blocks + 2 * self.lead
        along_x = weights.along_x[0][:, torch.from_numpy(self.order)]
        odd = torch.arange(-self.reach, self.reach + 1)[:, None] % 2
        signs = torch.from_numpy(strip.characters[1, self.order]).to(torch.float64)
        # (2, planes) what the weighed samples of f = 1 are
        sums = torch.stack([along_x.sum(0), (along_x * (1 - 2 * odd)).sum(0) * signs]).repeat(1, len(around))
        weight = weight / (weight @ sums[0])[:, None]
        windows = torch.stack([weight[r, start + r * step : start + r * step + length] for r in range(period)])
        ones = torch.stack([sums[:, start + r * step : start + r * step + length] for r in range(period)], 1)
        alternating = 1.0 - 2.0 * (torch.arange(length) % 2)
        response = torch.stack([ones[0] * alternating, ones[1], ones[1] * alternating]).mul(windows).sum(2)
        # (4, period, length / 4): planes i, i + 4, ... of a window; (1, period, length) on a GPU
        windows = windows.unflatten(1, (-1, apart)).movedim(2, 0)
        # float64 columns (planes, columns) and rows (strips, planes) from where a cell and its first strip begin
        cols = torch.arange(-self.reach, width + self.reach) + torch.from_numpy(strip.x[self.order])[:, None]
        rows = torch.arange(self.strips)[:, None] * period + torch.from_numpy(strip.y[self.order])
        self._cols, self._rows = cols.to(task.device), rows.to(task.device)
        self.constants = [t.to(task.device, task.dtype).contiguous() for t in (along_x, signs, windows, response)]
        shape = (self.strips, count, width + 2 * self.reach)
        windows_of = (blocks, period, length // apart), (start, step, apart)
        self.graph = _graph(task.integrand.function, shape, *windows_of, width, audit is not None, task.dtype)

    @staticmethod
    def unfit(task: Task) -> str | None:
        """Why there is no graph for this task; None if there is one."""
        if task.boundary != "extend":
            return f"a compiled picture needs boundary='extend', got {task.boundary!r}"
        if not isinstance(task.filter, SeparableFilter) or math.isinf(max(task.filter.radius)):
            return f"a compiled picture needs a filter that is a product and ends, got {task.filter}"
        return None

    def weigh(self, cell: Cell, at: Geometry) -> Weighed:
        """Evaluate f in and around `cell` and weigh the samples.

        Raises:
            NotCompiled: as `Compiled`.
        """
        task, period = self.task, self.strip.period
        values, powers, norms, samples, audited, *_ = self.graph(*self.inputs(cell, at))
        shape = self.strips, self.strip.count, self.width + 2 * self.reach
        task.integrand.evaluations += math.prod(shape) + (shape[0] * shape[2] if audited else 0)
        planes = [] if self.audit is None else self.audit.planes
        top, first = cell.row % period, at.strip - (cell.row // period - self.lead)
        strips = slice(first, first + at.strips)
        window = slice(top, top + cell.height), slice(0, cell.width)
        return Weighed(
            torch.stack([value[window] for value in values]),
            torch.stack([power[window] for power in powers]),
            torch.stack(norms)[:, strips, torch.from_numpy(self.place)],
            [values[strips, : at.cols] for values in audited],
            [{plane: channel[strips, int(self.place[plane]), : at.cols] for plane in planes} for channel in samples],
        )

    def inputs(self, cell: Cell, at: Geometry) -> list[Tensor]:
        """What the graph takes for a cell: f's x (planes, columns) and y (strips, planes), the weights, and x and y of an audit."""
        task, period = self.task, self.strip.period
        dtype, begin = task.screen.coordinate_dtype(cell, task.dtype), cell.row // period - self.lead
        x, y = task.screen.x_of(self._cols + cell.col), task.screen.y_of(self._rows + begin * period)
        inputs = [x.to(dtype), y.to(dtype), *self.constants]
        if self.audit is not None:
            # drawn outside: the graph would hash anew wherever a point is used
            col, row = self.audit.places(replace(at, strip=begin, strips=self.strips, col=cell.col - self.reach, cols=x.shape[1]))
            inputs += [task.screen.x_of(col).to(dtype), task.screen.y_of(row).to(dtype)]
        return inputs


def _windows(count: int, period: int, radius: float) -> tuple[int, int, int]:
    """Step, start and length of windows of planes, row r's from start + r step on, that hold all within the radius of the row's centre.

    The planes lie at (i + d) period / count, and the windows serve every d in [0, 1): other shifts need no other graph.
    """
    step = round(count / period)
    first = [math.ceil((r + 0.5 - radius) * count / period) - 1 - r * step for r in range(period)]
    last = [math.ceil((r + 0.5 + radius) * count / period) - 1 - r * step for r in range(period)]
    length = max(last) - min(first) + 1
    return step, min(first), -(-length // _APART) * _APART


def _graph(f: Function, *key: Any) -> Compiled:
    """The graph of f, that of an earlier picture where there is one."""
    try:
        return _kept(f, *key)
    except TypeError:
        # f has no hash
        return Compiled(_kernel(f, *key))


@lru_cache(maxsize=8)
def _kept(f: Function, *key: Any) -> Compiled:
    return Compiled(_kernel(f, *key))


def _kernel(
    f: Function,
    shape: tuple[int, int, int],
    windows: tuple[int, int, int],
    origin: tuple[int, int, int],
    width: int,
    audited: bool,
    dtype: torch.dtype,
) -> FunctionType:
    """The graph as a function of `Fused.inputs`.

    The compiler writes a loop over short sums that it would vectorise, and none over stacked ones: one tensor a channel, columns last.
    """
    _, planes, cols = shape
    (blocks, period, length), (start, step, apart) = windows, origin
    strides, reach = (planes * width, step * width, apart * width, 1), (cols - width) // 2

    def kernel(
        x: Tensor, y: Tensor, taps: Tensor, signs: Tensor, weights: Tensor, response: Tensor, *off: Tensor
    ) -> tuple[list[Tensor], ...]:
        values, powers, norms, kept, weighed = [], [], [], [], []
        coordinates = x[None].expand(shape), y[:, :, None].expand(shape)
        for samples in channels_of(f(*coordinates), coordinates[0], dtype):
            parts = []
            for parity in (reach % 2, 1 - reach % 2):
                terms = [taps[k][:, None] * samples[..., k : k + width] for k in range(parity, 2 * reach + 1, 2)]
                parts.append(sum(terms[1:], terms[0]) if terms else torch.zeros_like(parts[0]))
            even, odd = parts
            both, sums = torch.stack([even + odd, (even - odd) * signs[:, None]]), []
            for j in range(2):
                origins = [j * even.numel() + (start + i) * width for i in range(apart)]
                windows = [both.as_strided((blocks, period, length, width), strides, at) for at in origins]
                terms = [window * row[None, :, :, None] for window, row in zip(windows, weights.unbind(0))]
                if apart == 1:
                    turned = terms[0] * (1 - 2 * (torch.arange(length, device=even.device) % 2))[:, None]
                    sums += [terms[0].sum(2), turned.sum(2)]
                    continue
                # in one loop: both sums read what the other does
                halves = [sum(terms[k + 2 :: 2], terms[k]) for k in range(2)]
                sums += [(halves[0] + halves[1]).sum(2), (halves[0] - halves[1]).sum(2)]
            value, *characters = sums
            deviations = [(one - r[None, :, None] * value).square() for one, r in zip(characters, response.unbind(0))]
            values.append(value.flatten(0, 1))
            powers.append((deviations[0] + deviations[1] + deviations[2]).flatten(0, 1))
            norms.append(torch.linalg.vector_norm(samples, dim=2))
            kept.append(samples)
            weighed.append(both)
        asked = channels_of(f(*off), off[0], dtype) if audited else []
        return values, powers, norms, kept, asked, weighed

    return kernel
