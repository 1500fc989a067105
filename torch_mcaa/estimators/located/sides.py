"""Filters that end in a step, as the box does: a line just inside counts whole and one just outside not at all."""

from __future__ import annotations

import math

import torch

from torch_mcaa.estimators.base import Task
from torch_mcaa.filters import SeparableFilter

_CUT = 0.01
"""What w may have at its sides, in parts of the most it has, to go to 0 there."""
_PLACES = 65
"""Along either axis, at which that is looked at; odd, for the middle."""


def ends_in_step(task: Task) -> bool:
    """Whether w does not go to 0 at its sides."""
    filter = task.filter
    x, y = (torch.linspace(-radius, radius, _PLACES, dtype=torch.float64) for radius in filter.radius)
    size = filter(x, y[:, None]).detach().abs()
    return float(torch.cat([size[0], size[-1], size[:, 0], size[:, -1]]).max()) >= _CUT * float(size.max())


def sides(task: Task) -> float | None:
    """The fraction of a pixel at which the sides of the filters of all pixels lie, if they end in a step there; None if not.

    Lines halfway about it make the mean over lines a midpoint rule, whose error is of the order of n^-2 in the place of 0.3 / n.
    """
    filter = task.filter
    if not isinstance(filter, SeparableFilter) or math.isinf(filter.half_width) or not task.once(ends_in_step):
        return None
    width = 2 * filter.half_width
    return (0.5 + filter.half_width) % 1.0 if abs(width - round(width)) < 1e-9 else None
