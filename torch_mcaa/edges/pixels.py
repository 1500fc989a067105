"""Some of the pixels of a rectangle, in a list: what jumps reach is a small part of a picture."""

from __future__ import annotations

from functools import cached_property

import torch
from torch import Tensor

from torch_mcaa.picking import pick


class Pixels:
    """The pixels of `mask`, bool (h, w), whose first is (row, col) on the screen; row by row.

    Attributes:
        rows, cols: (P,) int64, counted from the rectangle's first.
        margin: how far beyond the rectangle places may lie that `index` is asked for.
    """

    def __init__(self, row: int, col: int, mask: Tensor, margin: int) -> None:
        self.row, self.col, self.margin = row, col, margin
        self.height, self.width = mask.shape
        flat = mask.flatten().nonzero()[:, 0]
        self.rows, self.cols = flat // self.width, flat % self.width
        wide = self.width + 2 * margin
        self._slot = torch.full(((self.height + 2 * margin) * wide,), len(self), dtype=torch.int64, device=mask.device)
        self._slot[self._flat(self.rows + row, self.cols + col)] = torch.arange(len(self), device=mask.device)

    def __len__(self) -> int:
        return len(self.rows)

    def index(self, rows: Tensor, cols: Tensor) -> Tensor:
        """Where in the list the pixels (rows, cols) of the screen are, P for those that are not."""
        at = self._flat(rows, cols)
        return self._slot.index_select(0, at.flatten()).view(at.shape)

    def _flat(self, rows: Tensor, cols: Tensor) -> Tensor:
        wide = self.width + 2 * self.margin
        return rows * wide + ((self.margin - self.row) * wide + self.margin - self.col) + cols

    def of(self, other: Pixels, values: Tensor, default: float) -> Tensor:
        """(..., P): values (..., Q) of another list of the same rectangle; `default` where that has no such pixel."""
        rest = values.new_full((*values.shape[:-1], 1), default)
        return pick(torch.cat([values, rest], -1), other.index(self.rows + self.row, self.cols + self.col))

    def plane(self, values: Tensor) -> Tensor:
        """(h, w): values (P,), and 0 elsewhere."""
        plane = values.new_zeros(self.height, self.width)
        plane[self.rows, self.cols] = values
        return plane

    def summed(self, values: Tensor) -> Tensor:
        """(..., P): the sum over each pixel and its neighbours in the list, up and down and then across."""
        for near in self._near:
            around = torch.cat([values, values.new_zeros((*values.shape[:-1], 1))], -1)
            values = pick(around, near[0]) + values + pick(around, near[1])
        return values

    def greatest(self, values: Tensor, reach: int) -> Tensor:
        """(P,): the largest of values (P,) >= 0 of pixels in the list that are `reach` steps off, or less, over others in it."""
        for near in self._near * reach:
            around = torch.cat([values, values.new_zeros(1)])
            values = torch.maximum(torch.maximum(pick(around, near[0]), values), pick(around, near[1]))
        return values

    @cached_property
    def _near(self) -> list[tuple[Tensor, Tensor]]:
        """The neighbours above and below, and left and right."""
        rows, cols = self.rows + self.row, self.cols + self.col
        return [
            (self.index(rows - 1, cols), self.index(rows + 1, cols)),
            (self.index(rows, cols - 1), self.index(rows, cols + 1)),
        ]
