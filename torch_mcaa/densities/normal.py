"""The normal density of the worked example."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from torch_mcaa.densities.base import Density
from torch_mcaa.errors import McaaError
from torch_mcaa.filters.validation import LARGEST, number


@dataclass(frozen=True, init=False)
class Normal(Density):
    """A normal density of the given variance in px², or variances (x, y), over the whole plane: (25), (27).

    Its mean is `centre`, (dx, dy) in pixels from the pixel's centre: that of a sub-pixel in (27).
    With w = N(0, a I) and this density N(d, b I), ∫∫ w²/w' = b² / (a (2b - a)) · exp(|d|² / (2b - a)) if 2b > a,
    else infinite. A u of 0 counts as half the spacing of the dtype's uniform numbers. Sampled in float64 whatever u is.
    Raises McaaError for a variance outside [1e-12, 1e12], and for a centre that is not a pair of numbers in [-1e6, 1e6].
    """

    variance: tuple[float, float]
    centre: tuple[float, float]

    def __init__(self, variance: float | tuple[float, float], centre: tuple[float, float] = (0.0, 0.0)) -> None:
        pair = variance if isinstance(variance, tuple) and len(variance) == 2 else (variance, variance)
        mend = "pass a variance in px² (the square of the standard deviation), or two: (x, y)"
        vx, vy = (number("Normal", "variance", value, 1e-12, 1e12, mend) for value in pair)
        mend = "pass the mean as (dx, dy) in px from the pixel's centre"
        if not isinstance(centre, tuple) or len(centre) != 2:
            raise McaaError(f"Normal: centre must be a pair of numbers; received {centre!r}: {mend}")
        cx, cy = (number("Normal", "centre", value, -LARGEST, LARGEST, mend) for value in centre)
        object.__setattr__(self, "variance", (vx, vy))
        object.__setattr__(self, "centre", (cx, cy))

    @property
    def radius(self) -> tuple[float, float]:
        return math.inf, math.inf

    def sample(self, u: Tensor, v: Tensor) -> tuple[Tensor, Tensor]:
        (vx, vy), (cx, cy) = self.variance, self.centre
        return _quantile(u, cx, math.sqrt(vx)), _quantile(v, cy, math.sqrt(vy))

    def pdf(self, dx: Tensor, dy: Tensor) -> Tensor:
        (vx, vy), (cx, cy) = self.variance, self.centre
        return torch.exp(-0.5 * ((dx - cx) ** 2 / vx + (dy - cy) ** 2 / vy)) / (2 * math.pi * math.sqrt(vx * vy))


def _quantile(u: Tensor, mean: float, std: float) -> Tensor:
    # In double, since float32 spoils the tails; the clamp keeps u = 0 from minus infinity.
    z = torch.erfinv(2 * u.double().clamp_min(torch.finfo(u.dtype).eps / 4) - 1)
    return (mean + z * (std * math.sqrt(2))).to(u.dtype)
