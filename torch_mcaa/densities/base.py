"""What a sampling density is: w' of Halton, Monte Carlo Anti-Aliasing, (6), around a pixel's centre."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

import torch
from torch import Tensor

from torch_mcaa.filters.base import Filter

_PROBES = 256


class Density(ABC):
    """A probability density over the plane; dx (right) and dy (down) are in pixels from the pixel's centre.

    Tensors are floating, of shapes that broadcast, on any device; results have their dtype and device.
    """

    @property
    @abstractmethod
    def radius(self) -> tuple[float, float]:
        """Half-widths (x, y) in pixels outside which the density is 0, `math.inf` where there are none."""

    @abstractmethod
    def sample(self, u: Tensor, v: Tensor) -> tuple[Tensor, Tensor]:
        """Map u, v in [0, 1) to a point (dx, dy) with this density; finite for every such u, v."""

    @abstractmethod
    def pdf(self, dx: Tensor, dy: Tensor) -> Tensor:
        """The density in 1/px², of integral 1."""

    def covers(self, filter: Filter) -> bool:
        """Whether w' > 0 wherever w ≠ 0, without which (6) is silently biased.

        The radii decide, and then 256² points spread over the filter's support, in float64: a hole wider than
        1/128 of its radius is found, and so is a density that underflows to 0 there. Over an infinite support
        only the radii are compared.
        """
        radius = filter.radius
        if any(own < needed for own, needed in zip(self.radius, radius, strict=True)):
            return False
        if math.inf in radius:
            return True
        # Offset by an irrational part of a step, so as not to hit the zeros between lobes, which do no harm.
        steps = (torch.arange(_PROBES, dtype=torch.float64) + 1 / math.pi) / _PROBES * 2 - 1
        dx, dy = steps * radius[0], steps[:, None] * radius[1]
        return not bool(((self.pdf(dx, dy) == 0) & (filter(dx, dy) != 0)).any())
