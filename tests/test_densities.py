"""One suite for every density, then the closed forms. Significance 1e-5 throughout, with fixed seeds."""

from __future__ import annotations

import copy
import math
import pickle
from collections.abc import Callable

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from torch import Tensor

from torch_mcaa.densities import Density, FilterDensity, Normal
from torch_mcaa.errors import McaaError
from torch_mcaa.filters import BlackmanHarris, Box, CatmullRom, Filter, Gaussian, Lanczos, Mitchell, Sinc, Tabulated, Tent

ALPHA = 1e-5
F64 = torch.float64
BELOW_ONE = 1 - 2.0**-24
BINS = 24

GRID = Tabulated(torch.randn(5, 7, generator=torch.Generator().manual_seed(3)) + 1, 1.5)
PROFILE = Tabulated([0.0, -1.0, 0.2, 4.0, 3.0, -0.5, 1.0], 1.5)
FILTERS = [Box(), Tent(), Gaussian(), Mitchell(), CatmullRom(), Lanczos(), BlackmanHarris(), PROFILE, GRID]
DENSITIES = [*map(FilterDensity, FILTERS), Normal(25.0), Normal((0.3, 2.0))]


def each(cases: list) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("density", cases, ids=repr)


def extent(density: Density) -> tuple[float, float]:
    """Half-widths that leave out less than 1e-15 of the density."""
    if isinstance(density, Normal):
        return 8 * math.sqrt(density.variance[0]), 8 * math.sqrt(density.variance[1])
    return density.radius


def plane(rx: float, ry: float, panels: int = 96) -> tuple[Tensor, Tensor, Tensor]:
    """Composite Gauss-Legendre rule of four nodes a panel: dx (1, n), dy (n, 1), weights (n, n)."""
    x, w = (torch.tensor(a) for a in np.polynomial.legendre.leggauss(4))
    edges = torch.linspace(-1, 1, panels + 1, dtype=F64)
    nodes = (edges[:-1, None] + (x + 1) / panels).reshape(-1)
    weights = (w / panels).repeat(panels)
    return rx * nodes[None], ry * nodes[:, None], rx * ry * weights * weights[:, None]


def uniforms(n: int, seed: int, dtype: torch.dtype = torch.float32) -> tuple[Tensor, Tensor]:
    u = torch.rand(2, n, generator=torch.Generator().manual_seed(seed), dtype=dtype)
    return u[0], u[1]


@each(DENSITIES)
def test_integral_is_one(density: Density) -> None:
    dx, dy, weights = plane(*extent(density))
    # |w| has kinks at its changes of sign, inside panels: they cost up to slope · (panel)² / 4.
    assert float((density.pdf(dx, dy) * weights).sum()) == pytest.approx(1, abs=1e-4)
    assert (density.pdf(dx, dy) >= 0).all()


@each(DENSITIES)
def test_chi_square_of_samples(density: Density) -> None:
    u, v = uniforms(1 << 17, 29)
    points = density.sample(u, v)
    half = extent(density)
    dx, dy, weights = plane(*half)
    panels = weights.shape[0] // BINS
    probability = (density.pdf(dx, dy) * weights).reshape(BINS, panels, BINS, panels).sum((1, 3))
    expected = probability.reshape(-1) * len(u)
    column, row = (((d / r + 1) / 2 * BINS).long().clamp(0, BINS - 1) for d, r in zip(points, half))
    counts = torch.bincount(row * BINS + column, minlength=BINS * BINS).double()
    large = expected >= 10
    counts = torch.cat([counts[large], counts[~large].sum()[None]])
    expected = torch.cat([expected[large], expected[~large].sum()[None]])
    used = expected > 0
    assert not counts[~used].any()
    statistic = float(((counts - expected) ** 2 / expected)[used].sum())
    assert stats.chi2.sf(statistic, int(used.sum()) - 1) > ALPHA


@each(DENSITIES)
@settings(max_examples=50, deadline=None, derandomize=True)
@given(u=st.floats(0, BELOW_ONE, width=32), v=st.sampled_from([0.0, 2.0**-24, 0.5, BELOW_ONE]))
def test_samples_are_finite_and_inside(density: Density, u: float, v: float) -> None:
    for dtype in (torch.float32, F64):
        dx, dy = density.sample(torch.tensor([u], dtype=dtype), torch.tensor([v], dtype=dtype))
        assert dx.dtype == dy.dtype == density.pdf(dx, dy).dtype == dtype
        assert torch.isfinite(dx + dy).all()
        assert abs(float(dx)) <= density.radius[0]
        assert abs(float(dy)) <= density.radius[1]


@each(DENSITIES)
def test_importance_sampling_is_unbiased(density: Density) -> None:
    """(6) with f = 1: the mean of w / w' is 1, for the filter itself or for a Gaussian inside the density."""
    filter = density.filter if isinstance(density, FilterDensity) else Gaussian(0.5, 1.5)
    assert density.covers(filter)
    dx, dy = density.sample(*uniforms(1 << 16, 31, F64))
    terms = filter(dx, dy) / density.pdf(dx, dy)
    bound = stats.norm.isf(ALPHA / 2) * float(terms.std()) / math.sqrt(len(terms))
    # 1e-9: rounding, where w' = w makes every term 1.
    assert abs(float(terms.mean()) - 1) <= bound + 1e-9


@each(DENSITIES)
def test_objects(density: Density) -> None:
    u, v = uniforms(64, 3)
    for other in (copy.deepcopy(density), pickle.loads(pickle.dumps(density))):
        for ours, theirs in zip(density.sample(u, v), other.sample(u, v)):
            torch.testing.assert_close(ours, theirs, atol=0, rtol=0)
    assert density == copy.copy(density)
    assert hash(density) == hash(copy.copy(density))


def test_repr_and_equality() -> None:
    assert repr(Normal(25)) == "Normal(variance=(25.0, 25.0))"
    assert Normal(25) == Normal((25.0, 25.0)) != Normal((25.0, 24.0))
    assert repr(FilterDensity(Box())) == "FilterDensity(filter=Box(width=1.0))"
    assert FilterDensity(Gaussian(0.5)) == FilterDensity(Gaussian(0.5))


def test_normal_is_the_inverse_cdf() -> None:
    u = torch.tensor([1e-6, 1e-3, 0.25, 0.5, 0.99, 1 - 1e-6], dtype=F64)
    dx, dy = Normal((4.0, 9.0)).sample(u, u.flip(0))
    torch.testing.assert_close(dx, torch.tensor(2 * stats.norm.ppf(u.numpy())), rtol=1e-8, atol=1e-12)
    torch.testing.assert_close(dy, torch.tensor(3 * stats.norm.ppf(u.flip(0).numpy())), rtol=1e-8, atol=1e-12)
    # u = 0 stands for the middle of [0, 2⁻²⁴) in float32.
    zero = torch.zeros(1)
    assert float(Normal(1.0).sample(zero, zero)[0]) == pytest.approx(stats.norm.ppf(2.0**-25), abs=1e-6)


def test_normal_pdf() -> None:
    dx, dy = torch.tensor([0.3, -2.0], dtype=F64), torch.tensor([1.0, 0.5], dtype=F64)
    truth = stats.norm.pdf(dx.numpy(), scale=2) * stats.norm.pdf(dy.numpy(), scale=3)
    torch.testing.assert_close(Normal((4.0, 9.0)).pdf(dx, dy), torch.tensor(truth))


@pytest.mark.parametrize(("a", "b", "shift"), [(0.25, 0.25, 0.0), (0.25, 0.5, 0.0), (0.25, 0.2, 0.0), (1.0, 2.0, 0.7)])
def test_second_moment_in_closed_form(a: float, b: float, shift: float) -> None:
    """∫ w²/ρ = b² / (a (2b - a)) · exp(|s|² / (2b - a)) for w = N(0, a), ρ = N(s, b), 2b > a."""
    std = math.sqrt(a)
    w, density = Gaussian(std, 14 * std), Normal(b)
    dx, dy, weights = plane(14 * std, 14 * std, 192)
    second = float((w(dx, dy) ** 2 / density.pdf(dx - shift, dy) * weights).sum())
    assert second == pytest.approx(b**2 / (a * (2 * b - a)) * math.exp(shift**2 / (2 * b - a)), rel=1e-9)


@pytest.mark.parametrize("filter", FILTERS, ids=repr)
def test_covers_itself(filter: Filter) -> None:
    assert FilterDensity(filter).covers(filter)
    assert Normal(25.0).covers(filter)


@pytest.mark.parametrize(
    ("density", "filter", "covered"),
    [
        (FilterDensity(Box()), Gaussian(), False),
        (FilterDensity(Gaussian()), Box(), True),
        (FilterDensity(Lanczos(3)), Mitchell(), True),
        (FilterDensity(Mitchell()), Lanczos(3), False),
        (FilterDensity(Gaussian()), Sinc(), False),
        (Normal(25.0), Sinc(), True),
        (FilterDensity(Tabulated([1.0, 0.0, 0.0, 1.0])), Box(2.0), False),
        (FilterDensity(Tabulated([1.0, 0.0, 0.0, 1.0])), Tabulated([2.0, 0.0, 0.0, 1.0]), True),
        (Normal(1e-4), Gaussian(0.5), False),
    ],
)
def test_covers(density: Density, filter: Filter, covered: bool) -> None:
    assert density.covers(filter) is covered


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Normal(0.0), "Normal: variance .*received 0.0.*px²"),
        (lambda: Normal(-1.0), "received -1.0"),
        (lambda: Normal(math.nan), "received nan"),
        (lambda: Normal((1.0, math.inf)), "received inf"),
        (lambda: Normal((1.0, 2.0, 3.0)), r"received \(1.0, 2.0, 3.0\)"),  # type: ignore[arg-type]
        (lambda: FilterDensity(Sinc()), "not integrable over the plane"),
        (lambda: FilterDensity(0.5), "FilterDensity: filter must be a Filter; received 0.5"),  # type: ignore[arg-type]
    ],
)
def test_bad_arguments(make: Callable[[], Density], message: str) -> None:
    with pytest.raises(McaaError, match=message):
        make()
