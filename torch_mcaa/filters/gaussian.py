"""The Gaussian filter, truncated."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from torch_mcaa.errors import McaaError
from torch_mcaa.filters.base import SeparableFilter
from torch_mcaa.filters.validation import LARGEST, pixels

_RADIUS = 5
"""Standard deviations."""


@dataclass(frozen=True, init=False, repr=False, eq=False)
class Gaussian(SeparableFilter):
    """A normal density of standard deviation `std` along each axis, cut at `radius` (5 std) and renormalised.

    Both in pixels. `sample` computes in float64 whatever u is. A `std` that is a tensor, such as a `torch.nn.Parameter`, is read at each
    use: the filter is what the tensor says then, and `Supersampler` gives it a gradient. Raises McaaError for a `std` or a `radius`
    outside [1e-6, 1e6], or a tensor of more than one number.
    """

    _std: float | Tensor
    _radius: float | None

    def __init__(self, std: float | Tensor = 0.5, radius: float | None = None) -> None:
        if isinstance(std, Tensor):
            if std.numel() != 1 or not std.is_floating_point():
                raise McaaError(f"Gaussian: std must be one number, got a tensor of shape {tuple(std.shape)} and dtype {std.dtype}")
        else:
            std = _checked(std)
        if radius is not None:
            radius = pixels("Gaussian", "radius", radius, "pass the half-width in pixels, or None for 5 std")
        object.__setattr__(self, "_std", std)
        object.__setattr__(self, "_radius", radius)
        _checked(self.std)

    def __repr__(self) -> str:
        return f"Gaussian(std={self.std!r}, radius={self.half_width!r})"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Gaussian) and (self.std, self.half_width) == (other.std, other.half_width)

    def __hash__(self) -> int:
        return hash((Gaussian, self.std, self.half_width))

    @property
    def std(self) -> float:
        return _checked(float(self._std.detach())) if isinstance(self._std, Tensor) else self._std

    @property
    def learned(self) -> tuple[Tensor, ...]:
        return (self._std,) if isinstance(self._std, Tensor) and self._std.requires_grad else ()

    @property
    def half_width(self) -> float:
        return min(_RADIUS * self.std, LARGEST) if self._radius is None else self._radius

    @property
    def absolute_profile_integral(self) -> float:
        return 1.0

    @property
    def _kept(self) -> float:
        """The share of the whole normal density that the truncation keeps."""
        return math.erf(self.half_width / (self.std * math.sqrt(2)))

    def profile(self, d: Tensor) -> Tensor:
        std, kept = self._scale(d)
        density = torch.exp(-0.5 * (d / std) ** 2) / (std * math.sqrt(2 * math.pi) * kept)
        return density.masked_fill(d.abs() > self.half_width, 0)

    def profile_cdf(self, d: Tensor) -> Tensor:
        std, kept = self._scale(d)
        inside = d.clamp(-self.half_width, self.half_width)
        return 0.5 + torch.erf(inside / (std * math.sqrt(2))) / (2 * kept)

    def _scale(self, d: Tensor) -> tuple[float | Tensor, float | Tensor]:
        """The standard deviation and the share that is kept, with a gradient for `learned` ones.

        The truncation of radius None moves with the standard deviation and counts nothing (1e-4 at 5 std).
        """
        if not (self.learned and torch.is_grad_enabled()):
            return self.std, self._kept
        std = self.learned[0].to(d).reshape(())
        return std, self._kept if self._radius is None else torch.erf(self._radius / (std * math.sqrt(2)))

    def profile_sample(self, u: Tensor) -> tuple[Tensor, Tensor]:
        # In float32 the product below rounds the last 1e-6 of the tails to a few values: at 5 std the fourth
        # moment is off by 1.5e-5. The double erfinv is no slower on CPUs.
        z = torch.erfinv((2 * u.double() - 1) * self._kept) * (self.std * math.sqrt(2))
        return z.clamp(-self.half_width, self.half_width).to(u.dtype), torch.ones_like(u)


def _checked(std: object) -> float:
    return pixels("Gaussian", "std", std, "pass the standard deviation in pixels, such as 0.5")
