"""Samples on horizontal and vertical lines over a rectangle of the screen: one rank-1 lattice is both.

The n points (g i / n, i / n) of a lattice of period 1 lie on n horizontal lines a pixel, and, g and n having no common divisor, on n vertical
ones; along either the samples are h = 1 px apart.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

Ask = Callable[[Tensor, Tensor], Tensor]
"""f at float64 screen columns and rows (N,): its values (C, N)."""


@dataclass(frozen=True)
class Samples:
    """f at the points of a lattice in the pixels [row, row + R) x [col, col + Q).

    Attributes:
        x, y: (n,) float64 offsets in [0, 1) of the points in every pixel.
        values: (C, R, n, Q), 0 where not asked.
        asked: bool (R, Q), the pixels in which f was evaluated.
        number: which of the lattices of a cell this is; random numbers hang on it.
    """

    x: Tensor
    y: Tensor
    row: int
    col: int
    values: Tensor
    asked: Tensor
    number: int

    @property
    def count(self) -> int:
        """Points, and lines along either axis, in a pixel."""
        return len(self.x)


def sample(ask: Ask, x: Tensor, y: Tensor, row: int, col: int, asked: Tensor, number: int) -> Samples:
    """Evaluate f at the offsets x, y (n,) in the pixels of `asked`, bool (R, Q), the first of which is (row, col)."""
    at_row, at_col = asked.nonzero().unbind(1)
    found = ask((at_col + col)[:, None].add(x).flatten(), (at_row + row)[:, None].add(y).flatten()).unflatten(1, (-1, len(x)))
    values = found.new_zeros(len(found), asked.shape[0], len(x), asked.shape[1])
    values[:, at_row, :, at_col] = found.transpose(0, 1)
    return Samples(x, y, row, col, values, asked, number)


def taps(profile: Callable[[Tensor], Tensor], places: Tensor, reach: int) -> Tensor:
    """(n, 2 reach + 1): the filter along one axis at the offsets `places` in the pixels up to `reach` off, from a pixel's centre."""
    return profile(places[:, None] + torch.arange(-reach, reach + 1, device=places.device) - 0.5)


def norm(samples: Samples, profile: Callable[[Tensor], Tensor], reach: int) -> float:
    """What the weights of the samples about any pixel sum to: about `samples.count`, by which they are divided."""
    wx, wy = (taps(profile, place, reach).sum(1) for place in (samples.x, samples.y))
    return float((wx * wy).sum())


def weighed(samples: Samples, profile: Callable[[Tensor], Tensor], rows: Tensor, cols: Tensor, reach: int) -> Tensor:
    """(C, N) float64: the samples' weighted means about the centres of the pixels (rows, cols), counted on the screen.

    profile: the filter along either axis; it is 0 more than `reach` pixels off.
    """
    wx, wy = (taps(profile, place, reach) for place in (samples.x, samples.y))
    offsets = torch.arange(-reach, reach + 1, device=rows.device)
    columns = (cols - samples.col)[:, None] + offsets
    total = torch.zeros(len(samples.values), len(rows), dtype=torch.float64, device=rows.device)
    for k, offset in enumerate(offsets.tolist()):
        # the samples of one row of pixels, (N, taps, C, n)
        near = samples.values[:, (rows - samples.row + offset)[:, None], :, columns].to(torch.float64)
        total += torch.einsum("tkcj,jk,j->ct", near, wx, wy[:, k])
    return total / norm(samples, profile, reach)
