"""What two shifts of a lattice say of the pixels whose jumps were corrected: a value, and by how much they differ its variance."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Self

import torch
from torch import Tensor

from torch_mcaa.estimators.located.jump_level import Level


@dataclass(frozen=True)
class Corrected:
    """Of one cell, in the pixels (rows, cols) whose jumps were corrected, (P,) or (C, P).

    Attributes:
        value, variance: float64; the variance NaN where a second shift could not be paid for, which would tell it.
        fine: bool, those corrected by the finer lattice.
    """

    rows: Tensor
    cols: Tensor
    value: Tensor
    variance: Tensor
    fine: Tensor

    @classmethod
    def of(cls, level: Level, value: Tensor, variance: Tensor, fine: Tensor) -> Self:
        """What a level has corrected; all (P,) or (C, P) in its pixels."""
        near, pixels = level.near, level.pixels
        return cls(pixels.rows[near], pixels.cols[near], value[:, near], variance[:, near], fine[near])

    def beside(self, other: Self) -> Self:
        """These pixels and others."""
        return type(self)(*(torch.cat([getattr(self, f.name), getattr(other, f.name)], -1) for f in fields(self)))


def merged(first: Level, second: Level) -> tuple[Tensor, Tensor]:
    """The mean of two shifts in the first's core, and its variance, pooled over neighbours there and with that of the brackets as a floor.

    Elsewhere the first shift's, and the variance of the core around.
    """
    core, pixels = first.core, first.pixels
    other, doubt = (pixels.of(second.pixels, values, 0.0) for values in (second.value, second.spread))
    squared = torch.where(core, (first.value - other).square() / 4, 0)
    pooled = pixels.summed(squared) / pixels.summed(core.to(torch.float64)).clamp_min(1e-9)
    value = torch.where(core, (first.value + other) / 2, first.value)
    brackets = torch.where(core, (first.spread + doubt) / 4, first.spread)
    return value, beyond(first, torch.maximum(pooled, squared) + brackets, torch.zeros_like(core))


def beyond(level: Level, variance: Tensor, known: Tensor) -> Tensor:
    """The variance, that of the core around in the pixels that are neither in it nor `known`: one shift does not tell theirs."""
    pixels, weight = level.pixels, level.core.to(torch.float64)
    around = variance * weight
    for _ in range(2):
        around, weight = pixels.summed(around), pixels.summed(weight)
    return torch.where(level.core | known, variance, around / weight.clamp_min(1e-9) + level.spread)
