"""Piecewise constant densities on a grid of bins; the functions below the class serve many histograms at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from torch_mcaa.densities.base import Density
from torch_mcaa.densities.mixture import choose, invert, running_sums
from torch_mcaa.errors import McaaError
from torch_mcaa.filters.validation import pixels


@dataclass(frozen=True, init=False, repr=False)
class Histogram(Density):
    """A density constant on each of R x C equal bins over [-rx, rx] x [-ry, ry], where radius = (rx, ry) in px.

    values: (R, C) nonnegative numbers, a nested sequence, an array or a tensor, proportional to the masses of the bins;
        rows downwards in dy, columns to the right in dx. Kept normalised to sum 1.
    radius: the half-width in px, or two: (x, y).

    dy grows with v, dx with u while v is held. A point on an edge between bins has the density of the one right of it or
    below it. Raises McaaError for values of another shape, negative or not finite or all 0, and for a radius outside
    [1e-6, 1e6].
    """

    values: tuple[tuple[float, ...], ...]
    _radius: tuple[float, float]
    _masses: Tensor = field(compare=False)

    def __init__(self, values: Tensor | np.ndarray | Sequence[Sequence[float]], radius: float | tuple[float, float]) -> None:
        pair = radius if isinstance(radius, tuple) and len(radius) == 2 else (radius, radius)
        rx, ry = (pixels("Histogram", "radius", r, "pass the half-width in pixels, such as 1.0, or two: (x, y)") for r in pair)
        masses = _normalised(values)
        object.__setattr__(self, "values", tuple(map(tuple, masses.tolist())))
        object.__setattr__(self, "_radius", (rx, ry))
        # Kept, since a large table is slow to make of Python's numbers at every call.
        object.__setattr__(self, "_masses", masses)

    def __repr__(self) -> str:
        rows, columns = self._masses.shape
        return f"Histogram(<{rows}x{columns} values>, radius={self._radius!r})"

    @property
    def radius(self) -> tuple[float, float]:
        return self._radius

    def sample(self, u: Tensor, v: Tensor) -> tuple[Tensor, Tensor]:
        u, v = torch.broadcast_tensors(u, v)
        row, column, y, x = _draw(self._masses.to(u.device), u.reshape(-1), v.reshape(-1))
        edges_x, edges_y = self._edges(u.device)
        dx, dy = _place(column, x, edges_x, u.dtype), _place(row, y, edges_y, v.dtype)
        return dx.reshape(u.shape), dy.reshape(u.shape)

    def pdf(self, dx: Tensor, dy: Tensor) -> Tensor:
        (rx, ry), (rows, columns) = self._radius, self._masses.shape
        edges_x, edges_y = self._edges(dx.device)
        heights = (self._masses * (rows * columns / (4 * rx * ry))).to(dx)
        inside = (dx.abs() <= rx) & (dy.abs() <= ry)
        return torch.where(inside, heights[_bin(dy, edges_y), _bin(dx, edges_x)], 0)

    def _edges(self, device: torch.device) -> tuple[Tensor, Tensor]:
        (rx, ry), (rows, columns) = self._radius, self._masses.shape
        return _edges(-rx, rx, columns, device), _edges(-ry, ry, rows, device)


def sample_bins(masses: Tensor, u: Tensor, v: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Draw points of histograms on the unit square: the row by v, the column by u within that row.

    masses: (R, C, *S) float64, nonnegative, of sum 1 over the first two dims. u, v: (n, *S) in [0, 1).
    Returns x, y (n, *S) in [0, 1), of u's dtype, and the density there, relative to the uniform one: the mass of the bin
    times R C, in float64, never 0. y grows with v, and x with u while v is held.
    """
    rows, columns, *_ = masses.shape
    row, column, y, x = _draw(masses, u, v)
    density = masses.flatten(0, 1).gather(0, row * columns + column) * (rows * columns)
    x = _place(column, x, _edges(0, 1, columns, u.device), u.dtype)
    return x, _place(row, y, _edges(0, 1, rows, v.device), v.dtype), density


def bin_density(masses: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """The density of `sample_bins` at x, y (n, *S) in [0, 1): at its own points, what it returned; float64."""
    rows, columns, *_ = masses.shape
    row, column = _bin(y, _edges(0, 1, rows, y.device)), _bin(x, _edges(0, 1, columns, x.device))
    return masses.flatten(0, 1).gather(0, row * columns + column) * (rows * columns)


def _draw(masses: Tensor, u: Tensor, v: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """The row and the column, and the positions in [0, 1] within them, along y and x, in float64."""
    columns = masses.shape[1]
    row, y = choose(masses.sum(1), v.double())
    column, x = invert(running_sums(masses, 1).flatten(0, 1), row * (columns + 1), columns, u.double())
    return row, column, y, x


def _edges(low: float, high: float, count: int, device: torch.device) -> Tensor:
    return torch.linspace(low, high, count + 1, dtype=torch.float64, device=device)


def _place(index: Tensor, inside: Tensor, edges: Tensor, dtype: torch.dtype) -> Tensor:
    left = edges.take(index)
    at = (left + inside * (edges.take(index + 1) - left)).to(dtype)
    # Rounded to dtype it may meet the right edge, where the next bin begins, whose density may be 0.
    right = edges.to(dtype)
    return torch.minimum(at, torch.nextafter(right, torch.full_like(right, -torch.inf)).take(index + 1))


def _bin(at: Tensor, edges: Tensor) -> Tensor:
    edges, last = edges.to(at.dtype), len(edges) - 2
    # By rounding at most one off, which the edges put right: a fifth of the time of torch.bucketize.
    guess = ((at - edges[0]) * ((last + 1) / (edges[-1] - edges[0]))).long().clamp(0, last)
    return guess.add(at < edges.take(guess), alpha=-1).add(at >= edges.take(guess + 1)).clamp(0, last)


def _normalised(values: object) -> Tensor:
    mend = "pass the masses of the bins as R rows of C numbers"
    try:
        array = np.asarray(values.detach().cpu().tolist() if isinstance(values, Tensor) else values)
    except (TypeError, ValueError) as error:
        raise McaaError(f"Histogram: values must be a table of numbers; received {values!r}: {mend}") from error
    if array.dtype.kind not in "biuf":
        raise McaaError(f"Histogram: values must be a table of numbers; received {values!r}: {mend}")
    if array.ndim != 2 or 0 in array.shape:
        raise McaaError(f"Histogram: values must have shape (rows, columns); received {array.shape}: {mend}")
    masses = torch.tensor(array, dtype=torch.float64)
    bad = ~((masses >= 0) & masses.isfinite())
    if bad.any():
        raise McaaError(f"Histogram: values must be nonnegative and finite; received {float(masses[bad][0])!r}: {mend}")
    if not masses.any():
        raise McaaError(f"Histogram: values must not be all 0; received {array.size} zeros: {mend}, at least one of them positive")
    # Divided by the largest first, lest the sum overflow.
    masses = masses / masses.max()
    return masses / masses.sum()
