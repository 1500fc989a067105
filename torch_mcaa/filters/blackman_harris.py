"""The Blackman-Harris filter: a window used as a filter."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from torch_mcaa.filters.inverse import TableSampledFilter

_COEFFICIENTS = (0.48829 / 0.35875, 0.14128 / 0.35875, 0.01168 / 0.35875)


@dataclass(frozen=True)
class BlackmanHarris(TableSampledFilter):
    """The minimum four-term Blackman-Harris window over [-2, 2] pixels: a positive bell.

    Coefficients: F. J. Harris, On the Use of Windows for Harmonic Analysis with the Discrete Fourier
    Transform, Proc. IEEE 66 (1978). The radius of 2 px is that of LuxCoreRender's and Sunflow's filters of
    this name.
    """

    @property
    def half_width(self) -> float:
        return 2.0

    @property
    def sign_changes(self) -> tuple[float, ...]:
        return ()

    def profile(self, d: Tensor) -> Tensor:
        angle = math.pi / self.half_width * d.clamp(-self.half_width, self.half_width)
        waves = sum(a * torch.cos(k * angle) for k, a in enumerate(_COEFFICIENTS, start=1))
        return torch.where(d.abs() <= self.half_width, (1 + waves) / (2 * self.half_width), 0)

    def profile_cdf(self, d: Tensor) -> Tensor:
        angle = math.pi / self.half_width * d.clamp(-self.half_width, self.half_width)
        waves = sum(a / k * torch.sin(k * angle) for k, a in enumerate(_COEFFICIENTS, start=1))
        return 0.5 + (angle + waves) / (2 * math.pi)
