"""Which directions the edges of each block have, as far as one sample a pixel tells."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torch_mcaa.estimators.blocks import BLOCK, shape_of
from torch_mcaa.grid import Cell
from torch_mcaa.patterns.turned import DIRECTIONS

_REACH = 2
"""Px: of the derivatives of a Gaussian of 1 px that tell f's slope; longer ones blur fine detail, and tell no more of coarse."""


def directions(values: Tensor, row: int, col: int, cell: Cell) -> Tensor:
    """(blocks, DIRECTIONS) float64: the sum of f's slope to the fourth power, which jumps stand out by, over the pixels of each
    block of a cell in which it has that direction.

    values: (C, H, W) one sample in each pixel from (row, col).
    """
    rows, cols = (
        (torch.arange(first - _REACH, first + size + _REACH, device=values.device) - start).clamp(0, most - 1)
        for first, size, start, most in (
            (cell.row, cell.height, row, values.shape[1]),
            (cell.col, cell.width, col, values.shape[2]),
        )
    )
    samples = values.to(torch.float64)[:, rows][:, :, cols]
    place = torch.arange(-_REACH, _REACH + 1, dtype=torch.float64)
    smooth = torch.exp(-place.square() / 2).tolist()
    steep = (place * torch.exp(-place.square() / 2)).tolist()
    across, down = (_along(_along(samples, y, 1), x, 2) for x, y in ((steep, smooth), (smooth, steep)))
    # quotients are rounded alike everywhere, angles are not
    bounds = torch.tan(((torch.arange(DIRECTIONS) + 0.5) / DIRECTIONS - 0.5) * math.pi).to(across)
    direction = torch.bucketize((down / across).nan_to_num(0.0), bounds) % DIRECTIONS
    tall, wide = shape_of(cell)
    i, j = (torch.arange(size, device=values.device) // BLOCK for size in (cell.height, cell.width))
    label = (i[:, None] * wide + j) * DIRECTIONS + direction
    total = torch.zeros(tall * wide * DIRECTIONS, dtype=torch.float64, device=values.device)
    for here, power in zip(label, (across.square() + down.square()).square(), strict=True):
        total.index_add_(0, here.flatten(), power.flatten())
    return total.view(-1, DIRECTIONS)


def _along(values: Tensor, taps: list[float], dim: int) -> Tensor:
    size = values.shape[dim] - len(taps) + 1
    return sum((values.narrow(dim, k, size) * tap for k, tap in enumerate(taps)), torch.zeros(()))
