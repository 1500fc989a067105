"""Whether f grows without bound where the largest of shared samples lie: then pixels there have no second moment.

Shared estimators keep no terms whose tail could be judged, and the few samples about one pole tell it badly from a bump. But where it
would be is known, and f can be asked there more closely: about a pole the values grow as fast as one approaches, about a bump or an edge not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from torch_mcaa.estimators.base import Task
from torch_mcaa.estimators.tail import hill
from torch_mcaa.grid import Cell

_MOST = 8
"""Places in a channel of a cell that are looked at, the highest ones."""
_APART = 1.0
"""Pixels between two places."""
_SIDE = 8
"""Points along a side of a window."""
_ZOOMS = 4
"""Times that a window is made smaller, by 4; fewer, but two, where the coordinates' rounding ends it."""
_FINEST = 16
"""Roundings of the coordinates that the last window is wide at least."""
_GROWTH = 1.5
"""What the median modulus grows by from window to window, at least: r^-0.6 grows by 2.3, along a line or about a point."""


@dataclass(frozen=True)
class _Place:
    """Where a sample stood out, in pixels of the screen."""

    height: float
    row: float
    col: float


class Poles:
    """The samples of a cell that stand out, and what f does about them. `density`: samples in a pixel."""

    def __init__(self, task: Task, cell: Cell, density: float) -> None:
        self.task, self.cell, self.density = task, cell, density
        self.places: dict[int, list[_Place]] = {}

    def look(self, channel: int, values: Tensor, row: Tensor, col: Tensor) -> None:
        """Note what stands out of samples (strips, planes, cols) at float64 screen rows and columns that expand to them.

        A sample does if its square is above a tenth of what its strip's sum of squares is above that of the strips beside it, and that a
        twentieth of the strip's own.
        """
        # rows of samples, not larger parts: their sums have the same bits for every number of threads
        norms = torch.linalg.vector_norm(values, dim=2).cpu().numpy().astype(np.float64)
        energy = np.square(norms).sum(1)
        excess = energy.copy()
        if len(energy) > 1:
            padded = np.concatenate([energy[1:2], energy, energy[-2:-1]])
            excess -= (padded[2:] + padded[:-2]) / 2
        standing = (excess > 0.05 * energy).nonzero()[0]
        if not len(standing):
            return
        planes = norms[standing].argmax(1)
        standing = standing[norms[standing, planes] ** 2 > 0.1 * excess[standing]]
        planes = norms[standing].argmax(1)
        if not len(standing):
            return
        rows = values[torch.from_numpy(standing), torch.from_numpy(planes)].abs().cpu().numpy()
        heights, cols = rows.max(1).astype(np.float64), rows.argmax(1)
        high = heights**2 > 0.1 * excess[standing]
        if not high.any():
            return
        row, col = row.expand(values.shape), col.expand(values.shape)
        found = self.places.setdefault(channel, [])
        for height, *index in zip(heights[high], standing[high], planes[high], cols[high], strict=True):
            found.append(_Place(float(height), float(row[tuple(index)]), float(col[tuple(index)])))

    def heavy(self, channels: int) -> Tensor | None:
        """(C, h, w) bool: the pixels whose filter reaches a place where f has no second moment; None if there is no such place."""
        reached = None
        for channel, found in self.places.items():
            for place in self._unbounded(channel, self._highest(found)):
                if reached is None:
                    reached = torch.zeros(channels, self.cell.height, self.cell.width, dtype=torch.bool, device=self.task.device)
                reached[channel] |= self._reach(place)
        return reached

    def _highest(self, found: list[_Place]) -> list[_Place]:
        chosen: list[_Place] = []
        for place in sorted(found, key=lambda p: (-p.height, p.row, p.col)):
            if len(chosen) == _MOST:
                break
            if all(max(abs(place.row - p.row), abs(place.col - p.col)) > _APART for p in chosen):
                chosen.append(place)
        return chosen

    def _reach(self, place: _Place) -> Tensor:
        """(h, w) bool: the pixels whose filter is not 0 there."""
        cell = self.cell
        dx = place.col - 0.5 - torch.arange(cell.col, cell.col + cell.width, dtype=torch.float64)
        dy = place.row - 0.5 - torch.arange(cell.row, cell.row + cell.height, dtype=torch.float64)[:, None]
        return (self.task.filter(dx.expand(cell.height, -1), dy.expand(-1, cell.width)) != 0).to(self.task.device)

    def _unbounded(self, channel: int, places: list[_Place]) -> list[_Place]:
        """Those of the places about which f grows from window to window, with a tail index above 1/2 inside them."""
        task, screen = self.task, self.task.screen
        asked = screen.coordinate_dtype(self.cell, task.dtype)
        half = 1.5 / math.sqrt(self.density)
        zooms = min(_ZOOMS, math.floor(math.log(half / self._finest(asked), 4)))
        if zooms < 2:
            # too far from the origin to look closely
            return []
        # an infinity that a user asked to be told of is no error at a point that the picture does not need
        integrand = replace(task.integrand, nonfinite="ignore")
        grid = (torch.arange(_SIDE, dtype=torch.float64) + 0.5) / _SIDE * 2 - 1
        dx, dy = grid.repeat(_SIDE), grid.repeat_interleave(_SIDE)
        row, col = (torch.tensor([getattr(p, name) for p in places], dtype=torch.float64) for name in ("row", "col"))
        middle, index = torch.zeros(len(places), dtype=torch.float64), torch.zeros(len(places), dtype=torch.float64)
        for zoom in range(zooms + 1):
            cols, rows = col[:, None] + half * dx, row[:, None] + half * dy
            if task.boundary != "extend":
                cols, rows = cols.clamp(0, screen.width * (1 - 2.0**-50)), rows.clamp(0, screen.height * (1 - 2.0**-50))
            x, y = (c.to(task.device, asked) for c in (screen.x_of(cols), screen.y_of(rows)))
            values = integrand(x, y)[channel].abs().nan_to_num(nan=0.0).to("cpu", torch.float64)
            median = values.median(1).values
            growing = median > (_GROWTH * middle if zoom else 0)
            places = [place for place, grows in zip(places, growing.tolist(), strict=True) if grows]
            if not places:
                break
            values, middle, index, cols, rows = (t[growing] for t in (values, median, index, cols, rows))
            if zoom:
                index += hill(values.T) / zooms
            highest = values.argmax(1, keepdim=True)
            col, row = cols.gather(1, highest)[:, 0], rows.gather(1, highest)[:, 0]
            half /= 4
        task.integrand.evaluations += integrand.evaluations
        return [place for place, k in zip(places, index.tolist(), strict=True) if k > 0.5]

    def _finest(self, asked: torch.dtype) -> float:
        """Half the width in pixels of the least window whose points are told apart by coordinates of this dtype."""
        cell, screen = self.cell, self.task.screen
        cols = torch.tensor([cell.col, cell.col + cell.width], dtype=torch.float64)
        rows = torch.tensor([cell.row, cell.row + cell.height], dtype=torch.float64)
        far = (float(screen.x_of(cols).abs().max()), float(screen.y_of(rows).abs().max()))
        return max(_FINEST / 2 * torch.finfo(asked).eps * c / abs(p) for c, p in zip(far, screen.pixel_size, strict=True))
