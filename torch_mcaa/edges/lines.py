"""Samples on horizontal and vertical lines over a rectangle of the screen: one rank-1 lattice is both.

The n points (g i / n, i / n) of a lattice of period 1 lie on n horizontal lines a pixel, and, g and n having no common divisor, on n vertical
ones; along either the samples are h = 1 px apart.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Self

import torch
from torch import Tensor

from torch_mcaa.filters.base import Filter

_AT_ONCE = 1 << 21
"""Weighed samples held at a time."""
Ask = Callable[[Tensor, Tensor], Tensor]
"""f at float64 screen columns and rows (N,): its values (C, N)."""


class Differences(ABC):
    """Absolute differences of neighbours on lines, `size` (C, M): each between a sample and the next on its line."""

    size: Tensor

    @abstractmethod
    def place(self, index: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """The line, and the row and column of pixels counted from the first, of the first sample of each (N,)."""

    @abstractmethod
    def ends(self, index: Tensor) -> tuple[Tensor, Tensor]:
        """f (C, N) at both samples."""

    @abstractmethod
    def beside(self, index: Tensor, steps: Tensor) -> Tensor:
        """(N, K): the difference so many `steps` (K,) on along the line of each; -1 where there is none."""

    def pruned(self, times: float) -> Tensor:
        """bool (C, M): those that may be over `times` the lower median of the four on either side; a quick test that lets others pass."""
        return self.size > 0


@dataclass(frozen=True)
class Lines:
    """The lines of a lattice.

    Attributes:
        x, y: (n,) float64 offsets in [0, 1) of the points in every pixel.
        number: which of the lattices of a cell this is; random numbers hang on it.
    """

    x: Tensor
    y: Tensor
    number: int

    @property
    def count(self) -> int:
        """Points, and lines along either axis, in a pixel."""
        return len(self.x)


@dataclass(frozen=True)
class Samples(Lines, ABC):
    """f at the points of a lattice in pixels of [row, row + R) x [col, col + Q).

    `codes`: one channel as `values` are, where f is followed: equal where it decided alike.
    """

    row: int
    col: int
    values: Tensor
    codes: Tensor | None = field(default=None, kw_only=True)

    def some(self, lines: slice) -> Self:
        """Those on some of the lines, of which the third axis of `values` is."""
        codes = None if self.codes is None else self.codes[:, :, lines]
        return replace(self, x=self.x[lines], y=self.y[lines], values=self.values[:, :, lines], codes=codes)

    @abstractmethod
    def differences(self, axis: int, codes: bool = False) -> Differences:
        """Between neighbours on the lines along `axis`, of the values or the `codes`."""


class Everywhere(Samples):
    """`values` (C, R, n, Q) in all the pixels."""

    def differences(self, axis: int, codes: bool = False) -> Differences:
        return _Dense(self.codes if codes and self.codes is not None else self.values, axis)


@dataclass(frozen=True)
class Scattered(Samples):
    """`values` (C, P, n) in some of the pixels, and `slot` (R, Q) int64, which of the P a pixel is, -1 for none."""

    slot: Tensor

    def differences(self, axis: int, codes: bool = False) -> Differences:
        return _Sparse(self.codes if codes and self.codes is not None else self.values, self.slot, axis)


class _Dense(Differences):
    def __init__(self, values: Tensor, axis: int) -> None:
        self.dim = 3 if axis == 0 else 1
        self.values, self.last = values, values.shape[self.dim] - 1
        self.whole = (values.narrow(self.dim, 1, self.last) - values.narrow(self.dim, 0, self.last)).abs_()
        self.size = self.whole.flatten(1)

    def pruned(self, times: float) -> Tensor:
        # two of four are below only if one of any three is; each pass over all takes as long as asking a cheap f
        least, inner = torch.zeros_like(self.whole), self.last - 3
        if inner > 0:
            two = torch.minimum(self.whole.narrow(self.dim, 0, self.last - 1), self.whole.narrow(self.dim, 1, self.last - 1))
            three = torch.minimum(two.narrow(self.dim, 0, inner + 1), self.whole.narrow(self.dim, 2, inner + 1)).mul_(times)
            least.narrow(self.dim, 3, inner).copy_(three.narrow(self.dim, 0, inner))
            right = least.narrow(self.dim, 0, inner)
            torch.maximum(right, three.narrow(self.dim, 1, inner), out=right)
        return (self.whole > least).flatten(1)

    def place(self, index: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        lines, cols = self.whole.shape[2:]
        return index // cols % lines, index // (cols * lines), index % cols

    def ends(self, index: Tensor) -> tuple[Tensor, Tensor]:
        line, row, col = self.place(index)
        along = self.dim == 3
        return self.values[:, row, line, col], self.values[:, row + (not along), line, col + along]

    def beside(self, index: Tensor, steps: Tensor) -> Tensor:
        lines, cols = self.whole.shape[2:]
        along, stride = (index % cols, 1) if self.dim == 3 else (index // (cols * lines), cols * lines)
        near = along[:, None] + steps
        return torch.where((near >= 0) & (near < self.last), index[:, None] + stride * steps, -1)


class _Sparse(Differences):
    def __init__(self, values: Tensor, slot: Tensor, axis: int) -> None:
        self.values, self.axis, self.lines = values, axis, values.shape[2]
        first, second = (slot[:, :-1], slot[:, 1:]) if axis == 0 else (slot[:-1], slot[1:])
        both = (first >= 0) & (second >= 0)
        self.row, self.col = both.nonzero().unbind(1)
        self.first, self.second = first[both], second[both]
        # one more pixel all around, in which there is none
        self.known = torch.full((slot.shape[0] + 2, slot.shape[1] + 2), -1, dtype=torch.int64, device=slot.device)
        self.known[self.row + 1, self.col + 1] = torch.arange(len(self.row), device=slot.device)
        self.size = (values[:, self.second] - values[:, self.first]).abs_().flatten(1)

    def place(self, index: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        pair = index // self.lines
        return index % self.lines, self.row[pair], self.col[pair]

    def ends(self, index: Tensor) -> tuple[Tensor, Tensor]:
        pair, line = index // self.lines, index % self.lines
        return self.values[:, self.first[pair], line], self.values[:, self.second[pair], line]

    def beside(self, index: Tensor, steps: Tensor) -> Tensor:
        line, row, col = self.place(index)
        height, width = self.known.shape
        down, right = (0 * steps, steps) if self.axis == 0 else (steps, 0 * steps)
        near_row, near_col = (row[:, None] + down + 1).clamp(0, height - 1), (col[:, None] + right + 1).clamp(0, width - 1)
        pair = self.known[near_row, near_col]
        return torch.where(pair >= 0, pair * self.lines + line[:, None], -1)


def scattered(ask: Ask, x: Tensor, y: Tensor, row: int, col: int, asked: Tensor, number: int, coded: bool = False) -> Scattered:
    """Evaluate f at the offsets x, y (n,) in the pixels of `asked`, bool (R, Q), the first of which is (row, col).

    coded: the last channel that is told is that of the codes.
    """
    at_row, at_col = asked.nonzero().unbind(1)
    values = ask((at_col + col)[:, None].add(x).flatten(), (at_row + row)[:, None].add(y).flatten()).unflatten(1, (-1, len(x)))
    slot = torch.full(asked.shape, -1, dtype=torch.int64, device=x.device)
    slot[at_row, at_col] = torch.arange(len(at_row), device=x.device)
    if coded:
        return Scattered(x, y, number, row, col, values[:-1], slot, codes=values[-1:])
    return Scattered(x, y, number, row, col, values, slot)


def weights(lines: Lines, filter: Filter, reach: int) -> Tensor:
    """(K, K, n): w of the samples of the pixels up to `reach` rows and columns off from a pixel's centre."""
    offsets = torch.arange(-reach, reach + 1, device=lines.x.device) - 0.5
    return filter(offsets[:, None] + lines.x, offsets[:, None, None] + lines.y)


def norm(lines: Lines, filter: Filter, reach: int) -> float:
    """What the weights of the samples about any pixel sum to: about `lines.count`, by which they are divided."""
    return float(weights(lines, filter, reach).sum())


def summed(samples: Scattered, filter: Filter, rows: Tensor, cols: Tensor, reach: int) -> Tensor:
    """(C, N) float64: the samples' weighted sums about the centres of the pixels (rows, cols), counted on the screen.

    filter: it is 0 more than `reach` pixels off, where all pixels were asked.
    """
    offsets, weight = torch.arange(-reach, reach + 1, device=rows.device), weights(samples, filter, reach).flatten(1)
    size = max(1, _AT_ONCE // weight.shape[1])
    parts = [_sums(samples, weight, offsets, *part) for part in zip(rows.split(size), cols.split(size), strict=True)]
    return torch.cat(parts, 1)


def _sums(samples: Scattered, weight: Tensor, offsets: Tensor, rows: Tensor, cols: Tensor) -> Tensor:
    """(C, N): the sums over the samples of the pixels around each, times the weights (taps, taps x n)."""
    columns = (cols - samples.col)[:, None] + offsets
    total = torch.zeros(len(samples.values), len(rows), dtype=torch.float64, device=rows.device)
    for k, offset in enumerate(offsets.tolist()):
        # the samples of one row of pixels
        near = samples.slot[(rows - samples.row + offset)[:, None], columns]
        for channel, values in enumerate(samples.values):
            # no product of matrices: its last bits may depend on the number of threads
            total[channel] += (values[near].flatten(1) * weight[k]).sum(1)
    return total
