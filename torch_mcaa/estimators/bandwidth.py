"""How many points a pixel a lattice needs for f, as far as its steepness tells: how f changes over a thirty-second of a pixel.

A tone of v cycles a pixel errs under a lattice by the filter's transform at v - g for its dual vectors g. So where the shortest of these is
longer than v + k it errs by less than the transform at k.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import torch
from torch import Tensor

from torch_mcaa import rng
from torch_mcaa.estimators.blocks import BLOCK
from torch_mcaa.estimators.counted import Counted
from torch_mcaa.filters import SeparableFilter
from torch_mcaa.grid import Cell
from torch_mcaa.patterns.lattice_search import reduced_basis
from torch_mcaa.patterns.lattice_table import STRIPS

_PAIRS = 48
"""Of a block: the mean of so many squares is known to a fifth."""
_APART = 1 / 32
"""Px: a quarter of a period of the highest tones that matter."""
_FEWEST, _MOST = 3, 16
"""Points: higher tones miss the dual vectors of a smaller lattice as often as not, and two rounds tell."""
_NODES = 4096
_HIGHEST, _STEP = 16.0, 1 / 32
"""Cycles a pixel."""
_SURE = 3.0
"""How far below what is allowed the error is to be: two lattices have to show it."""
_STREAM = 0xBA2D


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

    def points(self, frequency: Tensor, std: Tensor, allowed: Tensor) -> Tensor:
        """(blocks,) int64: enough for tones of a `frequency` and of a standard deviation to err by no more than is `allowed`, (C, blocks).

        And no more than as many random points would need.
        """
        ratio = allowed / std.clamp_min(1e-300)
        beyond = _STEP * (self.above[:, None, None] > ratio / _SURE).sum(0)
        counts, lengths = _shortest()
        place = torch.searchsorted(lengths, (frequency + beyond).nan_to_num(0.0)).clamp_max(len(counts) - 1)
        random = (self.power / ratio.square()).clamp(_FEWEST, _MOST).ceil().long()
        return torch.minimum(counts[place], random).amax(0)


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


def frequency_of(ask: Counted, cell: Cell, seed: int) -> tuple[Tensor, Tensor, Tensor]:
    """The root mean square frequency of f (C, blocks), cycles a pixel, its standard deviation and its mean.

    A tone's mean squared gradient is (2 pi v)^2 times its variance, half of which is along a random direction. The pairs are at random: on the
    pilot's grid a tone of whole cycles a pixel is constant.
    """
    blocks, device = cell.blocks(BLOCK), ask.invalid.device
    index = torch.arange(_PAIRS, device=device)
    block = torch.arange(len(blocks), device=device)[:, None]
    place = [rng.uniform(seed, _STREAM, block, index, axis, dtype=torch.float64) for axis in range(3)]
    size = torch.tensor([(b.row, b.col, b.height, b.width) for b in blocks], device=device)[:, :, None]
    row, col, turn = size[:, 0] + place[0] * size[:, 2], size[:, 1] + place[1] * size[:, 3], 2 * math.pi * place[2]
    places = torch.stack([col, col + _APART * turn.cos()]), torch.stack([row, row + _APART * turn.sin()])
    values = ask(*(p.flatten() for p in places)).to("cpu", torch.float64)
    here, there = values.view(-1, 2, len(blocks), _PAIRS).unbind(1)
    power = here.var(2)
    return (
        (2 * (there - here).square().mean(2) / power.clamp_min(1e-300)).sqrt() / (2 * math.pi * _APART),
        power.sqrt(),
        here.mean(2),
    )
