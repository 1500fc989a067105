"""Thin pieces that a lattice has too many lines to be followed on: on fewer lines of another."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from torch_mcaa.estimators.base import dilated
from torch_mcaa.estimators.located.corrected import Corrected, merged
from torch_mcaa.estimators.located.counted import Spent
from torch_mcaa.estimators.located.jump_level import FEWEST_LINES, Leveller, odd

AROUND = 5
"""Px: how far from where samples hit a piece it is looked for."""
_SAFE = 0.9
"""Of what can be paid for by what is expected, what is planned."""
_NUMBER = 6
"""Of the shift: others have those before."""


def sparser(work: Leveller, count: int, wanted: Tensor, unpaid: float) -> Corrected | None:
    """The pixels `wanted` (h, w), about pieces that `count` lines a pixel could not be followed on: it would have taken `unpaid` evaluations.

    By two shifts of a lattice of as many lines as are expected to be paid for; None if these are too few.
    """
    if not unpaid or not bool(wanted.any()):
        return None
    pixels = int(dilated(wanted, work.window.halo).count_nonzero())
    fewer = odd(min(count, int(_SAFE * work.ask.left / (2 * (pixels + unpaid / count)))))
    if fewer < FEWEST_LINES:
        return None
    work.thin.lost = torch.zeros_like(work.thin.lost)
    try:
        first = work.shift(fewer, _NUMBER, wanted)
        if not bool(first.core.any()):
            return None
        second = work.shift(fewer, _NUMBER + 1, first.pixels.plane(first.core), first)
    except Spent:
        return None
    whole = ~work.thin.lost[first.pixels.rows, first.pixels.cols]
    first = replace(first, near=first.near & whole, core=first.core & whole)
    return Corrected.of(first, *merged(first, second), torch.zeros_like(first.near))
