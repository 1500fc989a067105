"""Rounds that choose the next round: pilots without variance, pilots used twice, repeated looks, whole counts."""

from __future__ import annotations

import math

import pytest
import torch
from every_estimator import CHANCE, ENOUGH, PER_PIXEL, rms, z_score
from scipy import stats
from torch import Tensor

import torch_mcaa as mcaa
from torch_mcaa.integrand import Function
from torch_mcaa.strata import strata_counts

INDEPENDENT = mcaa.Independent()


def stripes(coverage: float) -> Function:
    """1 in the left part of every pixel: under Box() each has the value `coverage`, and needs luck to be seen."""
    return lambda x, y: (x - x.floor() < coverage).to(x.dtype)


def simulated(pixels: int, coverage: float, pilot: int, generator: torch.Generator) -> Tensor:
    return (torch.rand(pilot, pixels, generator=generator) < coverage).double()


@pytest.mark.parametrize("allocation", [mcaa.EqualVariance(), mcaa.Neyman()], ids=repr)
def test_03_zero_pilot_variance(allocation: mcaa.Neyman) -> None:
    """A column with a hairline of 0.02 px that 12 pilots in 13 do not see, beside flat ones: every pixel is looked at again.

    Naive, (14) with the pilot's own variances: no second look for flat pilots, 0.0065 instead of 0.02. Unbiased at |z| of 1e-5; the
    reported root mean square error within a factor 2.5, for it rests on the one pixel in five with a hit.
    """
    first = simulated(400_000, 0.02, 4, torch.Generator().manual_seed(0))
    second = simulated(400_000, 0.02, 12, torch.Generator().manual_seed(1))
    flat = first.var(0) == 0
    naive = torch.where(flat, first.mean(0), torch.cat([first, second]).mean(0))
    assert 0.004 < float(naive.mean()) < 0.009
    estimator = mcaa.Importance(INDEPENDENT, allocation=allocation)

    def f(x: Tensor, y: Tensor) -> Tensor:
        return ((x > 4) & (x < 4.02)).to(x.dtype)

    picture = mcaa.render(f, (2048, 9), filter=mcaa.Box(), estimator=estimator, spp=16)
    assert int(picture.spp.min()) > 4
    assert float(picture.stderr.min()) > 0
    column, reported = picture.image[0, :, 4], picture.stderr[0, :, 4]
    assert abs(z_score(column, 0.02)) < CHANCE
    assert 1 / 2.5 < rms(reported) / rms(column - 0.02) < 2.5


def test_03_zero_pilot_variance_of_strata() -> None:
    """The same within a pixel, (16): strata whose two pilot points agree get their share of the rest all the same.

    Naive: s_j* = 0 and a pixel that stays at its pilot's value.
    """
    estimator = mcaa.Stratified((2, 2), weights="filter", counts="optimal")
    picture = mcaa.render(stripes(0.02), (128, 128), filter=mcaa.Box(), estimator=estimator, spp=24)
    assert abs(z_score(picture.image, 0.02)) < CHANCE


@pytest.mark.parametrize("allocation", [mcaa.EqualVariance(), mcaa.Neyman()], ids=repr)
def test_04_reusing_the_pilot(allocation: mcaa.Neyman) -> None:
    """65,536 pixels of coverage 0.10: "fixed" and "discard_pilot" are unbiased, "pooled" is biased, measurably, and says so.

    Naive: "stop when the pilot of 8 saw no variance, else 24 more" averages 0.068 (below), the pilot's variances pooled with it 0.085 and their
    roots 0.091 ("pooled"). The fixed weights' |z| is at 1e-5; the pooled ones' bias is above 20 standard errors.
    """
    pilot = simulated(400_000, 0.10, 8, torch.Generator().manual_seed(0))
    rest = simulated(400_000, 0.10, 24, torch.Generator().manual_seed(1))
    shared = torch.where(pilot.var(0) == 0, pilot.mean(0), torch.cat([pilot, rest]).mean(0))
    assert float(shared.mean()) == pytest.approx(0.068, abs=2e-3)
    for combine in ("fixed", "discard_pilot", "pooled"):
        estimator = mcaa.Importance(INDEPENDENT, allocation=allocation, combine=combine)
        picture = mcaa.render(stripes(0.10), (256, 256), filter=mcaa.Box(), estimator=estimator, spp=16, seed=3)
        z = z_score(picture.image, 0.10)
        if combine == "pooled":
            assert z < -20 and any("pooled" in line for line in picture.bias)
        else:
            assert abs(z) < CHANCE and picture.bias == ()


@pytest.mark.parametrize(
    "chosen",
    [
        mcaa.Stratified(weights="filter", counts="optimal"),
        mcaa.Stratified(weights="filter", counts="optimal", combine="discard_pilot"),
        *[
            mcaa.AdaptiveImportance(density=d, combine=c)
            for d in (mcaa.Histogram, mcaa.Mixture)
            for c in ("fixed", "discard_pilot")
        ],
        mcaa.OrderedStrata(),
        mcaa.OrderedStrata(combine="discard_pilot"),
        mcaa.OrderedStrata(rounds=3),
    ],
    ids=repr,
)
def test_04_rounds_inside_a_pixel(chosen: mcaa.Stratified) -> None:
    """Rounds that learn from rounds, on 16,384 pixels of coverage 0.10: |z| of the mean at 1e-5.

    Naive: rounds averaged by their estimated inverse variances come out 0.087.
    """
    picture = mcaa.render(stripes(0.10), (128, 128), filter=mcaa.Box(), estimator=chosen, spp=32, seed=3)
    assert abs(z_score(picture.image, 0.10)) < CHANCE and picture.bias == ()


def test_04_rounds_of_a_tolerance_are_said_to_choose() -> None:
    """Rounds that end where the samples say so are biased whatever their weights. Naive: silent."""
    picture = mcaa.render(stripes(0.3), (8, 8), estimator=mcaa.Importance(INDEPENDENT), spp=256, tolerance=0.05)
    assert any("ended where" in line for line in picture.bias)


@pytest.mark.parametrize(
    "chosen",
    [
        mcaa.Importance(INDEPENDENT),
        mcaa.Importance(),
        mcaa.Auto(),
        mcaa.JumpCorrected(),
        mcaa.Shared(),
        mcaa.Stratified(weights="filter"),
    ],
    ids=repr,
)
def test_05_repeated_looks(chosen: mcaa.Importance) -> None:
    """One pixel of mean 0.3, 100 times: what `tolerance` promises is P(|error| <= 2 tolerance) >= 0.95, and so an RMSE below twice it.

    Naive: stopping at the first check that passes ends a quarter of the pixels after 4 equal points, with an error of 0.3: six times the
    tolerance. The count is at the binomial quantile of 1e-5 for a probability of 0.95.
    """
    pilot = simulated(100_000, 0.3, 4, torch.Generator().manual_seed(0))
    assert float((pilot.var(0) == 0).double().mean()) > 0.2
    tolerance = 0.05
    errors = torch.tensor(
        [
            float(
                mcaa.render(stripes(0.3), (1, 1), filter=mcaa.Box(), estimator=chosen, spp=1024, tolerance=tolerance, seed=s).image
            )
            - 0.3
            for s in range(100)
        ]
    )
    assert int((errors.abs() <= 2 * tolerance).sum()) >= stats.binom.ppf(1e-5, 100, 0.95)
    assert rms(errors) < 2 * tolerance


def floor(chosen: mcaa.Importance, spp: int) -> int:
    return chosen.fewest if chosen.allocation == mcaa.Uniform() else chosen.fewest + spp // 4


WHOLE = [(e, spp) for e in PER_PIXEL for spp in (17, 31, ENOUGH) if spp >= floor(e, spp)]


@pytest.mark.parametrize(("chosen", "spp"), WHOLE, ids=repr)
def test_14_integer_counts(chosen: mcaa.Importance, spp: int) -> None:
    """n_h are whole, at least the floor, and add up to n exactly; f is asked at just so many points.

    Naive: rounding (14) share by share misses the total and gives 0 to pixels of small variance (shown for Neyman's shares).
    """
    variance = torch.logspace(-6, 0, 35, dtype=torch.float64)
    naive = (35 * spp * variance.sqrt() / variance.sqrt().sum()).round()
    assert int(naive.min()) == 0 or int(naive.sum()) != 35 * spp

    def f(x: Tensor, y: Tensor) -> Tensor:
        return (x + 0.3 * y < 2).to(x.dtype)

    picture = mcaa.render(f, (5, 7), estimator=chosen, spp=spp)
    assert int(picture.spp.sum()) == 35 * chosen.count(spp)
    assert int(picture.spp.min()) >= chosen.fewest


@pytest.mark.parametrize("pattern", [INDEPENDENT, mcaa.Sobol()], ids=repr)
def test_14_a_floor_of_one_evaluation_keeps_a_standard_error(pattern: mcaa.Sobol) -> None:
    """One noisy pixel of 25 draws nearly all of the second round: the others still have what their pilot said, so a finite error.

    Naive: the variance of a second round of one point is unknown, and joined with the pilot's leaves nothing: +inf in every flat pixel.
    """
    estimator = mcaa.Importance(pattern, allocation=mcaa.EqualVariance())

    def f(x: Tensor, y: Tensor) -> Tensor:
        return torch.where((x > 2) & (x < 3) & (y > 2) & (y < 3), 1000 * torch.sin(40 * x), torch.sin(x))

    picture = mcaa.render(f, (5, 5), filter=mcaa.Box(), estimator=estimator, spp=16)
    assert int(picture.spp.argmax()) == 12
    assert bool(picture.stderr.isfinite().all())


def test_14_integer_counts_of_strata() -> None:
    """s_j of (16) over twelve decades of spread: whole, at least the floor, and adding up to n_h in every pixel.

    Naive: rounded shares add up to n_h in fewer than nine pixels of ten, and leave strata without a point.
    """
    spread = torch.exp(torch.empty(6, 64, 64, dtype=torch.float64).uniform_(-14, 14, generator=torch.Generator().manual_seed(0)))
    total = torch.arange(64 * 64).reshape(64, 64) % 40 + 12
    naive = (total * spread / spread.sum(0)).round()
    assert float((naive.sum(0) == total).double().mean()) < 0.9 and int(naive.min()) == 0
    counts = strata_counts(spread, total, 2)
    assert bool((counts.sum(0) == total).all()) and int(counts.min()) >= 2


@pytest.mark.parametrize("weights", ["filter", "balance"])
@pytest.mark.parametrize("spp", [16, 17])
def test_strata_that_do_not_divide(weights: str, spp: int) -> None:
    """16 and 17 points in 3 x 2 strata of unequal numbers: each weighed by its own s_j, so the mean is right and the error known.

    One exact value in 4096 pixels: |z| at 1e-5; reported over true is known to 2 % and pooling adds up to a third. Weighing all alike would
    be off by 1/16 of the difference between strata, 15 standard errors here.
    """
    estimator = mcaa.Stratified((3, 2), weights=weights)  # type: ignore[arg-type]
    picture = mcaa.render(stripes(0.4), (64, 64), filter=mcaa.Box(), estimator=estimator, spp=spp, dtype=torch.float64)
    assert int(picture.spp.min()) == int(picture.spp.max()) == spp
    assert abs(z_score(picture.image, 0.4)) < CHANCE
    assert 0.85 < rms(picture.stderr) / rms(picture.image - 0.4) < 1.5


def test_pooled_and_fixed_weights_are_not_mixed_up() -> None:
    """The weight of a pilot of 4 and 12 more: 4^1.5 : 12^1.5, whatever was seen. Naive: 4 : n_h, which the pilot chose."""
    estimators = [mcaa.Importance(INDEPENDENT, allocation=mcaa.Neyman(), combine=c) for c in ("fixed", "discard_pilot")]  # type: ignore[arg-type]
    fixed, last = (
        mcaa.render(stripes(0.5), (8, 8), filter=mcaa.Box(), estimator=e, spp=16, dtype=torch.float64).image for e in estimators
    )
    pilot = mcaa.render(
        stripes(0.5), (8, 8), filter=mcaa.Box(), estimator=mcaa.Importance(INDEPENDENT), spp=4, dtype=torch.float64
    ).image
    share = 12**1.5 / (4**1.5 + 12**1.5)
    torch.testing.assert_close(fixed, pilot + (last - pilot) * share, rtol=0, atol=1e-12)
    assert math.isclose(share, 0.8386, rel_tol=1e-3)
