"""The tent filter: linear interpolation."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torch_mcaa.filters.base import SeparableFilter
from torch_mcaa.filters.validation import pixels


@dataclass(frozen=True, init=False, repr=False)
class Tent(SeparableFilter):
    """(1 - |d|/radius) / radius along each axis, for |d| <= radius pixels.

    Raises McaaError for a radius outside [1e-6, 1e6].
    """

    _half_width: float

    def __init__(self, radius: float = 1.0) -> None:
        half_width = pixels("Tent", "radius", radius, "pass the half-width in pixels, such as 1.0")
        object.__setattr__(self, "_half_width", half_width)

    def __repr__(self) -> str:
        return f"Tent(radius={self._half_width!r})"

    @property
    def half_width(self) -> float:
        return self._half_width

    @property
    def absolute_profile_integral(self) -> float:
        return 1.0

    def profile(self, d: Tensor) -> Tensor:
        inside = d.abs() <= self.half_width
        return torch.where(inside, 1 - d.abs() / self.half_width, 0).clamp_min(0) / self.half_width

    def profile_cdf(self, d: Tensor) -> Tensor:
        t = (d / self.half_width).clamp(-1, 1)
        return 0.5 + t * (1 - 0.5 * t.abs())

    def profile_sample(self, u: Tensor) -> tuple[Tensor, Tensor]:
        tail = torch.minimum(u, 1 - u)
        distance = self.half_width * (1 - torch.sqrt(2 * tail))
        return torch.where(u < 0.5, -distance, distance), torch.ones_like(u)
