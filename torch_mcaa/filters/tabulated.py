"""Filters given by samples."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from torch_mcaa.errors import McaaError
from torch_mcaa.filters.base import SeparableFilter
from torch_mcaa.filters.inverse import InverseTable
from torch_mcaa.filters.tabulated_grid import TabulatedGrid
from torch_mcaa.filters.validation import pixels

Samples = Tensor | np.ndarray | Sequence[float] | Sequence[Sequence[float]]


def Tabulated(samples: Samples, radius: float = 1.0) -> TabulatedProfile | TabulatedGrid:
    """A filter that interpolates `samples` linearly, normalised to integral 1 and 0 beyond `radius` pixels.

    samples: either (n,), a profile p with w = p(dx) p(dy), which gives a `TabulatedProfile`; or
        (rows, columns), w itself, rows downwards in dy and columns to the right in dx, bilinear in between,
        which gives a `TabulatedGrid`. At least two a side, at equally spaced positions, the first at -radius
        and the last at +radius: the spacing is 2 · radius / (n - 1). Where an outermost sample is not 0, w
        jumps to 0 at the border.

    Two filters made so are equal only if they are the same object. Raises McaaError for other shapes, for NaN
    or infinite samples, for an integral that is 0 (to 12 digits of ∫|w|) or overflows, and for a radius
    outside [1e-6, 1e6].
    """
    radius = pixels("Tabulated", "radius", radius, "pass the half-width in pixels, such as 1.0")
    try:
        array = samples.detach().to("cpu", torch.float64) if isinstance(samples, Tensor) else samples
        values = torch.tensor(np.asarray(array, dtype=np.float64))
    except (TypeError, ValueError, RuntimeError) as error:
        raise McaaError(
            f"Tabulated: samples must be an array of numbers; received {type(samples).__name__}: "
            "pass a 1-D profile or a 2-D grid of w"
        ) from error
    shape = tuple(values.shape)
    if len(shape) not in (1, 2) or min(shape) < 2:
        raise McaaError(
            f"Tabulated: samples must have shape (n,) or (rows, columns), at least 2 a side; "
            f"received {shape}: pass a profile or a grid of w over [-radius, radius]"
        )
    if not torch.isfinite(values).all():
        bad = int((~torch.isfinite(values)).sum())
        raise McaaError(f"Tabulated: samples must be finite; received {bad} NaN or infinite ones: replace or drop them")
    integral, size = values, values.abs()
    for n in reversed(shape):
        spacing = 2 * radius / (n - 1)
        integral, size = torch.trapezoid(integral, dx=spacing), torch.trapezoid(size, dx=spacing)
    if not torch.isfinite(size) or integral.abs() <= 1e-12 * size:
        raise McaaError(
            f"Tabulated: samples must have a finite integral other than 0; received {float(integral):g} "
            f"(absolute {float(size):g}): what blocks constants cannot be normalised, so change the samples"
        )
    return (TabulatedProfile if len(shape) == 1 else TabulatedGrid)(values / integral, radius)


class TabulatedProfile(SeparableFilter):
    """What `Tabulated` returns for a profile; it alone makes one, and checks and normalises `values`."""

    def __init__(self, values: Tensor, radius: float) -> None:
        self._values, self._half_width = values, radius
        self._spacing = 2 * radius / (len(values) - 1)
        left, right = values[:-1], values[1:]
        self._cdf = torch.cat([values.new_zeros(1), ((left + right) * (self._spacing / 2)).cumsum(0)])
        nodes = torch.linspace(-radius, radius, len(values), dtype=torch.float64)
        crossing = left * right < 0
        zeros = (nodes[:-1] + self._spacing * left / (left - right))[crossing]
        nodes, order = torch.cat([nodes, zeros]).sort(stable=True)
        density = torch.cat([values, torch.zeros_like(zeros)])[order]
        masses = (density[:-1] + density[1:]) / 2 * nodes.diff()
        self._table = InverseTable(nodes, density.abs(), masses)

    def __repr__(self) -> str:
        return f"Tabulated(<{len(self._values)} samples>, radius={self._half_width!r})"

    @property
    def half_width(self) -> float:
        return self._half_width

    @property
    def absolute_profile_integral(self) -> float:
        return self._table.total

    def _cell(self, d: Tensor) -> tuple[Tensor, Tensor]:
        last = len(self._values) - 1
        position = ((d + self._half_width) / self._spacing).clamp(0, last)
        # The second clamp is for NaN, whose conversion is any integer.
        cell = position.long().clamp(0, last - 1)
        return cell, position - cell

    def profile(self, d: Tensor) -> Tensor:
        cell, t = self._cell(d)
        values = self._values.to(d)
        return torch.where(d.abs() <= self._half_width, torch.lerp(values[cell], values[cell + 1], t), 0)

    def profile_cdf(self, d: Tensor) -> Tensor:
        cell, t = self._cell(d)
        values, cdf = self._values.to(d), self._cdf.to(d)
        left, right = values[cell], values[cell + 1]
        return cdf[cell] + self._spacing * t * (left + 0.5 * t * (right - left))

    def profile_sample(self, u: Tensor) -> tuple[Tensor, Tensor]:
        return self._table(u)
