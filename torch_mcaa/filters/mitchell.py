"""The two-parameter family of cubic filters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from torch_mcaa.filters.inverse import TableSampledFilter
from torch_mcaa.filters.validation import number


@dataclass(frozen=True)
class Mitchell(TableSampledFilter):
    """Piecewise cubic over [-2, 2] pixels; (b, c) = (1, 0) is the cubic B-spline, (0, 1/2) Catmull-Rom.

    Source: D. P. Mitchell, A. N. Netravali, Reconstruction Filters in Computer Graphics, SIGGRAPH 1988.
    Raises McaaError for b or c outside [-10, 10].
    """

    b: float = 1 / 3
    c: float = 1 / 3

    def __post_init__(self) -> None:
        for name in ("b", "c"):
            value = number("Mitchell", name, getattr(self, name), -10, 10, "the common values lie in [0, 1]")
            object.__setattr__(self, name, value)
        super().__post_init__()

    @property
    def half_width(self) -> float:
        return 2.0

    @property
    def _inner(self) -> tuple[float, float, float]:
        """Coefficients of |d|³, |d|², 1 where |d| <= 1."""
        return 2 - 1.5 * self.b - self.c, -3 + 2 * self.b + self.c, 1 - self.b / 3

    @property
    def _outer(self) -> tuple[float, float]:
        """Coefficients of t³, t² with t = 2 - |d|, where |d| >= 1: (2 - |d|)² divides that piece."""
        return self.b / 6 + self.c, -self.c

    @property
    def sign_changes(self) -> tuple[float, ...]:
        cubic, square, constant = self._inner
        roots = np.roots([cubic, square, 0.0, constant])
        inner = [float(r.real) for r in roots if 0 < r.real < 1 and abs(r.imag) < 1e-9]
        cubic, square = self._outer
        outer = [2 + square / cubic] if cubic and 0 < -square / cubic < 1 else []
        return tuple(side * d for d in (*inner, 1.0, *outer) for side in (-1, 1))

    def profile(self, d: Tensor) -> Tensor:
        x = d.abs().clamp_max(2)
        cubic, square, constant = self._inner
        inner = (cubic * x + square) * x * x + constant
        t = 2 - x
        cubic, square = self._outer
        return torch.where(x <= 1, inner, (cubic * t + square) * t * t)

    def profile_cdf(self, d: Tensor) -> Tensor:
        x = d.abs().clamp_max(2)
        cubic, square, constant = self._inner
        inner = ((cubic / 4 * x + square / 3) * x * x + constant) * x
        t = 2 - x
        cubic, square = self._outer
        outer = 0.5 - (cubic / 4 * t + square / 3) * t * t * t
        return 0.5 + torch.sign(d) * torch.where(x <= 1, inner, outer)


def CatmullRom() -> Mitchell:
    """The interpolating cubic `Mitchell(0, 1/2)`.

    Source: E. Catmull, R. Rom, A Class of Local Interpolating Splines, 1974.
    """
    return Mitchell(0.0, 0.5)
