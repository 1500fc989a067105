"""What pbrt and Cycles do: every pixel has its own Owen-scrambled Sobol' points, drawn from w, and their mean.

Fair: the scrambling is the hash of Laine and Karras that both use (Burley 2020), on 32-bit integers, which vectorise, without the dimensions
beyond two that a film needs; the Gaussian's inverse is the built-in one; float32; in bands of rows that stay in the cache, samples first and
pixels last, so that sums run over whole rows. The filter is drawn from, so weights are 1.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from .base import RADIUS, STD, Outcome
from .cases import Case
from .sobol import reversed_bits

BAND = 2**17
WITHIN = math.erf(RADIUS / STD / math.sqrt(2))
_MULTIPLIERS = [c - 2**32 if c >= 2**31 else c for c in (0x6C50B47C, 0xB82F1E52, 0xC7AFE638, 0x8D22F6E6)]


def scrambled(sequence: Tensor, seeds: Tensor) -> Tensor:
    """Reversed bits (n, 1) int32 and a seed a pixel (1, P) int32 to points in [-1, 1), (n, P) float32."""
    x = sequence + seeds
    for multiplier in _MULTIPLIERS:
        x.bitwise_xor_(x * multiplier)
    for shift, mask in ((1, 0x55555555), (2, 0x33333333), (4, 0x0F0F0F0F), (8, 0x00FF00FF)):
        x = ((x >> shift) & mask) | ((x & mask) << shift)
    # read as signed, a number's highest bit is flipped, which is one more scrambling
    return (((x >> 16) & 0xFFFF) | (x << 16)).to(torch.float32).mul_(2.0**-31)


def render(case: Case, spp: int, seed: int) -> Outcome:
    generator, size = torch.Generator().manual_seed(seed), case.size
    sequences = [torch.from_numpy(bits.view(np.int32))[:, None] for bits in reversed_bits(spp)]
    image = torch.empty(size, size)
    step = max(1, BAND // (spp * size))
    for start in range(0, size, step):
        rows = min(step, size - start)
        seeds = torch.randint(-(2**31), 2**31, (2, 1, rows * size), generator=generator, dtype=torch.int32)
        x, y = (
            scrambled(sequence, own).mul_(WITHIN).erfinv_().mul_(STD * math.sqrt(2)).view(spp, rows, size)
            for sequence, own in zip(sequences, seeds, strict=True)
        )
        x.add_(torch.arange(size) + 0.5)
        y.add_((torch.arange(start, start + rows) + 0.5)[:, None])
        image[start : start + rows] = case.scene(x, y).mean(0)
    return Outcome(image, spp * size * size)
