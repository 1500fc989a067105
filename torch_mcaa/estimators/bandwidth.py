"""How many points a pixel a filter needs a lattice to have for an f of so high frequencies.

A tone of v cycles a pixel errs under a lattice by the filter's transform at v - g for its dual vectors g. So where the shortest of these is
longer than v + k it errs by less than the transform at k.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import torch
from torch import Tensor

from torch_mcaa.filters import SeparableFilter
from torch_mcaa.patterns.lattice_search import reduced_basis
from torch_mcaa.patterns.lattice_table import STRIPS

_FEWEST, _MOST = 3, 16
"""Points: higher tones miss the dual vectors of a smaller lattice as often as not, and two rounds tell."""
_NODES = 4096
_HIGHEST, _STEP = 16.0, 1 / 32
"""Cycles a pixel."""
_SURE = 3.0
"""How far below what is allowed the error is to be: two lattices have to show it."""
_WIDE = 3.0
"""How many times as wide as the filter the window is that tells a smooth f from one with detail between samples."""
_CUT = 4.5
"""Where it ends, in parts of how wide it is."""


class Bandwidth:
    """What a filter needs."""

    def __init__(self, filter: SeparableFilter) -> None:
        x = ((torch.arange(_NODES, dtype=torch.float64) + 0.5) / _NODES * 2 - 1) * filter.half_width
        profile = filter.profile(x).detach().cpu() * (2 * filter.half_width / _NODES)
        k = torch.arange(0, _HIGHEST, _STEP, dtype=torch.float64)
        transform = (torch.cos(2 * math.pi * k[:, None] * x) @ profile).abs()
        # what no higher tone exceeds
        self.above = transform.flip(0).cummax(0).values.flip(0)
        self.power = float((profile.square().sum() * (_NODES / (2 * filter.half_width))) ** 2)
        # as a normal density has it
        self.wide = _WIDE / math.sqrt(4 * math.pi * self.power)
        self.span = _CUT * self.wide
        x = x * (self.span / filter.half_width)
        window = self.window(x) / self.window(x).sum()
        one = float(window.square().sum()) * _NODES / (2 * self.span)
        self.std, self.told = 1 / (2 * math.sqrt(math.pi) * one), (self.power / one**2) ** 2 / 3

    def window(self, x: Tensor) -> Tensor:
        """A wide window along one axis, whose transform is nearly nothing at high frequencies; it ends smoothly at `span` px."""
        inside = (1 - (x / self.span).square()).clamp_min(0)
        return torch.exp(-0.5 * (x / self.wide).square()) * inside.square()

    def points(self, frequency: Tensor, std: Tensor, allowed: Tensor) -> Tensor:
        """(blocks,) int64: enough for tones of a `frequency` and of a standard deviation to err by no more than is `allowed`, (C, blocks).

        And no more than as many random points would need.
        """
        counts, lengths = _shortest()
        place = torch.searchsorted(lengths, self.length(frequency, std, allowed)).clamp_max(len(counts) - 1)
        random = (self.power / _allowed(allowed, std).square()).clamp(_FEWEST, _MOST).ceil().long()
        return torch.minimum(counts[place], random).amax(0)

    def margins(self, std: Tensor, allowed: Tensor) -> Tensor:
        """(2, C, blocks) cycles a pixel: how far a tone has to be from a lattice's dual vectors to err by no more than is `allowed`, and from the
        halves of these to be nothing under the wide window.
        """
        ratio = _allowed(allowed, std)
        leak = (ratio / math.sqrt(2 * self.told)).clamp(1e-30, 1)
        return torch.stack([self._beyond(ratio), (-leak.log() / 2).sqrt() / (math.pi * self.std)])

    def length(self, frequency: Tensor, std: Tensor, allowed: Tensor) -> Tensor:
        """Cycles a pixel: of a shortest dual vector that is surely enough for tones of a `frequency`."""
        return (frequency + self._beyond(_allowed(allowed, std) / _SURE)).nan_to_num(0.0)

    def _beyond(self, ratio: Tensor) -> Tensor:
        """Cycles a pixel beyond which the filter's transform is below a ratio."""
        return _STEP * (self.above[:, None, None] > ratio).sum(0)


def _allowed(allowed: Tensor, std: Tensor) -> Tensor:
    """What is allowed in parts of f's standard deviation: +inf where f is constant, were it 0 that nothing but a relative tolerance allows."""
    return torch.where(std > 0, allowed / std.clamp_min(1e-300), torch.inf)


@cache
def _shortest() -> tuple[Tensor, Tensor]:
    """Numbers of points a pixel, and the length of the shortest dual vector that the best lattice of up to so many has."""
    lengths, best = {}, 0.0
    for spp in range(1, _MOST + 1):
        period, count, generator = STRIPS[spp]
        best = max(
            best, float(np.linalg.norm(reduced_basis(np.array([1.0, -generator / period]), np.array([0.0, count / period]))[0]))
        )
        if spp >= _FEWEST:
            lengths[spp] = best
    return torch.tensor(list(lengths)), torch.tensor(list(lengths.values()), dtype=torch.float64)
