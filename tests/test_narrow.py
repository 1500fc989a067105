"""Filters narrower than a pixel: pictures without holes, by points drawn from the filter where a shared lattice has too few inside."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

import torch_mcaa as mcaa
from torch_mcaa import McaaError, scenes
from torch_mcaa.arguments import task_of
from torch_mcaa.estimators import Task
from torch_mcaa.estimators.narrow import LEAST, area, held
from torch_mcaa.estimators.parts import DRAWN, MODELS
from torch_mcaa.filters import Filter
from torch_mcaa.grid import Screen

SIZE = (64, 64)
DISC = scenes.Disc(32.3, 31.6, 20.2)


def under(filter: Filter) -> Task:
    boundary = "zero" if math.isinf(max(filter.radius)) else "extend"
    return task_of(DISC, Screen.of(SIZE), filter, boundary, "raise", 0, torch.float32, None)


def rms(filter: Filter, estimator: mcaa.Auto | mcaa.Importance, spp: int = 16, boundary: str = "extend") -> float:
    """Over the pixels of an edge, and four seeds."""
    centre = torch.arange(64, dtype=torch.float64) + 0.5
    truth = DISC.exact(centre[None], centre[:, None], filter)
    busy = (truth > 1e-4) & (truth < 1 - 1e-4)
    images = [
        mcaa.render(DISC, SIZE, filter=filter, estimator=estimator, spp=spp, boundary=boundary, seed=seed).image[0]  # type: ignore[arg-type]
        for seed in range(4)
    ]
    return float(torch.stack([(image - truth)[busy].square() for image in images]).mean().sqrt())


def test_area() -> None:
    assert area(under(mcaa.Box(0.3))) == pytest.approx(0.09)
    assert area(under(mcaa.Gaussian(0.1))) == pytest.approx(4 * math.pi * 0.01, rel=1e-3)
    assert area(under(mcaa.Tent(0.4))) == pytest.approx(2.25 * 0.16, rel=1e-3)
    # those of usual widths are shared whatever the number of points
    for filter in (mcaa.Gaussian(0.5), mcaa.Box(), mcaa.Tent(), mcaa.Mitchell(), mcaa.CatmullRom(), mcaa.Lanczos(3), mcaa.Sinc()):
        assert held(under(filter), 1) == math.inf


@pytest.mark.parametrize(
    "filter", [mcaa.Gaussian(0.02), mcaa.Gaussian(0.05), mcaa.Gaussian(0.1), mcaa.Box(0.1), mcaa.Box(0.5)], ids=repr
)
@pytest.mark.parametrize("boundary", ["extend", "zero", "renormalize"])
def test_auto_draws_from_narrow_filters(filter: Filter, boundary: str) -> None:
    """As well as `Importance()`: the NaN, and errors of up to 0.4, of a lattice without points inside the filter are 10 times as large."""
    found, drawn = (rms(filter, e, boundary=boundary) for e in (mcaa.Auto(), mcaa.Importance()))
    assert found <= 1.01 * drawn < 0.06
    picture = mcaa.render(DISC, SIZE, filter=filter, boundary=boundary)  # type: ignore[arg-type]
    assert picture.models[DRAWN] == MODELS[DRAWN] and bool((picture.model == DRAWN).all()) and picture.bias == ()
    error = picture.image[0] - mcaa.render(DISC, SIZE, filter=filter, spp=1024).image[0]
    assert float((error.abs() <= 2 * picture.stderr[0]).double().mean()) >= 0.95


def test_a_filter_with_enough_points_stays_on_a_lattice() -> None:
    """Located jumps are twice to six times as good as points drawn from a Gaussian of 0.16 or 0.2 px."""
    for std in (0.16, 0.2):
        filter = mcaa.Gaussian(std)
        assert rms(filter, mcaa.Auto()) < 0.6 * rms(filter, mcaa.Importance())
        picture = mcaa.render(DISC, SIZE, filter=filter)
        assert not bool((picture.model == DRAWN).any()) and any("ratio" in reason for reason in picture.bias)


def test_bias_is_that_of_the_rounds_that_were_made() -> None:
    """At 6 evaluations a pixel, the first round of a tolerance, points are drawn from this Gaussian; later and larger ones are lattices."""
    filter = mcaa.Gaussian(0.15)
    easy, hard = (mcaa.render(DISC, SIZE, filter=filter, spp=64, tolerance=tolerance) for tolerance in (1.0, 1e-4))
    assert easy.bias == () and bool((easy.model == DRAWN).all())
    assert any("decide" in reason for reason in hard.bias) and bool((hard.model != DRAWN).any())
    # fewer than 5 are a plain lattice
    assert not any("decide" in reason for reason in mcaa.render(DISC, SIZE, spp=4).bias)


@pytest.mark.parametrize("kind", ["gaussian", "box", "tent"])
def test_no_pixel_is_without_a_point(kind: str) -> None:
    """Whatever the width, the number of points and the scene: finite from `Auto()`, and from the others, or refused."""

    def chequers(x: Tensor, y: Tensor) -> Tensor:
        return (torch.sin(1.9 * x) * torch.cos(2.3 * y) > 0).to(x.dtype) + 0.1 * torch.sin(50 * x)

    for width in (0.03, 0.1, 0.2, 0.45, 0.7, 0.95):
        filter = {"gaussian": mcaa.Gaussian(width / 2), "box": mcaa.Box(width), "tent": mcaa.Tent(width)}[kind]
        for spp in (1, 2, 6, 16):
            for f in (DISC, chequers):
                image = mcaa.render(f, (40, 40), filter=filter, spp=spp, seed=spp).image
                assert bool(image.isfinite().all()) and float(image.abs().max()) < 1.2
            assert bool(mcaa.render(DISC, (40, 40), filter=filter, spp=spp, tolerance=0.05).image.isfinite().all())
            if held(under(filter), spp) < LEAST:
                with pytest.raises(McaaError, match=r"Shared\(.* is so narrow .*; use Auto\(\) or Importance\(\)"):
                    mcaa.render(DISC, SIZE, filter=filter, spp=spp, estimator=mcaa.Shared())
            else:
                assert bool(mcaa.render(DISC, (40, 40), filter=filter, spp=spp, estimator=mcaa.Shared()).image.isfinite().all())
    with pytest.raises(
        McaaError, match=r"JumpCorrected\(.* is so narrow that of 11 evaluations .*; use Auto\(\) or Importance\(\)"
    ):
        mcaa.render(DISC, SIZE, filter=mcaa.Gaussian(0.05), estimator=mcaa.JumpCorrected())
