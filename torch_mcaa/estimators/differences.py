"""What the differences between one sample a pixel and its neighbours tell of blocks."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_mcaa.edges.pilot import Judged, Verdict
from torch_mcaa.estimators.lattice.audit import tile_means
from torch_mcaa.estimators.located.blocks import BLOCK

_LEAST = 1e-4
"""What is added to the mean square difference of neighbouring samples: a block that shows none has some."""
_TEXTURE = 0.01
"""The median difference of neighbouring samples, in ranges of the cell, from which on f changes everywhere."""
_DETAILED = 3.5
"""How much more differences count for where jumps have detail beside them: on noise a lattice errs by four times as much as on edges."""
_SMOOTH, _RESOLVED = 0.3, 0.25
"""From this correlation of a difference with the next on f is smooth, if it changes everywhere: what differences count for where it does
not jump, too."""
_SLOW = 0.9
"""From this correlation on what changes everywhere is no detail: any lattice resolves it."""


class Differences:
    """Of samples (C, h, w), one in each pixel of a cell: numbers for each of its blocks, on the CPU."""

    def __init__(self, values: Tensor) -> None:
        span = (values.amax((1, 2)) - values.amin((1, 2)))[:, None, None]
        # a constant has no range to be measured in, and no differences
        values = values / torch.where(span > 0, span, 1)
        # as many as samples
        steps = [torch.nn.functional.pad(torch.diff(values, dim=d), pad) for d, pad in ((1, (0, 0, 0, 1)), (2, (0, 1)))]
        sizes = [step.abs().amax(0) for step in steps]
        spread = (_LEAST + torch.maximum(*(tile_means(size.square(), BLOCK, BLOCK) for size in sizes))).sqrt()
        nexts = [step * step.roll(1, d) for d, step in enumerate(steps, 1)]
        signed, square = (tile_means(torch.cat(parts).sum(0), BLOCK, BLOCK) for parts in (nexts, [step.square() for step in steps]))
        square.clamp_min_(torch.finfo(square.dtype).tiny)
        self._spread, self._correlation = (plane.flatten().to("cpu", torch.float64) for plane in (spread, signed / square))
        # a median above a number: more than half are
        several = (tile_means((size > _TEXTURE).to(torch.float32), BLOCK, BLOCK) for size in sizes)
        self._changes = (torch.maximum(*several) > 0.5).flatten().cpu()
        self.texture = self._changes & (self._correlation < _SLOW)
        """bool (blocks,), whether f has detail everywhere."""

    def doubt(self, judged: Judged) -> Tensor:
        """(blocks,) float64: how far off lattices of as many points are expected to be, in any unit, in blocks that were judged.

        By the root of the mean square difference, the detail that was found beside jumps, and the mean product of a difference and the next.
        """
        jumps = judged.verdict >= Verdict.NOISE
        factor = torch.where(jumps, 1 + _DETAILED * judged.detail, 1)
        smooth = ~jumps & self._changes & (self._correlation > _SMOOTH)
        return self._spread * torch.where(smooth, _RESOLVED, factor)
