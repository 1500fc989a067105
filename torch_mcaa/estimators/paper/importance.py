"""Importance sampling, (6), and crude Monte Carlo, (4), one pixel at a time."""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from torch import Tensor

from torch_mcaa.densities import Density, FilterDensity
from torch_mcaa.errors import McaaError, warn
from torch_mcaa.estimators.base import Task
from torch_mcaa.estimators.paper.pixelwise import Drawn, Pixels, Pixelwise
from torch_mcaa.estimators.paper.tail import pareto_k
from torch_mcaa.estimators.paper.weights import check_weights
from torch_mcaa.filters import Box
from torch_mcaa.moments import Moments
from torch_mcaa.patterns import Independent, Lattice, Pattern, Sobol


@dataclass(frozen=True, repr=False)
class Importance(Pixelwise):
    """(6): (g, rho) = (w f / (w' n), w'), each pixel with its own points.

    Unbiased. The standard error is the pattern's own; it is the larger of the pixel's and its 3 x 3 neighbours' mean. Predicted is (10),
    the variance of as many independent points.

    Attributes:
        pattern: where in the unit square the points lie.
        density: w'; None is the filter itself, |w| / integral of |w|, for which every weight has the same modulus.
    """

    pattern: Pattern = field(default_factory=Sobol)
    density: Density | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.density is not None and not isinstance(self.density, Density):
            raise McaaError(f"density must be a density such as Normal(0.3), or None for that of the filter, got {self.density!r}")

    def count(self, spp: int) -> int:
        return self.pattern.count(spp)

    def check(self, task: Task) -> None:
        super().check(task)
        if isinstance(self.pattern, Lattice):
            warn(
                "Importance(Lattice()) has no point off its lattices, so its standard error is blind to tones on their dual vectors; "
                "Shared(Lattice()) has, and Importance(Sobol()) needs none"
            )
        density = self._density(task)
        check_weights(task, density, repr(density), "use a density at least as wide as the filter, or a Mixture with FilterDensity")

    def draw(self, pixels: Pixels, n: int) -> Drawn:
        u, v = pixels.points(self.pattern, n)
        filter = pixels.task.filter
        if self.density is None:
            dx, dy, weight = filter.sample(u, v)
        else:
            dx, dy = self.density.sample(u, v)
            weight = filter(dx, dy) / self.density.pdf(dx, dy)
        values, valid = pixels.evaluate(dx, dy)
        return weighted(values, weight, valid, self.pattern, u, v)

    def _density(self, task: Task) -> Density:
        return FilterDensity(task.filter) if self.density is None else self.density


@dataclass(frozen=True, repr=False)
class Crude(Pixelwise):
    """Crude Monte Carlo, (4): independent uniform points in the pixel itself, g = w f / n with n points a square pixel.

    Unbiased when the support of w lies in the pixel.

    Attributes:
        biased_ok: with any other w, run all the same with c = 1 / n as most renderers do, which is the box of the pixel whatever w
            is. `Rendering.bias` says so.
    """

    biased_ok: bool = False

    def check(self, task: Task) -> None:
        super().check(task)
        if not self.biased_ok and not _within_pixel(task):
            raise McaaError(
                f"Crude samples the pixel alone, and {task.filter} reaches {max(task.filter.radius):g} px from its centre, "
                "so the estimate would be biased; use Box(), Importance(), or Crude(biased_ok=True) to have it all the same"
            )

    def bias(self, task: Task, spp: int) -> tuple[str, ...]:
        reason = f"Crude: {task.filter} reaches beyond the pixel; this is the box of the pixel"
        return super().bias(task, spp) + (() if _within_pixel(task) else (reason,))

    def draw(self, pixels: Pixels, n: int) -> Drawn:
        u, v = pixels.points(Independent(), n)
        dx, dy = u - 0.5, v - 0.5
        weight = pixels.task.filter(dx, dy) if _within_pixel(pixels.task) else Box()(dx, dy)
        values, valid = pixels.evaluate(dx, dy)
        return weighted(values, weight, valid, Independent(), u, v)


def weighted(
    values: Tensor, weight: Tensor, valid: Tensor | None, pattern: Pattern, u: Tensor, v: Tensor, bounded: bool = False
) -> Drawn:
    """The mean of f (C, n, P) times weights w / w' (n, P) over a pattern's points u, v (n, P).

    With weights that are `bounded` only f itself can be without a second moment.
    """
    n, terms = len(weight), values * weight
    moments = Moments.of(terms, 1, valid)
    shares = (terms if valid is None else torch.where(valid, terms, 0)) / moments.count.clamp_min(1)[..., None, :]
    variance = torch.stack([pattern.variance(channel, u, v) for channel in shares])
    invalid = torch.zeros_like(weight[0]) if valid is None else n - valid.sum(0)
    return Drawn(
        moments.mean, variance, moments.variance_of_mean, effective(weight), pareto_k(values if bounded else terms), invalid
    )


def effective(weight: Tensor) -> Tensor:
    """(P,): the effective sample size of weights (n, P), Kish's (sum |w|)^2 / sum w^2; 0 where all are 0."""
    return (weight.abs().sum(0).square() / weight.square().sum(0)).nan_to_num(nan=0.0)


def _within_pixel(task: Task) -> bool:
    return max(task.filter.radius) <= 0.5
