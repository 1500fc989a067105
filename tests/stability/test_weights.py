"""Weights w / w' of (6) and (8) that are ruinous, missing, of both signs, or not integrable (Halton, Monte Carlo Anti-Aliasing)."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from every_estimator import ALL, BY_FILTER, CHANCE, SHARED, half_plane, rms, z_score
from torch import Tensor

import torch_mcaa as mcaa
from torch_mcaa.errors import McaaError
from torch_mcaa.integrand import Function

GAUSSIAN = mcaa.Gaussian(0.5)


def ones(x: Tensor, y: Tensor) -> Tensor:
    return torch.ones_like(x)


def paper_pixels(strata: tuple[int, int], pixels: int, each: int) -> tuple[Tensor, Tensor, float]:
    """(8) with (28) for f = 1 as printed: values and their (12) from the sample, (pixels,), and the true variance by quadrature."""
    (m1, m2), gamma = strata, 0.25
    m, generator = m1 * m2, torch.Generator().manual_seed(1)
    values, sampled, true = torch.zeros(pixels, dtype=torch.float64), torch.zeros(pixels, dtype=torch.float64), 0.0
    grid = torch.linspace(-2.5, 2.5, 1001, dtype=torch.float64)[:-1] + 0.0025
    for j in range(m):
        rho = mcaa.Normal(gamma / m, ((j % m1 + 0.5) / m1 - 0.5, (j // m1 + 0.5) / m2 - 0.5))
        dx, dy = rho.sample(*(torch.rand(2, each, pixels, dtype=torch.float64, generator=generator)))
        terms = GAUSSIAN(dx, dy) / (m * rho.pdf(dx, dy))
        values += terms.mean(0)
        sampled += terms.var(0) / each
        mu = float((GAUSSIAN(grid, grid[:, None]).square() / rho.pdf(grid, grid[:, None])).sum()) * 0.005**2
        true += (mu - 1) / (m * m * each)
    return values, sampled, true


@pytest.mark.parametrize("strata", [(2, 1), (1, 2), (2, 2), (4, 4)])
def test_01_ruinous_weights(strata: tuple[int, int]) -> None:
    """(8) with the strata of (28) is refused; the mixture of the same strata is unbiased and knows its error.

    Naive: f = 1 comes out as if its standard error were below 1, where it is 5e6 for 2 x 2 strata and 10^55 for 4 x 4, and too dark: the
    rare weights that make up the mean are never met. Reported over true error: 4096 pixels know a root mean square to 2 % or so for bounded
    weights; pooling over neighbours adds up to a third.
    """
    with pytest.raises(McaaError, match="too narrow"):
        mcaa.render(ones, (2, 2), estimator=mcaa.Stratified(strata, weights="paper"), spp=64)
    if strata[0] * strata[1] > 2:
        values, sampled, true = paper_pixels(strata, 4096, 4)
        assert float(sampled.median().sqrt()) < 1 < 1e6 < math.sqrt(true)
        assert float(values.median()) < 0.99
    picture = mcaa.render(ones, (64, 64), estimator=mcaa.Stratified(strata, weights="balance"), spp=64, dtype=torch.float64)
    assert abs(z_score(picture.image, 1.0)) < CHANCE
    assert 0.8 < rms(picture.stderr) / rms(picture.image - 1) < 1.6


@pytest.mark.parametrize("variance", [0.05, 0.1, 0.124])
def test_01_ruinous_density(variance: float) -> None:
    """w' of (25) with 2 b <= g has an infinite second moment but for the cut of w: refused, and not where a Mixture bounds the weights.

    Naive: a small sample variance around a mean that is too low.
    """
    narrow = mcaa.Normal(variance)
    with pytest.raises(McaaError, match=r"too narrow .* Mixture"):
        mcaa.render(ones, (2, 2), estimator=mcaa.Importance(density=narrow))
    repaired = mcaa.Importance(mcaa.Independent(), mcaa.Mixture([narrow, mcaa.FilterDensity(GAUSSIAN)]))
    assert abs(z_score(mcaa.render(ones, (64, 64), estimator=repaired).image, 1.0)) < CHANCE


def test_01_strata_of_the_filter_have_no_weights_at_all() -> None:
    """Naive (8) has ruinous ones; strata of equal measure give a constant exactly, to the rounding of 16 terms in float32."""
    picture = mcaa.render(ones, (8, 8), estimator=mcaa.Stratified((4, 4), weights="filter"), spp=16)
    assert float((picture.image - 1).abs().max()) < 16 * torch.finfo(torch.float32).eps


HOLE = [[1.0, 1.0, 1.0], [1.0, 0.0, 1.0], [1.0, 1.0, 1.0]]


@pytest.mark.parametrize(
    "density",
    [
        mcaa.Histogram([[1.0]], 1.0),
        mcaa.Histogram(HOLE, 2.5),
        mcaa.FilterDensity(mcaa.Box()),
        mcaa.FilterDensity(mcaa.Gaussian(0.5, radius=1.5)),
        mcaa.Mixture([mcaa.FilterDensity(mcaa.Box()), mcaa.Histogram(HOLE, 1.5)]),
    ],
    ids=repr,
)
def test_02_support(density: mcaa.FilterDensity) -> None:
    """w' = 0 where w is not.

    Naive: f = 1 under a density of radius 1 comes out 0.911, at 25 and more of its own standard errors from 1 over 4096 pixels.
    """
    with pytest.raises(McaaError, match="silent bias"):
        mcaa.render(ones, (2, 2), filter=GAUSSIAN, estimator=mcaa.Importance(density=density))
    u = torch.rand(2, 16, 4096, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    dx, dy = mcaa.Histogram([[1.0]], 1.0).sample(*u)
    naive = (GAUSSIAN(dx, dy) * 4).mean(0)
    assert float(naive.mean()) == pytest.approx(0.911, abs=0.02) and z_score(naive, 1.0) < -25


def test_02_support_of_crude_is_the_pixel() -> None:
    """Naive: uniform points in the pixel give the box of the pixel whatever w is, (4). Refused, or done and said in `bias`."""
    with pytest.raises(McaaError, match="biased"):
        mcaa.render(ones, (2, 2), estimator=mcaa.Crude())
    assert any("reaches beyond the pixel" in line for line in mcaa.render(ones, (2, 2), estimator=mcaa.Crude(biased_ok=True)).bias)
    assert mcaa.render(ones, (2, 2), estimator=mcaa.Crude(), filter=mcaa.Box()).bias == ()


def cut_at(edge: float) -> Function:
    return lambda x, y: (x < edge).to(x.dtype)


@pytest.mark.parametrize("filter", [mcaa.Lanczos(3), mcaa.CatmullRom(), mcaa.Mitchell()], ids=repr)
@pytest.mark.parametrize("chosen", BY_FILTER, ids=repr)
def test_06_negative_lobes(chosen: mcaa.Importance, filter: mcaa.Lanczos) -> None:
    """An edge under w < 0, 2048 pixels with one exact value: no value passes what the weights bound, and the mean is right.

    Naive: sum w f / sum w over 4 points spread over the support passes 50 for f in {0, 1}: sum w comes close to 0. Bound: a weight is at
    most integral |w|, or four times that where a quarter of the points is drawn from |w|. |z| of the mean at 1e-5.
    """
    edge = 0.8
    u = torch.rand(2, 4, 4096, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    dx, dy = (2 * u - 1) * filter.half_width
    w = filter(dx, dy)
    assert float(((w * (dx < edge - 0.5)).sum(0) / w.sum(0)).abs().max()) > 50
    picture = mcaa.render(cut_at(edge), (2048, 1), filter=filter, estimator=chosen, spp=16, dtype=torch.float64)
    assert float(picture.image.abs().max()) <= 4 * filter.absolute_integral + 1e-9
    assert abs(z_score(picture.image, half_plane(edge, 0.5, filter))) < CHANCE


@pytest.mark.parametrize("chosen", SHARED, ids=repr)
def test_06_negative_lobes_of_shared_points(chosen: mcaa.Shared) -> None:
    """The same over 32 seeds, since pixels that share points share errors; 5.2 is the quantile of 1e-5 of Student's t of 31 degrees.

    Naive: as above. The ratio's bias is of the order of the variance: a quarter of one picture's error is allowed for it.
    """
    filter, edge = mcaa.Lanczos(3), 0.8
    pictures = [
        mcaa.render(cut_at(edge), (4, 1), filter=filter, estimator=chosen, spp=16, dtype=torch.float64, seed=s).image.mean()
        for s in range(32)
    ]
    error = torch.stack(pictures) - half_plane(edge, 0.5, filter)
    assert float(error.abs().max()) < filter.absolute_integral
    assert abs(float(error.mean())) < (5.2 / math.sqrt(32) + 0.25) * float(error.std())


def test_06_predicted_variance_has_the_square_of_the_integral_of_the_modulus() -> None:
    """(11) for w' = |w| / I and f = 1 is I^2, so (10) is (I^2 - 1) / n: 1 % for the mean of 4096 sample variances of 16 points.

    Naive, without the sign: I in place of 1, and a variance of 0.
    """
    filter = mcaa.Lanczos(3)
    picture = mcaa.render(ones, (64, 64), filter=filter, estimator=mcaa.Importance(mcaa.Independent()), spp=16)
    assert picture.predicted_variance is not None
    expected = (filter.absolute_integral**2 - 1) / 16
    assert float(picture.predicted_variance.mean()) == pytest.approx(expected, rel=0.01)
    assert abs(z_score(picture.image, 1.0)) < CHANCE


def test_07_the_modulus_of_the_full_sinc_has_no_integral() -> None:
    """Naive: sinc cut off somewhere. Its variance grows without bound: integral |sinc| gains 4 / pi^2 with each e-fold of the radius."""
    x = np.linspace(0, 1000, 1_000_001)
    integrals = [2 * np.abs(np.sinc(x[x <= r])).sum() * 0.001 for r in (10, 100, 1000)]
    np.testing.assert_allclose(np.diff(integrals), 4 / np.pi**2 * np.log(10), rtol=0.01)
    with pytest.raises(McaaError, match="not integrable|no finite integral"):
        mcaa.FilterDensity(mcaa.Sinc())


@pytest.mark.parametrize("boundary", ["extend", "renormalize"])
def test_07_full_sinc_over_the_plane_is_refused(boundary: str) -> None:
    """By every estimator, with the reason and the mend. Naive: an estimate whose variance has no bound."""
    for chosen in ALL:
        with pytest.raises(McaaError, match=r"no finite integral.* boundary='zero'"):
            mcaa.render(ones, (4, 4), filter=mcaa.Sinc(), estimator=chosen, boundary=boundary, spp=64)  # type: ignore[arg-type]


def sine_integral_picture(size: int) -> Tensor:
    """(size, size): the integral over the screen of sinc about each pixel's centre, squared per axis, by a fine midpoint rule."""
    at = (torch.arange(size * 1000, dtype=torch.float64) + 0.5) / 1000
    profile = torch.stack([torch.sinc(at - (k + 0.5)).sum() / 1000 for k in range(size)])
    return profile[:, None] * profile


@pytest.mark.parametrize(
    "chosen",
    [mcaa.Shared(), mcaa.Importance(mcaa.Independent(), mcaa.Normal(6.0)), mcaa.Importance(mcaa.Sobol(), mcaa.Normal(6.0))],
    ids=repr,
)
def test_07_full_sinc_on_a_closed_screen(chosen: mcaa.Importance) -> None:
    """f = 1 on 6 x 6 pixels, 0 outside: over 32 seeds each pixel's z is below the quantile of 1e-5 for 36 pixels, 5.1, t-widened to 6.5.

    Naive: sampling |sinc| needs a normalisation that does not exist. Shared weights are a ratio, whose bias the test allows no room for.
    """
    pictures = torch.stack(
        [
            mcaa.render(
                ones, (6, 6), filter=mcaa.Sinc(), estimator=chosen, boundary="zero", spp=64, seed=s, dtype=torch.float64
            ).image[0]
            for s in range(32)
        ]
    )
    error = pictures - sine_integral_picture(6)
    z = error.mean(0) / (error.std(0) / math.sqrt(32))
    assert float(z.abs().max()) < 6.5


@pytest.mark.parametrize(
    "chosen", [*BY_FILTER, mcaa.Stratified(weights="balance"), mcaa.Crude(), mcaa.JumpCorrected(), *SHARED[4:]], ids=repr
)
def test_07_estimators_that_need_the_integral_of_the_modulus_say_so(chosen: mcaa.Importance) -> None:
    """Naive: inf / inf weights, that is NaN pixels, or the sinc cut off without a word."""
    with pytest.raises(McaaError, match=r"Sinc|sinc"):
        mcaa.render(ones, (4, 4), filter=mcaa.Sinc(), estimator=chosen, boundary="zero", spp=64)
