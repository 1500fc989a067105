"""The picture that rounds are merged into."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_mcaa.errors import McaaError
from torch_mcaa.estimators import Diagnostics, Estimate, Task
from torch_mcaa.grid import Cell


def blank(task: Task, channels: int, diagnosed: bool) -> Estimate:
    """The planes of a whole picture before the first round: NaN, with a variance of +inf.

    Raises:
        McaaError: a picture that does not fit into memory.
    """
    height, width = task.screen.height, task.screen.width

    def full(value: float, *shape: int, dtype: torch.dtype = task.dtype) -> Tensor:
        return torch.full(shape, value, dtype=dtype, device=task.device)

    try:
        counts = torch.zeros(2, height, width, dtype=torch.int32, device=task.device)
        diagnostics = None
        if diagnosed:
            ess = full(0.0, height, width, dtype=torch.float32)
            diagnostics = Diagnostics(
                full(torch.inf, channels, height, width), ess, full(torch.nan, channels, height, width, dtype=torch.float32)
            )
        return Estimate(
            full(torch.nan, channels, height, width), full(torch.inf, channels, height, width), counts[0], counts[1], diagnostics
        )
    except RuntimeError as error:
        raise _too_large(task, channels) from error


def check_size(task: Task) -> None:
    """Raises McaaError if not even one channel would fit into memory: before plans are made for every part of the screen."""
    try:
        torch.empty(4, task.screen.height, task.screen.width, dtype=task.dtype, device=task.device)
    except RuntimeError as error:
        raise _too_large(task, 1) from error


def _too_large(task: Task, channels: int) -> McaaError:
    size = f"{task.screen.height} x {task.screen.width} pixels in {channels} channel{'s' * (channels > 1)}"
    return McaaError(f"a picture of {size} does not fit into memory; ask for a smaller size")


def add(picture: Estimate, cell: Cell, new: Estimate, share: float | Tensor | None, propagate: bool) -> None:
    """Merge a round into a cell of the picture, in place.

    Args:
        share: the round's weight, a number or (h, w); None to replace what is there, all but the numbers of points.
        propagate: whether a NaN is to stay; else a round in which no sample met a pixel's filter says nothing about it.
    """
    window = (slice(None), *cell.window)
    value, variance = new.value, new.variance
    if share is not None:
        old_value, old_variance = picture.value[window], picture.variance[window]
        value = old_value + (new.value - old_value) * share
        variance = old_variance * (1 - share) ** 2 + new.variance * share**2
        if not propagate:
            for empty, v, s in ((old_value.isnan(), new.value, new.variance), (new.value.isnan(), old_value, old_variance)):
                value, variance = torch.where(empty, v, value), torch.where(empty, s, variance)
    picture.value[window], picture.variance[window] = value, variance
    picture.points[cell.window] += new.points
    picture.invalid[cell.window] += new.invalid
    before, after = picture.diagnostics, new.diagnostics
    if before is not None and after is not None:
        predicted, ess, pareto_k = after.predicted, after.ess, after.pareto_k
        if share is not None:
            predicted = before.predicted[window] * (1 - share) ** 2 + predicted * share**2
            ess = before.ess[cell.window] + ess
            pareto_k = torch.fmax(before.pareto_k[window], pareto_k)
        before.predicted[window], before.ess[cell.window], before.pareto_k[window] = predicted, ess, pareto_k


def part_of(new: Estimate, cell: Cell, inner: Cell) -> Estimate:
    """The estimate of a part of its cell."""
    if inner == cell:
        return new
    window = inner.within(cell)

    def cut(plane: Tensor | None) -> Tensor | None:
        return None if plane is None else plane if plane.shape[-2:] == (1, 1) else plane[(..., *window)]

    diagnostics = new.diagnostics
    if diagnostics is not None:
        diagnostics = Diagnostics(
            *(plane[(..., *window)] for plane in (diagnostics.predicted, diagnostics.ess, diagnostics.pareto_k))
        )
    value, variance, points, invalid = (plane[(..., *window)] for plane in (new.value, new.variance, new.points, new.invalid))
    return Estimate(value, variance, points, invalid, diagnostics, cut(new.heavy), cut(new.unseen), cut(new.model), cut(new.blind))
