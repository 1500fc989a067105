"""A filter that is bilinear on a regular grid, not separable."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_mcaa.filters.base import Filter
from torch_mcaa.filters.gauss import legendre
from torch_mcaa.filters.inverse import InverseTable, linear_inverse


class TabulatedGrid(Filter):
    """What `Tabulated` returns for a grid; it alone makes one, and checks and normalises `values` first.

    The one filter whose |weight| is not constant: the points are drawn from q / ∫∫q, with q the bilinear
    interpolant of the |samples|. q is |w| where the four samples about a point have one sign and exceeds it
    elsewhere, so the weight w/pdf is ±∫∫q there and smaller elsewhere: unbiased, and bounded by ∫∫q.
    """

    separable = False

    def __init__(self, values: Tensor, radius: float) -> None:
        rows, columns = values.shape
        self._radius = radius
        self._spacing_y, self._spacing_x = 2 * radius / (rows - 1), 2 * radius / (columns - 1)
        self._values = values
        sizes = values.abs()
        self._row_cdfs = torch.cat(
            [values.new_zeros(rows, 1), ((sizes[:, :-1] + sizes[:, 1:]) * (self._spacing_x / 2)).cumsum(1)],
            dim=1,
        )
        row_masses = self._row_cdfs[:, -1]
        heights = torch.linspace(-radius, radius, rows, dtype=torch.float64)
        bands = (row_masses[:-1] + row_masses[1:]) * (self._spacing_y / 2)
        self._marginal = InverseTable(heights, row_masses, bands)
        self._absolute_integral = _mean_absolute(values).sum().item() * self._spacing_x * self._spacing_y

    def __repr__(self) -> str:
        rows, columns = self._values.shape
        return f"Tabulated(<{rows}x{columns} samples>, radius={self._radius!r})"

    @property
    def radius(self) -> tuple[float, float]:
        return self._radius, self._radius

    @property
    def absolute_integral(self) -> float:
        return self._absolute_integral

    def __call__(self, dx: Tensor, dy: Tensor) -> Tensor:
        return self._interpolate(self._values.to(dx), dx, dy)

    def beyond(self, dx: Tensor, dy: Tensor, axis: int) -> Tensor:
        values, spacing = (self._values, self._spacing_x) if axis == 0 else (self._values.T, self._spacing_y)
        along, across = (dx, dy) if axis == 0 else (dy, dx)
        rows, columns = values.shape
        # of each row the integral from a sample on, and half the samples' spacing times what they are
        half = values * (spacing / 2)
        rest = torch.cat([(half[:, :-1] + half[:, 1:]).flip(1).cumsum(1).flip(1), half.new_zeros(rows, 1)], 1).to(dx)
        half, (column, s) = half.to(dx), _cell(along, self._radius, spacing, columns)

        def of(row: Tensor) -> Tensor:
            # to the next sample
            end = torch.lerp(half[row, column], half[row, column + 1], s)
            return rest[row, column + 1] + (1 - s) * (end + half[row, column + 1])

        row, t = _cell(across, self._radius, 2 * self._radius / (rows - 1), rows)
        return torch.where((across.abs() <= self._radius) & (along < self._radius), torch.lerp(of(row), of(row + 1), t), 0)

    def pdf(self, dx: Tensor, dy: Tensor) -> Tensor:
        """The bilinear interpolant q of the |samples|, divided by its integral: see the class."""
        return self._interpolate(self._values.to(dx).abs(), dx, dy) / self._marginal.total

    def sample(self, u: Tensor, v: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        dy, _ = self._marginal(v)
        dx = self._sample_row(u, dy)
        values = self._values.to(u)
        bound = self._interpolate(values.abs(), dx, dy)
        # Only a u or v of exactly 0 can end on a border where q is 0.
        weight = self._interpolate(values, dx, dy) / torch.where(bound > 0, bound, 1) * self._marginal.total
        return dx, dy, weight

    def _sample_row(self, u: Tensor, dy: Tensor) -> Tensor:
        """Invert the CDF of q(·, dy), which is linear in dy between those of the two rows about it."""
        rows, columns = self._values.shape
        row, t = _cell(dy, self._radius, self._spacing_y, rows)
        cdfs, sizes = self._row_cdfs.to(u), self._values.to(u).abs()

        def between_rows(table: Tensor, column: Tensor) -> Tensor:
            return torch.lerp(table[row, column], table[row + 1, column], t)

        low = torch.zeros_like(row)
        high = torch.full_like(row, columns - 1)
        target = u * between_rows(cdfs, high)
        for _ in range((columns - 1).bit_length()):
            middle = (low + high) // 2
            right = between_rows(cdfs, middle) <= target
            low, high = torch.where(right, middle, low), torch.where(right, high, middle)
        column = low.clamp_max(columns - 2)
        below, above = between_rows(cdfs, column), between_rows(cdfs, column + 1)
        tiny = torch.finfo(u.dtype).tiny
        fraction = ((target - below) / (above - below).clamp_min(tiny)).clamp(0, 1)
        inside = linear_inverse(fraction, between_rows(sizes, column), between_rows(sizes, column + 1))
        return ((column + inside) * self._spacing_x - self._radius).clamp(-self._radius, self._radius)

    def _interpolate(self, values: Tensor, dx: Tensor, dy: Tensor) -> Tensor:
        rows, columns = values.shape
        row, t = _cell(dy, self._radius, self._spacing_y, rows)
        column, s = _cell(dx, self._radius, self._spacing_x, columns)
        above = torch.lerp(values[row, column], values[row, column + 1], s)
        below = torch.lerp(values[row + 1, column], values[row + 1, column + 1], s)
        inside = (dx.abs() <= self._radius) & (dy.abs() <= self._radius)
        return torch.where(inside, torch.lerp(above, below, t), 0)


def _cell(d: Tensor, radius: float, spacing: float, samples: int) -> tuple[Tensor, Tensor]:
    position = ((d + radius) / spacing).clamp(0, samples - 1)
    # The second clamp is for NaN, whose conversion is any integer.
    cell = position.long().clamp(0, samples - 2)
    return cell, position - cell


def _mean_absolute(values: Tensor) -> Tensor:
    """Mean of |bilinear interpolant| over each cell.

    Along y it has a closed form in the values p, q at the ends, |p + q|/2 or (p² + q²) / 2|p - q|; p and q
    are linear in x, so between their zeros a Gauss rule of 24 nodes does the rest.
    """
    top_left, top_right = values[:-1, :-1], values[:-1, 1:]
    low_left, low_right = values[1:, :-1], values[1:, 1:]

    def zero(left: Tensor, right: Tensor) -> Tensor:
        crosses = left * right < 0
        return torch.where(crosses, left / torch.where(crosses, left - right, 1), 0)

    breaks = [
        torch.zeros_like(top_left),
        zero(top_left, top_right),
        zero(low_left, low_right),
        torch.ones_like(top_left),
    ]
    edges = torch.stack(breaks).sort(dim=0).values
    total = torch.zeros_like(top_left)
    for node, weight in zip(*(t.tolist() for t in legendre(torch.tensor([0.0, 1.0], dtype=torch.float64), 24)), strict=True):
        x = edges[:-1] + edges.diff(dim=0) * node
        p, q = torch.lerp(top_left, top_right, x), torch.lerp(low_left, low_right, x)
        opposite = p * q < 0
        split = (p * p + q * q) / (2 * torch.where(opposite, p - q, 1).abs())
        height = torch.where(opposite, split, (p + q).abs() / 2)
        total = total + (height * edges.diff(dim=0)).sum(0) * weight
    return total
