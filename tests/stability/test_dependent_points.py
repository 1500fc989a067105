"""Points that depend on one another: what they cannot see, and what s^2 / n says of them."""

from __future__ import annotations

import math
import warnings

import numpy as np
import pytest
import torch
from every_estimator import BY_FILTER, SHARED, rms
from torch import Tensor

import torch_mcaa as mcaa
from torch_mcaa.integrand import Function
from torch_mcaa.patterns.lattice_search import best_generator, reduced_basis


def tone(u: float, v: float, phase: float) -> Function:
    return lambda x, y: 0.5 + 0.5 * torch.cos(2 * math.pi * (u * x + v * y) + phase)


@pytest.mark.parametrize("chosen", [mcaa.Shared(), mcaa.Shared(replicates=2)], ids=repr)
def test_11_resonance(chosen: mcaa.Shared) -> None:
    """A tone on the dual lattice of the points that one `Shared` round has: reported at least half the true error, over 12 seeds.

    Naive: all points, and all cosets, see one value: a variance of 0 (shown) beside a root mean square error of 0.35.
    """
    strip = mcaa.Lattice().strip(16 // chosen.replicates, 0, chosen.replicates == 1, (0.3, 0.6))
    dual = np.linalg.inv(strip.basis).T
    u, v = dual[np.hypot(*dual.T).argmin()]
    seen = np.cos(2 * math.pi * (u * strip.x + v * strip.y))
    assert seen.std() < 1e-9
    pictures = [mcaa.render(tone(u, v, 0.8 * s), (32, 32), estimator=chosen, spp=16, seed=s) for s in range(12)]
    error = rms(torch.stack([p.image for p in pictures]) - 0.5)
    assert error > 0.15
    assert rms(torch.stack([p.stderr for p in pictures])) > 0.5 * error


def test_11_resonance_of_a_pixel_by_itself() -> None:
    """`Importance(Lattice())` under a box: a tone on the dual of the pixel's lattice, whole in the pixel so that each is exactly 0.5.

    Naive: every difference of neighbours is 0, so a variance of 0, beside a root mean square error of 0.35. No point is off the lattice, so it is
    said that this error would not be seen; the net that is recommended instead reports its own.
    """
    generator = best_generator(15, 1)
    u, v = reduced_basis(np.array([1.0, -float(generator)]), np.array([0.0, 15.0]))[0]
    wave = tone(float(u), float(v), 0.0)
    with pytest.warns(mcaa.McaaWarning, match="blind to tones"):
        picture = mcaa.render(wave, (32, 32), filter=mcaa.Box(), estimator=mcaa.Importance(mcaa.Lattice()), spp=15)
    assert rms(picture.image - 0.5) > 0.3
    picture = mcaa.render(wave, (32, 32), filter=mcaa.Box(), estimator=mcaa.Importance(), spp=16)
    assert 0.5 < rms(picture.stderr) / rms(picture.image - 0.5) < 2.5


def edge(angle: float) -> Function:
    """One half-plane in every pixel, by its fractional coordinates: under Box() all pixels have one value."""
    a, b = math.cos(angle), math.sin(angle)
    return lambda x, y: (a * (x - x.floor() - 0.45) + b * (y - y.floor() - 0.55) < 0).to(x.dtype)


CALIBRATED = [e for e in BY_FILTER if e.allocation == mcaa.Uniform()]


@pytest.mark.parametrize("angle", [0.0, 0.5, 2.0])
@pytest.mark.parametrize("chosen", CALIBRATED, ids=repr)
def test_12_dependent_points(chosen: mcaa.Importance, angle: float) -> None:
    """Reported over true root mean square error of 4096 pixels with one edge, at 16 points, within 0.8 and 2.6.

    The true one is known to 2 %; a pixel's own is raised to its neighbours' mean, 1.2 to 1.4 for estimates as rough as those of 4 pairs.
    Lattice() is documented to 3.5 (12 in variance) and left out above.
    """
    picture = mcaa.render(edge(angle), (64, 64), filter=mcaa.Box(), estimator=chosen, spp=16)
    true = float(picture.image.std())
    ratio = rms(picture.stderr) / true
    assert 0.8 < ratio < (3.5 if "Lattice" in repr(chosen) else 2.6)


def test_12_naive_variance_of_jittered_points() -> None:
    """What s^2 / n says of 4 x 4 jittered points, which is what (10) predicts, is at least 3 times the variance there is."""
    picture = mcaa.render(edge(0.5), (64, 64), filter=mcaa.Box(), estimator=mcaa.Importance(mcaa.Jittered()), spp=16)
    assert picture.predicted_variance is not None
    true = float(picture.image.var())
    assert float(picture.predicted_variance.mean()) > 3 * true
    assert float(picture.stderr.square().mean()) < 3 * true


@pytest.mark.parametrize("chosen", SHARED, ids=repr)
def test_12_dependent_pixels(chosen: mcaa.Shared) -> None:
    """Shared points on a disc's edge, over 24 seeds: reported over true within 0.75 and 3 as the package's own figures are.

    Naive: s^2 / n over the points in reach, as if they were independent, is 4 to 40 times the variance.
    """

    def disc(x: Tensor, y: Tensor) -> Tensor:
        return (torch.hypot(x - 8.2, y - 7.7) < 5.1).to(x.dtype)

    # where jumps are located the floor for what no sample met is far above the rest
    size, spp = ((16, 16), 16) if isinstance(chosen, mcaa.Shared) else ((64, 64), 16)
    pictures = [mcaa.render(disc, size, estimator=chosen, spp=spp, seed=s, dtype=torch.float64) for s in range(24)]
    images = torch.stack([p.image for p in pictures])
    inner = (images.mean(0) > 0.05) & (images.mean(0) < 0.95)
    true = rms(images.std(0)[inner])
    seen = torch.stack([(p.stderr.square() - p.unseen.square()).clamp_min(0).sqrt() for p in pictures])
    assert 0.75 < rms(seen[:, inner]) / true < 3


class Line(mcaa.Independent):
    """Independent points on the diagonal of the square: x and y depend on each other wholly."""

    def points(self, n: int, *args: Tensor, **options: object) -> tuple[Tensor, Tensor]:
        u, _ = super().points(n, *args, **options)  # type: ignore[arg-type]
        return u, u.clone()


@pytest.mark.parametrize("order", [0, 1, 2, 3])
@pytest.mark.parametrize("spp", [1, 2, 3, 5, 8, 14, 15, 16, 20])
def test_13_singular_control_variates_with_few_points(order: int, spp: int) -> None:
    """Fewer points than the 10 terms of order 3, in one fold of them: a lower order, and a mean that is right.

    Naive: normal equations that are singular, and values far outside the range of f. Here 0 <= f <= 1: f within 0.5 of that; the mean
    over 4096 pixels at |z| of 1e-5.
    """
    estimator = mcaa.ControlVariate(order=order, pattern=mcaa.Independent())
    picture = mcaa.render(edge(0.5), (64, 64), filter=mcaa.Box(), estimator=estimator, spp=spp, dtype=torch.float64)
    truth = float(mcaa.render(edge(0.5), (1, 1), filter=mcaa.Box(), estimator=mcaa.Importance(mcaa.Jittered()), spp=2**18).image)
    image = picture.image
    assert bool(image.isfinite().all())
    assert float(image.min()) > -1.5 and float(image.max()) < 2.5
    assert abs(float(image.mean()) - truth) < 4.42 * float(image.std()) / 64 + 2e-5


@pytest.mark.parametrize("order", [1, 2, 3])
def test_13_singular_control_variates_on_a_line(order: int) -> None:
    """All points of a pixel on one line: terms that depend on one another are not fitted.

    Naive: the normal equations of 1, x, y on a line are singular (condition above 10^12, shown), and the integral of psi is anything.
    """
    u = torch.rand(16, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    columns = torch.stack([torch.ones_like(u), u, u], 1)
    assert float(torch.linalg.cond(columns.T @ columns)) > 1e12
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        picture = mcaa.render(
            lambda x, y: x + (y > 4).to(x.dtype), (8, 8), estimator=mcaa.ControlVariate(order, Line()), spp=16, dtype=torch.float64
        )
    assert bool(picture.image.isfinite().all()) and float(picture.stderr.min()) > 0
    assert float(picture.image.min()) > -2 and float(picture.image.max()) < 11


def test_13_fitting_on_the_points_that_are_corrected_is_biased() -> None:
    """Cross-fitted, the mean over 16,384 pixels is right at |z| of 1e-5.

    Naive: psi fitted on the very points it corrects, whose residuals have mean 0, so the value is the integral of psi: off by more than
    10 standard errors at 14 points for the corners of the pixel, where leverages are large.
    """

    def corners(x: Tensor, y: Tensor) -> Tensor:
        return (((x - x.floor() - 0.5).abs() > 0.35) & ((y - y.floor() - 0.5).abs() > 0.35)).to(x.dtype)

    generator = torch.Generator().manual_seed(0)
    x, y = torch.rand(2, 16384, 14, dtype=torch.float64, generator=generator)
    a, b = x - 0.5, y - 0.5
    columns = torch.stack([torch.ones_like(a), a, b, a * a - 1 / 12, a * b, b * b - 1 / 12], -1)
    naive = torch.linalg.lstsq(columns, corners(x, y)[..., None]).solution[:, 0, 0]
    assert abs(float((naive.mean() - 0.09) / (naive.std() / 128))) > 10
    estimator = mcaa.ControlVariate(2, mcaa.Independent())
    image = mcaa.render(corners, (128, 128), filter=mcaa.Box(), estimator=estimator, spp=14, dtype=torch.float64).image
    assert abs(float((image.mean() - 0.09) / (image.std() / 128))) < 4.42
