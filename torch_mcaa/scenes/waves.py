"""Scenes of frequencies: one sinusoid, and the zone plate that holds all of them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from torch_mcaa.filters.base import Filter
from torch_mcaa.filters.box import Box
from torch_mcaa.filters.gaussian import Gaussian
from torch_mcaa.scenes.base import ClosedForm, Scene


@dataclass(frozen=True)
class Sinusoid(Scene):
    """½ + ½ cos(2π (u x + v y) + phase); u, v in cycles a pixel, phase in radians."""

    u: float
    v: float
    phase: float = 0.0

    def __call__(self, x: Tensor, y: Tensor) -> Tensor:
        return 0.5 + 0.5 * torch.cos(2 * math.pi * (self.u * x + self.v * y) + self.phase)

    def _closed_forms(self) -> Mapping[type[Filter], ClosedForm]:
        return {Gaussian: self._gaussian, Box: self._box}

    def _gaussian(self, cx: Tensor, cy: Tensor, std: float) -> Tensor:
        response = math.exp(-2 * (math.pi * std) ** 2 * (self.u**2 + self.v**2))
        return 0.5 + response * (self(cx, cy) - 0.5)

    def _box(self, cx: Tensor, cy: Tensor, width: float) -> Tensor:
        return 0.5 + _sinc(self.u * width) * _sinc(self.v * width) * (self(cx, cy) - 0.5)


def _sinc(t: float) -> float:
    return math.sin(math.pi * t) / (math.pi * t) if t else 1.0


@dataclass(frozen=True)
class ZonePlate(Scene):
    """½ + ½ cos(k ρ²), ρ the distance from (cx, cy) in pixels; |k| ρ / π cycles a pixel at ρ."""

    k: float
    cx: float
    cy: float

    def __call__(self, x: Tensor, y: Tensor) -> Tensor:
        return 0.5 + 0.5 * torch.cos(self.k * ((x - self.cx) ** 2 + (y - self.cy) ** 2))

    def _closed_forms(self) -> Mapping[type[Filter], ClosedForm]:
        return {Gaussian: self._gaussian}

    def _gaussian(self, cx: Tensor, cy: Tensor, std: float) -> Tensor:
        """Real part of exp(i k ρ² / (1 − i q)) / (1 − i q), q = 2 k std²: a Gaussian of complex variance."""
        rho2 = (cx - self.cx) ** 2 + (cy - self.cy) ** 2
        q = 2 * self.k * std**2
        scale = 1 + q**2
        turn = self.k * rho2 / scale
        return 0.5 + 0.5 * torch.exp(-q * turn) * (torch.cos(turn) - q * torch.sin(turn)) / scale
