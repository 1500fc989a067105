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

from torch_mcaa.densities import Density, FilterDensity, Histogram, Mixture, Normal
from torch_mcaa.densities.histogram import bin_density, sample_bins
from torch_mcaa.densities.mixture import choose
from torch_mcaa.errors import McaaError
from torch_mcaa.filters import BlackmanHarris, Box, CatmullRom, Filter, Gaussian, Lanczos, Mitchell, Sinc, Tabulated, Tent

ALPHA = 1e-5
F64 = torch.float64
BELOW_ONE = 1 - 2.0**-24
BINS = 24

GRID = Tabulated(torch.randn(5, 7, generator=torch.Generator().manual_seed(3)) + 1, 1.5)
PROFILE = Tabulated([0.0, -1.0, 0.2, 4.0, 3.0, -0.5, 1.0], 1.5)
FILTERS = [Box(), Tent(), Gaussian(), Mitchell(), CatmullRom(), Lanczos(), BlackmanHarris(), PROFILE, GRID]
# Edges of bins and boxes lie on those of the panels of `plane`. HOLED is 0 in its outer ring, beyond 1.5 px.
STEPS = Histogram([[1.0, 5.0, 2.0, 1e-3], [0.5, 0.5, 4.0, 2.0], [3.0, 1.0, 9.0, 0.25]], (2.0, 1.5))
HOLED = Histogram(np.pad(np.arange(1.0, 37.0).reshape(6, 6), 1), 2.0)
TWO = Mixture([Normal(0.3, (-0.5, 0.25)), Normal((2.0, 0.5), (1.0, 0.0))], [1.0, 3.0])
THREE = Mixture((FilterDensity(Box()), Histogram([[1, 0, 2]], 1.0), FilterDensity(Gaussian(0.5, 2.0))), (0.1, 0.2, 4))
NORMALS = [Normal(25.0), Normal((0.3, 2.0)), Normal((0.3, 2.0), (0.7, -1.5))]
DENSITIES = [*map(FilterDensity, FILTERS), *NORMALS, TWO, THREE, STEPS, HOLED]


def each(cases: list) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("density", cases, ids=repr)


def extent(density: Density) -> tuple[float, float]:
    """Half-widths that leave out less than 1e-15 of the density."""
    if isinstance(density, Normal):
        rx, ry = (abs(c) + 8 * math.sqrt(v) for c, v in zip(density.centre, density.variance))
        return rx, ry
    if isinstance(density, Mixture):
        rx, ry = map(max, zip(*map(extent, density.components)))
        return rx, ry
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
    assert repr(Normal(25)) == "Normal(variance=(25.0, 25.0), centre=(0.0, 0.0))"
    assert Normal(25) == Normal((25.0, 25.0)) != Normal((25.0, 24.0))
    assert Normal(25, (1, 0)) == Normal(25, centre=(1.0, 0.0)) != Normal(25)
    assert repr(Mixture([Normal(1.0)])) == f"Mixture(components=({Normal(1.0)},), weights=(1.0,))"
    assert Mixture([Normal(1.0), Normal(4.0)]) == Mixture((Normal(1.0), Normal(4.0)), (3, 3.0)) != Mixture([Normal(1.0)])
    assert repr(Histogram(torch.eye(3), (1, 2))) == "Histogram(<3x3 values>, radius=(1.0, 2.0))"
    same = [np.eye(3), 7 * torch.eye(3, dtype=torch.bfloat16), [[1, 0, 0], [0, 1, 0], [0, 0, 1]]]
    assert {Histogram(values, 2) for values in same} == {Histogram(torch.eye(3), (2.0, 2.0))}
    assert Histogram(torch.eye(3), 2) != Histogram(torch.eye(3), 1) != Histogram(torch.ones(3, 3), 1)
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
    for cx, cy in [(0.0, 0.0), (-0.4, 2.5)]:
        truth = stats.norm.pdf(dx.numpy(), cx, 2) * stats.norm.pdf(dy.numpy(), cy, 3)
        torch.testing.assert_close(Normal((4.0, 9.0), (cx, cy)).pdf(dx, dy), torch.tensor(truth))


def test_normal_is_moved_by_its_centre() -> None:
    u, v = uniforms(1000, 5, F64)
    for ours, origin, shift in zip(Normal(2.0, (3.0, -4.0)).sample(u, v), Normal(2.0).sample(u, v), (3.0, -4.0)):
        torch.testing.assert_close(ours, origin + shift, rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    ("a", "b", "centre"),
    [
        (0.25, 0.25, (0.0, 0.0)),
        (0.25, 0.5, (0.0, 0.0)),
        (0.25, 0.2, (0.0, 0.0)),
        (1.0, 2.0, (0.0, 0.7)),
        (0.25, 0.2, (-0.3, 0.4)),
    ],
)
def test_second_moment_in_closed_form(a: float, b: float, centre: tuple[float, float]) -> None:
    """∫ w²/ρ = b² / (a (2b - a)) · exp(|d|² / (2b - a)) for w = N(0, a I), ρ = N(d, b I), 2b > a."""
    std = math.sqrt(a)
    w, density = Gaussian(std, 14 * std), Normal(b, centre)
    dx, dy, weights = plane(14 * std, 14 * std, 192)
    second = float((w(dx, dy) ** 2 / density.pdf(dx, dy) * weights).sum())
    assert second == pytest.approx(b**2 / (a * (2 * b - a)) * math.exp(math.hypot(*centre) ** 2 / (2 * b - a)), rel=1e-9)


def test_moments_of_a_mixture() -> None:
    """Mean Σ p c, second moments Σ p (variance + c²): by quadrature, and of samples on a grid of 512² strata."""
    assert TWO.weights == (0.25, 0.75)
    mean = -0.5 / 4 + 1.0 * 3 / 4, 0.25 / 4
    second = (0.3 + 0.25) / 4 + (2 + 1) * 3 / 4, (0.3 + 0.0625) / 4 + 0.5 * 3 / 4
    dx, dy, weights = plane(*extent(TWO))
    density = TWO.pdf(dx, dy) * weights
    centres = (torch.arange(512, dtype=F64) + 0.5) / 512
    points = TWO.sample(centres, centres[:, None])
    for d, at, m1, m2 in zip((dx, dy), points, mean, second):
        assert float((d * density).sum()) == pytest.approx(m1, abs=1e-9)
        assert float((d**2 * density).sum()) == pytest.approx(m2, abs=1e-9)
        # Within a component the midpoint rule has 128 strata or more: it puts z² at 0.99, missing the outer tails.
        assert float(at.mean()) == pytest.approx(m1, abs=1e-3)
        assert float((at**2).mean()) == pytest.approx(m2, rel=0.02)


def test_mixture_keeps_strata_and_order_within_each_component() -> None:
    n = 1 << 12
    u = (torch.arange(n, dtype=F64) + 0.5) / n
    index, inner = choose(torch.tensor([0.25, 0.0, 0.5, 0.25], dtype=F64), u)
    for k, share in ((0, 0.25), (2, 0.5), (3, 0.25)):
        m = int(n * share)
        torch.testing.assert_close(inner[index == k], (torch.arange(m, dtype=F64) + 0.5) / m, rtol=0, atol=1e-12)
    assert (index.diff() >= 0).all()


def test_mixture_of_one_is_that_one() -> None:
    u, v = uniforms(1000, 7)
    for component in (Normal(0.3, (1.0, 2.0)), STEPS, FilterDensity(GRID)):
        mixture = Mixture([component])
        for ours, theirs in zip(mixture.sample(u, v), component.sample(u, v)):
            torch.testing.assert_close(ours, theirs, rtol=0, atol=0)
        assert mixture.radius == component.radius
    assert Mixture([STEPS, FilterDensity(Tent())]).radius == (2.0, 1.5)
    assert Mixture([STEPS, Normal(1.0)]).radius == (math.inf, math.inf)


@each([TWO, THREE, STEPS])
def test_samples_broadcast(density: Density) -> None:
    u, v = torch.rand(3, 1, generator=torch.Generator().manual_seed(1)), torch.rand(4, generator=torch.Generator().manual_seed(2))
    grid = density.sample(u, v)
    flat = density.sample(u.expand(3, 4).reshape(-1), v.expand(3, 4).reshape(-1))
    for ours, theirs in zip(grid, flat):
        assert ours.shape == (3, 4)
        assert torch.equal(ours.reshape(-1), theirs)


def test_weights_of_any_scale() -> None:
    assert Mixture([Normal(1.0), Normal(2.0)], (1e308, 1e308)).weights == (0.5, 0.5)
    assert Mixture([Normal(1.0), Normal(2.0)], [3e-300, 1e-300]).weights == pytest.approx((0.75, 0.25), rel=1e-15)
    assert Histogram([[1e308, 1e308]], 1.0).values == ((0.5, 0.5),)
    assert math.fsum(map(math.fsum, STEPS.values)) == pytest.approx(1, abs=1e-15)


def masses_of(*shape: int, holes: float, seed: int = 17) -> Tensor:
    """Masses of sum 1 over the first two dims, with that share of holes, and of magnitudes over 12 decades."""
    r = torch.rand(2, *shape, dtype=F64, generator=torch.Generator().manual_seed(seed))
    masses = torch.where(r[0] < holes, 0, 10 ** (-12 * r[1] ** 4))
    masses[1, 0] += 1e-3
    return masses / masses.sum((0, 1))


def loop_choose(weights: list[float], u: float) -> tuple[int, float]:
    """The cell where the running sum first exceeds u; the last one of any weight where rounding lets none do so."""
    below = 0.0
    for k, weight in enumerate(weights):
        if u < below + weight:
            return k, (u - below) / weight
        below += weight
    return max(k for k, weight in enumerate(weights) if weight > 0), 1.0


SHAPES = [(4, 4), (8, 5), (1, 7), (3, 1), (1, 1), (16, 16)]


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("dtype", [torch.float32, F64])
def test_shared_functions_against_plain_loops(shape: tuple[int, int], dtype: torch.dtype) -> None:
    (rows, columns), s = shape, (2, 3)
    masses = masses_of(rows, columns, *s, holes=0.4) if rows > 1 else torch.full((1, columns, *s), 1 / columns, dtype=F64)
    u, v = (r.reshape(40, *s) for r in uniforms(240, 19, dtype))
    x, y, density = sample_bins(masses, u, v)
    across, stretched = choose(masses.sum(1), v)
    assert x.dtype == y.dtype == stretched.dtype == dtype
    # A cell of mass p stretches the rounding of the sums, 2⁻⁵², by 1/p; bins of under 1e-6 hardly ever come up.
    near = 1e-9 if dtype == F64 else 1e-6
    for i, j in np.ndindex(*s):
        table = masses[:, :, i, j].tolist()
        for n in range(40):
            row, b = loop_choose([math.fsum(line) for line in table], float(v[n, i, j]))
            column, a = loop_choose([m / math.fsum(table[row]) for m in table[row]], float(u[n, i, j]))
            assert float(density[n, i, j]) == pytest.approx(table[row][column] * rows * columns, rel=1e-12)
            assert float(x[n, i, j]) == pytest.approx((column + a) / columns, abs=near)
            assert float(y[n, i, j]) == pytest.approx((row + b) / rows, abs=near)
            assert int(across[n, i, j]) == row
            assert float(stretched[n, i, j]) == pytest.approx(b, abs=near)
    assert torch.equal(bin_density(masses, x, y), density)


@pytest.mark.parametrize("shape", SHAPES[:-1])
def test_classes_against_shared_functions(shape: tuple[int, int]) -> None:
    masses = masses_of(*shape, holes=0.3) if shape[0] > 1 else torch.full(shape, 1 / shape[1], dtype=F64)
    density = Histogram(masses, (0.5, 2.0))
    u, v = uniforms(500, 23, F64)
    x, y, relative = (part[:, 0] for part in sample_bins(masses[..., None], u[:, None], v[:, None]))
    dx, dy = density.sample(u, v)
    torch.testing.assert_close(dx, x - 0.5, rtol=0, atol=1e-15)
    torch.testing.assert_close(dy, 4 * y - 2, rtol=0, atol=4e-15)
    torch.testing.assert_close(density.pdf(dx, dy), relative / 4)
    index, _ = choose(torch.tensor(THREE.weights, dtype=F64), u)
    own = THREE.sample(u, v)[0][index == 1]
    # The middle third of the one histogram among THREE is a hole.
    assert (own.abs() >= 1 / 3).all()


@pytest.mark.parametrize("dtype", [torch.float32, F64])
@pytest.mark.parametrize("shape", [(3, 4), (5, 7), (8, 8), (7, 49)])
def test_edges_never_lead_into_holes(shape: tuple[int, int], dtype: torch.dtype) -> None:
    """u and v on every running sum, one step to either side, at 0 and just below 1; half of the bins are holes."""
    masses = masses_of(*shape, holes=0.5)
    masses[0] = 0
    masses[-1, -1] = 0
    # Radii that are no binary fractions, so that the edges round.
    density = Histogram(masses, (0.7, 1.1))
    masses = torch.tensor(density.values, dtype=F64)
    on = torch.cat([torch.zeros(1, dtype=F64), masses.sum(1).cumsum(0), *(row.cumsum(0) / row.sum() for row in masses[1:])]).to(
        dtype
    )
    one = torch.ones(1, dtype=dtype)
    on = torch.cat([on, torch.nextafter(on, one), torch.nextafter(on, -one)])
    on = on[on.isfinite()].clamp(0, 1 - torch.finfo(dtype).eps / 2)
    u, v = (r.reshape(-1) for r in torch.meshgrid(on, on, indexing="ij"))
    x, y, relative = sample_bins(masses, u, v)
    assert (relative > 0).all()
    assert torch.equal(bin_density(masses, x, y), relative)
    assert (x >= 0).all() and (x < 1).all() and (y >= 0).all() and (y < 1).all()
    dx, dy = density.sample(u, v)
    torch.testing.assert_close(density.pdf(dx, dy).double(), relative / (4 * 0.7 * 1.1), rtol=1e-6, atol=1e-30)
    index, inner = choose(masses.flatten(), u)
    assert (masses.flatten()[index] > 0).all()
    assert (inner >= 0).all() and (inner < 1).all()


@settings(max_examples=200, deadline=None, derandomize=True)
@given(
    weights=st.lists(st.sampled_from([0.0, 0.0, 5e-324, 1e-310, 1e-17, 0.1, 1 / 3, 1.0]), min_size=1, max_size=17).filter(any),
    u=st.floats(0, 1, exclude_max=True),
    wide=st.booleans(),
)
def test_choose_is_never_out_of_range(weights: list[float], u: float, wide: bool) -> None:
    dtype = F64 if wide else torch.float32
    at = torch.tensor([0.0, u, 1 - torch.finfo(dtype).eps / 2], dtype=F64).to(dtype).clamp_max(1 - torch.finfo(dtype).eps / 2)
    index, inner = choose(torch.tensor(weights, dtype=F64) / sum(weights), at)
    assert all(weights[k] > 0 for k in index)
    assert (inner >= 0).all() and (inner < 1).all()
    assert index.dtype == torch.int64 and inner.dtype == dtype
    assert index[0] <= index[1] <= index[2]


def test_rounding_neither_reaches_one_nor_leaves_the_mass() -> None:
    # 1 - 3e-12 of a cell, which is 1 in float32.
    u = torch.tensor([0.3])
    index, inner = choose(torch.tensor([float(u) + 1e-12, 1 - float(u) - 1e-12], dtype=F64), u)
    assert index.tolist() == [0] and float(inner) == BELOW_ONE
    # 0.9 of the least positive number is that number, at whose right there is nothing.
    masses = torch.tensor([[5e-324, 0.0], [0.5, 0.5]], dtype=F64)
    x, y, density = sample_bins(masses, torch.tensor([0.9], dtype=F64), torch.zeros(1, dtype=F64))
    assert 0 <= float(x) < 0.5 and 0 <= float(y) < 0.5 and float(density) > 0


@each([STEPS, HOLED])
def test_histogram_grows_with_u_and_v(density: Histogram) -> None:
    u, v = (r.sort().values for r in uniforms(1000, 41))
    dx, dy = density.sample(u, v[::100, None])
    assert (dx.diff(dim=1) >= 0).all()
    assert (dy.diff(dim=0) >= 0).all() and (dy.diff(dim=1) == 0).all()


def test_histogram_orientation_and_borders() -> None:
    density = Histogram([[1.0, 2.0, 3.0], [4.0, 5.0, 5.0]], (3.0, 1.0))
    x, y = torch.tensor([-2.0, 0.0, 2.0]), torch.tensor([-0.5, 0.5])
    torch.testing.assert_close(density.pdf(x, y[:, None]), torch.tensor([[1.0, 2.0, 3.0], [4.0, 5.0, 5.0]]) / 20 / 2)
    edge = torch.tensor([-3.1, -3.0, -1.0, 1.0, 3.0, 3.1, math.inf, -math.inf, math.nan])
    truth = torch.tensor([0.0, 1.0, 2.0, 3.0, 3.0, 0.0, 0.0, 0.0, 0.0]) / 40
    torch.testing.assert_close(density.pdf(edge, torch.full_like(edge, -1.0)), truth)
    assert not density.pdf(edge, torch.full_like(edge, 1.5)).any()


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
        (Normal(25.0, (3.0, 4.0)), Mitchell(), True),
        (Normal(1e-2, (4.0, 0.0)), Box(), False),
        (HOLED, Gaussian(0.5, 1.5), True),
        (HOLED, Gaussian(0.5, 1.6), False),
        (Histogram([[1, 1, 1], [1, 0, 1], [1, 1, 1]], 2.0), Box(), False),
        (Histogram(np.ones((1, 1)), 1.0), Tent(), True),
        (Histogram(np.ones((2, 2)), (1.0, 0.9)), Tent(), False),
        (Mixture([HOLED, Histogram([[1.0]], 2.0)], [1, 1e-9]), Gaussian(0.5, 2.0), True),
        # A wide bar and a high one, which leave the corners out.
        (Mixture([Histogram([[1.0]], (2.0, 0.5)), Histogram([[1.0]], (0.5, 2.0))]), Mitchell(), False),
        (Mixture([FilterDensity(Box()), Normal(1.0)]), Sinc(), True),
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
        (lambda: Normal(1.0, 0.5), "Normal: centre must be a pair of numbers; received 0.5: .*px"),  # type: ignore[arg-type]
        (lambda: Normal(1.0, (0.0, 0.0, 0.0)), "centre must be a pair"),  # type: ignore[arg-type]
        (lambda: Normal(1.0, (math.nan, 0.0)), r"Normal: centre must be a number in \[-1e\+06, 1e\+06\]; received nan"),
        (lambda: Normal(1.0, (0.0, "0")), "received '0'"),  # type: ignore[arg-type]
        (lambda: Mixture([]), r"Mixture: components must be .* at least one Density; received \[\]"),
        (lambda: Mixture(Normal(1.0)), "components must be a list or tuple"),  # type: ignore[arg-type]
        (lambda: Mixture([Normal(1.0), Box()]), "every component must be a Density; received Box"),  # type: ignore[list-item]
        (lambda: Mixture([Normal(1.0)], [0.5, 0.5]), r"weights must be a list or tuple of 1; received \[0.5, 0.5\]"),
        (lambda: Mixture([Normal(1.0)], 1.0), "weights must be a list or tuple of 1; received 1.0"),  # type: ignore[arg-type]
        (lambda: Mixture([Normal(1.0)] * 2, [1.0, 0.0]), "weights must be positive finite numbers; received 0.0: .*equal"),
        (lambda: Mixture([Normal(1.0)] * 2, [1.0, -1.0]), "received -1.0"),
        (lambda: Mixture([Normal(1.0)] * 2, [math.nan, 1.0]), "received nan"),
        (lambda: Mixture([Normal(1.0)] * 2, [math.inf, 1.0]), "received inf"),
        (lambda: Mixture([Normal(1.0)] * 2, ["1", 1.0]), "received '1'"),  # type: ignore[list-item]
        (lambda: Mixture([Normal(1.0)] * 2, [True, 1.0]), "received True"),
        (lambda: Histogram([[1.0]], 0.0), "Histogram: radius must be a number .*received 0.0: .*pixels"),
        (lambda: Histogram([[1.0]], (1.0, math.inf)), "radius .*received inf"),
        (lambda: Histogram([[1.0]], (1.0, 1.0, 1.0)), r"radius .*received \(1.0, 1.0, 1.0\)"),  # type: ignore[arg-type]
        (lambda: Histogram([1.0, 2.0], 1.0), r"values must have shape \(rows, columns\); received \(2,\)"),  # type: ignore[list-item]
        (lambda: Histogram(torch.ones(2, 0), 1.0), r"received \(2, 0\)"),
        (lambda: Histogram(torch.ones(2, 2, 2), 1.0), r"received \(2, 2, 2\)"),
        (
            lambda: Histogram([[1.0, 2.0], [3.0]], 1.0),
            r"values must be a table of numbers; received \[\[1.0, 2.0\], \[3.0\]\]: .*rows",
        ),
        (lambda: Histogram([["1"]], 1.0), r"table of numbers; received \[\['1'\]\]"),  # type: ignore[list-item]
        (lambda: Histogram(torch.ones(1, 1, dtype=torch.complex64), 1.0), "table of numbers"),
        (lambda: Histogram(None, 1.0), "table of numbers; received None"),  # type: ignore[arg-type]
        (lambda: Histogram([[1.0, -2.0]], 1.0), "values must be nonnegative and finite; received -2.0"),
        (lambda: Histogram([[1.0, math.nan]], 1.0), "received nan"),
        (lambda: Histogram(np.array([[1.0, np.inf]]), 1.0), "received inf"),
        (lambda: Histogram(np.zeros((2, 3)), 1.0), "values must not be all 0; received 6 zeros: .*positive"),
        (lambda: FilterDensity(Sinc()), "not integrable over the plane"),
        (lambda: FilterDensity(0.5), "FilterDensity: filter must be a Filter; received 0.5"),  # type: ignore[arg-type]
    ],
)
def test_bad_arguments(make: Callable[[], Density], message: str) -> None:
    with pytest.raises(McaaError, match=message):
        make()
