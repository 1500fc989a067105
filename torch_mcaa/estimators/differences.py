"""What the differences between one sample a pixel and its neighbours tell of blocks."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_mcaa.edges.pilot import Verdict
from torch_mcaa.estimators.lattice.audit import tile_means
from torch_mcaa.estimators.located.blocks import BLOCK

_LEAST = 1e-4
"""What is added to the mean square difference of neighbouring samples: a block that shows none has some."""
_TEXTURE = 0.01
"""The median difference of neighbouring samples, in ranges of the cell, from which on f has detail everywhere."""
_ALONE, _NOISY = -0.25, 8.0
"""The correlation of a difference with the next is -0.5 in noise and about 0 where edges lie alone. From the first on differences count for more:
on noise a lattice errs by three times as much as on edges."""
_WAVES, _BETWEEN = 0.64, 0.1
"""The mean product of the sizes of a difference and the next, in mean squares, that fast tones have at least, and how much less is noise for certain:
that of two colours has 0.5."""
_SMOOTH, _RESOLVED = 0.3, 0.25
"""From this correlation on f is smooth, if it has detail everywhere: what differences count for where it does not jump, too."""


class Differences(NamedTuple):
    """What is known of the blocks (blocks,), on the CPU.

    Attributes:
        texture: bool, whether f has detail everywhere. spread: float64, the root of the mean square difference, in ranges of the cell.
        correlation, together: float64, the mean product of a difference and the next, and that of their sizes, in mean squares.
    """

    texture: Tensor
    spread: Tensor
    correlation: Tensor
    together: Tensor

    @staticmethod
    def of(values: Tensor) -> Differences:
        """Of samples (C, h, w), one in each pixel of a cell."""
        span = (values.amax((1, 2)) - values.amin((1, 2)))[:, None, None]
        # a constant has no range to be measured in, and no differences
        span = torch.where(span > 0, span, 1)
        steps = [torch.nn.functional.pad(torch.diff(values / span, dim=d), pad) for d, pad in ((1, (0, 0, 0, 1)), (2, (0, 1)))]
        largest = [step.abs().amax(0) for step in steps]
        # a median above a number: more than half are
        texture = torch.maximum(*(tile_means((size > _TEXTURE).to(torch.float32), BLOCK, BLOCK) for size in largest)) > 0.5
        spread = (_LEAST + torch.maximum(*(tile_means(size.square(), BLOCK, BLOCK) for size in largest))).sqrt()
        nexts = [step * step.roll(1, d) for d, step in enumerate(steps, 1)]
        signed, unsigned, square = (
            tile_means(torch.cat(parts).sum(0), BLOCK, BLOCK)
            for parts in (nexts, [part.abs() for part in nexts], [step.square() for step in steps])
        )
        square.clamp_min_(torch.finfo(values.dtype).tiny)
        numbers = (spread, signed / square, unsigned / square)
        return Differences(texture.flatten().cpu(), *(t.flatten().to("cpu", torch.float64) for t in numbers))

    def doubt(self, verdict: Tensor) -> Tensor:
        """(blocks,) float64: how far off lattices of as many points are expected to be, in any unit, in blocks of these verdicts."""
        changes = verdict >= Verdict.NOISE
        noise = (_ALONE - self.correlation).clamp_min(0) * ((_WAVES - self.together) / _BETWEEN).clamp(0, 1)
        factor = torch.where(changes, 1 + _NOISY * noise, 1)
        smooth = ~changes & self.texture & (self.correlation > _SMOOTH)
        return self.spread * torch.where(smooth, _RESOLVED, factor)
