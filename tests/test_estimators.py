"""One suite over every estimator: unbiasedness, coverage, convergence, and what the lattice cannot see by itself."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from families import FAMILIES, FILTER, SIZE, estimator, grid_and_blur, score

import torch_mcaa as mcaa
from torch_mcaa import scenes
from torch_mcaa.patterns.lattice_search import dual_vectors
from torch_mcaa.patterns.lattice_table import STRIPS

EDGES = [name for name in FAMILIES if "edges" in name or name in ("discs", "0.1 px lines")]
PATTERNS = [mcaa.Independent(), mcaa.Jittered(), mcaa.MultiJittered(), mcaa.Sobol(), mcaa.Lattice()]
ESTIMATORS = [mcaa.Importance(p) for p in PATTERNS] + [mcaa.Shared(p) for p in PATTERNS] + [mcaa.Shared(replicates=3)]


def sidak(pixels: int, alpha: float = 1e-5) -> float:
    """The two-sided normal quantile at which the largest of `pixels` |z| passes with probability alpha at most."""
    one = -math.expm1(math.log1p(-alpha) / pixels)
    return math.sqrt(2) * float(torch.erfinv(torch.tensor(1 - one, dtype=torch.float64)))


@pytest.mark.parametrize("filter", [mcaa.Gaussian(0.5, radius=4.0), mcaa.Box()], ids=repr)
@pytest.mark.parametrize("chosen", ESTIMATORS, ids=repr)
def test_unbiased(chosen: object, filter: mcaa.Gaussian):
    """|z| of the mean over 256 seeds, for every pixel that the disc's edge passes well inside, and for their sum.

    Pixels with a value in (0.05, 0.95) have errors of bounded kurtosis, so a mean of 256 is normal enough at 1e-5; Student's t of 255
    degrees widens the quantile by 4 %. The self-normalised shared points have a bias of the order of their variance, which is below a
    tenth of the standard error at 16 points and so below 1.6 standard errors of the mean.
    """
    scene, size, seeds = scenes.Disc(5.2, 4.7, 3.1), (9, 10), 256
    centre_x, centre_y = torch.arange(10, dtype=torch.float64) + 0.5, torch.arange(9, dtype=torch.float64) + 0.5
    truth = scene.exact(centre_x[None], centre_y[:, None], filter)
    pictures = torch.stack(
        [
            mcaa.render(scene, size, filter=filter, estimator=chosen, spp=16, seed=s, dtype=torch.float64).image[0]
            for s in range(seeds)
        ]  # type: ignore[arg-type]
    )
    inner = (truth > 0.05) & (truth < 0.95)
    error = (pictures - truth)[:, inner]
    slack = 1.6 if isinstance(chosen, mcaa.Shared) and not isinstance(chosen.pattern, mcaa.Lattice) else 0.0
    z = error.mean(0) / (error.std(0) / math.sqrt(seeds))
    assert float(z.abs().max()) < 1.04 * sidak(int(inner.sum())) + slack
    total = error.sum(1)
    assert abs(float(total.mean() / (total.std() / math.sqrt(seeds)))) < 1.04 * 4.42 + slack * math.sqrt(int(inner.sum()))


# located jumps are known to 1e-6, and what no sample met, which counts in the standard error, is then most of it
NOT_TOO_LARGE = [(mcaa.Shared(), 2.5), (mcaa.Auto(), math.inf), (mcaa.JumpCorrected(), math.inf)]


@pytest.mark.parametrize("spp", [16, 64])
@pytest.mark.parametrize("family", EDGES)
@pytest.mark.parametrize(("chosen", "most"), NOT_TOO_LARGE, ids=repr)
def test_standard_error_is_calibrated(chosen: object, most: float, family: str, spp: int):
    """Over 64 scenes, 24 where that takes long, the 95 % interval covers at least 0.90 (lines 0.85) of the pixels that are not flat.

    Reported over true in (0.9, 2.5), or above 0.75 where one scene of 24 whose thin line was not followed is most of the error.
    """
    result = score(family, estimator(chosen, spp), 64 if chosen == mcaa.Shared() else 24)
    assert result.coverage >= (0.85 if "lines" in family else 0.90)
    assert (0.9 if chosen == mcaa.Shared() else 0.75) < result.ratio < most


@pytest.mark.parametrize("filter", [mcaa.Box(), mcaa.Gaussian(0.35, radius=2.8), mcaa.Gaussian(1.0, radius=8.0)], ids=repr)
@pytest.mark.parametrize(("chosen", "most"), NOT_TOO_LARGE, ids=repr)
def test_standard_error_is_calibrated_under_other_filters(chosen: object, most: float, filter: mcaa.Gaussian):
    if isinstance(filter, mcaa.Box) and chosen == mcaa.JumpCorrected():
        pytest.skip("documented: under a filter that ends in a step what is left of the error is not normal")
    for family in ("random edges", "discs"):
        result = score(family, estimator(chosen, 16, filter=filter), 48, filter)
        assert result.coverage >= 0.90
        assert (0.9 if chosen == mcaa.Shared() else 0.75) < result.ratio < most


@pytest.mark.parametrize("chosen", [e for e in ESTIMATORS if e != mcaa.Shared()], ids=repr)
def test_standard_error_of_the_others(chosen: object):
    """Replicates and in-pixel contrasts of 16 points: at least 0.85 covered, reported over true in (0.75, 3)."""
    result = score("discs", estimator(chosen, 16), 32)
    assert result.coverage >= 0.85
    assert 0.75 < result.ratio < 3


@pytest.mark.parametrize("filter", [FILTER, mcaa.Box()], ids=repr)
@pytest.mark.parametrize("spp", [16, 64])
@pytest.mark.parametrize(
    "chosen",
    [
        mcaa.Importance(mcaa.Independent()),
        mcaa.Importance(mcaa.Jittered()),
        mcaa.Importance(mcaa.MultiJittered()),
        mcaa.Importance(mcaa.Sobol()),
        mcaa.Stratified((2, 2)),
        mcaa.Stratified((2, 2), weights="balance"),
        mcaa.Stratified((2, 2), counts="optimal"),
        mcaa.AdaptiveImportance(),
        mcaa.AdaptiveImportance(density=mcaa.Mixture),
        mcaa.ControlVariate(),
        mcaa.OrderedStrata(),
    ],
    ids=repr,
)
def test_no_more_than_twice_the_true_error_on_edges(chosen: object, spp: int, filter: mcaa.Gaussian):
    """For patterns that are not lattices; 16 scenes leave some 5 % on either error, so 2 has a slack of 5 %."""
    for family in ("random edges", "axis edges", "discs"):
        result = score(family, estimator(chosen, spp, filter=filter), 16, filter)
        assert 0.85 < result.ratio < 2 * 1.05, family


# the root mean square errors that a shared shifted lattice is known to reach, 16 and 64 evaluations a pixel
KNOWN = {
    "random edges": (1.2e-2, 3.5e-3),
    "axis edges": (8.2e-3, 1.8e-3),
    "near-axis edges": (5.4e-3, 2.4e-3),
    "diagonal edges": (1.4e-2, 3.8e-3),
    "0.1 px lines": (2.2e-2, 5.3e-3),
    "discs": (1.2e-2, 3.9e-3),
    "tones < 1 c/px": (1e-12, 1e-12),
    "tones 1-3 c/px": (1e-4, 1e-12),
    "tones 3-8 c/px": (7.6e-2, 4.2e-3),
}


@pytest.mark.parametrize("family", list(FAMILIES))
def test_error_is_as_small_as_a_shared_lattice_can_have_it(family: str):
    # 96 random scenes leave 10 % on a root mean square that a few of them dominate
    for spp, known in zip((16, 64), KNOWN[family], strict=True):
        assert score(family, estimator(mcaa.Shared(), spp), 96).rmse < 1.15 * known


@pytest.mark.parametrize("family", ["axis edges", "near-axis edges", "diagonal edges"])
@pytest.mark.parametrize("chosen", [mcaa.Auto(), mcaa.JumpCorrected(), mcaa.Shared()], ids=repr)
def test_better_than_a_grid_and_a_blur(chosen: object, family: str):
    for spp, k in ((16, 4), (64, 8)):
        assert score(family, estimator(chosen, spp), 48).rmse < score(family, grid_and_blur(k), 48).rmse


@pytest.mark.parametrize(
    ("chosen", "family", "exponent"),
    [
        (mcaa.Shared(), "random edges", -0.75),
        (mcaa.Importance(mcaa.Independent()), "random edges", -0.5),
        (mcaa.Importance(mcaa.Sobol()), "random edges", -0.75),
        (mcaa.Shared(mcaa.Sobol()), "random edges", -0.75),
    ],
    ids=repr,
)
def test_convergence_exponent(chosen: object, family: str, exponent: float):
    """The slope of log RMSE over log n, n = 8, 32, 128: each RMSE is known to about 8 %, so the slope to 0.05."""
    counts = np.array([8, 32, 128])
    errors = [score(family, estimator(chosen, int(n)), 24).rmse for n in counts]
    slope = np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert slope == pytest.approx(exponent, abs=0.15)


@pytest.mark.parametrize("rank", [0, 4, 20])
@pytest.mark.parametrize("spp", [4, 16, 64])
@pytest.mark.parametrize("chosen", [mcaa.Shared(), mcaa.Auto()], ids=repr)
def test_a_tone_on_the_dual_vectors_is_not_reported_with_comfort(chosen: mcaa.Shared, spp: int, rank: int):
    """Reported at least half the true RMSE, where all points of the lattice and of its cosets see one value.

    Those whose lattices are others, or have company, meet some of these tones with small errors.
    """
    period, count, generator = STRIPS[spp]
    dual = dual_vectors(count, generator, period)
    u, v = (float(c) for c in dual[np.argsort(np.hypot(*dual.T), kind="stable")[rank]])
    error, reported = [], []
    for seed in range(8):
        picture = mcaa.render(scenes.Sinusoid(u, v, seed * math.pi / 4), (32, 32), estimator=chosen, spp=spp, seed=seed)
        # the tone is far above what the filter passes: its pixels are all 0.5
        error.append(picture.image - 0.5)
        reported.append(picture.stderr)
    rmse, stderr = (float(torch.stack(t).square().mean().sqrt()) for t in (error, reported))
    assert chosen != mcaa.Shared() or rmse > 0.2
    assert stderr > 0.5 * rmse


def test_a_dual_tone_beside_an_edge_is_seen():
    period, count, generator = STRIPS[16]
    dual = dual_vectors(count, generator, period)
    u, v = dual[np.hypot(*dual.T).argmin()]

    def f(x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        return (x + 0.3 * y > 20).to(x.dtype) + 0.3 * torch.cos(2 * math.pi * (u * x + v * y))

    stderr = torch.stack([mcaa.render(f, (32, 32), estimator=mcaa.Shared(), seed=s).stderr for s in range(8)])
    assert float(stderr.square().mean().sqrt()) > 0.5 * 0.3 / math.sqrt(2)


def test_replicates_see_a_dual_tone_too():
    strip = mcaa.Lattice().strip(8, 0, False, (0.0, 0.0))
    basis = np.linalg.inv(strip.basis).T
    u, v = basis[np.hypot(*basis.T).argmin()]
    pictures = [
        mcaa.render(scenes.Sinusoid(u, v, s * 0.8), (32, 32), estimator=mcaa.Shared(replicates=2), seed=s) for s in range(12)
    ]
    error = torch.stack([p.image - 0.5 for p in pictures]).square().mean().sqrt()
    assert float(torch.stack([p.stderr for p in pictures]).square().mean().sqrt()) > 0.5 * float(error)


@pytest.mark.parametrize("seed", range(3))
def test_a_table_and_its_separable_twin_agree(seed: int):
    """The sum over taps of a filter that does not separate is the product form of `Shared`, to rounding."""
    profile = torch.tensor([0.1, 0.6, 1.0, 0.5, 0.0], dtype=torch.float64)
    scene = scenes.Disc(8.1, 7.6, 5.0)
    one, two = (
        mcaa.render(scene, (15, 17), filter=filter, estimator=mcaa.Shared(), dtype=torch.float64, seed=seed)
        for filter in (mcaa.Tabulated(profile, radius=1.5), mcaa.Tabulated(profile[:, None] * profile, radius=1.5))
    )
    torch.testing.assert_close(one.image, two.image, rtol=0, atol=1e-12)
    torch.testing.assert_close(one.stderr, two.stderr, rtol=1e-9, atol=1e-12)


def test_families_fill_the_picture():
    assert 4 * max(FILTER.radius) < SIZE
