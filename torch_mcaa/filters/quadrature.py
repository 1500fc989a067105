"""Rules for integrals against a profile: panels on which it is smooth."""

from __future__ import annotations

import math
from collections.abc import Hashable
from functools import lru_cache

import torch
from torch import Tensor

from torch_mcaa.filters.base import SeparableFilter
from torch_mcaa.filters.gauss import legendre
from torch_mcaa.filters.inverse import TableSampledFilter
from torch_mcaa.filters.tabulated import TabulatedProfile

WHOLE, OCTAVES, NODES = 512, 40, 16
"""Whole pixels either side of the centre that are borders of panels, octaves of the radius, and nodes a panel, of `rule`."""
_PARTS = 4
FEW = 10
"""Nodes on each of `panels`."""
_EXACT, _AHEAD = 1e-15, 8


def kinks(filter: SeparableFilter) -> Tensor:
    """Where the profile, or its modulus, has no derivative, beside whole pixels."""
    if isinstance(filter, TabulatedProfile):
        return filter._table._cells[:, 0]
    return torch.tensor(filter.sign_changes if isinstance(filter, TableSampledFilter) else (), dtype=torch.float64)


def borders(radius: float, kinks: Tensor, whole: int, octaves: int) -> Tensor:
    """Borders of panels over [-radius, radius]: a filter much narrower than its radius has panels of its own size."""
    pixels = torch.arange(min(math.floor(radius), whole) + 1, dtype=torch.float64)
    powers = radius * 2.0 ** -torch.arange(octaves * _PARTS, dtype=torch.float64).div(_PARTS)
    half = torch.cat([pixels, powers])
    every = torch.cat([half, -half, kinks]).clamp(-radius, radius).unique()
    # a panel of rounding has no weight, but its nodes may lie outside the support
    return every[torch.cat([torch.tensor([True]), every.diff() > 1e-14 * radius])]


def rule(filter: SeparableFilter) -> tuple[Tensor, Tensor]:
    """Positions and weights of a rule for smooth functions times a profile of finite half-width, or its modulus."""
    return legendre(borders(filter.half_width, kinks(filter), WHOLE, OCTAVES), NODES)


def panels(filter: SeparableFilter) -> Tensor:
    """Borders of few panels over a finite support on which rules of FEW nodes are right for the profile, and for it times a cubic."""
    return _panels(filter) if isinstance(filter, Hashable) else _panels.__wrapped__(filter)


@lru_cache(64)
def _panels(filter: SeparableFilter) -> Tensor:
    """As long as can be, from the left, of the panels of `rule`: a longer one has to come to what its parts do."""

    def integrals(borders: Tensor, nodes: int) -> Tensor:
        """(3, panels) of the profile, and of it times the first and the third power."""
        x, weight = legendre(borders, nodes)
        mass, place = weight * filter.profile(x), x / filter.half_width
        return torch.stack([mass, mass * place, mass * place**3]).view(3, -1, nodes).sum(-1)

    fine = borders(filter.half_width, kinks(filter), WHOLE, OCTAVES)
    parts = integrals(fine, NODES)
    allowed = _EXACT * float(parts[0].abs().sum())
    chosen = [0]
    while chosen[-1] < len(fine) - 1:
        first, last = chosen[-1], chosen[-1] + 1
        for ahead in (_AHEAD, len(fine)):
            ends = fine[first + 1 : first + 1 + ahead]
            tried = torch.stack([fine[first].expand_as(ends), ends], 1).flatten()
            found = integrals(tried, FEW)[:, ::2]
            off = (found - parts[:, first : first + ahead].cumsum(1)).abs().amax(0)
            good = (off <= allowed).nonzero().flatten()
            last = max(last, first + 1 + int(good[-1]) if len(good) else 0)
            if last < first + ahead:
                break
        chosen.append(last)
    return fine[chosen]
