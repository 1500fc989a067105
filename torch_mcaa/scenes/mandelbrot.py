"""The Mandelbrot set: an integrand that costs much a point and has no closed form."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from torch_mcaa.filters.base import Filter
from torch_mcaa.scenes.base import ClosedForm, Scene, require_positive

_BAILOUT = 256.0


@dataclass(frozen=True)
class Mandelbrot(Scene):
    """Root of the share of `iterations` that z ← z² + c takes until |z| > 256, smoothed; 0 where z stays.

    (cx, cy) is the pixel position that shows c = real + i imag, `scale` the pixels a unit of c. `exact` always raises.
    """

    cx: float
    cy: float
    scale: float
    real: float = -0.75
    imag: float = 0.0
    iterations: int = 200

    def __post_init__(self) -> None:
        require_positive(self, scale=self.scale, iterations=self.iterations)

    def __call__(self, x: Tensor, y: Tensor) -> Tensor:
        a = (x - self.cx) / self.scale + self.real
        b = (y - self.cy) / self.scale + self.imag
        u, v, count = a, b, torch.zeros_like(x)
        for _ in range(self.iterations):
            u2, v2 = u * u, v * v
            inside = u2 + v2 <= _BAILOUT**2
            u, v = torch.where(inside, u2 - v2 + a, u), torch.where(inside, 2 * u * v + b, v)
            count = count + inside.to(x.dtype)
        norm2 = u * u + v * v
        escaped = norm2 > _BAILOUT**2
        doublings = torch.log2(torch.log(norm2.clamp_min(_BAILOUT**2)) / math.log(_BAILOUT**2))
        return torch.where(escaped, torch.sqrt((count - doublings).clamp_min(0) / self.iterations), 0.0)

    def _closed_forms(self) -> Mapping[type[Filter], ClosedForm]:
        return {}
