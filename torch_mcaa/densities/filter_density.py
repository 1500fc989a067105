"""Importance sampling by the filter itself."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from torch_mcaa.densities.base import Density
from torch_mcaa.errors import McaaError
from torch_mcaa.filters.base import Filter


@dataclass(frozen=True)
class FilterDensity(Density):
    """|w| / ∫∫|w| of a filter (for a tabulated grid: the `pdf` of that filter).

    Raises McaaError for what is not a Filter, and for one whose |w| is not integrable (Sinc).
    """

    filter: Filter

    def __post_init__(self) -> None:
        if not isinstance(self.filter, Filter):
            raise McaaError(f"FilterDensity: filter must be a Filter; received {self.filter!r}: pass one such as Gaussian(0.5)")
        _ = self.filter.absolute_integral

    @property
    def radius(self) -> tuple[float, float]:
        return self.filter.radius

    def sample(self, u: Tensor, v: Tensor) -> tuple[Tensor, Tensor]:
        dx, dy, _ = self.filter.sample(u, v)
        return dx, dy

    def pdf(self, dx: Tensor, dy: Tensor) -> Tensor:
        return self.filter.pdf(dx, dy)
