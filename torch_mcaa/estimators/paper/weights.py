"""Whether a density is fit to sample a filter: the weights w / w' of (6)."""

from __future__ import annotations

import math

import torch

from torch_mcaa.densities import Density
from torch_mcaa.errors import McaaError
from torch_mcaa.estimators.base import Task

_LARGEST = 1e4
_SHARE = 0.01
_PROBES = 512


def check_weights(task: Task, density: Density, what: str, mend: str) -> None:
    """Refuse a density that is 0 where w is not, or whose second moment, (11) for f = 1, no reasonable number of points would see.

    That is so when more than 1 % of the integral of w^2 / w' lies where w / w' is above 10^4, which for a normal w of variance g
    and w' of variance b about the same centre means 2 b <= g. 512^2 points over the filter's support decide; over an infinite one, the
    screen.

    Raises:
        McaaError: such a density.
    """
    if not density.covers(task.filter):
        raise McaaError(f"{what} is 0 where {task.filter} is not, which would be a silent bias; {mend}")
    radius = [
        r if math.isfinite(r) else side for r, side in zip(task.filter.radius, (task.screen.width, task.screen.height), strict=True)
    ]
    steps = (torch.arange(_PROBES, dtype=torch.float64) + 1 / math.pi) / _PROBES * 2 - 1
    dx, dy = steps * radius[0], steps[:, None] * radius[1]
    w = task.filter(dx, dy).abs()
    weight = torch.where(w > 0, w / density.pdf(dx, dy), 0)
    second = w * weight
    largest, seen = float(weight.max()), float(torch.where(weight > _LARGEST, 0, second).sum() / second.sum())
    if not seen >= 1 - _SHARE:
        raise McaaError(
            f"{what} is too narrow for {task.filter}: weights w / w' reach {largest:.1e}, where {1 - seen:.0%} of the second moment lies, so "
            f"the variance would look small and be ruinous; {mend}"
        )
