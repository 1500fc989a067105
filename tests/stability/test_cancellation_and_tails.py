"""Numbers that lie far apart: small variances about large means, pixels far from the origin, tails without a second moment."""

from __future__ import annotations

import math
import warnings

import pytest
import torch
from every_estimator import ALL, BY_DENSITY, BY_FILTER, CHANCE, ENOUGH, PER_PIXEL, SHARED, rms, z_score
from torch import Tensor

import torch_mcaa as mcaa
from torch_mcaa.errors import McaaWarning
from torch_mcaa.integrand import Function
from torch_mcaa.moments import Moments

STEP = 2.0**-10
"""Of float32 between 8192 and 16384: what 10^4 + STEP k can hold."""


def grains(x: Tensor, y: Tensor) -> Tensor:
    """STEP times a whole number from 0 to 7, one value a strip of 0.1 px."""
    return STEP * torch.remainder((10 * x + 3 * y).floor(), 8)


def test_08_cancellation_in_the_moments() -> None:
    """10^4 + STEP k in float32: 3 digits of the variance, here of all 52 bits but those of the mean.

    Naive: the mean of squares less the square of the mean, in float32, is off by 10^5 times the variance, or negative.
    """
    k = torch.randint(0, 8, (1, 1000, 50), generator=torch.Generator().manual_seed(0))
    small = STEP * k.to(torch.float32)
    large = 1e4 + small
    naive = large.square().mean(1) - large.mean(1).square()
    exact = (STEP * k.to(torch.float64)).var(1)
    assert float(((naive - exact).abs() / exact).median()) > 1e4
    torch.testing.assert_close(Moments.of(large, 1).variance, exact, rtol=1e-6, atol=0)


@pytest.mark.parametrize("sizes", [[500, 500], [1, 999], [3, 0, 997], [250] * 4])
def test_08_cancellation_when_merging(sizes: list[int]) -> None:
    """Moments merged from parts are those of one pass: to 1e-6 of the variance, whose terms are known to 1e4 eps / STEP = 2e-9.

    Naive, merging sums of squares: 10^8 against a variance of 5e-6, 4 digits too few in float64.
    """
    terms = 1e4 + STEP * torch.randint(0, 8, (2, 1000, 30), generator=torch.Generator().manual_seed(1)).to(torch.float32)
    valid = torch.rand(1000, 30, generator=torch.Generator().manual_seed(2)) < 0.9
    for kept in (None, valid):
        parts = [
            Moments.of(t, 1, v) for t, v in zip(terms.split(sizes, 1), [None] * len(sizes) if kept is None else kept.split(sizes))
        ]
        merged = parts[0]
        for part in parts[1:]:
            merged = merged.merge(part)
        whole = Moments.of(terms, 1, kept)
        for one, two in ((merged, whole), (parts[-1].merge(merged), merged.merge(parts[-1]))):
            torch.testing.assert_close(one.count.expand_as(one.mean), two.count.expand_as(two.mean), rtol=0, atol=0)
            torch.testing.assert_close(one.mean, two.mean, rtol=1e-15, atol=0)
            torch.testing.assert_close(one.variance, two.variance, rtol=1e-6, atol=0)


WITH_FIXED_PLACES = [
    e for e in BY_FILTER if e.allocation == mcaa.Uniform() and not isinstance(e, (mcaa.AdaptiveImportance, mcaa.OrderedStrata))
]
"""Those that learn where to look from the values look elsewhere when a constant is added, or when rounding breaks a tie."""


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("chosen", WITH_FIXED_PLACES, ids=repr)
def test_08_cancellation_in_a_picture(chosen: mcaa.Importance, dtype: torch.dtype) -> None:
    """f and 10^4 + f at the same points have the same predicted variance and, in float64, the same standard error, to 3 digits.

    Naive, lambda - phi^2 of (10) in float32: nothing of the variance is left. All weights are 1.
    """
    low, high = (mcaa.render(f, (8, 8), estimator=chosen, spp=16, dtype=dtype) for f in (grains, lambda x, y: 1e4 + grains(x, y)))
    assert low.predicted_variance is not None and high.predicted_variance is not None
    torch.testing.assert_close(high.predicted_variance, low.predicted_variance, rtol=1e-3, atol=0)
    if dtype == torch.float64:
        torch.testing.assert_close(high.stderr, low.stderr, rtol=1e-3, atol=0)
        torch.testing.assert_close(high.image - 1e4, low.image, rtol=0, atol=1e-10)


@pytest.mark.parametrize("chosen", SHARED, ids=repr)
def test_08_cancellation_of_shared_points(chosen: mcaa.Shared) -> None:
    """The same in float64, to 2 digits, since 10^4 times the rounding of the weights' sum adds some.

    Naive: 10^4 times the spread of the sum of weights, 2e-7, would be a third of f itself.
    """
    low, high = (
        mcaa.render(f, (8, 8), estimator=chosen, spp=16, dtype=torch.float64) for f in (grains, lambda x, y: 1e4 + grains(x, y))
    )
    torch.testing.assert_close(high.stderr, low.stderr, rtol=1e-2, atol=0)
    torch.testing.assert_close(high.image - 1e4, low.image, rtol=0, atol=1e-8)


@pytest.mark.parametrize("at", [65_536.0, 1e6])
@pytest.mark.parametrize("chosen", ALL, ids=repr)
def test_09_large_coordinates(chosen: mcaa.Importance, at: float) -> None:
    """The same picture about (at, -at) as about the origin: 2e-5, the float32 rounding of f there and here.

    Naive: float32 has 128 places a pixel at 65,536 and 16 at 10^6; jitter collapses and a tone of 0.7 c/px is off by
    2 pi 0.7 / 256 = 2e-2 and more.
    """
    x = at + torch.rand(1000, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    assert len(x.to(torch.float32).unique()) <= 130
    asked: list[torch.dtype] = []

    def tone(x0: float, y0: float) -> Function:
        def f(x: Tensor, y: Tensor) -> Tensor:
            asked.append(x.dtype)
            return torch.sin(2 * math.pi * 0.7 * (x - x0)) * torch.cos(2 * math.pi * 0.3 * (y - y0))

        return f

    near = mcaa.render(tone(0, 0), (5, 6), estimator=chosen, spp=ENOUGH)
    asked.clear()
    far = mcaa.render(tone(at, -at), (5, 6), estimator=chosen, spp=ENOUGH, extent=(at, at + 6, -at, -at + 5))
    assert set(asked) == {torch.float64}
    if any(name in repr(chosen) for name in ("allocation", "OrderedStrata", "Mixture")):
        # a tie broken by rounding moves a whole evaluation: within the errors they report
        assert float(((far.image - near.image) / torch.hypot(far.stderr, near.stderr)).abs().max()) < 5
    else:
        torch.testing.assert_close(far.image, near.image, rtol=0, atol=2e-5)


@pytest.mark.parametrize("chosen", [mcaa.Shared(), mcaa.Importance(mcaa.Jittered())], ids=repr)
def test_09_large_pixels(chosen: mcaa.Importance) -> None:
    """A picture of 70,000 columns: the last pixels of a sawtooth are as good as the first ones.

    Naive: float32 pixel + jitter rounds to 128 places a pixel, and (near the right end of a pixel) into the next one. The root mean
    square errors of the 2,000 first and last columns are each known to 5 %, so their ratio to 20 % at 1e-4.
    """
    picture = mcaa.render(lambda x, y: x - x.floor(), (1, 70_000), filter=mcaa.Box(), estimator=chosen, spp=16)
    error = picture.image[0, 0] - 0.5
    assert 0.8 < rms(error[-2000:]) / rms(error[:2000]) < 1.25
    assert 0.8 < rms(picture.stderr[0, 0, -2000:]) / rms(picture.stderr[0, 0, :2000]) < 1.25


def pole(x: Tensor, y: Tensor) -> Tensor:
    """r^-1.5 about (8.3, 8.6): integrable, its square is not."""
    return (torch.hypot(x - 8.3, y - 8.6) + 1e-30).pow(-1.5)


TAILED = [e for e in PER_PIXEL if not isinstance(e, mcaa.Crude) and not isinstance(e.allocation, mcaa.Neyman)]


def heavy(chosen: mcaa.Importance, spp: int, seed: int) -> tuple[int, mcaa.Rendering]:
    """How many pixels have no standard error, which a warning must say if there are any; and the picture."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        warnings.filterwarnings("ignore", "Importance.Lattice")
        picture = mcaa.render(pole, (17, 9), estimator=chosen, spp=spp, seed=seed, extent=(4, 13, 4, 21))
    without = int(picture.stderr.isinf().any(0).sum())
    assert [w.category for w in caught] == [McaaWarning] * (without > 0)
    assert not without or f"in {without} pixels" in str(caught[0].message)
    assert bool(picture.image.isfinite().all())
    assert bool(picture.stderr[0, 10:].isfinite().all())
    return without, picture


@pytest.mark.parametrize("chosen", TAILED, ids=repr)
def test_10_heavy_tails(chosen: mcaa.Importance) -> None:
    """r^-1.5 at a point, 24 seeds: +inf standard errors there, a warning with their count, and finite ones 4 px away.

    Naive: s^2 / n, finite in every sample and without a limit. A tail index found for 0.7 of the pictures, the least for independent terms, is
    found 7 times or more but for 2e-5; 64 points find it once or more at a rate of 0.4, or say by NaN that they cannot tell.
    """
    assert sum(heavy(chosen, 256, seed)[0] > 0 for seed in range(24)) >= 7
    few = [heavy(chosen, 64, seed) for seed in range(24)]
    assert any(without for without, _ in few) or all(bool(p.pareto_k.isnan().all()) for _, p in few if p.pareto_k is not None)


def pole_truth() -> float:
    """Pixel (8, 8) of `pole` under Gaussian(0.5): with r = t^2, r^-1.5 r dr = 2 dt, a smooth integrand."""
    t = (torch.arange(2000, dtype=torch.float64) + 0.5) / 2000 * math.sqrt(3.5)
    angle = torch.arange(256, dtype=torch.float64)[:, None] * (2 * math.pi / 256)
    w = mcaa.Gaussian(0.5)(8.3 - 8.5 + t.square() * angle.cos(), 8.6 - 8.5 + t.square() * angle.sin())
    return float(w.sum() * 2 * (math.sqrt(3.5) / 2000) * (2 * math.pi / 256))


@pytest.mark.parametrize("chosen", SHARED, ids=repr)
def test_10_heavy_tails_under_shared_points(chosen: mcaa.Shared) -> None:
    """The pole's own pixel at 64 points over 48 seeds: +inf, or an interval of +-2 standard errors that covers at least 0.80.

    Naive: s^2 / n covers 0.4 to 0.6, with errors of up to 150 standard errors. 0.80 is 4.8 standard deviations below 0.95 for 48 pictures.
    """
    truth, covered = pole_truth(), 0
    for seed in range(48):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", McaaWarning)
            picture = mcaa.render(pole, (17, 17), estimator=chosen, spp=64, seed=seed)
        covered += abs(float(picture.image[0, 8, 8]) - truth) <= 2 * float(picture.stderr[0, 8, 8])
    assert covered >= 0.80 * 48


def test_10_heavy_tails_of_few_points_are_not_judged() -> None:
    """16 points cannot tell a tail: `pareto_k` is NaN, not a number that looks fine. Naive: an index of three terms."""
    picture = mcaa.render(pole, (17, 17), estimator=mcaa.Importance(mcaa.Independent()), spp=16)
    assert picture.pareto_k is not None and bool(picture.pareto_k.isnan().all())


FINITE: dict[str, Function] = {
    "quadratic": lambda x, y: (x - 8) ** 2 + (y - 8) ** 2 - 3 * x * y,
    "wide blob": lambda x, y: torch.exp(-((x - 8) ** 2 + (y - 8) ** 2) / 2),
    "blob": lambda x, y: torch.exp(-((x - 8) ** 2 + (y - 8) ** 2) / 0.18),
    "edge": lambda x, y: (x + 0.3 * y > 9).to(x.dtype),
    "disc": lambda x, y: (torch.hypot(x - 8, y - 8) < 5).to(x.dtype),
    "line": lambda x, y: ((x + 0.3 * y - 9).abs() < 0.05).to(x.dtype),
    "tone": lambda x, y: torch.sin(40 * x) * torch.sin(37 * y),
}


@pytest.mark.parametrize("scene", list(FINITE))
@pytest.mark.parametrize("chosen", TAILED, ids=repr)
def test_10_finite_tails_are_left_alone(chosen: mcaa.Importance, scene: str) -> None:
    """Bounded f, and polynomials: all moments exist, so no warning, and a finite standard error in every pixel.

    Naive: a tail index of few terms takes edges, or the flanks of a blob, for heavy tails. Warnings are errors in these tests.
    """
    for spp in (16, 64):
        if chosen.fewest <= spp:
            picture = mcaa.render(FINITE[scene], (16, 16), estimator=chosen, spp=spp, seed=1)
            assert bool(picture.stderr.isfinite().all())


@pytest.mark.parametrize("chosen", ALL, ids=repr)
def test_dynamic_range(chosen: mcaa.Importance) -> None:
    """10^6 beside 1, in float32: pixels beyond the filter's reach of the bright ones keep 5 digits, or the error they report.

    Naive: sums over the whole picture, as of a Fourier transform in float32, leave 10^6 eps = 0.1 everywhere.
    """

    def f(x: Tensor, y: Tensor) -> Tensor:
        return torch.where(x < 2, 1e6, 1.0) * torch.ones_like(y)

    picture = mcaa.render(f, (8, 16), estimator=chosen, spp=ENOUGH)
    assert bool(picture.stderr.isfinite().all()) and float(picture.stderr.min()) > 0
    dark, bright = picture.image[..., 5:], picture.image[..., 0]
    if chosen in BY_DENSITY or "Pairs" in repr(chosen) or "Mixture" in repr(chosen):
        assert float((dark.mean() - 1).abs()) < 0.05 and float(dark.max()) < 3
        assert abs(z_score(dark, 1.0)) < 1.3 * CHANCE
    else:
        torch.testing.assert_close(dark, torch.ones_like(dark), rtol=0, atol=1e-5)
    assert 0.5e6 < float(bright.mean()) < 1.5e6
