"""The shared lattice in one compiled graph: f, the weights along x, and the four sums along y, without a pass over memory for each.

The planes of samples are sorted along y, so that those which reach a row of pixels are a window of the strips' planes one after another.
Windows of one length begin at equal steps inside a strip, so one loop serves all rows; what they hold beyond a filter's reach weighs 0.
Of the samples weighed along x those of even and of odd k are kept apart: their sum and their difference are what the value and the
characters need. Samples, sums and differences are results of the graph, which keeps it from evaluating f again for every pixel.
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
        seen, more: C of (strips, columns), of the audit, as `Audit.judged` takes them; none without one.
    """

    value: Tensor
    power: Tensor
    norms: Tensor
    seen: list[Tensor]
    more: list[Tensor]


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
        self.task, self.strip, self.audit, self.width = task, strip, audit, width
        self.order = np.argsort(strip.y)
        self.place = np.argsort(self.order)
        period, count = strip.period, strip.count
        # a cell begins anywhere in a strip
        blocks, self.lead = -(-(height + period - 1) // period), -(-self.reach // period)
        step, start, length = _windows(count, period, max(task.filter.radius))
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
        sums = [s.repeat(len(around)) for s in (along_x.sum(0), (along_x * (1 - 2 * odd)).sum(0))]
        weight = weight / (weight @ sums[0])[:, None]
        characters = torch.from_numpy(strip.characters[:, self.order]).to(torch.float64)
        turns = torch.stack([1.0 - 2.0 * b * (around % 2) for _, b in strip.parities])
        rows = torch.cat([weight[None], weight * (turns[:, :, None] * characters[:, None]).flatten(1)[:, None]])
        response = torch.stack([rows[1 + j] @ sums[a] for j, (a, _) in enumerate(strip.parities)])
        windows = torch.stack([rows[:, r, start + r * step : start + r * step + length] for r in range(period)], 1)
        # float64 columns (planes, columns) and rows (strips, planes) from where a cell and its first strip begin
        cols = torch.arange(-self.reach, width + self.reach) + torch.from_numpy(strip.x[self.order])[:, None]
        rows = torch.arange(self.strips)[:, None] * period + torch.from_numpy(strip.y[self.order])
        self._cols, self._rows = cols.to(task.device), rows.to(task.device)
        self.constants = [t.to(task.device, task.dtype).contiguous() for t in (along_x, windows, response)]
        self._watched: list[Tensor] = []
        if audit is not None:
            steps = [(0, 0), *((down, right) for _, down, right in audit.neighbours)]
            planes = [int(self.place[plane]) for plane in (audit.reference, *(plane for plane, _, _ in audit.neighbours))]
            self._watched = [torch.tensor(t).to(task.device) for t in (steps, planes)]
        shape = (self.strips, count, width + 2 * self.reach)
        windows_of = (blocks, period, length), (start, step)
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
        values, powers, norms, seen, more, *_ = self.graph(*self.inputs(cell, at))
        shape = self.strips, self.strip.count, self.width + 2 * self.reach
        task.integrand.evaluations += math.prod(shape) + (shape[0] * shape[2] if seen else 0)
        top, first = cell.row % period, at.strip - (cell.row // period - self.lead)
        strips = slice(first, first + at.strips)
        window = slice(top, top + cell.height), slice(0, cell.width)
        return Weighed(
            torch.stack([value[window] for value in values]),
            torch.stack([power[window] for power in powers]),
            torch.stack(norms)[:, strips, torch.from_numpy(self.place)],
            [s[strips, : at.cols] for s in seen],
            [m[strips, : at.cols] for m in more],
        )

    def inputs(self, cell: Cell, at: Geometry) -> list[Tensor]:
        """What the graph takes for a cell: f's x (planes, columns) and y (strips, planes), the weights, and what concerns the audit."""
        task, period = self.task, self.strip.period
        dtype, begin = task.screen.coordinate_dtype(cell, task.dtype), cell.row // period - self.lead
        x, y = task.screen.x_of(self._cols + cell.col), task.screen.y_of(self._rows + begin * period)
        inputs = [x.to(dtype), y.to(dtype), *self.constants]
        if self.audit is not None:
            # drawn outside: the graph would hash anew wherever a point is used
            col, row = self.audit.places(replace(at, strip=begin, strips=self.strips, col=cell.col - self.reach, cols=x.shape[1]))
            # neighbours are looked for among the samples of the cell's own geometry
            bounds = torch.tensor([at.strip - begin, at.strip - begin + at.strips, at.cols])
            inputs += [task.screen.x_of(col).to(dtype), task.screen.y_of(row).to(dtype), bounds.to(task.device), *self._watched]
        return inputs


def _windows(count: int, period: int, radius: float) -> tuple[int, int, int]:
    """Step, start and length of windows of planes, row r's from start + r step on, that hold all within the radius of the row's centre.

    The planes lie at (i + d) period / count, and the windows serve every d in [0, 1): other shifts need no other graph.
    """
    step = round(count / period)
    first = [math.ceil((r + 0.5 - radius) * count / period) - 1 - r * step for r in range(period)]
    last = [math.ceil((r + 0.5 + radius) * count / period) - 1 - r * step for r in range(period)]
    return step, min(first), max(last) - min(first) + 1


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
    origin: tuple[int, int],
    width: int,
    audited: bool,
    dtype: torch.dtype,
) -> FunctionType:
    """The graph as a function of `Fused.inputs`.

    The compiler writes a loop over short sums that it would vectorise, and none over stacked ones: one tensor a channel, columns last.
    """
    _, planes, cols = shape
    (blocks, period, length), (start, step) = windows, origin
    strides, reach = (planes * width, step * width, width, 1), (cols - width) // 2

    def kernel(x: Tensor, y: Tensor, taps: Tensor, matrix: Tensor, response: Tensor, *watched: Tensor) -> tuple[list[Tensor], ...]:
        values, powers, norms, kept, weighed, seen, more = [], [], [], [], [], [], []
        coordinates = x[None].expand(shape), y[:, :, None].expand(shape)
        for samples in channels_of(f(*coordinates), coordinates[0], dtype):
            parts = []
            for parity in (reach % 2, 1 - reach % 2):
                terms = [taps[k][:, None] * samples[..., k : k + width] for k in range(parity, 2 * reach + 1, 2)]
                parts.append(sum(terms[1:], terms[0]) if terms else torch.zeros_like(parts[0]))
            even, odd = parts
            both, sums = torch.stack([even + odd, even - odd]), []
            for j, rows in enumerate((matrix[:2], matrix[2:])):
                window = both.as_strided((blocks, period, length, width), strides, j * even.numel() + start * width)
                sums += [(window * row[None, :, :, None]).sum(2) for row in rows.unbind(0)]
            value, *characters = sums
            deviations = [(one - r[None, :, None] * value).square() for one, r in zip(characters, response.unbind(0))]
            values.append(value.flatten(0, 1))
            powers.append((deviations[0] + deviations[1] + deviations[2]).flatten(0, 1))
            norms.append(torch.linalg.vector_norm(samples, dim=2))
            kept.append(samples)
            weighed.append(both)
        if audited:
            seen, more, asked = _watch(f, kept, *watched)
            kept += asked
        return values, powers, norms, seen, more, kept, weighed

    return kernel


def _watch(
    f: Function,
    samples: list[Tensor],
    x: Tensor,
    y: Tensor,
    bounds: Tensor,
    steps: Tensor,
    planes: Tensor,
) -> tuple[list[Tensor], list[Tensor], list[Tensor]]:
    """For each channel what `Audit.judged` takes, of f at the audit's points and the samples (strips, planes, columns) about them, and f there.

    Args:
        x, y: (strips, columns).
        bounds: which strips [from, to) and how many columns are looked at.
        steps, planes: strips and columns from the audit's sample, and the plane, of that sample and its four neighbours.
    """
    strips, _, cols = samples[0].shape
    row, col = torch.arange(strips, device=bounds.device)[:, None], torch.arange(cols, device=bounds.device)[None]
    asked, seen, more = channels_of(f(x, y), x, samples[0].dtype), [], []
    for audited, channel in zip(asked, samples):
        reference = channel.index_select(1, planes[:1])[:, 0]
        square, most = (audited - reference).square(), torch.zeros_like(audited)
        for k in range(1, 5):
            down, right = row + steps[k, 0], col + steps[k, 1]
            inside = (down >= bounds[0]) & (down < bounds[1]) & (right >= 0) & (right < bounds[2])
            plane = planes[k : k + 1].expand(strips, cols)
            there = channel[down.clamp(0, strips - 1), plane, right.clamp(0, cols - 1)]
            most = torch.maximum(most, torch.where(inside, (there - reference).square(), 0))
        seen.append(square)
        more.append((square > most).to(square.dtype))
    return seen, more, asked
