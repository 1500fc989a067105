"""Importance sampling, (6), one pixel at a time."""

from __future__ import annotations

from dataclasses import dataclass, field

import torch

from torch_mcaa.densities import Density, FilterDensity
from torch_mcaa.errors import McaaError
from torch_mcaa.estimators.base import Estimate, Estimator, Round, Task, pooled, settled
from torch_mcaa.estimators.points import evaluate_points
from torch_mcaa.filters import SeparableFilter
from torch_mcaa.grid import Cell
from torch_mcaa.patterns import Pattern, Sobol


@dataclass(frozen=True)
class Importance(Estimator):
    """(6): (g, rho) = (w f / (w' n), w'), each pixel with its own points.

    Unbiased. The standard error is the pattern's own; it is the larger of the pixel's and its 3 x 3 neighbours' mean.

    Attributes:
        pattern: where in the unit square the points lie.
        density: w'; None is the filter itself, |w| / integral of |w|, for which every weight has the same modulus.
    """

    pattern: Pattern = field(default_factory=Sobol)
    density: Density | None = None

    @property
    def fewest(self) -> int:
        return 1

    def check(self, task: Task) -> None:
        density = self._density(task)
        if not density.covers(task.filter):
            raise McaaError(
                f"{density} is 0 where {task.filter} is not, which would be a silent bias; use a density that covers the filter"
            )
        if task.boundary == "renormalize" and not isinstance(task.filter, SeparableFilter):
            raise McaaError(
                f"boundary='renormalize' needs the integral of w over the screen, known for separable filters only, not {task.filter}; use Shared"
            )

    def cell(self, task: Task, adaptive: bool) -> tuple[int, int]:
        return (32, 32) if adaptive else (64, 64)

    def round(self, task: Task, spp: int, number: int) -> Round:
        return _ImportanceRound(task, self.pattern, self._density(task), self.pattern.count(spp), number)

    def _density(self, task: Task) -> Density:
        return FilterDensity(task.filter) if self.density is None else self.density


class _ImportanceRound(Round):
    def __init__(self, task: Task, pattern: Pattern, density: Density, count: int, number: int) -> None:
        self.task, self.pattern, self.density, self.count, self.number = task, pattern, density, count, number
        self.per_pixel = float(count)

    def points(self, cell: Cell) -> int:
        return self.count * cell.height * cell.width

    def estimate(self, cell: Cell) -> Estimate:
        task = self.task
        rows = torch.arange(cell.row, cell.row + cell.height, device=task.device)
        cols = torch.arange(cell.col, cell.col + cell.width, device=task.device)
        u, v = self.pattern.points(self.count, rows, cols, seed=task.seed, round=self.number, dtype=torch.float64)
        dx, dy = self.density.sample(u, v)
        weight = (task.filter(dx, dy) / self.density.pdf(dx, dy)).to(task.dtype)
        values, _, bad = evaluate_points(task, cell, cols + (0.5 + dx), rows[:, None] + (0.5 + dy))
        terms = values * weight / self.count
        invalid = torch.zeros(cell.height, cell.width, dtype=torch.int32, device=task.device)
        if bad is not None:
            invalid = bad.sum(0, dtype=torch.int32)
            left = self.count - invalid
            terms = terms * torch.where(left > 0, self.count / left.clamp_min(1).to(task.dtype), torch.nan)
        value = terms.sum(1)
        variance = torch.stack([self.pattern.variance(channel, u, v) for channel in terms])
        if task.boundary == "renormalize":
            norm = self._inside(cell)
            value, variance = value / norm, variance / norm.square()
        if bad is not None and task.integrand.nonfinite == "propagate":
            value = torch.where(invalid > 0, torch.nan, value)
        points = torch.full_like(invalid, self.count)
        return Estimate(value, settled(pooled(variance), value, self.count), points, invalid)

    def _inside(self, cell: Cell) -> torch.Tensor:
        """(h, w): the integral of w over the screen, of each pixel."""
        task = self.task
        assert isinstance(task.filter, SeparableFilter)
        cdf = task.filter.profile_cdf
        cols = torch.arange(cell.col, cell.col + cell.width, dtype=torch.float64) + 0.5
        rows = torch.arange(cell.row, cell.row + cell.height, dtype=torch.float64) + 0.5
        along_x = cdf(task.screen.width - cols) - cdf(-cols)
        along_y = cdf(task.screen.height - rows) - cdf(-rows)
        return (along_y[:, None] * along_x).to(task.device, task.dtype)
