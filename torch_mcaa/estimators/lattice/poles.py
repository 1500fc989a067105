"""Whether f grows without bound where the largest of shared samples lie: then pixels there have no second moment.

Shared estimators keep no terms whose tail could be judged, and the few samples about one pole tell it badly from a bump. But where it
would be is known, and f can be asked there more closely: about a pole the values grow as fast as one approaches, about a bump or an edge not.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from torch_mcaa.estimators.base import Task
from torch_mcaa.estimators.paper.tail import hill
from torch_mcaa.grid import Cell

_MOST = 8
"""Rows of samples of a channel that are looked at in a cell, the brightest ones."""
_ABOVE = 2.2
"""What a row's sum of squares is above the mean over a pixel either side. An edge along the rows makes it 2, a pole much more."""
_SHARE = 0.25
"""What one sample's square is of its row's sum of squares, at least."""
_SIDE = 8
"""Points along a side of a window."""
_ZOOMS = 4
"""Times that a window is made smaller, by 4; fewer, but two, where the coordinates' rounding ends it."""
_FINEST = 16
"""Roundings of the coordinates that the last window is wide at least."""
_GROWTH = 1.5
"""What the median modulus grows by from window to window, at least: r^-0.6 grows by 2.3, along a line or about a point."""


# (strips, planes) of some rows of samples, (K,) each, and a channel -> the samples, and their float64 screen rows and columns, (K, cols) each
Fetch = Callable[[Tensor, Tensor, int], tuple[Tensor, Tensor, Tensor]]


@dataclass(frozen=True)
class _Place:
    """A sample that stands out, in pixels of the screen."""

    row: float
    col: float


class Poles:
    """The rows of a cell's samples, and what f does where one of them stands out.

    Of two poles in a cell that lie in the same two rows of pixels only the higher is found.

    Args:
        density: samples in a pixel.
        order: the planes of a strip from top to bottom.
    """

    def __init__(self, task: Task, cell: Cell, density: float, order: np.ndarray) -> None:
        self.task, self.cell, self.density, self.order = task, cell, density, order
        self._norms: dict[int, list[Tensor]] = {}

    def add(self, channel: int, values: Tensor) -> None:
        """Take note of samples (strips, planes, cols), the next planes."""
        # of rows, not larger parts: these sums have the same bits for every number of threads
        self.note(channel, torch.linalg.vector_norm(values, dim=2))

    def note(self, channel: int, norms: Tensor) -> None:
        """Take note of the norms of rows of samples (strips, planes), the next planes."""
        self._norms.setdefault(channel, []).append(norms)

    def heavy(self, fetch: Fetch) -> Tensor | None:
        """(C, h, w) bool: the pixels whose filter reaches a place where f has no second moment; None if there is no such place."""
        reached = None
        for channel in self._norms:
            for place in self._unbounded(channel, self._places(channel, fetch)):
                if reached is None:
                    shape = (len(self._norms), self.cell.height, self.cell.width)
                    reached = torch.zeros(shape, dtype=torch.bool, device=self.task.device)
                reached[channel] |= self._reach(place)
        return reached

    def _places(self, channel: int, fetch: Fetch) -> list[_Place]:
        """What stands out of a channel's samples."""
        norms = torch.cat(self._norms[channel], 1).cpu().numpy()[:, self.order]
        # where squares overflow nothing is found, and the standard error is +inf by itself
        with np.errstate(over="ignore", invalid="ignore"):
            energy = np.square(norms, dtype=np.float64).ravel()
            near = math.ceil(self.density)
            # beyond the first and the last row there are zeros: a constant is then less than twice the mean
            padded = np.zeros(len(energy) + 2 * near + 1)
            padded[near + 1 : near + 1 + len(energy)] = energy
            total = padded.cumsum(out=padded)
            around = total[2 * near + 1 :] - total[: -2 * near - 1]
            standing = (energy * (2 * near + 1) > _ABOVE * around).nonzero()[0]
        if not len(standing):
            return []
        chosen: list[int] = []
        for one in standing[np.argsort(-energy[standing], kind="stable")].tolist():
            if all(abs(one - other) > near for other in chosen):
                chosen.append(one)
            if len(chosen) == _MOST:
                break
        strips, planes = (
            torch.tensor(chosen) // len(self.order),
            torch.from_numpy(self.order)[torch.tensor(chosen) % len(self.order)],
        )
        values, rows, cols = fetch(strips, planes, channel)
        squares = values.to("cpu", torch.float64).square()
        highest = squares > _SHARE * torch.from_numpy(energy[chosen])[:, None]
        rows, cols = rows.expand(values.shape)[highest], cols.expand(values.shape)[highest]
        return [_Place(row, col) for row, col in zip(rows.tolist(), cols.tolist(), strict=True)]

    def _reach(self, place: _Place) -> Tensor:
        """(h, w) bool: the pixels whose filter is not 0 there."""
        cell = self.cell
        dx = place.col - 0.5 - torch.arange(cell.col, cell.col + cell.width, dtype=torch.float64)
        dy = place.row - 0.5 - torch.arange(cell.row, cell.row + cell.height, dtype=torch.float64)[:, None]
        return (self.task.filter(dx.expand(cell.height, -1), dy.expand(-1, cell.width)) != 0).to(self.task.device)

    def _unbounded(self, channel: int, places: list[_Place]) -> list[_Place]:
        """Those of the places about which f grows from window to window, with a tail index above 1/2 inside them."""
        if not places:
            return []
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
            values, middle, index, cols, rows = (t[growing] for t in (values, median, index, cols, rows))
            if not places:
                break
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
