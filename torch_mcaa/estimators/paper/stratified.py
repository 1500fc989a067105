"""Stratified sampling of a pixel, (7)-(9), with the weights as printed, repaired, or none at all."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import torch
from torch import Tensor

from torch_mcaa.densities import FilterDensity, Mixture, Normal
from torch_mcaa.errors import McaaError
from torch_mcaa.estimators.base import Task
from torch_mcaa.estimators.paper.importance import effective
from torch_mcaa.estimators.paper.pixelwise import Drawn, Pixels, Pixelwise, combined
from torch_mcaa.estimators.paper.tail import pareto_k
from torch_mcaa.estimators.paper.weights import check_weights
from torch_mcaa.filters.moments import variance as filter_variance
from torch_mcaa.moments import Moments
from torch_mcaa.patterns import Independent
from torch_mcaa.patterns.base import skewness_factor
from torch_mcaa.strata import strata_counts

_PILOT = 2
"""The fewest evaluations of a stratum in the pilot of optimal counts, to have a variance."""


@dataclass(frozen=True, repr=False)
class Stratified(Pixelwise):
    """m = m1 m2 strata in each pixel, s_j evaluations in stratum j, adding up to n: (7)-(9).

    * weights="paper": (8) as printed. The strata are normal densities about the centres (24) of the sub-pixels, each of which estimates
      phi / m by itself. Predicted is (12).
    * weights="balance": the same points, divided by the mixture that was sampled, g = f w / sum_k s_k rho_k (the balance heuristic of
      Veach and Guibas, 1995), with a share of them drawn from |w| itself, which bounds every weight (Hesterberg, 1995).
    * weights="filter": strata of equal measure of the filter's own inverse cumulative distribution. All weights have the same modulus, and
      the variance is never above that of no strata.

    Unbiased. Normal strata with (28) are ruinous: for a normal w the second moment (13) is infinite from two strata on, and refused.

    Attributes:
        strata: (m1, m2), along x and y.
        density: the normal density of each stratum, its centre left out; None for (28) with "paper", and with "balance" for the variance
            that makes the mixture's covariance that of w: that of w less that of the centres.
        weights: "paper", "balance" or "filter"; None for "filter", which measures best, and "balance" where a density is given.
        defensive: share of the evaluations drawn from |w| under "balance", 0 <= defensive < 1.
        counts: "equal", or "optimal" for (16): a quarter of the evaluations is a pilot, whose variances choose the rest, which is then combined
            with it as `combine` says. Predicted is (17). Not with "balance", for whose variance (16) is not the minimum.
    """

    strata: tuple[int, int] = (2, 2)
    density: Normal | None = None
    weights: Literal["paper", "balance", "filter"] | None = None
    defensive: float = 0.1
    counts: Literal["equal", "optimal"] = "equal"

    def __post_init__(self) -> None:
        super().__post_init__()
        pair = self.strata
        if not (
            isinstance(pair, tuple)
            and len(pair) == 2
            and all(isinstance(m, int) and not isinstance(m, bool) and m > 0 for m in pair)
        ):
            raise McaaError(f"strata must be two integers of at least 1, (m1, m2) along x and y, got {pair!r}")
        if self.density is not None and not isinstance(self.density, Normal):
            raise McaaError(f"the density of the strata must be Normal(variance), got {self.density!r}; for other pairs use Pairs")
        if self.weights not in (None, "paper", "balance", "filter"):
            raise McaaError(f"weights must be 'paper', 'balance' or 'filter', got {self.weights!r}")
        if self.kind == "filter" and self.density is not None:
            raise McaaError(f"weights='filter' takes its strata from the filter, got density={self.density!r}; leave it out")
        if self.counts not in ("equal", "optimal"):
            raise McaaError(f"counts must be 'equal' or 'optimal', got {self.counts!r}")
        if self.counts == "optimal" and self.kind == "balance":
            raise McaaError(
                "counts='optimal' is (16), which is no minimum for weights='balance'; use 'filter' or 'paper', or equal counts"
            )
        if isinstance(self.defensive, bool) or not isinstance(self.defensive, int | float) or not 0 <= self.defensive < 1:
            raise McaaError(f"defensive must be a share of the evaluations in [0, 1), got {self.defensive!r}; 0.1 is usual")

    @property
    def kind(self) -> Literal["paper", "balance", "filter"]:
        """The weights, chosen where they were left out."""
        return self.weights or ("filter" if self.density is None else "balance")

    @property
    def fewest(self) -> int:
        m = self.strata[0] * self.strata[1]
        return (1 + _PILOT) * m if self.counts == "optimal" else m + (self.kind == "balance" and self.defensive > 0)

    def bias(self, task: Task, spp: int) -> tuple[str, ...]:
        pooled = self.combine == "pooled" and self.counts == "optimal"
        return super().bias(task, spp) + (
            ("combine='pooled': the strata's pilot chose the numbers that weigh it",) if pooled else ()
        )

    def check(self, task: Task) -> None:
        super().check(task)
        if self.kind == "filter":
            _ = task.filter.absolute_integral
            return
        normals = self._normals(task)
        if self.kind == "paper":
            mend = "use weights='balance', weights='filter', or a wider density"
            for normal in normals:
                what = f"a stratum of {self}, a normal density of variance {normal.variance[0]:.4g} x {normal.variance[1]:.4g} px²,"
                check_weights(task, normal, what, mend)
            return
        parts, shares = [*normals], [(1 - self.defensive) / len(normals)] * len(normals)
        if self.defensive:
            parts, shares = [*parts, FilterDensity(task.filter)], [*shares, self.defensive]
        check_weights(task, Mixture(parts, shares), f"the mixture of {self}", "raise the defensive share, or use a wider density")

    def draw(self, pixels: Pixels, n: int) -> Drawn:
        if self.kind == "balance":
            return stratified(*self._balanced(pixels, n), bounded=self.defensive > 0)
        bounded = self.kind == "filter"
        m = self.strata[0] * self.strata[1]
        if self.counts == "equal":
            return stratified(*self._separate(pixels, torch.full((m, len(pixels)), n // m), n % m, 0), bounded)
        each = max(_PILOT, n // (4 * m))
        left = n - each * m
        first = self._separate(pixels, torch.full((m, len(pixels)), each), 0, 0)
        moments = _unit_moments(*first)
        # one more observation, of the pixel's mean variance: a flat pilot of two does not prove a stratum flat
        seen = moments.variance.nan_to_num(nan=0.0).mean(0)
        s = strata_counts(((each * seen + seen.mean(0)) / (each + 1)).sqrt(), left, 1)
        second = self._separate(pixels, s, 0, 1)
        moments = moments.merge(_unit_moments(*second))
        predicted = moments.variance.sqrt().sum(1).square() / left
        main = replace(stratified(*second, bounded), predicted=predicted)
        return combined([stratified(*first, bounded), main], [0.0 if self.combine == "discard_pilot" else each * m, left])

    def _normals(self, task: Task) -> list[Normal]:
        """rho_hj about each sub-pixel's centre, row by row."""
        (m1, m2), spread = self.strata, filter_variance(task.filter)
        beta = spread[0] / (m1 * m2), spread[1] / (m1 * m2)
        if self.kind == "balance":
            # the variance of m equally spaced centres in a unit interval is (1 - m^-2) / 12
            beta = spread[0] - (1 - m1**-2) / 12, spread[1] - (1 - m2**-2) / 12
        if self.density is not None:
            beta = self.density.variance
        if min(beta) <= 1e-3 * min(spread):
            raise McaaError(
                f"{task.filter} is narrower than the spread of the {m1} x {m2} sub-pixels' centres, so no normal strata make up its covariance; "
                "use weights='filter', or give a density"
            )
        return [Normal(beta, ((i + 0.5) / m1 - 0.5, (j + 0.5) / m2 - 0.5)) for j in range(m2) for i in range(m1)]

    def _separate(self, pixels: Pixels, s: Tensor, rest: int, inner: int) -> tuple[Tensor, Tensor, Tensor | None, Tensor]:
        """Strata that estimate their parts by themselves: s (m, P) points each, and one more in the first `rest`.

        Returns f (C, n, P), its coefficients (n, P) in the estimate, where it was finite, and the stratum (n, P).
        """
        (m1, m2), task = self.strata, pixels.task
        s = s.to(pixels.rows.device).clone()
        s[:rest] += 1
        n = int(s[:, 0].sum())
        stratum = (torch.arange(n, device=s.device)[:, None, None] >= s.cumsum(0)).sum(1)
        u, v = pixels.points(Independent(), n, inner)
        if self.kind == "filter":
            dx, dy, sign = task.filter.sample((stratum % m1 + u) / m1, (stratum // m1 + v) / m2)
            coefficient = sign / (m1 * m2)
        else:
            normals = self._normals(task)
            centres = torch.tensor([normal.centre for normal in normals], dtype=torch.float64, device=s.device)[stratum]
            own = Normal(normals[0].variance)
            x, y = own.sample(u, v)
            dx, dy = x + centres[..., 0], y + centres[..., 1]
            coefficient = task.filter(dx, dy) / (m1 * m2 * own.pdf(x, y))
        values, valid = pixels.evaluate(dx, dy)
        coefficient = coefficient / s.gather(0, stratum)
        return values, coefficient, valid, stratum

    def _balanced(self, pixels: Pixels, n: int) -> tuple[Tensor, Tensor, Tensor | None, Tensor]:
        task, normals = pixels.task, self._normals(pixels.task)
        m = len(normals)
        from_filter = min(n - m, max(1, round(self.defensive * n))) if self.defensive else 0
        s = [(n - from_filter) // m + (j < (n - from_filter) % m) for j in range(m)] + [from_filter]
        u, v = pixels.points(Independent(), n)
        starts = [sum(s[:j]) for j in range(m + 1)]
        places = [normal.sample(u[a : a + k], v[a : a + k]) for normal, a, k in zip(normals, starts, s, strict=False)]
        if from_filter:
            places.append(task.filter.sample(u[starts[m] :], v[starts[m] :])[:2])
        dx, dy = (torch.cat(axis) for axis in zip(*places, strict=True))
        mixture = torch.stack([k * normal.pdf(dx, dy) for k, normal in zip(s, normals, strict=False)]).sum(0)
        if from_filter:
            mixture = mixture + from_filter * task.filter.pdf(dx, dy)
        coefficient = task.filter(dx, dy) / mixture
        values, valid = pixels.evaluate(dx, dy)
        index = torch.arange(m + 1, device=u.device).repeat_interleave(torch.tensor(s, device=u.device))
        return values, coefficient, valid, index[:, None].expand_as(u)


def _unit_moments(values: Tensor, coefficient: Tensor, valid: Tensor | None, stratum: Tensor) -> Moments:
    """(C, m, P) moments of f w / (m rho_j): of the terms as if each stratum had one."""
    strata = int(stratum.max()) + 1
    count = torch.zeros(strata, stratum.shape[1], dtype=values.dtype, device=values.device)
    count.scatter_add_(0, stratum, torch.ones_like(coefficient))
    return Moments.by_stratum(values * coefficient * count.gather(0, stratum), stratum, strata, valid)


def stratified(values: Tensor, coefficient: Tensor, valid: Tensor | None, stratum: Tensor, bounded: bool = True) -> Drawn:
    """The sum of coefficient (n, P) times f (C, n, P), of which the terms of one `stratum` (n, P) are alike; its variance is (12).

    With weights that are `bounded` only f itself can be without a second moment.
    """
    invalid = torch.zeros_like(coefficient[0])
    terms = values * coefficient
    if valid is not None:
        invalid = len(valid) - valid.sum(0)
        kept = torch.where(valid, coefficient.abs(), 0).sum(0)
        terms = terms * torch.where(kept > 0, coefficient.abs().sum(0) / kept, torch.nan)
        terms = torch.where(valid | (kept == 0), terms, 0)
    strata = int(stratum.max()) + 1
    moments = Moments.by_stratum(terms, stratum, strata)
    # a stratum of one point has no variance of its own: that of all terms, as if their coefficients were alike, is larger on the mean
    typical = Moments.by_stratum(coefficient.abs()[None], stratum, strata).mean[0]
    alike = (terms / typical.gather(0, stratum)).nan_to_num(nan=0.0, posinf=0.0, neginf=0.0)
    alone = Moments.of(alike, 1).variance[:, None] * typical.square()
    variance = (moments.count * torch.where(moments.count > 1, moments.variance, alone)).nan_to_num(posinf=torch.inf)
    variance = torch.where(moments.count > 0, variance, 0).sum(1)
    reported = variance * torch.stack([skewness_factor(channel) for channel in alike])
    return Drawn(terms.sum(1), reported, variance, effective(coefficient), pareto_k(values if bounded else alike), invalid)
