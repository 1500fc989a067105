"""The sinc: the full theoretical form, over the whole plane."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from torch_mcaa.errors import McaaError
from torch_mcaa.filters.base import SeparableFilter
from torch_mcaa.filters.gauss import legendre

_LAGUERRE = tuple(zip(*(a.tolist() for a in np.polynomial.laguerre.laggauss(24)), strict=True))


def sinc(d: Tensor) -> Tensor:
    """sin(πd) / (πd), finite for every finite d: the clamp keeps πd from overflowing float32."""
    return torch.sinc(d.clamp(-1e30, 1e30))


def sine_integral(x: Tensor) -> Tensor:
    """Si(x) = ∫ sin(t)/t over [0, x], for float64 x, within 2e-14; 40 evaluations of an elementary function.

    Up to |x| = 10 by 16 Gauss-Legendre nodes; beyond by Si = π/2 - f cos - g sin with the auxiliary functions
    f and g (Abramowitz and Stegun, 5.2.8, 5.2.12, 5.2.13) by 24 Gauss-Laguerre nodes.
    """
    near = x.clamp(-10, 10)
    small = torch.zeros_like(x)
    nodes, weights = legendre(torch.tensor([0.0, 1.0], dtype=torch.float64), 16)
    for node, weight in zip(nodes.tolist(), weights.tolist(), strict=True):
        small = small + near * torch.sinc(near * (node / math.pi)) * weight
    big = x.abs().clamp(10, 1e17)
    f, g = torch.zeros_like(x), torch.zeros_like(x)
    for node, weight in _LAGUERRE:
        term = weight / (1 + (node / big) ** 2)
        f, g = f + term, g + term * node
    large = math.pi / 2 - (f / big) * torch.cos(big) - (g / big**2) * torch.sin(big)
    return torch.where(x.abs() <= 10, small, torch.sign(x) * large)


def _not_integrable() -> McaaError:
    return McaaError(
        "Sinc: |sinc| is not integrable over the plane, so no density is proportional to it; received "
        "Sinc(): use Lanczos(3), which truncates it, or a density such as Normal(25.0) with f = 0 off screen"
    )


@dataclass(frozen=True)
class Sinc(SeparableFilter):
    """sinc(dx) sinc(dy) over the whole plane: the ideal low-pass filter of the pixel grid.

    Its integral is 1 as an improper one. |sinc| is not integrable over the plane, so there is no density
    proportional to it: whatever needs ∫|w| (`absolute_integral`, `sample`, `pdf` ...) raises McaaError.
    """

    @property
    def half_width(self) -> float:
        return math.inf

    @property
    def absolute_profile_integral(self) -> float:
        raise _not_integrable()

    def profile(self, d: Tensor) -> Tensor:
        return sinc(d)

    def profile_cdf(self, d: Tensor) -> Tensor:
        """½ + Si(πd)/π, computed in float64 whatever d is."""
        return (0.5 + sine_integral(math.pi * d.double()) / math.pi).to(d.dtype)

    def profile_sample(self, u: Tensor) -> tuple[Tensor, Tensor]:
        raise _not_integrable()
