"""The box filter: the average over a square."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torch_mcaa.filters.base import SeparableFilter
from torch_mcaa.filters.validation import pixels


@dataclass(frozen=True)
class Box(SeparableFilter):
    """Constant over a square of `width` pixels; the default is the pixel itself.

    Points on the border have the weight of the interior. Raises McaaError for a width outside [1e-6, 1e6].
    """

    width: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "width", pixels("Box", "width", self.width, "pass the side in pixels, such as 1.0"))

    @property
    def half_width(self) -> float:
        return self.width / 2

    @property
    def absolute_profile_integral(self) -> float:
        return 1.0

    def profile(self, d: Tensor) -> Tensor:
        return (d.abs() <= self.half_width).to(d.dtype) / self.width

    def profile_cdf(self, d: Tensor) -> Tensor:
        return (0.5 + d / self.width).clamp(0, 1)

    def profile_sample(self, u: Tensor) -> tuple[Tensor, Tensor]:
        return (u - 0.5) * self.width, torch.ones_like(u)
