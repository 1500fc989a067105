"""Scenes of straight edges: half-plane, stripe, hairlines, checkerboard."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import torch
from torch import Tensor

from torch_mcaa.errors import McaaError
from torch_mcaa.filters.base import Filter
from torch_mcaa.filters.box import Box
from torch_mcaa.filters.gaussian import Gaussian
from torch_mcaa.scenes.base import REACH, ClosedForm, Scene, require_positive


def _across(angle: float, offset: float, x: Tensor, y: Tensor) -> Tensor:
    """Signed distance from the line x cos(angle) + y sin(angle) = offset."""
    return x * math.cos(angle) + y * math.sin(angle) - offset


def _square_above_line(d: Tensor, angle: float, width: float) -> Tensor:
    """Share of a square that lies at positive distance from a line, d the distance of the square's centre.

    The distance of a uniform point is the sum of two uniform ones, so its density is a trapezoid. Measured
    from the nearer end of the trapezoid nothing cancels, however close the line is to an axis.
    """
    a, b = sorted((abs(math.cos(angle)) * width, abs(math.sin(angle)) * width), reverse=True)
    e = ((a + b) / 2 - d.abs()).clamp_min(0)
    outside = torch.where(e < b, e * e / torch.full_like(e, 2 * a * b), (e - b / 2) / a)
    return torch.where(d > 0, 1 - outside, outside)


@dataclass(frozen=True)
class HalfPlane(Scene):
    """1 where x cos(angle) + y sin(angle) ≥ offset, else 0; angle in radians, offset in pixels."""

    angle: float
    offset: float

    def __call__(self, x: Tensor, y: Tensor) -> Tensor:
        return (_across(self.angle, self.offset, x, y) >= 0).to(x.dtype)

    def _closed_forms(self) -> Mapping[type[Filter], ClosedForm]:
        return {Gaussian: self._gaussian, Box: self._box}

    def _gaussian(self, cx: Tensor, cy: Tensor, std: float) -> Tensor:
        return torch.special.ndtr(_across(self.angle, self.offset, cx, cy) / std)

    def _box(self, cx: Tensor, cy: Tensor, width: float) -> Tensor:
        return _square_above_line(_across(self.angle, self.offset, cx, cy), self.angle, width)


@dataclass(frozen=True)
class Stripe(Scene):
    """1 where |x cos(angle) + y sin(angle) − offset| ≤ width / 2, else 0; in radians and pixels."""

    angle: float
    offset: float
    width: float

    def __post_init__(self) -> None:
        require_positive(self, width=self.width)

    def __call__(self, x: Tensor, y: Tensor) -> Tensor:
        return (_across(self.angle, self.offset, x, y).abs() <= self.width / 2).to(x.dtype)

    def _closed_forms(self) -> Mapping[type[Filter], ClosedForm]:
        return {Gaussian: self._gaussian, Box: self._box}

    def _gaussian(self, cx: Tensor, cy: Tensor, std: float) -> Tensor:
        d = _across(self.angle, self.offset, cx, cy)
        return torch.special.ndtr((d + self.width / 2) / std) - torch.special.ndtr((d - self.width / 2) / std)

    def _box(self, cx: Tensor, cy: Tensor, width: float) -> Tensor:
        d = _across(self.angle, self.offset, cx, cy)
        above, below = (_square_above_line(d + side, self.angle, width) for side in (self.width / 2, -self.width / 2))
        return above - below


@dataclass(frozen=True)
class Hairlines(Scene):
    """Parallel stripes of one width, 1 on them and 0 between; angle in radians, offsets and width in pixels.

    Raises McaaError for stripes that touch: the closed form is the sum over the stripes.
    """

    angle: float
    offsets: tuple[float, ...]
    width: float

    def __post_init__(self) -> None:
        require_positive(self, width=self.width)
        ordered = sorted(self.offsets)
        gap = min((b - a for a, b in pairwise(ordered)), default=math.inf)
        if not ordered or not gap > self.width:
            raise McaaError(
                f"Hairlines needs one or more offsets further apart than the width {self.width}, got {self.offsets}: spread them"
            )

    def __call__(self, x: Tensor, y: Tensor) -> Tensor:
        across = _across(self.angle, 0.0, x, y)
        on = torch.zeros_like(x, dtype=torch.bool)
        for offset in self.offsets:
            on = on | ((across - offset).abs() <= self.width / 2)
        return on.to(x.dtype)

    def _closed_forms(self) -> Mapping[type[Filter], ClosedForm]:
        return {Gaussian: partial(self._sum, Gaussian), Box: partial(self._sum, Box)}

    def _sum(self, kind: type[Filter], cx: Tensor, cy: Tensor, size: float) -> Tensor:
        total = torch.zeros_like(cx)
        for offset in self.offsets:
            total += Stripe(self.angle, offset, self.width)._closed_forms()[kind](cx, cy, size)
        return total


@dataclass(frozen=True)
class Checkerboard(Scene):
    """Squares of side period / 2, alternately 1 and 0; a square of 1 begins at `phase`; all in pixels."""

    period: float
    phase: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        require_positive(self, period=self.period)

    def __call__(self, x: Tensor, y: Tensor) -> Tensor:
        scale = 2 / self.period
        cell = torch.floor((x - self.phase[0]) * scale) + torch.floor((y - self.phase[1]) * scale)
        return 1 - torch.remainder(cell, 2)

    def _closed_forms(self) -> Mapping[type[Filter], ClosedForm]:
        return {Gaussian: self._gaussian, Box: self._box}

    def _gaussian(self, cx: Tensor, cy: Tensor, std: float) -> Tensor:
        across = self._wave_gaussian(cx - self.phase[0], std)
        return 0.5 + 0.5 * across * self._wave_gaussian(cy - self.phase[1], std)

    def _box(self, cx: Tensor, cy: Tensor, width: float) -> Tensor:
        across = self._wave_box(cx - self.phase[0], width)
        return 0.5 + 0.5 * across * self._wave_box(cy - self.phase[1], width)

    def _wave_gaussian(self, t: Tensor, std: float) -> Tensor:
        """Mean of the square wave ±1 (+1 on the first half period): the jumps within reach, one Φ each."""
        cell = self.period / 2
        first = torch.floor((t - REACH * std) / cell)
        total = torch.ones_like(t)
        for j in range(1, math.ceil(2 * REACH * std / cell) + 2):
            total += 2 * (-1) ** j * torch.special.ndtr((t - (first + j) * cell) / std)
        return (1 - 2 * torch.remainder(first, 2)) * total

    def _wave_box(self, t: Tensor, width: float) -> Tensor:
        """Mean of the same wave over a box, from its integral, a triangle wave."""
        low, high = (torch.remainder(t + side, self.period) for side in (-width / 2, width / 2))
        return (torch.minimum(high, self.period - high) - torch.minimum(low, self.period - low)) / width
