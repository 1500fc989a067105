"""The Lanczos filter: the sinc under a sinc window."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import torch
from torch import Tensor

from torch_mcaa.filters.inverse import TableSampledFilter
from torch_mcaa.filters.sinc import sinc, sine_integral
from torch_mcaa.filters.validation import integer


@dataclass(frozen=True)
class Lanczos(TableSampledFilter):
    """sinc(d) sinc(d/lobes) over [-lobes, lobes] pixels, divided by its integral (0.997 for 3 lobes).

    Source: C. E. Duchon, Lanczos Filtering in One and Two Dimensions, J. Appl. Meteorology 18 (1979).
    Raises McaaError unless `lobes` is a whole number from 1 to 64.
    """

    lobes: int = 3
    _integral: float = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        lobes = integer("Lanczos", "lobes", self.lobes, 1, 64, "the common values are 2 and 3")
        object.__setattr__(self, "lobes", lobes)
        half = self._from_zero(torch.tensor(float(lobes), dtype=torch.float64))
        object.__setattr__(self, "_integral", 2 * float(half))
        super().__post_init__()

    @property
    def half_width(self) -> float:
        return float(self.lobes)

    @property
    def sign_changes(self) -> tuple[float, ...]:
        return tuple(float(d) for d in range(1 - self.lobes, self.lobes) if d != 0)

    def _from_zero(self, x: Tensor) -> Tensor:
        """∫ sinc(t) sinc(t/lobes) over [0, x], |x| <= lobes: by parts, from the product of sines as a sum."""
        slow, fast = math.pi * (1 - 1 / self.lobes), math.pi * (1 + 1 / self.lobes)
        waves = fast * sine_integral(fast * x) - slow * sine_integral(slow * x)
        return self.lobes / (2 * math.pi**2) * waves - x * sinc(x) * sinc(x / self.lobes)

    def profile(self, d: Tensor) -> Tensor:
        inside = d.abs() <= self.half_width
        return torch.where(inside, sinc(d) * sinc(d / self.lobes) / self._integral, 0)

    def profile_cdf(self, d: Tensor) -> Tensor:
        """In closed form with the sine integral, computed in float64 whatever d is."""
        inside = d.double().clamp(-self.half_width, self.half_width)
        return (0.5 + self._from_zero(inside) / self._integral).to(d.dtype)
