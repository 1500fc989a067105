"""What a filter is: a weight function w about a pixel's centre; (1) of Halton, Monte Carlo Anti-Aliasing."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import ClassVar

import torch
from torch import Tensor

from torch_mcaa.filters.gauss import legendre


class Filter(ABC):
    """A weight function w(dx, dy) of integral 1 over the plane, truncation included; it may be negative.

    dx (right) and dy (down) are in pixels from the pixel's centre: floating tensors of shapes that broadcast,
    on any device. Results have their dtype and device. w is 0 outside the closed support.
    """

    separable: ClassVar[bool]

    @property
    @abstractmethod
    def radius(self) -> tuple[float, float]:
        """Half-widths (x, y) of the support in pixels, `math.inf` where it is unbounded."""

    @property
    @abstractmethod
    def absolute_integral(self) -> float:
        """∫∫|w|, at least 1. Raises McaaError where it diverges."""

    @property
    def learned(self) -> tuple[Tensor, ...]:
        """Tensors that require a gradient and that w depends on, differentiably where grad mode is on."""
        return ()

    @abstractmethod
    def __call__(self, dx: Tensor, dy: Tensor) -> Tensor:
        """w(dx, dy), in 1/px²."""

    def beyond(self, dx: Tensor, dy: Tensor, axis: int) -> Tensor:
        """The integral of w along x (`axis` 0) or y (1) from (dx, dy) on, in 1/px.

        By Gauss-Legendre rules of 8 nodes on panels of a quarter of a pixel or less, unless the filter says otherwise.
        """
        radius = self.radius[axis]
        from_ = (dx if axis == 0 else dy).clamp(-radius, radius)
        panels = math.ceil(8 * radius)
        step, total = (radius - from_) / panels, torch.zeros(())
        nodes, weights = legendre(torch.arange(panels + 1, dtype=torch.float64), 8)
        for node, weight in zip(nodes.tolist(), weights.tolist(), strict=True):
            place = from_ + step * node
            total = total + weight * (self(place, dy) if axis == 0 else self(dx, place))
        return step * total

    @abstractmethod
    def sample(self, u: Tensor, v: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Map u, v in [0, 1) to points (dx, dy) with density `pdf`, and their weight w / pdf = ±∫∫|w|.

        dy grows with v, and dx with u while v is held, so stratified and low-discrepancy (u, v) stay so.
        Every u, v in [0, 1) gives a point inside the support. Raises McaaError where ∫∫|w| diverges.
        """

    @abstractmethod
    def pdf(self, dx: Tensor, dy: Tensor) -> Tensor:
        """The density of the points of `sample`, in 1/px²: |w| / ∫∫|w|, unless the filter says otherwise."""


class SeparableFilter(Filter):
    """w(dx, dy) = profile(dx) · profile(dy)."""

    separable = True

    @property
    @abstractmethod
    def half_width(self) -> float:
        """Half-width of the profile's support in pixels."""

    @property
    @abstractmethod
    def absolute_profile_integral(self) -> float:
        """∫|profile|. Raises McaaError where it diverges."""

    @abstractmethod
    def profile(self, d: Tensor) -> Tensor:
        """The one-dimensional factor, in 1/px: integral 1, and 0 where |d| > half_width."""

    @abstractmethod
    def profile_cdf(self, d: Tensor) -> Tensor:
        """∫ profile over (-inf, d]. It is not monotone where the profile is negative."""

    @abstractmethod
    def profile_sample(self, u: Tensor) -> tuple[Tensor, Tensor]:
        """Map u in [0, 1) to d with density |profile| / ∫|profile|, and the profile's sign there (±1)."""

    @property
    def radius(self) -> tuple[float, float]:
        return self.half_width, self.half_width

    @property
    def absolute_integral(self) -> float:
        return self.absolute_profile_integral**2

    def __call__(self, dx: Tensor, dy: Tensor) -> Tensor:
        return self.profile(dx) * self.profile(dy)

    def beyond(self, dx: Tensor, dy: Tensor, axis: int) -> Tensor:
        along, across = (dx, dy) if axis == 0 else (dy, dx)
        return (1 - self.profile_cdf(along)) * self.profile(across)

    def sample(self, u: Tensor, v: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        dx, sign_x = self.profile_sample(u)
        dy, sign_y = self.profile_sample(v)
        return dx, dy, sign_x * sign_y * self.absolute_integral

    def pdf(self, dx: Tensor, dy: Tensor) -> Tensor:
        return self(dx, dy).abs() / self.absolute_integral
