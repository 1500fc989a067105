"""The normal density of the worked example."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from torch_mcaa.densities.base import Density
from torch_mcaa.filters.validation import number


@dataclass(frozen=True, init=False)
class Normal(Density):
    """A normal density of the given variance in px², or variances (x, y), over the whole plane: (25), (27).

    With w = N(0, a I) and this density N(0, b I), ∫∫ w²/w' = b² / (a (2b - a)) if 2b > a, else infinite.
    A u of 0 counts as half the spacing of the dtype's uniform numbers. Computed in float64 whatever u is.
    Raises McaaError for a variance outside [1e-12, 1e12].
    """

    variance: tuple[float, float]

    def __init__(self, variance: float | tuple[float, float]) -> None:
        pair = variance if isinstance(variance, tuple) and len(variance) == 2 else (variance, variance)
        mend = "pass a variance in px² (the square of the standard deviation), or two: (x, y)"
        vx, vy = (number("Normal", "variance", value, 1e-12, 1e12, mend) for value in pair)
        object.__setattr__(self, "variance", (vx, vy))

    @property
    def radius(self) -> tuple[float, float]:
        return math.inf, math.inf

    def sample(self, u: Tensor, v: Tensor) -> tuple[Tensor, Tensor]:
        vx, vy = self.variance
        return _quantile(u, math.sqrt(vx)), _quantile(v, math.sqrt(vy))

    def pdf(self, dx: Tensor, dy: Tensor) -> Tensor:
        vx, vy = self.variance
        return torch.exp(-0.5 * (dx**2 / vx + dy**2 / vy)) / (2 * math.pi * math.sqrt(vx * vy))


def _quantile(u: Tensor, std: float) -> Tensor:
    # In double, since float32 spoils the tails; the clamp keeps u = 0 from minus infinity.
    z = torch.erfinv(2 * u.double().clamp_min(torch.finfo(u.dtype).eps / 4) - 1)
    return (z * (std * math.sqrt(2))).to(u.dtype)
