"""Moments of a filter: what polynomials times w integrate to."""

from __future__ import annotations

import math
from collections.abc import Hashable
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from torch_mcaa.errors import McaaError
from torch_mcaa.filters.base import Filter, SeparableFilter
from torch_mcaa.filters.inverse import TableSampledFilter
from torch_mcaa.filters.tabulated import TabulatedProfile
from torch_mcaa.filters.tabulated_grid import TabulatedGrid

_NODES = 16
_WHOLE = 512
"""Whole pixels either side of the centre that are borders of panels."""
_OCTAVES = 40
_PARTS = 4


def moment(filter: Filter, i: int, j: int) -> float:
    """The integral of x^i y^j w(x, y) over the plane, x and y in pixels from the pixel's centre.

    By Gauss-Legendre rules on panels that end at 0, at whole pixels, at the nodes of tables, and where powers of two part the radius:
    within 1e-10 of the integral of |x^i y^j w| for the filters of this package; for a filter of your own that does not separate, as good
    as 8 nodes a panel are, some 4 panels an octave.

    Raises:
        McaaError: a filter of infinite radius, whose moments are not finite.
    """
    _check(filter)
    return _moment(filter, i, j) if isinstance(filter, Hashable) else _moment.__wrapped__(filter, i, j)


def variance(filter: Filter) -> tuple[float, float]:
    """The variances (x, y) in px^2 of the density |w| / integral of |w|, to the accuracy of `moment` (1e-4 of it for a grid with changes of sign).

    Raises:
        McaaError: a filter of infinite radius, whose moments are not finite.
    """
    _check(filter)
    return _variance(filter) if isinstance(filter, Hashable) else _variance.__wrapped__(filter)


def _check(filter: Filter) -> None:
    if math.isinf(max(filter.radius)):
        raise McaaError(f"the moments of {filter} are not finite, since its support is not; use one that ends, such as Lanczos(3)")


@lru_cache(256)
def _moment(filter: Filter, i: int, j: int) -> float:
    if isinstance(filter, SeparableFilter):
        x, weight = _rule(filter.half_width, _kinks(filter))
        values = weight * filter.profile(x)
        return float((values * x**i).sum() * (values * x**j).sum())
    dx, dy, values = _plane(filter)
    return float((values * dx**i * dy**j).sum())


@lru_cache(64)
def _variance(filter: Filter) -> tuple[float, float]:
    if isinstance(filter, SeparableFilter):
        x, weight = _rule(filter.half_width, _kinks(filter))
        along = _spread(x, weight * filter.profile(x).abs())
        return along, along
    dx, dy, values = _plane(filter)
    size = values.abs()
    return _spread(dx[0], size.sum(0)), _spread(dy[:, 0], size.sum(1))


def _spread(x: Tensor, mass: Tensor) -> float:
    mass = mass / mass.sum()
    return float((mass * (x - (mass * x).sum()).square()).sum())


def _kinks(filter: SeparableFilter) -> Tensor:
    """Where the profile, or its modulus, has no derivative, beside whole pixels."""
    if isinstance(filter, TabulatedProfile):
        return filter._table._cells[:, 0]
    return torch.tensor(filter.sign_changes if isinstance(filter, TableSampledFilter) else (), dtype=torch.float64)


def _plane(filter: Filter) -> tuple[Tensor, Tensor, Tensor]:
    """dx (1, n), dy (m, 1) and w times the weights of the rule (m, n)."""
    axes: list[tuple[Tensor, Tensor]] = []
    for axis, radius in enumerate(filter.radius):
        if isinstance(filter, TabulatedGrid):
            # bilinear in each of its cells: 4 nodes are exact up to x^6 y^6; several panels a cell are for the modulus, which has creases
            cells = filter._values.shape[1 - axis] - 1
            borders = torch.linspace(-radius, radius, cells * math.ceil(256 / cells) + 1, dtype=torch.float64)
            axes.append(_legendre(borders, 4))
        else:
            axes.append(_legendre(_borders(radius, torch.empty(0, dtype=torch.float64), 32, 6), 8))
    (dx, along), (dy, down) = axes
    return dx[None], dy[:, None], filter(dx[None], dy[:, None]) * along * down[:, None]


def _rule(radius: float, kinks: Tensor) -> tuple[Tensor, Tensor]:
    return _legendre(_borders(radius, kinks, _WHOLE, _OCTAVES), _NODES)


def _borders(radius: float, kinks: Tensor, whole: int, octaves: int) -> Tensor:
    """Borders of panels over [-radius, radius]: a filter much narrower than its radius has panels of its own size."""
    pixels = torch.arange(min(math.floor(radius), whole) + 1, dtype=torch.float64)
    powers = radius * 2.0 ** -torch.arange(octaves * _PARTS, dtype=torch.float64).div(_PARTS)
    half = torch.cat([pixels, powers])
    every = torch.cat([half, -half, kinks]).clamp(-radius, radius).unique()
    # a panel of rounding has no weight, but its nodes may lie outside the support
    return every[torch.cat([torch.tensor([True]), every.diff() > 1e-14 * radius])]


def _legendre(borders: Tensor, nodes: int) -> tuple[Tensor, Tensor]:
    """Positions and weights of the Gauss-Legendre rule of so many nodes on each panel."""
    x, weight = (torch.from_numpy(a) for a in np.polynomial.legendre.leggauss(nodes))
    width = borders.diff()[:, None] / 2
    return (borders[:-1, None] + width * (1 + x)).flatten(), (width * weight).flatten()
