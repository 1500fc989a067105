"""Which directions the edges of each block have: as far as one sample a pixel tells, or as jumps that were found face."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torch_mcaa.edges.normals import REACH, slopes
from torch_mcaa.edges.pilot import Judged
from torch_mcaa.estimators.located.blocks import BLOCK, shape_of
from torch_mcaa.estimators.located.counted import Counted, Spent
from torch_mcaa.grid import Cell
from torch_mcaa.patterns.turned import DIRECTIONS
from torch_mcaa.picking import numbers
from torch_mcaa.sums import add_at

_KNOWN = 4
"""Jumps whose edges were met again that tell a block's directions."""
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
    direction = _number((down / across).nan_to_num(0.0))
    tall, wide = shape_of(cell)
    i, j = (torch.arange(size, device=values.device) // BLOCK for size in (cell.height, cell.width))
    label = (i[:, None] * wide + j) * DIRECTIONS + direction
    total = torch.zeros(tall * wide * DIRECTIONS, dtype=torch.float64, device=values.device)
    for here, power in zip(label, (across.square() + down.square()).square(), strict=True):
        add_at(total, here.flatten(), power.flatten())
    return total.view(-1, DIRECTIONS)


def faced(ask: Counted, judged: Judged, wanted: Tensor, edges: Tensor, seed: int) -> Tensor:
    """`directions` (blocks, DIRECTIONS) with those of the jumps found in the blocks that are `wanted`, if there are some, each block's sum kept.

    Samples tell the directions of edges that are closer than they are wrong. Where all neighbours differ alike none is a candidate, and they
    are all there is.
    """
    faces, blocks = torch.zeros_like(edges), len(edges)
    met = torch.zeros(blocks, dtype=torch.float64)
    chosen = [numbers(wanted.to(part.device)[part]) for _, part in judged.sharp]
    if not any(len(here) for here in chosen):
        return edges
    for (jumps, part), here, number in zip(judged.sharp, chosen, judged.crossings, strict=True):
        try:
            index, slope = slopes(ask, jumps.take(here), seed)
        except Spent:
            return edges
        block = part[here][index].cpu()
        slope, size = slope.cpu(), jumps.jump[:, here[index]].cpu().to(torch.float64).square().sum(0)
        # lines meet an edge as often as it faces along them, those of both axes one that is not flat to either
        along, flat = 1 / (1 + slope.square()).sqrt(), slope.abs() < 1 / REACH
        length = 1 / (along + torch.where(flat, 0, slope.abs() * along))
        tangent = -slope if jumps.axis == 0 else -1 / slope
        tried = torch.bincount(part.cpu(), minlength=blocks).clamp_min(1)
        faces.view(-1).index_add_(0, block * DIRECTIONS + _number(tangent), size * length * (number / tried)[block])
        met += torch.bincount(block, minlength=blocks)
    known = (met >= _KNOWN)[:, None]
    return torch.where(known, faces * (edges.sum(1) / faces.sum(1).clamp_min(1e-300))[:, None], edges)


def _number(tangent: Tensor) -> Tensor:
    """Of the direction that has a tangent."""
    # quotients are rounded alike everywhere, angles are not
    bounds = torch.tan(((torch.arange(DIRECTIONS) + 0.5) / DIRECTIONS - 0.5) * math.pi).to(tangent)
    return torch.bucketize(tangent, bounds) % DIRECTIONS


def _along(values: Tensor, taps: list[float], dim: int) -> Tensor:
    size = values.shape[dim] - len(taps) + 1
    return sum((values.narrow(dim, k, size) * tap for k, tap in enumerate(taps)), torch.zeros(()))
