"""Evaluating f at the points of a pattern, plane by plane, in blocks that stay in the cache."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_mcaa.estimators.base import Task
from torch_mcaa.grid import Cell
from torch_mcaa.integrand import BLOCK, width_of


def evaluate_points(task: Task, cell: Cell, col: Tensor, row: Tensor) -> tuple[Tensor, Tensor, Tensor | None]:
    """f at float64 screen columns and rows (n, R, C) inside or around `cell`.

    Returns:
        Values (channels, n, R, C); whether each point counts, bool (n, R, C): those off the screen do not, unless the boundary is
        "extend"; and where f was not finite, or None. Points that do not count, or where f was not finite, have the value 0.
    """
    asked = task.screen.coordinate_dtype(cell, task.dtype)
    inside = torch.ones_like(col, dtype=torch.bool)
    if task.boundary != "extend":
        inside = (col >= 0) & (col < task.screen.width) & (row >= 0) & (row < task.screen.height)
        # f is not asked outside the screen; these values are multiplied by 0
        col, row = col.clamp(0, task.screen.width * (1 - 2.0**-50)), row.clamp(0, task.screen.height * (1 - 2.0**-50))
    x, y = task.screen.x_of(col).to(asked), task.screen.y_of(row).to(asked)
    step = max(1, BLOCK * width_of(x.device) // x[0].numel())
    parts, invalid = [], []
    for start in range(0, len(x), step):
        values = task.integrand(x[start : start + step], y[start : start + step])
        bad = None if task.integrand.nonfinite == "raise" else task.integrand.invalid(values)
        parts.append(torch.stack(values))
        invalid.append(torch.zeros_like(inside[start : start + step]) if bad is None else bad)
    values, bad = torch.cat(parts, 1), torch.cat(invalid)
    if bool(bad.any()):
        values = values.masked_fill(bad, 0)
    else:
        bad = None
    if task.boundary != "extend":
        values = values * inside
    return values, inside, bad
