"""Filters narrower than a pixel: where few points of a shared lattice lie inside one, points drawn from it do better."""

from __future__ import annotations

import math
from dataclasses import replace

import torch

from torch_mcaa.errors import McaaError
from torch_mcaa.estimators.base import Estimate, Round, Task
from torch_mcaa.estimators.paper.importance import Importance
from torch_mcaa.grid import Cell

LEAST = 2.0
"""Points inside the filter from which on the weights of every pixel, of whatever shift, sum to a third of their mean or more; with 1.5 there
are pixels without a point under a box."""
SOME = 1.5
"""The same for filters that go to 0 at their sides: half of their mean."""
WORTH = 5.0
"""Those from which on a lattice of lines errs less than as many points as there are in a pixel, drawn from the filter: 3 to 8 on edges."""
_PLACES = 128


def area(task: Task) -> float:
    """(integral of |w|)^2 / integral of w^2: how many px^2 count under a filter; as many pixels share a sample, and inf under endless ones."""
    filter = task.filter
    if math.isinf(max(filter.radius)):
        return math.inf
    steps = (torch.arange(_PLACES, dtype=torch.float64) + 0.5) / _PLACES * 2 - 1
    w = filter(steps * filter.radius[0], steps[:, None] * filter.radius[1]).detach().abs()
    return float(4 * filter.radius[0] * filter.radius[1] * w.mean().square() / w.square().mean())


def held(task: Task, count: int) -> float:
    """How many of `count` points a pixel lie inside a filter that takes less than a pixel, on average; inf for others, whose samples are shared."""
    covered = task.once(area)
    return count * covered if covered < 1 else math.inf


def check_held(task: Task, count: int, what: str) -> None:
    """Refuse a lattice of `count` points a pixel, few of which lie inside the filter.

    Raises:
        McaaError: on average fewer than `LEAST`, so that in some pixels there is none.
    """
    inside = held(task, count)
    if inside < LEAST:
        raise McaaError(
            f"{what}: {task.filter} is so narrow that of {count} evaluations a pixel {inside:.2g} lie inside it, and it needs {LEAST:g}; "
            "use Auto() or Importance(), whose points are drawn from the filter, or raise spp"
        )


class DrawnRound(Round):
    """`Importance()`, as one of the models of an estimator that chooses."""

    def __init__(self, task: Task, spp: int, number: int, model: int) -> None:
        self.drawn, self.model, self.per_pixel = Importance().round(task, spp, number), model, float(spp)

    def points(self, cell: Cell) -> int:
        return self.drawn.points(cell)

    def estimate(self, cell: Cell) -> Estimate:
        found = self.drawn.estimate(cell)
        lost = found.without_moment
        model = torch.full_like(found.points, self.model, dtype=torch.uint8)
        return replace(found, diagnostics=None, heavy=lost if bool(lost.any()) else None, model=model)
