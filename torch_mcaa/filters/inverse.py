"""Sampling by a tabulated inverse CDF."""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass, field, fields

import torch
from torch import Tensor

from torch_mcaa.filters.base import SeparableFilter

_CELLS = 1024
_BUCKETS = 2**14


def linear_inverse(fraction: Tensor, start: Tensor, end: Tensor) -> Tensor:
    """Inverse CDF on [0, 1] of a density linear from `start` to `end`, both >= 0 and of any scale."""
    # The usual root of the quadratic, rationalised: nothing cancels, whichever end is the larger.
    root = torch.sqrt(torch.lerp(start * start, end * end, fraction))
    return fraction * (start + end) / (start + root).clamp_min(torch.finfo(fraction.dtype).tiny)


class InverseTable:
    """Inverse CDF of a density that is linear between nodes, and the sign that each cell carries.

    nodes (n+1,) increasing positions; density (n+1,) >= 0 at them, up to a factor a cell; masses (n,) signed
    integrals over the cells, whose absolute values are the probabilities of the cells, up to a common factor.
    Float64 CPU tensors. `total` is the sum of |masses|.
    """

    def __init__(self, nodes: Tensor, density: Tensor, masses: Tensor) -> None:
        cdf = torch.cat([masses.new_zeros(1), masses.abs().cumsum(0)])
        self.total = float(cdf[-1])
        cdf = cdf / cdf[-1]
        # One row a cell, so that a lookup touches one stretch of memory.
        columns = [nodes[:-1], nodes[1:], density[:-1], density[1:], cdf[:-1], cdf[1:], torch.sign(masses)]
        self._cells = torch.stack(columns, dim=1)
        # The cell at the left end of each of _BUCKETS equal parts of [0, 1): with it the search has a few
        # steps without branches, a third of the time of torch.searchsorted. _BUCKETS is a power of 2 so that
        # the ends of the parts are exact in every dtype, which keeps rounding the CDF from moving it past
        # them.
        ends = torch.arange(_BUCKETS + 1, dtype=torch.float64) / _BUCKETS
        first = torch.searchsorted(cdf, ends, right=True) - 1
        self._steps = int(first.diff().max()).bit_length()
        self._first = first[:-1]
        self._cdf = torch.cat([cdf, cdf.new_full((2**self._steps,), 2.0)])

    def __call__(self, u: Tensor) -> tuple[Tensor, Tensor]:
        """u in [0, 1) of any shape -> (position, sign), of u's shape, dtype and device."""
        flat = u.reshape(-1)
        cdf = self._cdf.to(u)
        bucket = (flat * _BUCKETS).long().clamp(0, _BUCKETS - 1)
        cell = self._first.to(u.device).index_select(0, bucket)
        for step in range(self._steps - 1, -1, -1):
            ahead = cell + 2**step
            cell = torch.where(cdf.index_select(0, ahead) <= flat, ahead, cell)
        cell = cell.clamp_max(len(self._cells) - 1)
        left, right, start, end, below, above, sign = self._cells.to(u).index_select(0, cell).unbind(1)
        fraction = ((flat - below) / (above - below)).clamp(0, 1)
        position = torch.lerp(left, right, linear_inverse(fraction, start, end))
        return torch.minimum(position, right).reshape(u.shape), sign.reshape(u.shape)


@dataclass(frozen=True)
class TableSampledFilter(SeparableFilter):
    """A profile whose CDF is known in closed form but has no closed inverse.

    |profile| is sampled through its linear interpolant on at least 256 cells a pixel, whose masses are exact
    and whose nodes include every change of sign, so that signs and weights are exact. What is left is an
    error of the fourth order in the width of a cell: below 1e-8 of the moments, in float64. The table is made
    with the filter and left out of pickles.
    """

    _table: InverseTable = field(init=False, repr=False, compare=False)

    @property
    @abstractmethod
    def sign_changes(self) -> tuple[float, ...]:
        """Every position inside the support where the profile changes sign; others may be among them."""

    def __post_init__(self) -> None:
        # Not lazily: torch.compile cannot trace the lock of functools.cached_property.
        cells = _CELLS * max(1, math.ceil(self.half_width / 2))
        grid = torch.linspace(-self.half_width, self.half_width, cells + 1, dtype=torch.float64)
        nodes = torch.unique(torch.cat([grid, grid.new_tensor(self.sign_changes)]))
        table = InverseTable(nodes, self.profile(nodes).abs(), self.profile_cdf(nodes).diff())
        object.__setattr__(self, "_table", table)

    def __reduce__(self) -> tuple[type, tuple[object, ...]]:
        return type(self), tuple(getattr(self, f.name) for f in fields(self) if f.init)

    @property
    def absolute_profile_integral(self) -> float:
        return self._table.total

    def profile_sample(self, u: Tensor) -> tuple[Tensor, Tensor]:
        return self._table(u)
