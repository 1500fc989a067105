"""Smooth scenes: ramp, quadratic, blob, and highlights far above white."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import torch
from torch import Tensor

from torch_mcaa.errors import McaaError
from torch_mcaa.filters.base import Filter
from torch_mcaa.filters.box import Box
from torch_mcaa.filters.gaussian import Gaussian
from torch_mcaa.scenes.base import ClosedForm, Scene, require_positive


@dataclass(frozen=True)
class Ramp(Scene):
    """value + slope_x x + slope_y y; slopes a pixel. Every symmetric filter leaves it as it is."""

    slope_x: float
    slope_y: float
    value: float = 0.0

    def __call__(self, x: Tensor, y: Tensor) -> Tensor:
        return self.value + self.slope_x * x + self.slope_y * y

    def _closed_forms(self) -> Mapping[type[Filter], ClosedForm]:
        return {Gaussian: self._unchanged, Box: self._unchanged}

    def _unchanged(self, cx: Tensor, cy: Tensor, size: float) -> Tensor:
        return self(cx, cy)


@dataclass(frozen=True)
class Quadratic(Scene):
    """value + xx dx² + xy dx dy + yy dy², with (dx, dy) the offset from (cx, cy) in pixels."""

    cx: float
    cy: float
    xx: float
    xy: float
    yy: float
    value: float = 0.0

    def __call__(self, x: Tensor, y: Tensor) -> Tensor:
        dx, dy = x - self.cx, y - self.cy
        return self.value + self.xx * dx * dx + self.xy * dx * dy + self.yy * dy * dy

    def _closed_forms(self) -> Mapping[type[Filter], ClosedForm]:
        return {Gaussian: self._gaussian, Box: self._box}

    def _gaussian(self, cx: Tensor, cy: Tensor, std: float) -> Tensor:
        return self(cx, cy) + (self.xx + self.yy) * std**2

    def _box(self, cx: Tensor, cy: Tensor, width: float) -> Tensor:
        return self(cx, cy) + (self.xx + self.yy) * width**2 / 12


@dataclass(frozen=True)
class Blob(Scene):
    """height · exp(−ρ² / 2 std²), ρ the distance from (cx, cy); std in pixels."""

    cx: float
    cy: float
    std: float
    height: float = 1.0

    def __post_init__(self) -> None:
        require_positive(self, std=self.std)

    def __call__(self, x: Tensor, y: Tensor) -> Tensor:
        return self.height * torch.exp(((x - self.cx) ** 2 + (y - self.cy) ** 2) * (-0.5 / self.std**2))

    def _closed_forms(self) -> Mapping[type[Filter], ClosedForm]:
        return {Gaussian: self._gaussian, Box: self._box}

    def _gaussian(self, cx: Tensor, cy: Tensor, std: float) -> Tensor:
        wider = Blob(self.cx, self.cy, math.hypot(self.std, std), self.height)
        return wider(cx, cy) * (self.std / wider.std) ** 2

    def _box(self, cx: Tensor, cy: Tensor, width: float) -> Tensor:
        return self.height * self._mean(cx - self.cx, width) * self._mean(cy - self.cy, width)

    def _mean(self, d: Tensor, width: float) -> Tensor:
        """Mean of exp(−t² / 2 std²) over a box around d."""
        scale = math.sqrt(2) * self.std
        rise = torch.erf((d + width / 2) / scale) - torch.erf((d - width / 2) / scale)
        return rise * (scale * math.sqrt(math.pi) / 2 / width)


@dataclass(frozen=True)
class Highlights(Scene):
    """Small blobs of great height on an even, dim ground: what a few samples a pixel miss or overrate."""

    blobs: tuple[Blob, ...]
    background: float

    def __post_init__(self) -> None:
        if not self.blobs:
            raise McaaError("Highlights needs one or more blobs, got (): give some")

    def __call__(self, x: Tensor, y: Tensor) -> Tensor:
        total = torch.full_like(x, self.background)
        for blob in self.blobs:
            total = total + blob(x, y)
        return total

    def _closed_forms(self) -> Mapping[type[Filter], ClosedForm]:
        return {Gaussian: partial(self._sum, Gaussian), Box: partial(self._sum, Box)}

    def _sum(self, kind: type[Filter], cx: Tensor, cy: Tensor, size: float) -> Tensor:
        total = torch.full_like(cx, self.background)
        for blob in self.blobs:
            total += blob._closed_forms()[kind](cx, cy, size)
        return total
