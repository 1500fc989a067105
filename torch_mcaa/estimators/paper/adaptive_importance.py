"""Sequential importance sampling (section 9 of Halton's paper): the density is modelled on the values met so far, in each pixel by itself."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field

import torch
from torch import Tensor

from torch_mcaa.densities import Density, Histogram, Mixture, Normal
from torch_mcaa.densities.histogram import sample_bins
from torch_mcaa.densities.mixture import choose
from torch_mcaa.errors import McaaError
from torch_mcaa.estimators.paper.importance import weighted
from torch_mcaa.estimators.paper.pixelwise import Drawn, Pixels, Sequential, combined
from torch_mcaa.filters import Filter
from torch_mcaa.filters.moments import variance as filter_variance
from torch_mcaa.patterns import Pattern, Sobol
from torch_mcaa.sums import add_rows

_DEFENSIVE = 0.25
"""Share of every round that is drawn from |w|: no weight is above integral |w| over it."""
_STEPS = 8
"""Of the fit of a mixture after each round."""
_BINS = 8
"""At most so many bins along each axis."""


@dataclass(frozen=True, repr=False)
class AdaptiveImportance(Sequential):
    """w'_h modelled on the values of C = f w_h met so far; the next round draws from it.

    Unbiased: each round is, whatever the rounds before it were, and "fixed" weighs round k by the root of k, which is within 1/8 of the best
    weights for any rate of learning between none and 1/k (Owen and Zhou, "The square root rule for adaptive importance sampling", 2020). "pooled"
    weighs all alike; "discard_pilot" leaves the first round out. A share of each round comes from |w| itself.

    Attributes:
        rounds: how many, of as nearly equal numbers of evaluations as can be.
        density: `Histogram`, over equal parts of the filter's inverse cumulative distribution, with the root mean square of f in each; or
            `Mixture`, of normal densities at fixed places over the filter, with weights in proportion to what each explains of |C|
            (population Monte Carlo: Cappe, Douc, Guillin, Marin and Robert, 2008).
        pattern: where in the unit square the points of a round lie.
    """

    rounds: int = 4
    density: type[Density] = Histogram
    pattern: Pattern = field(default_factory=Sobol)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.density not in (Histogram, Mixture):
            raise McaaError(
                f"density must be the class Histogram or Mixture, which each pixel has its own of, got {self.density!r}"
            )

    def draw(self, pixels: Pixels, n: int) -> Drawn:
        sizes = self._sizes(n)
        model: _Model = (_Bins if self.density is Histogram else _Normals)(
            pixels.task.filter, sizes[0], len(pixels), pixels.rows.device
        )
        rounds = []
        for inner, size in enumerate(sizes):
            u, v = pixels.points(self.pattern, size, inner)
            dx, dy, weight = model.sample(u, v)
            values, valid = pixels.evaluate(dx, dy)
            rounds.append(weighted(values, weight, valid, self.pattern, u, v, bounded=True))
            if inner + 1 < self.rounds:
                model.learn(values if valid is None else torch.where(valid, values, 0))
        weights = [1.0 if self.combine == "pooled" else math.sqrt(k + 1) for k in range(self.rounds)]
        if self.combine == "discard_pilot":
            weights[0] = 0.0
        return combined(rounds, weights)

    def count(self, spp: int) -> int:
        return sum(self._sizes(spp))

    def _sizes(self, n: int) -> list[int]:
        return [self.pattern.count(n // self.rounds + (k < n % self.rounds)) for k in range(self.rounds)]


class _Model(ABC):
    """P densities, one a pixel, that learn from what was met at the points they gave."""

    @abstractmethod
    def sample(self, u: Tensor, v: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """(n, P) numbers in [0, 1) to offsets dx, dy and weights w / w'."""

    @abstractmethod
    def learn(self, values: Tensor) -> None:
        """Take in f (C, n, P) at the points of the last sample."""


class _Bins(_Model):
    """Bins in the unit square of the filter's inverse cumulative distribution, so weights are integral |w| over the bin's density."""

    def __init__(self, filter: Filter, size: int, pixels: int, device: torch.device) -> None:
        self.filter = filter
        # one point of the first round in each
        self.side = max(2, min(_BINS, math.isqrt(size)))
        shape = (self.side, self.side, pixels)
        self.masses = torch.full(shape, 1 / self.side**2, dtype=torch.float64, device=device)
        self.count = torch.zeros(shape, dtype=torch.float64, device=device)
        self.squares = torch.zeros_like(self.count)

    def sample(self, u: Tensor, v: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        x, y, density = sample_bins(self.masses, u, v)
        self.bins = (y * self.side).to(torch.int64) * self.side + (x * self.side).to(torch.int64)
        dx, dy, weight = self.filter.sample(x, y)
        return dx, dy, weight / density

    def learn(self, values: Tensor) -> None:
        squares = values.square().mean(0)
        self.count.flatten(0, 1).scatter_add_(0, self.bins, torch.ones_like(squares))
        add_rows(self.squares.flatten(0, 1), self.bins, squares)
        # the neighbours' values count as one more point, since a bin that happened to hold none, or a dark one, says little
        around = _box3(self.squares) / _box3(self.count).clamp_min(1)
        density = ((self.squares + around) / (self.count + 1)).sqrt()
        total = density.sum((0, 1))
        even = 1 / self.side**2
        self.masses = torch.where(total > 0, density / total.clamp_min(torch.finfo(total.dtype).tiny), even)
        self.masses = (1 - _DEFENSIVE) * self.masses + _DEFENSIVE * even


class _Normals(_Model):
    """The filter's density and 3 x 3 normal ones about it, a standard deviation and a quarter of w apart."""

    def __init__(self, filter: Filter, size: int, pixels: int, device: torch.device) -> None:
        self.filter = filter
        (vx, vy), steps = filter_variance(filter), (-1.25, 0.0, 1.25)
        self.normals = [Normal((0.4 * vx, 0.4 * vy), (a * math.sqrt(vx), b * math.sqrt(vy))) for b in steps for a in steps]
        self.weights = torch.full((len(self.normals) + 1, pixels), 0.5 / len(self.normals), dtype=torch.float64, device=device)
        self.weights[-1] = 0.5
        self.parts = torch.empty(len(self.weights), 0, pixels, dtype=torch.float64, device=device)
        self.ratios = torch.empty(0, pixels, dtype=torch.float64, device=device)

    def sample(self, u: Tensor, v: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        chosen, inner = choose(self.weights, u)
        dx, dy, _ = self.filter.sample(inner, v)
        for k, normal in enumerate(self.normals):
            x, y = normal.sample(inner, v)
            dx, dy = torch.where(chosen == k, x, dx), torch.where(chosen == k, y, dy)
        parts = torch.stack([*(normal.pdf(dx, dy) for normal in self.normals), self.filter.pdf(dx, dy)])
        self.weight = self.filter(dx, dy) / (self.weights[:, None] * parts).sum(0)
        self.parts = torch.cat([self.parts, parts], 1)
        return dx, dy, self.weight

    def learn(self, values: Tensor) -> None:
        self.ratios = torch.cat([self.ratios, (values * self.weight).square().mean(0).sqrt()])
        total = self.ratios.sum(0)
        learned = self.weights
        for _ in range(_STEPS):
            # expectation and maximisation of sum |C| / w' log of the mixture; one part in ten is the first guess, so that none dies out
            explained = (learned[:, None] * self.parts / (learned[:, None] * self.parts).sum(0) * self.ratios).sum(1)
            learned = (
                0.9 * torch.where(total > 0, explained / total.clamp_min(torch.finfo(total.dtype).tiny), self.weights)
                + 0.1 * self.weights
            )
        self.weights = (1 - _DEFENSIVE) * learned
        self.weights[-1] += _DEFENSIVE


def _box3(plane: Tensor) -> Tensor:
    """Sums over 3 x 3 neighbours of the first two dims."""
    padded = torch.nn.functional.pad(plane.movedim(-1, 0), (1, 1, 1, 1))
    return torch.nn.functional.avg_pool2d(padded[:, None], 3, 1, divisor_override=1)[:, 0].movedim(0, -1)
