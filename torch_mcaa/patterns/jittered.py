"""One uniform point in each cell of a grid."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import final

import torch
from torch import Tensor

from torch_mcaa.patterns.base import Pattern, check_count, check_points, clamp_below_one, independent_variance, jitter

__all__ = ["Jittered"]

_STREAM = 0x6A697474


@final
@dataclass(frozen=True)
class Jittered(Pattern):
    """One uniform point in each of a b equal cells, a rows by b columns, in row-major order.

    Counts are the products n = a b with a <= b <= 2 a: 1, 2, 4, 6, 8, 9, 12, 15, 16, 18, 20, ... Error
    n**-0.75 across an edge, n**-1 for smooth f.
    """

    def count(self, n: int) -> int:
        rows, columns = strata(n)
        return rows * columns

    def points(
        self, n: int, rows: Tensor, cols: Tensor, *, seed: int, round: int, dtype: torch.dtype = torch.float32
    ) -> tuple[Tensor, Tensor]:
        check_points(self, n, rows, cols, dtype)
        height, width = strata(n)
        u, v = jitter(_STREAM, n, rows, cols, seed, round, dtype)
        index = torch.arange(n, device=rows.device)[:, None, None]
        u.add_(index % width).div_(width)
        v.add_(index // width).div_(height)
        return clamp_below_one(u), clamp_below_one(v)

    def variance(self, terms: Tensor, u: Tensor, v: Tensor) -> Tensor:
        """`curvature_variance` over the grid.

        Measured with the box filter on 4,096 each of half-planes and discs (edges), quadratics, blobs and tones
        (smooth): mean reported over true variance, and coverage of the 95 % interval.

            n       4          8          16         64         256
            edges   1.5  .66   1.5  .81   1.8  .91   1.6  .97   1.5  .98
            smooth  2.9  .94   2.3  .97   2.2  .98   1.5  .98   1.2  .97
        """
        return curvature_variance(terms.unflatten(0, strata(len(terms))))


def strata(n: int) -> tuple[int, int]:
    """(rows, columns) with rows <= columns <= 2 rows and the largest product <= n; the squarest of those."""
    check_count(n)
    shapes = [(a, min(n // a, 2 * a)) for a in range(1, math.isqrt(n) + 1)]
    _, rows, columns = max([(a * b, a, b) for a, b in shapes])
    return rows, columns


def neighbour_variance(cells: Tensor) -> Tensor:
    """n / 2 times the mean squared difference of the terms of neighbouring cells, (rows, columns, ...); +inf for one cell.

    With independent points E(t - t')**2 / 2 is the mean variance of the two cells plus half the squared
    difference of their means: too large where f has a gradient, and hardly ever too small.
    """
    height, width = cells.shape[:2]
    n = height * width
    if n == 1:
        return torch.full_like(cells[0, 0], torch.inf)
    squares = cells.diff(dim=0).square_().sum((0, 1)) + cells.diff(dim=1).square_().sum((0, 1))
    return squares.mul_(n / 2 / (2 * n - height - width))


def curvature_variance(cells: Tensor) -> Tensor:
    """n / 6 times the mean squared second difference along the rows and columns of n cells, (rows, columns, ...).

    Where a row or column begins and ends a first difference stands in, so the sum of squares of m white terms is 6 m - 8, and only
    equal terms give 0. +inf for one cell. A gradient that is the same in three cells is no error here, unlike in `neighbour_variance`.
    """
    height, width = cells.shape[:2]
    if height == width == 1:
        return torch.full_like(cells[0, 0], torch.inf)
    squares, weight = torch.zeros_like(cells[0, 0]), 0
    for lines in (cells, cells.transpose(0, 1)):
        if len(lines) > 1:
            steps = lines.diff(dim=0)
            squares += steps.diff(dim=0).square_().sum((0, 1)) + (steps[0].square() + steps[-1].square()).sum(0)
            weight += (6 * len(lines) - 8) * lines.shape[1]
    return squares.mul_(height * width / weight)


def steepness(terms: Tensor, u: Tensor, v: Tensor) -> Tensor:
    """log2 |g_u / g_v| of the first moments g of the terms about the points' mean, times 5 R**2 if that is below 1; 0 for equal terms.

    R**2 is the share of the terms' squares that a plane through them explains: 3/4 for an upright edge through the middle. Where it is
    small, as for a disc or a line inside the square, the ratio says nothing about where f is steep.
    """
    along_u, along_v = ((terms * (x - x.mean(0))).sum(0).square_() for x in (u, v))
    explained = (along_u + along_v) * (12 / len(terms)) / independent_variance(terms)
    return (along_u.log2_() - along_v.log2_()).mul_((5 * explained).clamp_(max=1)).div_(2).nan_to_num_(nan=0.0)


def choice_factor(n: int) -> float:
    """What makes good that cells chosen by `steepness` show too little of white noise: 1 + (2 / n)**2, n >= 4.

    Measured on normal terms, reported over true variance of `Sobol` and `MultiJittered` without it and with it: .80 to .83 and 1.00 to
    1.04 at n = 4, .92 and .97 to .99 at 8, .98 and 1.00 at 16, 1.00 from 32 on.
    """
    return 1 + (2 / n) ** 2
