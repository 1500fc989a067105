"""Independent uniform points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import torch
from torch import Tensor

from torch_mcaa.patterns.base import Pattern, check_count, check_points, independent_variance, jitter, skewness_factor

__all__ = ["Independent"]

_STREAM = 0x696E6470


@final
@dataclass(frozen=True)
class Independent(Pattern):
    """Plain Monte Carlo: error n**-0.5 for every f, the yardstick of the other patterns. Any n."""

    def count(self, n: int) -> int:
        check_count(n)
        return n

    def points(
        self, n: int, rows: Tensor, cols: Tensor, *, seed: int, round: int, dtype: torch.dtype = torch.float32
    ) -> tuple[Tensor, Tensor]:
        check_points(self, n, rows, cols, dtype)
        return jitter(_STREAM, n, rows, cols, seed, round, dtype)

    def variance(self, terms: Tensor, u: Tensor, v: Tensor) -> Tensor:
        """s**2 / n times `skewness_factor`."""
        return independent_variance(terms) * skewness_factor(terms)
