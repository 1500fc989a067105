"""Sequential correlated sampling: a polynomial times w, whose integral is known, is taken from w f, and its integral given back."""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from torch import Tensor

from torch_mcaa.errors import McaaError
from torch_mcaa.estimators.base import Task
from torch_mcaa.estimators.paper.importance import effective, weighted
from torch_mcaa.estimators.paper.pixelwise import Drawn, Pixels, Pixelwise
from torch_mcaa.estimators.paper.tail import pareto_k
from torch_mcaa.filters import Filter
from torch_mcaa.filters.moments import moment, variance
from torch_mcaa.moments import Moments
from torch_mcaa.patterns import Pattern, Sobol

_FEWEST, _FEWEST_POSITIVE = 4, 14
"""Points below which there are no folds: what a mean of f that goes with the sign of w pays for; for w >= 0, a slope."""
_SUPPORT = 2
"""Points a term that a fit needs."""
_SINGULAR = 1e-3
"""A term whose part that no lower term explains is below this share of it is not fitted."""


@dataclass(frozen=True, repr=False)
class ControlVariate(Pixelwise):
    """Sequential correlated sampling: the mean of (C - psi) / w' plus the integral of psi, with C = w f and w' = |w| / integral of |w|.

    psi = p w with a polynomial p in dx, dy fitted to f by least squares. Each of two folds of the points, randomised by itself, is corrected
    by the p fitted on the other, so the value is unbiased. The fitting points alone lower the degree of p, for each pixel and channel: where
    they are fewer than two a term, near a curve on which the terms depend on one another, or where the mean square of the leave-one-out
    errors (PRESS) is larger. Below 14 points, 4 if w has negative lobes, there are no folds and this is `Importance(pattern)`.

    For f that is smooth within the filter, and for w with negative lobes, whose weights alone have a variance. Not for edges: two nets of
    n / 2 points cost more than the fit gains. RMSE over random scenes, Gaussian(0.5):

        n = 64                      quadratics  blobs    discs    edges    axis edges  0.1 px lines  tones < 1 c/px
        Importance(Independent())   9.5e-1      5.6e-3   3.8e-2   3.8e-2   3.7e-2      2.3e-2        3.7e-2
        Importance(Sobol())         6.1e-2      4.0e-4   1.3e-2   1.4e-2   6.1e-3      1.9e-2        9.9e-3
        ControlVariate()            2.5e-14     2.3e-4   1.6e-2   1.7e-2   9.8e-3      2.0e-2        1.5e-2

        n = 16
        Importance(Independent())   1.9         1.2e-2   7.5e-2   7.7e-2   7.7e-2      4.5e-2        7.5e-2
        Importance(Sobol())         2.8e-1      1.8e-3   3.6e-2   3.7e-2   2.5e-2      4.1e-2        3.7e-2
        ControlVariate()            5.4e-2      1.4e-3   4.3e-2   4.5e-2   3.6e-2      4.3e-2        4.9e-2

    A ramp under Lanczos(3), 16 points: 6.7e-1 by Importance(Sobol()), 2e-15 by ControlVariate(). Also measured: four folds cost edges
    another 20 to 60 %, and make 16 points enough for a quadratic; without PRESS, Sobol points do as well, independent ones 10 % worse on
    lines and tones.

    The tail index is the smaller of those of the terms before and after psi is taken away: psi / w' is bounded, so the two are equal, and
    either may seem to have a heavy tail where there is none.

    Attributes:
        order: the largest degree of p, 0 to 3.
        pattern: where in the unit square the points of each fold lie.

    Raises:
        McaaError: another order; when rendering, a filter whose moments are not finite (Sinc).
    """

    order: int = 2
    pattern: Pattern = field(default_factory=Sobol)

    def __post_init__(self) -> None:
        super().__post_init__()
        if isinstance(self.order, bool) or not isinstance(self.order, int) or not 0 <= self.order <= 3:
            raise McaaError(f"order must be 0, 1, 2 or 3, the degree of the polynomials, got {self.order!r}")

    def count(self, spp: int) -> int:
        def usable(n: int) -> bool:
            return all(self.pattern.count(size) == size for positive in (False, True) for size in self._folds(n, positive))

        return next(n for n in range(spp, 0, -1) if usable(n))

    def _folds(self, n: int, positive: bool) -> list[int]:
        """The sizes of the folds of n points; the first is the power of two nearest to half of them, for the sake of nets."""
        if n < _FEWEST or (positive and n < _FEWEST_POSITIVE and self.pattern.count(n) == n):
            return [n]
        first = self.pattern.count(1 << (2 * n // 3).bit_length() - 1)
        return [first, n - first]

    def check(self, task: Task) -> None:
        super().check(task)
        variance(task.filter)

    def draw(self, pixels: Pixels, n: int) -> Drawn:
        filter = pixels.task.filter
        sizes = self._folds(n, positive=filter.absolute_integral < 1 + 1e-9)
        drawn = [pixels.points(self.pattern, size, k) for k, size in enumerate(sizes)]
        dx, dy, weight = filter.sample(*(torch.cat(axis) for axis in zip(*drawn, strict=True)))
        values, valid = pixels.evaluate(dx, dy)
        if len(sizes) == 1:
            return weighted(values, weight, valid, self.pattern, *drawn[0])
        kept = torch.ones_like(weight, dtype=torch.bool) if valid is None else valid
        columns, totals = _monomials(filter, self.order, dx, dy)
        share = kept.to(torch.float64) / kept.sum(0).clamp_min(1)
        value = spread = predicted = torch.zeros_like(values[:, 0])
        residuals: list[Tensor] = []
        start = 0
        for size, (u, v) in zip(sizes, drawn, strict=True):
            fold = slice(start, start + size)
            start += size
            fit = kept * weight.square()
            fit[fold] = 0
            polynomial, integral = _fitted(columns, totals, values, fit)
            residual = torch.where(kept[fold], weight[fold] * (values - polynomial)[:, fold], 0)
            part = share[fold].sum(0)
            moments = Moments.of(residual, 1, kept[fold])
            value = value + torch.where(part > 0, part * (moments.mean + integral), 0)
            # what is left of an edge has lost the slope by which a net's grid is chosen, so without a fit it may tell the error better
            plain = torch.where(kept[fold], weight[fold] * values[:, fold], 0)
            variances = [[self.pattern.variance(each * share[fold], u, v) for each in terms] for terms in (residual, plain)]
            spread = spread + torch.minimum(*(torch.stack(each) for each in variances))
            residuals.append(residual)
            predicted = predicted + torch.where(part > 0, part.square() * moments.variance_of_mean, 0)
        value = torch.where(kept.any(0), value, torch.nan)
        tail = _tail(values * weight, torch.cat(residuals, 1), pixels.task.dtype)
        return Drawn(value, spread, predicted, effective(weight), tail, (~kept).sum(0).to(weight))


def _monomials(filter: Filter, order: int, dx: Tensor, dy: Tensor) -> tuple[list[list[Tensor]], list[list[float]]]:
    """x^i y^j (n, P) by degree i + j, in units of the standard deviation of |w|, and their integrals times w."""
    sx, sy = (v**0.5 for v in variance(filter))
    x, y = dx / sx, dy / sy
    powers = [[(d - j, j) for j in range(d + 1)] for d in range(order + 1)]
    columns = [[x**i * y**j for i, j in each] for each in powers]
    return columns, [[moment(filter, i, j) / (sx**i * sy**j) for i, j in each] for each in powers]


def _fitted(columns: list[list[Tensor]], totals: list[list[float]], values: Tensor, fit: Tensor) -> tuple[Tensor, Tensor]:
    """The polynomials p (C, n, P) fitted to values (C, n, P) with weights `fit` (n, P), and the integrals (C, P) of p w.

    By modified Gram-Schmidt, degree by degree, in which the integrals take part: so every order's fit comes from one pass. An order is
    kept where its PRESS is the least.
    """
    basis: list[tuple[Tensor, Tensor]] = []
    polynomial, integral = torch.zeros_like(values), torch.zeros_like(values[:, 0])
    kept = polynomial, integral
    best = torch.full_like(integral, torch.inf)
    leverage = torch.zeros_like(fit)
    points, supported = (fit > 0).sum(0), torch.ones_like(fit[0], dtype=torch.bool)
    for degree, (same, wholes) in enumerate(zip(columns, totals, strict=True)):
        for column, whole in zip(same, wholes, strict=True):
            total = torch.full_like(fit[0], whole)
            before = (fit * column.square()).sum(0)
            for other, its in basis:
                along = (fit * other * column).sum(0)
                column, total = column - along * other, total - along * its
            left = (fit * column.square()).sum(0)
            supported = supported & (left > _SINGULAR**2 * before)
            scale = torch.where(supported, left.rsqrt(), 0)
            column, total = column * scale, total * scale
            basis.append((column, total))
            leverage = leverage + fit * column.square()
            along = (fit * column * (values - polynomial)).sum(1)
            polynomial, integral = polynomial + along[:, None] * column, integral + along * total
        press = (fit * ((values - polynomial) / (1 - leverage)).square()).sum(1)
        press = torch.where((leverage < 1 - 1e-9).all(0), press, torch.inf)
        better = (
            supported & (points >= _SUPPORT * len(basis)) & (press < best) if degree else torch.ones_like(best, dtype=torch.bool)
        )
        best = torch.where(better, press, best)
        kept = torch.where(better[:, None], polynomial, kept[0]), torch.where(better, integral, kept[1])
    return kept


def _tail(terms: Tensor, residuals: Tensor, dtype: torch.dtype) -> Tensor:
    """(P,): the tail index of terms (C, n, P) and of what is left of them, the smaller; NaN where one of them has none."""
    rounding = 64 * torch.finfo(dtype).eps * terms.abs().amax(1, keepdim=True)
    return torch.minimum(pareto_k(terms), pareto_k(torch.where(residuals.abs() > rounding, residuals, 0)))
