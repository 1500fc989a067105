"""How far off a pixel may be."""

from __future__ import annotations

import math
from dataclasses import dataclass
from numbers import Real

import torch
from torch import Tensor

from torch_mcaa.errors import McaaError

FEW_SHIFTS = (2.0, 1.27)
"""What a standard error from two shifts, and from four, counts for: they may agree by chance. With a true one of s tolerances four report less
than 1 / c with a probability of 1 / (c s)^2, and then are beyond two tolerances in P(|z| > 2 / s): at most 0.05, whatever s. Two report the larger
of a pixel's own and the mean with its neighbours', which err in part by themselves: along an edge at most 0.01, of a pixel alone 0.067.
"""


@dataclass(frozen=True)
class Tolerance:
    """How far off a pixel may be: by `absolute`, or `relative` times its modulus, whichever is larger.

    Without an absolute one, pixels that are almost black ask for the most.

    Raises:
        McaaError: a tolerance that is negative or not finite, or neither above 0.
    """

    absolute: float = 0.0
    relative: float = 0.0

    def __post_init__(self) -> None:
        for name, value in (("absolute", self.absolute), ("relative", self.relative)):
            if isinstance(value, bool) or not isinstance(value, Real) or not math.isfinite(value) or value < 0:
                raise McaaError(f"the {name} tolerance must be a finite number of at least 0, got {value!r}")
        if self.absolute == 0 and self.relative == 0:
            raise McaaError("a tolerance must be above 0, got 0; for instance tolerance=1e-3")

    def allowed(self, value: Tensor) -> Tensor:
        """The largest standard error of values."""
        return (self.relative * value.abs()).clamp_min(self.absolute)

    def ratio(self, value: Tensor, variance: Tensor) -> Tensor:
        """Variances in parts of what is allowed, of which 1 is all; NaN counts as +inf, and 0 is 0, where nothing is allowed too."""
        allowed = self.allowed(value)
        ratio = torch.where(variance == 0, 0, variance / (allowed * allowed))
        return torch.nan_to_num(ratio, nan=torch.inf, posinf=torch.inf)

    def excess(self, value: Tensor, variance: Tensor) -> float:
        """The largest `ratio`: the tolerance is met if it is at most 1."""
        return float(self.ratio(value, variance).max())
