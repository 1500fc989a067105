"""What the differences between one sample a pixel and its neighbours tell of blocks."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_mcaa.estimators.lattice.audit import tile_means
from torch_mcaa.estimators.located.blocks import BLOCK

_LEAST = 1e-4
"""What is added to the mean square difference of neighbouring samples: a block that shows none has some."""
_TEXTURE = 0.01
"""The median difference of neighbouring samples, in ranges of the cell, from which on f has detail everywhere."""
_TOGETHER, _NOISY = 0.25, 8.0
"""In noise half of the differences come side by side. From the first share on they count for more: a lattice errs by three times as much there
as on edges between samples that differ as much."""


class Differences(NamedTuple):
    """What is known of the blocks (blocks,), on the CPU.

    Attributes:
        texture: bool, whether f has detail everywhere. spread: float64, the root of the mean square difference, in ranges of the cell.
        noisy: float64, how many times as far a lattice is expected to be off where f is noise as on edges of the same spread.
    """

    texture: Tensor
    spread: Tensor
    noisy: Tensor

    @staticmethod
    def of(values: Tensor) -> Differences:
        """Of samples (C, h, w), one in each pixel of a cell."""
        span = (values.amax((1, 2)) - values.amin((1, 2))).clamp_min(torch.finfo(values.dtype).tiny)[:, None, None]
        steps = [
            torch.nn.functional.pad((torch.diff(values, dim=dim) / span).abs().amax(0), pad)
            for dim, pad in ((1, (0, 0, 0, 1)), (2, (0, 1)))
        ]
        squares = [tile_means(step.square(), BLOCK, BLOCK) for step in steps]
        pairs = [tile_means(step * step.roll(1, dim), BLOCK, BLOCK) for dim, step in enumerate(steps)]
        # a median above a number: more than half are
        texture = torch.maximum(*(tile_means((step > _TEXTURE).to(torch.float32), BLOCK, BLOCK) for step in steps)) > 0.5
        together = torch.maximum(*(pair / square.clamp_min(1e-12) for pair, square in zip(pairs, squares, strict=True)))
        noisy = 1 + _NOISY * (together - _TOGETHER).clamp_min(0)
        spread = (_LEAST + torch.maximum(*squares)).sqrt()
        return Differences(texture.flatten().cpu(), *(t.flatten().to("cpu", torch.float64) for t in (spread, noisy)))
