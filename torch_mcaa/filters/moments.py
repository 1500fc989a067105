"""Moments of a filter: what polynomials times w integrate to."""

from __future__ import annotations

import math
from collections.abc import Hashable
from functools import lru_cache

import torch
from torch import Tensor

from torch_mcaa.errors import McaaError
from torch_mcaa.filters.base import Filter, SeparableFilter
from torch_mcaa.filters.gauss import legendre
from torch_mcaa.filters.quadrature import borders, rule
from torch_mcaa.filters.tabulated_grid import TabulatedGrid


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
        x, weight = rule(filter)
        values = weight * filter.profile(x)
        return float((values * x**i).sum() * (values * x**j).sum())
    dx, dy, values = _plane(filter)
    return float((values * dx**i * dy**j).sum())


@lru_cache(64)
def _variance(filter: Filter) -> tuple[float, float]:
    if isinstance(filter, SeparableFilter):
        x, weight = rule(filter)
        along = _spread(x, weight * filter.profile(x).abs())
        return along, along
    dx, dy, values = _plane(filter)
    size = values.abs()
    return _spread(dx[0], size.sum(0)), _spread(dy[:, 0], size.sum(1))


def _spread(x: Tensor, mass: Tensor) -> float:
    mass = mass / mass.sum()
    return float((mass * (x - (mass * x).sum()).square()).sum())


def _plane(filter: Filter) -> tuple[Tensor, Tensor, Tensor]:
    """dx (1, n), dy (m, 1) and w times the weights of the rule (m, n)."""
    axes: list[tuple[Tensor, Tensor]] = []
    for axis, radius in enumerate(filter.radius):
        if isinstance(filter, TabulatedGrid):
            # bilinear in each of its cells: 4 nodes are exact up to x^6 y^6; several panels a cell are for the modulus, which has creases
            cells = filter._values.shape[1 - axis] - 1
            ends = torch.linspace(-radius, radius, cells * math.ceil(256 / cells) + 1, dtype=torch.float64)
            axes.append(legendre(ends, 4))
        else:
            axes.append(legendre(borders(radius, torch.empty(0, dtype=torch.float64), 32, 6), 8))
    (dx, along), (dy, down) = axes
    return dx[None], dy[:, None], filter(dx[None], dy[:, None]) * along * down[:, None]
