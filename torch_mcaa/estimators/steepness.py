"""Which frequencies f has, as far as its slope and its bend over a thirty-second of a pixel tell."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from torch_mcaa import rng
from torch_mcaa.estimators.lattice.audit import tile_means
from torch_mcaa.estimators.located.blocks import BLOCK, by_pixel, rectangles_of
from torch_mcaa.estimators.located.counted import Counted
from torch_mcaa.grid import Cell

_PLACES = 24
"""Of a block: the mean of so many squares is known to a fifth."""
_APART = 1 / 64
"""Px: an eighth of a period of the highest tones that matter."""
_SAME = 1.5
"""Variances of the grid's samples and of places at random are of one f unless one is so many times the other."""
_TOLD = 0.4
"""How far from its mean f has to be, and how steep, in parts of what it is on average, for a place to tell a tone's frequency."""
_ALIKE, _ENOUGH = 0.4, 6
"""How far, in parts of it, frequencies may be from their mean to be those of one tone, and in how many places."""
_FURTHER = 1.25
"""How much further than in the places that were met frequencies spread."""
_STREAM = 0xBA2D


@dataclass(frozen=True)
class Steepness:
    """How f changes in each block.

    Attributes:
        frequency: (C, blocks) f's root mean square frequency, cycles a pixel.
        tones: (C, blocks, T, 2) frequencies in cycles a pixel: where f is one tone what it has in places over the block, and a little beyond;
            else as many of the root mean square frequency in all directions.
        std, mean: (C, blocks) f's standard deviation and mean.
        steepest: float64 (blocks, 2) screen row and column of the steepest place that was met.
    """

    frequency: Tensor
    tones: Tensor
    std: Tensor
    mean: Tensor
    steepest: Tensor


def steepness_of(ask: Counted, cell: Cell, grid: Tensor, seed: int) -> Steepness:
    """What a few places in each block tell, and places on both sides of them along both axes.

    A tone's squared differences over 2 d are on average 4 sin^2(2 pi v d) times its variance, and its second difference is everywhere
    -4 sin^2(pi v d) times what it is itself, its mean aside. The places are at random: on the pilot's `grid` (C, h, w), which else tells mean
    and variance better, a tone of whole cycles a pixel is constant.
    """
    blocks, device = rectangles_of(cell), ask.invalid.device
    index = torch.arange(_PLACES, device=device)
    block = torch.arange(len(blocks), device=device)[:, None]
    place = [rng.uniform(seed, _STREAM, block, index, axis, dtype=torch.float64) for axis in (0, 1)]
    top, left, height, width = blocks.to(device)[:, :, None].unbind(1)
    row, col = top + place[0] * height, left + place[1] * width
    right, down = torch.tensor([0, 1, -1, 0, 0]), torch.tensor([0, 0, 0, 1, -1])
    asked = [(_APART * step).to(device)[:, None, None] + place for step, place in ((right, col), (down, row))]
    values = ask(*(places.flatten() for places in asked)).to("cpu", torch.float64)
    # (C, blocks, places)
    here, *beside = values.view(-1, 5, len(blocks), _PLACES).unbind(1)
    even = tile_means(grid, BLOCK, BLOCK)
    level, own = even.flatten(1).to(here), here.var(2)
    spread = tile_means((grid - by_pixel(even, cell)).square(), BLOCK, BLOCK).flatten(1).to(here)
    power = torch.where((own < _SAME * spread) & (spread < _SAME * own), spread, own)
    slopes = torch.stack([after - before for after, before in (beside[:2], beside[2:])], -1)
    steep = slopes.square().sum(3)
    sine = (slopes.square().mean(2) / 4 / power[..., None].clamp_min(1e-300)).sqrt()
    frequency = (sine.clamp_max(1).asin() / (2 * math.pi * _APART)).square().sum(2).sqrt()
    first = (steep / steep.mean(2, keepdim=True).clamp_min(1e-300)).amax(0).argmax(1, keepdim=True).to(device)
    bent = torch.stack([after + before - 2 * here for after, before in (beside[:2], beside[2:])], -1)
    return Steepness(
        frequency,
        _tones(here - level[..., None], bent, slopes, frequency),
        torch.maximum(own, spread).sqrt(),
        here.mean(2),
        torch.cat([row.gather(1, first), col.gather(1, first)], 1).cpu(),
    )


def _tones(off: Tensor, bent: Tensor, slopes: Tensor, frequency: Tensor) -> Tensor:
    """As in `Steepness`, from f without its mean (C, blocks, places), its second differences and slopes (C, blocks, places, 2)."""
    ratio = -bent / torch.where(off == 0, 1, off)[..., None]
    length = (ratio.clamp(0, 4).sqrt().div(2).asin() / (math.pi * _APART)).norm(dim=3)
    steep = slopes.norm(dim=3)
    told = torch.stack([size > _TOLD * size.square().mean(2, keepdim=True).sqrt() for size in (off.abs(), steep)]).all(0)
    # a tone's slope is along its frequency, or against it
    wave = slopes * (length / steep.clamp_min(1e-300))[..., None]
    first = steep.argmax(2)[..., None, None].expand(-1, -1, 1, 2)
    wave = wave * torch.where((slopes * slopes.gather(2, first)).sum(3, keepdim=True) < 0, -1, 1)
    number = told.sum(2)[..., None, None]
    middle = (wave * told[..., None]).sum(2, keepdim=True) / number.clamp_min(1)
    wave = torch.where(told[..., None], wave, middle)
    off_middle = (wave - middle).norm(dim=3).amax(2)
    pure = (off_middle < _ALIKE * middle.norm(dim=3)[..., 0]) & (number[..., 0, 0] >= _ENOUGH)
    angle = torch.arange(_PLACES) * (math.pi / _PLACES)
    around = frequency[..., None, None] * torch.stack([angle.cos(), angle.sin()], -1).to(wave)
    return torch.where(
        pure[..., None, None], torch.cat([wave, middle + _FURTHER * (wave - middle)], 2), torch.cat([around, 0.5 * around], 2)
    )
