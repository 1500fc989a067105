"""What all estimators that draw points for each pixel have in common: counts, diagnostics, labels, bits and errors."""

from __future__ import annotations

import math

import pytest
import torch

import torch_mcaa as mcaa
from torch_mcaa import scenes

DISC = scenes.Disc(10.2, 9.7, 6.1)
ESTIMATORS = [
    mcaa.Importance(),
    mcaa.Importance(mcaa.Independent(), mcaa.Normal(0.3)),
    mcaa.Importance(density=mcaa.Mixture([mcaa.FilterDensity(mcaa.Gaussian(0.5)), mcaa.Normal(1.0)])),
    mcaa.Crude(biased_ok=True),
    mcaa.Stratified((3, 2), density=mcaa.Normal(0.4), weights="paper"),
    mcaa.Stratified((2, 2), weights="balance"),
    mcaa.Stratified((3, 2)),
    mcaa.Stratified((2, 2), counts="optimal"),
    mcaa.AdaptiveImportance(),
    mcaa.AdaptiveImportance(3, mcaa.Mixture),
    mcaa.ControlVariate(),
    mcaa.OrderedStrata(),
    mcaa.OrderedStrata(3),
]
each = pytest.mark.parametrize("chosen", ESTIMATORS, ids=repr)


def with_allocation(chosen: object, allocation: object, combine: str = "fixed") -> mcaa.Importance:
    from dataclasses import replace

    return replace(chosen, allocation=allocation, combine=combine)  # type: ignore[type-var]


@each
def test_diagnostics_have_their_shapes_and_ranges(chosen: mcaa.Importance) -> None:
    picture = mcaa.render(lambda x, y: (DISC(x, y), x), (19, 20), estimator=chosen, spp=32)
    assert picture.predicted_variance is not None and picture.ess is not None and picture.pareto_k is not None
    assert picture.predicted_variance.shape == picture.pareto_k.shape == (2, 19, 20) and picture.ess.shape == (19, 20)
    assert (picture.predicted_variance >= 0).all() and picture.predicted_variance.isfinite().all()
    # the effective size of n weights is from 1 to n
    assert (picture.ess > 0).all() and (picture.ess <= picture.spp * (1 + 1e-6)).all()
    assert (picture.stderr > 0).all() and picture.stderr.isfinite().all()


def test_equal_weights_are_worth_all_their_points() -> None:
    for chosen in (mcaa.Importance(), mcaa.Stratified((2, 2), weights="filter")):
        picture = mcaa.render(DISC, (8, 8), estimator=chosen, spp=16)
        assert picture.ess is not None
        torch.testing.assert_close(picture.ess, torch.full((8, 8), 16.0))


def test_shared_points_have_no_weights_of_their_own() -> None:
    picture = mcaa.render(DISC, (8, 8))
    assert picture.predicted_variance is None and picture.ess is None and picture.pareto_k is None
    assert any("ratio" in reason for reason in picture.bias)


@each
@pytest.mark.parametrize("allocation", [mcaa.EqualVariance(), mcaa.Neyman()], ids=repr)
@pytest.mark.parametrize("spp", [32, 37])
def test_an_allocation_spends_what_it_has(chosen: mcaa.Importance, allocation: mcaa.Neyman, spp: int) -> None:
    """In whole evaluations, to the last one, and nowhere below the estimator's least; more of them where the edge is."""
    picture = mcaa.render(DISC, (19, 20), estimator=with_allocation(chosen, allocation), spp=spp)
    assert picture.stderr.isfinite().all()
    assert int(picture.spp.sum()) == spp * 19 * 20
    assert int(picture.spp.min()) >= 2 * chosen.fewest
    assert picture.predicted_optimum is not None and picture.predicted_optimum > 0
    # where weights differ, flat pixels have a variance too
    if not ("Normal" in repr(chosen) or "Mixture" in repr(chosen)):
        on_edge = (picture.image[0] > 0.1) & (picture.image[0] < 0.9)
        assert picture.spp[on_edge].double().mean() > 1.5 * picture.spp[~on_edge].double().mean()


def test_patterns_with_few_counts_stay_under_the_cap() -> None:
    chosen = mcaa.Importance(mcaa.Jittered(), allocation=mcaa.Neyman())
    picture = mcaa.render(DISC, (19, 20), estimator=chosen, spp=32)
    assert 0.8 * 32 * 19 * 20 < int(picture.spp.sum()) <= 32 * 19 * 20
    assert all(mcaa.Jittered().count(n) == n for n in (picture.spp - 8).unique().tolist())


def test_known_variances_need_no_pilot() -> None:
    known = torch.ones(6, 6)
    known[2, 3] = 9
    picture = mcaa.render(DISC, (6, 6), estimator=mcaa.Importance(allocation=mcaa.EqualVariance(known)), spp=44)
    assert int(picture.spp.sum()) == 44 * 36
    assert picture.spp[2, 3] == 9 * picture.spp[0, 0] == 324
    assert picture.predicted_optimum == pytest.approx(44 / (44 * 36))
    with pytest.raises(mcaa.McaaError, match=r"have shape \(6, 6\), the picture \(5, 6\)"):
        mcaa.render(DISC, (5, 6), estimator=mcaa.Importance(allocation=mcaa.EqualVariance(known)), spp=44)


def test_a_flat_pilot_does_not_starve_a_pixel() -> None:
    """A dot that one pilot point in sixteen meets: pixels where all missed it still get evaluations in the second round."""
    dot = scenes.Disc(4.5, 4.5, 0.12)
    picture = mcaa.render(
        lambda x, y: dot(x, y) + (x > 8), (16, 16), estimator=mcaa.Importance(allocation=mcaa.EqualVariance()), spp=64
    )
    assert int(picture.spp.min()) > 16


def test_what_one_pixel_may_draw_is_capped() -> None:
    """A dot in a flat picture would get all that is left, 12,000 times the mean; estimated variances give at most 64 times the mean."""
    dot = scenes.Disc(50.5, 50.5, 0.4)
    picture = mcaa.render(dot, (101, 101), estimator=mcaa.Importance(allocation=mcaa.EqualVariance()), spp=16)
    assert int(picture.spp.max()) <= 4 + 64 * 13


@each
def test_equal_bits_for_every_number_of_threads(chosen: mcaa.Importance) -> None:
    chosen = with_allocation(chosen, mcaa.EqualVariance())
    threads = torch.get_num_threads()
    pictures = []
    try:
        for count in (1, 2, 3):
            torch.set_num_threads(count)
            pictures.append(mcaa.render(DISC, (70, 67), estimator=chosen, spp=32, seed=5))
    finally:
        torch.set_num_threads(threads)
    for other in pictures[1:]:
        for name in ("image", "stderr", "spp", "predicted_variance", "ess"):
            assert torch.equal(getattr(pictures[0], name), getattr(other, name)), name


@each
def test_seeds_and_pixels_differ(chosen: mcaa.Importance) -> None:
    one, two = (mcaa.render(lambda x, y: torch.frac(3 * x), (6, 6), estimator=chosen, spp=24, seed=s) for s in (0, 1))
    assert (one.image != two.image).all()
    assert len(one.image.unique()) == 36


def test_labels_of_bias() -> None:
    def bias(chosen: object, **arguments: object) -> tuple[str, ...]:
        return mcaa.render(DISC, (19, 20), estimator=chosen, spp=32, **arguments).bias  # type: ignore[arg-type]

    for chosen in ESTIMATORS:
        if not isinstance(chosen, mcaa.Crude):
            assert bias(chosen) == (), chosen
    equal = mcaa.EqualVariance()
    assert bias(mcaa.Importance(allocation=equal)) == bias(mcaa.Importance(allocation=equal, combine="discard_pilot")) == ()
    assert "pooled" in bias(mcaa.Importance(allocation=equal, combine="pooled"))[0]
    assert bias(mcaa.Importance(combine="pooled")) == ()
    assert "pooled" in bias(mcaa.Stratified(weights="filter", counts="optimal", combine="pooled"))[0]
    assert "beyond the pixel" in bias(mcaa.Crude(biased_ok=True))[0]
    assert bias(mcaa.Crude(biased_ok=True), filter=mcaa.Box()) == bias(mcaa.Crude(), filter=mcaa.Tent(0.5)) == ()
    assert "ended where the samples" in bias(mcaa.Importance(), tolerance=0.03)[0]
    holes = mcaa.render(lambda x, y: torch.where(x < 3, torch.nan, x), (8, 8), estimator=mcaa.Importance(), nonfinite="ignore")
    assert "left out" in holes.bias[0]


def test_names_say_what_differs_from_the_defaults() -> None:
    assert repr(mcaa.Importance()) == "Importance()"
    assert repr(mcaa.AdaptiveImportance(3, mcaa.Mixture)) == "AdaptiveImportance(rounds=3, density=Mixture)"
    assert repr(mcaa.Importance(allocation=mcaa.Neyman(torch.ones(4, 5)))) == "Importance(allocation=Neyman(known=<4 x 5>))"
    assert repr(mcaa.Stratified((4, 4), weights="paper")) == "Stratified(strata=(4, 4), weights='paper')"


def test_crude_is_right_for_a_filter_inside_the_pixel_alone() -> None:
    centre = torch.arange(20, dtype=torch.float64) + 0.5
    truth = DISC.exact(centre[None], centre[:19, None], mcaa.Box())
    picture = mcaa.render(DISC, (19, 20), filter=mcaa.Box(), estimator=mcaa.Crude(), spp=256, dtype=torch.float64)
    edge = (truth > 0.05) & (truth < 0.95)
    z = (picture.image[0] - truth)[edge] / (truth * (1 - truth) / 256).sqrt()[edge]
    assert float(z.abs().max()) < 5  # of 70 pixels; 1e-4 for a normal, binomials of 256 have slightly longer tails
    with pytest.raises(mcaa.McaaError, match="reaches 2.5 px"):
        mcaa.render(DISC, (4, 4), estimator=mcaa.Crude())
    with pytest.raises(mcaa.McaaError, match="reaches 1 px"):
        mcaa.render(DISC, (4, 4), filter=mcaa.Tent(), estimator=mcaa.Crude())


@pytest.mark.parametrize("filter", [mcaa.Gaussian(0.5), mcaa.Mitchell(), mcaa.Lanczos(2), mcaa.Box()], ids=repr)
@each
def test_constants(chosen: mcaa.Importance, filter: mcaa.Gaussian) -> None:
    """Exact where every weight is 1; else each of 144 pixels within six root mean square standard errors of its value."""
    if "Normal(variance=(0." in repr(chosen) and not isinstance(filter, mcaa.Gaussian):
        pytest.skip("that density is made for a normal filter")
    picture = mcaa.render(
        lambda x, y: torch.full_like(x, 0.7), (12, 12), filter=filter, estimator=chosen, spp=64, dtype=torch.float64
    )
    assert picture.predicted_variance is not None
    error = float((picture.image - 0.7).abs().max())
    alike = (
        chosen == mcaa.Importance()
        or isinstance(chosen, mcaa.Crude | mcaa.OrderedStrata)
        or (isinstance(chosen, mcaa.Stratified) and chosen.kind == "filter")
    )
    if isinstance(chosen, mcaa.ControlVariate) or (alike and filter.absolute_integral == 1):
        # the integral of w is known to 1e-12
        assert error < 1e-12
    else:
        assert error < 6 * float(picture.predicted_variance.mean().sqrt()) + 1e-12


def test_stratified_with_a_density_too_narrow_is_refused() -> None:
    for strata in ((2, 1), (2, 2), (4, 4)):
        with pytest.raises(mcaa.McaaError, match=r"too narrow|is 0 where"):
            mcaa.render(DISC, (8, 8), estimator=mcaa.Stratified(strata, weights="paper"))
    with pytest.raises(mcaa.McaaError, match="too narrow"):
        mcaa.render(DISC, (8, 8), estimator=mcaa.Importance(density=mcaa.Normal(0.1)))
    with pytest.raises(mcaa.McaaError, match="sub-pixels' centres"):
        mcaa.render(DISC, (8, 8), filter=mcaa.Gaussian(0.2), estimator=mcaa.Stratified(weights="balance"))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: mcaa.Stratified((0, 2)), "strata must be two integers"),
        (lambda: mcaa.Stratified(3), "strata must be two integers"),  # type: ignore[arg-type]
        (lambda: mcaa.Stratified(density=mcaa.FilterDensity(mcaa.Box())), "must be Normal"),  # type: ignore[arg-type]
        (lambda: mcaa.Stratified(weights="best"), "'paper', 'balance' or 'filter'"),  # type: ignore[arg-type]
        (lambda: mcaa.Stratified(defensive=1.0), "share of the evaluations"),
        (lambda: mcaa.Stratified(weights="filter", density=mcaa.Normal(1.0)), "leave it out"),
        (lambda: mcaa.Stratified(weights="balance", counts="optimal"), "no minimum for weights='balance'"),
        (lambda: mcaa.Stratified(counts="many"), "'equal' or 'optimal'"),  # type: ignore[arg-type]
        (lambda: mcaa.AdaptiveImportance(1), "rounds must be an integer from 2"),
        (lambda: mcaa.AdaptiveImportance(density=mcaa.Normal), "class Histogram or Mixture"),
        (lambda: mcaa.AdaptiveImportance(density=mcaa.Histogram([[1.0]], 1.0)), "class Histogram or Mixture"),  # type: ignore[arg-type]
        (lambda: mcaa.OrderedStrata(True), "rounds must be an integer from 2"),
        (lambda: mcaa.Importance(mcaa.Normal(0.3)), "pattern must be a pattern"),  # type: ignore[arg-type]
        (lambda: mcaa.ControlVariate(pattern=mcaa.Sobol), "pattern must be a pattern"),  # type: ignore[arg-type]
        (lambda: mcaa.Importance(density="normal"), "density must be a density"),  # type: ignore[arg-type]
        (lambda: mcaa.Importance(combine="best"), "'discard_pilot', 'fixed' or 'pooled'"),  # type: ignore[arg-type]
        (lambda: mcaa.Importance(allocation="neyman"), "allocation must be"),  # type: ignore[arg-type]
        (lambda: mcaa.Importance(allocation=mcaa.Neyman), "allocation must be"),  # type: ignore[arg-type]
    ],
)
def test_bad_arguments(make, message: str) -> None:
    with pytest.raises(mcaa.McaaError, match=message):
        make()


@pytest.mark.parametrize(
    ("chosen", "spp", "least"),
    [
        (mcaa.Stratified((3, 3), weights="balance"), 9, 10),
        (mcaa.Stratified((3, 3)), 8, 9),
        (mcaa.AdaptiveImportance(), 7, 8),
        (mcaa.OrderedStrata(), 3, 4),
        (mcaa.Importance(allocation=mcaa.Neyman()), 2, 3),
        (mcaa.Stratified((2, 2), weights="filter", allocation=mcaa.EqualVariance()), 7, 8),
    ],
    ids=repr,
)
def test_budgets_below_the_floors(chosen: mcaa.Importance, spp: int, least: int) -> None:
    with pytest.raises(mcaa.McaaError, match=rf"got spp = {spp}"):
        mcaa.render(DISC, (4, 4), estimator=chosen, spp=spp)
    assert int(mcaa.render(DISC, (4, 4), estimator=chosen, spp=least).spp.sum()) == 16 * least


def test_filters_without_an_integral_are_refused_with_the_reason() -> None:
    for chosen in (mcaa.Importance(), mcaa.Stratified(), mcaa.AdaptiveImportance(), mcaa.OrderedStrata(), mcaa.ControlVariate()):
        with pytest.raises(mcaa.McaaError, match=r"not integrable|not finite"):
            mcaa.render(DISC, (8, 8), filter=mcaa.Sinc(), boundary="zero", estimator=chosen)


def test_the_full_sinc_on_a_bounded_screen() -> None:
    """A wide normal density covers a small screen; the shared lattice, which convolves, is the truth it is held against."""

    def f(x, y):
        return 0.5 + 0.5 * torch.sin(0.9 * x + 0.4 * y)

    wide = mcaa.Importance(density=mcaa.Mixture([mcaa.FilterDensity(mcaa.Lanczos(3)), mcaa.Normal(16.0)]))
    truth = mcaa.render(f, (8, 8), filter=mcaa.Sinc(), boundary="zero", estimator=mcaa.Shared(), spp=1024, dtype=torch.float64)
    picture = mcaa.render(f, (8, 8), filter=mcaa.Sinc(), boundary="zero", estimator=wide, spp=4096, dtype=torch.float64)
    z = (picture.image - truth.image) / (picture.stderr.square() + truth.stderr.square()).sqrt()
    assert float(z.abs().max()) < 4.5 and float(picture.stderr.max()) < 0.1


@pytest.mark.parametrize("combine", ["fixed", "discard_pilot", "pooled"])
def test_rounds_are_combined_as_asked(combine: str) -> None:
    """Two independent rounds of 8 and 24 evaluations, evenly shared: the variance of their mean over that of 32 points together.

    Weights n^1.5: (8 (8/8)... ) = (8^3/8 + 24^3/24) / (8^1.5 + 24^1.5)^2 x 32 = 1.046; the last round alone 32/24; pooled 1.
    """
    known = {"fixed": 32 * (8**2 + 24**2) / (8**1.5 + 24**1.5) ** 2, "discard_pilot": 32 / 24, "pooled": 1.0}[combine]
    size = 96
    chosen = mcaa.Importance(mcaa.Independent(), allocation=mcaa.Neyman(), combine=combine)  # type: ignore[arg-type]
    # every pixel has the same variance, 1/12, so each gets what the others do, but for what the pilot's noise moves
    picture = mcaa.render(lambda x, y: torch.frac(97.3 * x + 41.7 * y), (size, size), estimator=chosen, spp=32, dtype=torch.float64)
    ratio = float(picture.image.var()) / (1 / 12 / 32)
    # 9,216 values: the ratio is known to 1.5 %, and uneven counts cost a few per cent
    assert known * 0.94 < ratio < known * 1.08
    assert math.isclose(float(picture.spp.double().mean()), 32)
