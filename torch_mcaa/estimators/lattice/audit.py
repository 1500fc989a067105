"""Points off the lattice, that see what the lattice cannot: a tone on its dual vectors is constant on all its points.

One point for each strip and column, at a random place in the lattice's unit cell around a sample. Where f is resolved it differs from that
sample no more than the most different of the sample's four neighbours does; in white noise it differs more one time in five. Where it
differs more than two times in five, over a tile of the screen, the lattice is blind there, and half the points' mean squared difference
is the variance. Where it differs up to one time in five, that much of f is taken for noise, on which a lattice does no better than chance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from torch_mcaa import rng
from torch_mcaa.estimators.base import Task
from torch_mcaa.estimators.lattice.lattice_weights import Geometry
from torch_mcaa.grid import Cell
from torch_mcaa.patterns.lattice import Strip

_AUDIT = 0xA0D17
_POINTS = 48
_NOISE, _BLIND = 1 / 5, 2 / 5
"""How often points differ more in noise, and over a tile of all the points where the lattice is blind."""


@dataclass(frozen=True)
class Seen:
    """What the audit tells of a cell, in tiles: one for each, or a single one for all.

    Attributes:
        blind: (rows, columns) the variance of what the lattice does not see, 0 where it resolves f.
        noise: (rows, columns) the part of f that is noise, 0 to 1.
        tall, wide: a tile's size in pixels.
        window: the cell's pixels among those of the tiles.
    """

    blind: Tensor
    noise: Tensor
    tall: int
    wide: int
    window: tuple[slice, slice]

    def by_pixel(self, tiles: Tensor) -> Tensor:
        """(h, w): what each pixel's tile has; (1, 1) where all have the same."""
        if tiles.numel() == 1:
            return tiles
        rows, cols = tiles.shape
        repeated = tiles[:, None, :, None].expand(rows, self.tall, cols, self.wide)
        return repeated.reshape(rows * self.tall, cols * self.wide)[self.window]


class Audit:
    """The audit of one strip lattice; `planes` are the planes of samples it needs."""

    def __init__(self, task: Task, strip: Strip, number: int) -> None:
        self.task, self.strip, self.number = task, strip, number
        # in the strip's last pixel, so that a strip which the screen cuts off does not hold more than its share of points
        self.reference = int(np.argmax(strip.y))
        self.neighbours = [self._neighbour(sign * step) for step in strip.basis for sign in (1, -1)]
        self.planes = sorted({self.reference, *(plane for plane, _, _ in self.neighbours)})

    def _neighbour(self, step: np.ndarray) -> tuple[int, int, int]:
        """The plane of the sample at `step` from the reference, and the change of strip and column that leads there."""
        strip = self.strip
        x, y = strip.x[self.reference] + step[0], strip.y[self.reference] + step[1]
        dx, dy = x - strip.x, (y - strip.y) / strip.period
        plane = int(np.argmin((dx - dx.round()) ** 2 + ((dy - dy.round()) * strip.period) ** 2))
        return plane, round(float(dy[plane])), round(float(dx[plane]))

    def row(self) -> int:
        """The pixel of the strip in which all its audit points lie."""
        return int(self.strip.y[self.reference])

    def places(self, at: Geometry) -> tuple[Tensor, Tensor]:
        """float64 screen columns and rows (strips, cols) of the audit points, each in the pixel of its sample."""
        strips = torch.arange(at.strip, at.strip + at.strips, device=self.task.device)[:, None]
        cols = torch.arange(at.col, at.col + at.cols, device=self.task.device)[None, :]
        drawn = rng.bits(self.task.seed, _AUDIT, self.number, strips, cols)
        a, b = (drawn & 0xFFFF).to(torch.float64) / 65536 - 0.5, (drawn >> 16).to(torch.float64) / 65536 - 0.5
        basis, row = self.strip.basis, self.row()
        x = (self.strip.x[self.reference] + a * basis[0, 0] + b * basis[1, 0]).clamp(0, 1 - 2.0**-20)
        y = (self.strip.y[self.reference] + a * basis[0, 1] + b * basis[1, 1]).clamp(row, row + 1 - 2.0**-20)
        return cols + x, strips * self.strip.period + y

    def seen(self, cell: Cell, at: Geometry, audited: Tensor, held: dict[int, Tensor]) -> Seen:
        """Of f at the audit's points, `audited` (strips, cols), and in the held planes, as large."""
        reference = held[self.reference]
        seen = (audited - reference).square()
        most = torch.zeros_like(seen)
        for plane, down, right in self.neighbours:
            here, there = _shifted(reference, down, right), _shifted(held[plane], -down, -right)
            inner = _shifted(most, down, right)
            torch.maximum(inner, (there - here).square(), out=inner)
        more = (seen > most).to(seen.dtype)
        tall = max(1, min(round(7 / self.strip.period), at.strips))
        wide = min(-(-_POINTS // tall), at.cols)
        top, left = cell.row - at.strip * self.strip.period, cell.col - at.col
        window = slice(top, top + cell.height), slice(left, left + cell.width)
        share = tile_means(more, tall, wide)
        if not bool(share.any()):
            return Seen(seen.new_zeros(1, 1), seen.new_zeros(1, 1), tall * self.strip.period, wide, window)
        # tiles that are cut hold fewer points, of which chance decides more
        rows, cols = (
            (size - torch.arange(0, size, step, device=share.device)).clamp_max(step)
            for size, step in zip(more.shape, (tall, wide), strict=True)
        )
        most = _NOISE + (_BLIND - _NOISE) * (tall * wide / (rows[:, None] * cols)).sqrt()
        power = torch.where(share > most, tile_means(seen, tall, wide) / 2, 0.0)
        return Seen(power, (share / _NOISE).clamp_max(1), tall * self.strip.period, wide, window)


def _shifted(plane: Tensor, down: int, right: int) -> Tensor:
    """The part of a plane whose elements (i, j) have an element (i + down, j + right)."""
    height, width = plane.shape
    return plane[max(0, -down) : height - max(0, down), max(0, -right) : width - max(0, right)]


def tile_means(plane: Tensor, tall: int, wide: int) -> Tensor:
    """The means over tiles of (h, w); the last ones of a row or column are cut."""
    size = (tall, wide)
    return torch.nn.functional.avg_pool2d(plane[None], size, size, ceil_mode=True, count_include_pad=False)[0]
