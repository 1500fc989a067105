"""The screen: pixels, centres, cells, and the coordinates that f is given ((21)-(24) of Halton's paper).

A place on the screen is an integer pixel and an offset in [0, 1), kept apart until the last moment, so that a pixel far from the
origin is sampled as finely as the first one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torch_mcaa import rng
from torch_mcaa.errors import McaaError

_FINEST_STEP = 2.0**-10


@dataclass(frozen=True)
class Cell:
    """A rectangle of pixels, the unit of work: rows [row, row + height), columns [col, col + width)."""

    row: int
    col: int
    height: int
    width: int

    @property
    def window(self) -> tuple[slice, slice]:
        """The slices that cut this cell out of a picture."""
        return slice(self.row, self.row + self.height), slice(self.col, self.col + self.width)

    def blocks(self, side: int) -> list[Cell]:
        """Its blocks of `side` x `side` pixels, row by row; the last ones of a row or column are cut."""
        return [
            Cell(self.row + row, self.col + col, min(side, self.height - row), min(side, self.width - col))
            for row in range(0, self.height, side)
            for col in range(0, self.width, side)
        ]

    def grown(self, by: int) -> Cell:
        """With so many pixels more on every side."""
        return Cell(self.row - by, self.col - by, self.height + 2 * by, self.width + 2 * by)

    def overlap(self, other: Cell) -> Cell:
        """What it shares with another, which touches it."""
        row, col = max(self.row, other.row), max(self.col, other.col)
        bottom = min(self.row + self.height, other.row + other.height)
        return Cell(row, col, bottom - row, min(self.col + self.width, other.col + other.width) - col)

    def places(self, count: int, seed: int, *keys: int, device: torch.device | None = None) -> tuple[Tensor, Tensor]:
        """(count,) float64 columns and rows of places in it, random by the seed and the keys."""
        index = torch.arange(count, device=device)
        col, row = (rng.uniform(seed, *keys, axis, index, dtype=torch.float64) for axis in (0, 1))
        return self.col + col * self.width, self.row + row * self.height

    def within(self, other: Cell) -> tuple[slice, slice]:
        """The slices that cut this cell out of planes of another."""
        row, col = self.row - other.row, self.col - other.col
        return slice(row, row + self.height), slice(col, col + self.width)

    def rectangles(self, side: int, labels: Sequence[object]) -> list[tuple[Cell, list[int]]]:
        """Blocks of one label as few rectangles: the part of the cell, and its blocks.

        labels: of the blocks of `side` x `side` pixels, row by row; the last ones of a row or column are cut.
        """
        wide = -(-self.width // side)
        # first row, rows, first column, columns, in blocks
        merged: list[tuple[int, int, int, int]] = []
        for row in range(len(labels) // wide):
            start = 0
            for col in range(wide):
                here = row * wide + start
                if col + 1 < wide and labels[here + col + 1 - start] == labels[here]:
                    continue
                width = col + 1 - start
                above = next((m for m in merged if m[0] + m[1] == row and m[2:] == (start, width)), None)
                if above is not None and labels[above[0] * wide + start] == labels[here]:
                    merged[merged.index(above)] = (above[0], above[1] + 1, start, width)
                else:
                    merged.append((row, 1, start, width))
                start = col + 1
        found = []
        for row, height, col, width in merged:
            part = Cell(
                self.row + row * side,
                self.col + col * side,
                min(height * side, self.height - row * side),
                min(width * side, self.width - col * side),
            )
            found.append((part, [(row + i) * wide + col + j for i in range(height) for j in range(width)]))
        return found


@dataclass(frozen=True)
class Screen:
    """S of (21): `height` x `width` pixels over `extent` = (x0, x1, y0, y1) in f's coordinates (the default: pixels, y down)."""

    height: int
    width: int
    extent: tuple[float, float, float, float]

    @classmethod
    def of(cls, size: object, extent: object = None) -> Screen:
        """Check what a user typed as `size` (height, width) and `extent`.

        Raises:
            McaaError: sizes that are not positive integers; an extent that is not four finite numbers with x0 != x1, y0 != y1.
        """
        if not (isinstance(size, (tuple, list, torch.Size)) and len(size) == 2 and all(_is_integer(s) for s in size)):
            raise McaaError(f"size must be two integers (height, width), got {size!r}; write for instance size=(512, 512)")
        height, width = (int(s) for s in size)
        if height < 1 or width < 1:
            raise McaaError(f"size must be at least one pixel each way, got height {height}, width {width}; ask for positive ones")
        if extent is None:
            return cls(height, width, (0.0, float(width), 0.0, float(height)))
        try:
            x0, x1, y0, y1 = (float(e) for e in extent)  # pyright: ignore[reportGeneralTypeIssues]
        except (TypeError, ValueError) as error:
            raise McaaError(f"extent must be four numbers (x0, x1, y0, y1), got {extent!r}") from error
        screen = cls(height, width, (x0, x1, y0, y1))
        # x1 - x0 may overflow, and a pixel of it underflow
        if not all(map(math.isfinite, (*screen.extent, *screen.pixel_size))) or 0 in screen.pixel_size:
            raise McaaError(f"extent must be finite with x0 != x1 and y0 != y1, got {(x0, x1, y0, y1)}")
        return screen

    @property
    def whole(self) -> Cell:
        """All its pixels."""
        return Cell(0, 0, self.height, self.width)

    @property
    def pixel_size(self) -> tuple[float, float]:
        """(L1 / N1, L2 / N2): the width and height of a pixel in f's coordinates, negative where the extent runs backwards."""
        x0, x1, y0, y1 = self.extent
        return (x1 - x0) / self.width, (y1 - y0) / self.height

    def x_of(self, col: Tensor) -> Tensor:
        """f's x of float64 screen columns (pixels)."""
        return _along(col, self.extent[0], self.pixel_size[0])

    def y_of(self, row: Tensor) -> Tensor:
        """f's y of float64 screen rows (pixels)."""
        return _along(row, self.extent[2], self.pixel_size[1])

    def centres(self, cell: Cell | None = None, strata: tuple[int, int] = (1, 1)) -> tuple[Tensor, Tensor]:
        """(23): float64 coordinates (width,) and (height,) of the centres of a cell's pixels, of all pixels by default.

        With `strata` = (m1, m2), (24): (m1 width,) and (m2 height,) of the centres of the m1 x m2 sub-pixels of each, in order.
        """
        cell = cell or self.whole
        m1, m2 = strata
        cols = (torch.arange(m1 * cell.col, m1 * (cell.col + cell.width), dtype=torch.float64) + 0.5) / m1
        rows = (torch.arange(m2 * cell.row, m2 * (cell.row + cell.height), dtype=torch.float64) + 0.5) / m2
        return self.x_of(cols), self.y_of(rows)

    def coordinate_dtype(self, cell: Cell, dtype: torch.dtype) -> torch.dtype:
        """The dtype in which f is asked: `dtype`, or float64 where that would step by more than 2^-10 px inside the cell.

        A margin of one cell is included, so that the filter's reach does not change the answer at a border.
        """
        corner_x = self.x_of(torch.tensor([cell.col - cell.width, cell.col + 2.0 * cell.width], dtype=torch.float64))
        corner_y = self.y_of(torch.tensor([cell.row - cell.height, cell.row + 2.0 * cell.height], dtype=torch.float64))
        for corner, pixel in ((corner_x, self.pixel_size[0]), (corner_y, self.pixel_size[1])):
            magnitude, floats = float(corner.abs().max()), torch.finfo(dtype)
            # the gap between floats is at most eps times the magnitude; below `tiny` it shrinks no more
            gap = 2.0 ** math.floor(math.log2(max(magnitude, floats.tiny))) * floats.eps
            if gap > _FINEST_STEP * abs(pixel) or magnitude > floats.max:
                return torch.float64
        return dtype

    def cells(self, height: int, width: int) -> Iterator[Cell]:
        """The canonical cells, row by row: they lie on a fixed grid of the screen and are cut off where it ends."""
        for row in range(0, self.height, height):
            for col in range(0, self.width, width):
                yield Cell(row, col, min(height, self.height - row), min(width, self.width - col))


def _is_integer(value: object) -> bool:
    return not isinstance(value, bool) and hasattr(value, "__index__")


def _along(pixels: Tensor, first: float, size: float) -> Tensor:
    """Coordinates along one axis; pixels are the usual ones."""
    return pixels if (first, size) == (0, 1) else first + size * pixels
