"""A disc, in one channel or in colour."""

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


@dataclass(frozen=True)
class Disc(Scene):
    """1 within r of (cx, cy), else 0; in pixels.

    The box is closed (area of a circle in a square). The Gaussian is the distribution of Rice (a noncentral
    χ² of two degrees), here by a quadrature of one dimension good to 1e-12.
    """

    cx: float
    cy: float
    r: float

    def __post_init__(self) -> None:
        require_positive(self, r=self.r)

    def __call__(self, x: Tensor, y: Tensor) -> Tensor:
        return ((x - self.cx) ** 2 + (y - self.cy) ** 2 <= self.r**2).to(x.dtype)

    def _closed_forms(self) -> Mapping[type[Filter], ClosedForm]:
        return {Gaussian: self._gaussian, Box: self._box}

    def _gaussian(self, cx: Tensor, cy: Tensor, std: float) -> Tensor:
        """Chords at r sin θ across the line to the pixel, each a difference of Φ.

        The integrand is analytic and of period π in θ, so that the trapezoidal rule converges exponentially.
        """
        d = torch.hypot(cx - self.cx, cy - self.cy) / std
        r = self.r / std
        n = 2 * math.ceil(4 * r + 16)
        cover = (d < r).double()
        near = (d - r).abs() < REACH
        d = d[near]
        total = torch.zeros_like(d)
        for k in range(-n // 2 + 1, n // 2):
            sine, cosine = math.sin(math.pi * k / n), math.cos(math.pi * k / n)
            if abs(r * sine) <= REACH:
                weight = r * cosine * math.exp(-0.5 * (r * sine) ** 2) * math.sqrt(math.pi / 2) / n
                total += weight * (torch.special.ndtr(r * cosine - d) - torch.special.ndtr(-r * cosine - d))
        cover[near] = total
        return cover

    def _box(self, cx: Tensor, cy: Tensor, width: float) -> Tensor:
        """The square's outline walked once: triangles from the centre where inside the disc, else sectors."""
        left, top = cx - width / 2 - self.cx, cy - width / 2 - self.cy
        right, bottom = left + width, top + width
        corners = [(left, top), (right, top), (right, bottom), (left, bottom), (left, top)]
        area = torch.zeros_like(left)
        for a, b in pairwise(corners):
            area += self._swept(a, b)
        return area / width**2

    def _swept(self, a: tuple[Tensor, Tensor], b: tuple[Tensor, Tensor]) -> Tensor:
        """Signed area of the disc within the triangle (centre, a, b)."""
        dx, dy = b[0] - a[0], b[1] - a[1]
        length2 = dx**2 + dy**2
        middle = -(a[0] * dx + a[1] * dy) / length2
        distance2 = (a[0] * dy - a[1] * dx) ** 2 / length2
        half = ((self.r**2 - distance2).clamp_min(0) / length2).sqrt()
        enter, leave = (middle - half).clamp(0, 1), (middle + half).clamp(0, 1)
        p = (a[0] + enter * dx, a[1] + enter * dy)
        q = (a[0] + leave * dx, a[1] + leave * dy)
        return 0.5 * (_cross(p, q) + self.r**2 * (_angle(a, p) + _angle(q, b)))


def _cross(u: tuple[Tensor, Tensor], v: tuple[Tensor, Tensor]) -> Tensor:
    return u[0] * v[1] - u[1] * v[0]


def _angle(u: tuple[Tensor, Tensor], v: tuple[Tensor, Tensor]) -> Tensor:
    return torch.atan2(_cross(u, v), u[0] * v[0] + u[1] * v[1])


@dataclass(frozen=True)
class ColorDisc(Scene):
    """A disc of one colour on a ground of another, as many channels as the colours have."""

    disc: Disc
    inside: tuple[float, ...]
    outside: tuple[float, ...]

    def __post_init__(self) -> None:
        if not self.inside or len(self.inside) != len(self.outside):
            raise McaaError(f"ColorDisc needs colours of one length, got {self.inside} and {self.outside}: match them")

    def __call__(self, x: Tensor, y: Tensor) -> tuple[Tensor, ...]:
        return self._mix(self.disc(x, y))

    def _mix(self, cover: Tensor) -> tuple[Tensor, ...]:
        return tuple(b + (a - b) * cover for a, b in zip(self.inside, self.outside, strict=True))

    def _closed_forms(self) -> Mapping[type[Filter], ClosedForm]:
        return {kind: partial(self._mixed, form) for kind, form in self.disc._closed_forms().items()}

    def _mixed(self, form: ClosedForm, cx: Tensor, cy: Tensor, size: float) -> Tensor:
        return torch.stack(self._mix(form(cx, cy, size)))
