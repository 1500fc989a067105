"""Any mixture of estimators and densities, (2) and (3): what (6) and (8) are two cases of."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torch_mcaa.allocation import Allocation, Uniform
from torch_mcaa.dense import described
from torch_mcaa.densities import Density
from torch_mcaa.errors import McaaError
from torch_mcaa.estimators.base import Task
from torch_mcaa.estimators.paper.importance import Importance, effective
from torch_mcaa.estimators.paper.pixelwise import ROUNDS, Combine, Drawn, Pixels, Pixelwise
from torch_mcaa.estimators.paper.tail import pareto_k
from torch_mcaa.moments import Moments
from torch_mcaa.patterns import Independent

Terms = Callable[[Tensor, Tensor, Tensor], Tensor]
_SIGNIFICANCE = 1e-6


@dataclass(frozen=True, repr=False, init=False)
class Pairs(Pixelwise):
    """(2): G = sum over the pairs (g, rho) of the mean of g over independent points of density rho, unbiased if and only if (3) holds.

    g(values, dx, dy) turns the values of f in one channel, at the points with offsets dx, dy in px from the pixel's centre, into terms; all
    are (n, P) float64, of n points in each of P pixels. One point of each pair: sum over the pairs of E[g] = phi, (3). So (8) is
    g = f w / (m rho), without s_j, and (6) the one pair f w / w'. n evaluations are shared out evenly, what is left to the first pairs.

    The standard error is the root of the sum of the pairs' variances; of a pair with one point, t^2 stands for the variance of its term t,
    which is larger by the square of the mean. Predicted is the same. `ess` is that of the terms g would have for f = 1.

    Attributes:
        pairs: the (g, rho).
        checked: from `check`: whether each pixel is also estimated by Importance(Independent()), with as many points again, beyond spp.

    Raises:
        McaaError: no pairs or more than 63, a g that is not callable, a rho that is not a Density; when rendering, a g whose terms have
            another shape or are not finite, and with check=True, two estimates that differ by more than chance would have it once in 10^6
            rounds of a picture: (3) does not hold, or a rho is so narrow that the variance cannot be seen.
    """

    pairs: tuple[tuple[Terms, Density], ...]
    checked: bool

    def __init__(
        self,
        pairs: Sequence[tuple[Terms, Density]],
        check: bool = False,
        *,
        allocation: Allocation = Uniform(),  # noqa: B008
        combine: Combine = "fixed",
    ) -> None:
        mend = "pass a list of them, such as [(lambda f, dx, dy: f * w(dx, dy) / rho.pdf(dx, dy), rho)]"
        if not isinstance(pairs, (list, tuple)) or not 0 < len(pairs) < ROUNDS:
            raise McaaError(f"Pairs needs 1 to {ROUNDS - 1} pairs (g, rho), got {pairs!r}; {mend}")
        for pair in pairs:
            if not isinstance(pair, (list, tuple)) or len(pair) != 2:
                raise McaaError(f"Pairs: every pair must be (g, rho), got {pair!r}; {mend}")
            if not callable(pair[0]):
                raise McaaError(f"Pairs: g must be a function g(values, dx, dy), got {pair[0]!r}; {mend}")
            if not isinstance(pair[1], Density):
                raise McaaError(f"Pairs: rho must be a Density such as Normal(0.3), got {pair[1]!r}; {mend}")
        if not isinstance(check, bool):
            raise McaaError(f"Pairs: check must be True or False, got {check!r}; more pairs go into the list")
        object.__setattr__(self, "pairs", tuple((g, rho) for g, rho in pairs))
        object.__setattr__(self, "checked", check)
        object.__setattr__(self, "allocation", allocation)
        object.__setattr__(self, "combine", combine)
        self.__post_init__()

    def __repr__(self) -> str:
        names = ", ".join(f"({getattr(g, '__name__', type(g).__name__)}, {rho!r})" for g, rho in self.pairs)
        said = ["check=True"] * self.checked + [f"allocation={self.allocation!r}"] * (self.allocation != Uniform())
        return f"Pairs({', '.join([f'[{names}]', *said, *[f'combine={self.combine!r}'] * (self.combine != 'fixed')])})"

    @property
    def fewest(self) -> int:
        return len(self.pairs)

    def check(self, task: Task) -> None:
        super().check(task)
        if self.checked:
            Importance(Independent()).check(task)

    def bias(self, task: Task, spp: int) -> tuple[str, ...]:
        reason = "Pairs: that the pairs fulfil (3) is not checked; check=True does it"
        return super().bias(task, spp) + (() if self.checked else (reason,))

    def draw(self, pixels: Pixels, n: int) -> Drawn:
        k = len(self.pairs)
        shares, weights, invalid = [], [], []
        value = variance = None
        for index, (g, rho) in enumerate(self.pairs):
            size = n // k + (index < n % k)
            dx, dy = rho.sample(*pixels.points(Independent(), size, index + 1))
            values, valid = pixels.evaluate(dx, dy)
            terms = torch.stack([_terms(index, g, channel, dx, dy) for channel in values])
            kept = torch.ones_like(dx, dtype=torch.bool) if valid is None else valid
            moments = Moments.of(terms, 1, kept)
            terms = torch.where(kept, terms, 0)
            spread = torch.where(moments.count > 1, moments.variance_of_mean, terms.square().sum(1))
            value = moments.mean if value is None else value + moments.mean
            variance = spread if variance is None else variance + spread
            shares.append(terms / size)
            weights.append(_terms(index, g, torch.ones_like(dx), dx, dy) / size)
            invalid.append((~kept).sum(0))
        assert value is not None and variance is not None
        if self.checked:
            _compare(pixels, n, value, variance)
        lost = torch.stack(invalid).sum(0).to(variance)
        return Drawn(value, variance, variance, effective(torch.cat(weights)), pareto_k(torch.cat(shares, 1)), lost)


def _terms(index: int, g: Terms, values: Tensor, dx: Tensor, dy: Tensor) -> Tensor:
    terms = g(values, dx, dy)
    if not isinstance(terms, Tensor) or terms.shape != values.shape:
        raise McaaError(
            f"Pairs: g of pair {index} must return a tensor of the shape of its arguments, {tuple(values.shape)}, got {described(terms)}"
        )
    terms = terms.to(torch.float64)
    bad = int((~torch.isfinite(terms)).sum())
    if bad:
        raise McaaError(
            f"Pairs: g of pair {index} returned {bad} terms that are not finite; divide by no density that may be 0 at a point"
        )
    return terms


def _compare(pixels: Pixels, n: int, value: Tensor, variance: Tensor) -> None:
    """Raise where `value` (C, P) and Importance differ, in a pixel or in their sum, by more than chance allows.

    Both variances are taken about the common mean, as a test of two proportions does: for n points each, that adds d^2 / 2n for a difference
    d. So terms that happen to be all equal are no proof, and z never passes sqrt(2 n): few points can only tell by their sum.
    """
    other = Importance(Independent()).draw(pixels, n)
    difference = value - other.value
    both = variance + other.variance + difference.square() / (2 * n)
    known = torch.isfinite(difference) & torch.isfinite(both)
    difference, both = torch.where(known, difference, 0), torch.where(known, both, 0)
    # rounding: equal constants may differ in their last bits, with no variance at all
    both = both + (1e-12 * other.value.nan_to_num(nan=0.0)).square()
    total = difference.sum(1) / both.sum(1).sqrt()
    z = torch.cat([(difference / both.sqrt()).flatten(), total]).nan_to_num(nan=0.0).abs()
    screen = pixels.task.screen
    tests = 2 * len(value) * screen.height * screen.width
    bound = -float(torch.special.ndtri(torch.tensor(_SIGNIFICANCE / tests / 2, dtype=torch.float64)))
    if float(z.max()) > bound:
        where = "the sum over pixels" if int(z.argmax()) >= difference.numel() else "a pixel"
        mean = float(difference.mean())
        raise McaaError(
            f"Pairs: the pairs and Importance differ in {where} by {float(z.max()):.1f} standard errors ({mean:+.3g} a pixel), above "
            f"{bound:.1f}, so (3), sum of E[g] = phi, does not hold, or a rho is too narrow; for m densities g = f w / (m rho)"
        )
