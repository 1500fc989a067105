"""One suite for every filter, then the closed forms of each.

Statistical tests have fixed seeds and significance 1e-5, divided (Sidak) among the statistics looked at together. Quadrature is
composite Gauss-Legendre with its panels on the knots of every filter here, so its own error is rounding: 1e-12 and below.
"""

from __future__ import annotations

import copy
import math
import pickle
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import special, stats
from torch import Tensor

import torch_mcaa.filters as filters
from torch_mcaa.errors import McaaError
from torch_mcaa.filters import (
    BlackmanHarris,
    Box,
    CatmullRom,
    Filter,
    Gaussian,
    Lanczos,
    Mitchell,
    SeparableFilter,
    Sinc,
    Tabulated,
    Tent,
    parse_filter,
)
from torch_mcaa.filters.sinc import sine_integral

ALPHA = 1e-5
F64 = torch.float64
BELOW_ONE = 1 - 2.0**-24

CLOSED = [
    Box(),
    Box(2.5),
    Tent(),
    Tent(1.5),
    Gaussian(),
    Gaussian(1.0, 2.0),
    Gaussian(0.3, 3.0),
    Mitchell(),
    Mitchell(1, 0),
    Mitchell(-1, 3),
    CatmullRom(),
    Lanczos(1),
    Lanczos(2),
    Lanczos(),
    Lanczos(8),
    BlackmanHarris(),
]
PROFILES = [Tabulated([0.0, -1.0, 0.2, 4.0, 3.0, -0.5, 1.0], 1.5), Tabulated([1.0, 0.0, 0.0, 0.0, 1.0])]
GRIDS = [
    Tabulated(torch.randn(5, 7, generator=torch.Generator().manual_seed(3)) + 1, 1.5),
    Tabulated([[0.0, 1.0, 0.0], [1.0, 2.0, 3.0], [0.0, 1.0, 0.0]]),
]
SAMPLED = [*CLOSED, *PROFILES]
SEPARABLE = [*SAMPLED, Sinc()]


def each(cases: list, name: str = "filter") -> pytest.MarkDecorator:
    return pytest.mark.parametrize(name, cases, ids=repr)


def rule(half_width: float, panels: int = 1536, order: int = 4) -> tuple[Tensor, Tensor]:
    """Nodes and weights over [-half_width, half_width]; the panels' number is divisible by 2⁹ and by 3."""
    x, w = (torch.tensor(a) for a in np.polynomial.legendre.leggauss(order))
    edges = torch.linspace(-half_width, half_width, panels + 1, dtype=F64)
    width = edges.diff()[:, None] / 2
    return (edges[:-1, None] + width * (x + 1)).reshape(-1), (width * w).reshape(-1)


def plane(filter: Filter, panels: int = 96) -> tuple[Tensor, Tensor, Tensor]:
    """dx (1, n), dy (n, 1) and weights (n, n) over the support."""
    (x, wx), (y, wy) = rule(filter.radius[0], panels), rule(filter.radius[1], panels)
    return x[None], y[:, None], wx * wy[:, None]


def uniforms(n: int, seed: int, dtype: torch.dtype = torch.float32) -> tuple[Tensor, Tensor]:
    u = torch.rand(2, n, generator=torch.Generator().manual_seed(seed), dtype=dtype)
    return u[0], u[1]


# ---------------------------------------------------------------- w and its integrals


@each([*SAMPLED, *GRIDS])
def test_integral_is_one(filter: Filter) -> None:
    dx, dy, weights = plane(filter, 192)
    assert float((filter(dx, dy) * weights).sum()) == pytest.approx(1, abs=1e-12)


@each(SAMPLED)
def test_absolute_integral(filter: SeparableFilter) -> None:
    x, w = rule(filter.half_width, 24576)
    # The panel in which |profile| has its kink is the error: slope · (5 px / 24576)² / 4, 1e-7 for the steepest.
    assert filter.absolute_profile_integral == pytest.approx(float((filter.profile(x).abs() * w).sum()), abs=2e-7)
    assert filter.absolute_integral == filter.absolute_profile_integral**2 >= 1 - 1e-12


@each(SEPARABLE)
def test_cdf_is_the_integral_of_the_profile(filter: SeparableFilter) -> None:
    half = min(filter.half_width, 15.0)
    x, w = rule(half)
    integral = (filter.profile(x) * w).reshape(-1, 4).sum(1).cumsum(0)
    edges = torch.linspace(-half, half, 1537, dtype=F64)
    cdf = filter.profile_cdf(edges)
    torch.testing.assert_close(cdf[1:] - cdf[0], integral, atol=1e-12, rtol=0)
    far = filter.profile_cdf(torch.tensor([-1e300, 1e300], dtype=F64))
    torch.testing.assert_close(far, torch.tensor([0.0, 1.0], dtype=F64), atol=1e-14, rtol=0)


@each(SEPARABLE)
def test_profile_is_the_derivative_of_the_cdf(filter: SeparableFilter) -> None:
    half = min(filter.half_width, 15.0)
    d = (torch.linspace(-half, half, 1000, dtype=F64)[1:-1]).requires_grad_()
    (slope,) = torch.autograd.grad(filter.profile_cdf(d).sum(), d)
    torch.testing.assert_close(slope, filter.profile(d.detach()), atol=1e-10, rtol=0)


@each(SEPARABLE)
def test_separable(filter: SeparableFilter) -> None:
    dx, dy = torch.linspace(-3, 3, 41, dtype=F64), torch.linspace(-2, 2, 37, dtype=F64)[:, None]
    assert filter.separable
    assert filter.radius == (filter.half_width, filter.half_width)
    torch.testing.assert_close(filter(dx, dy), filter.profile(dx) * filter.profile(dy))


@each([*SAMPLED, *GRIDS])
@pytest.mark.parametrize("dtype", [torch.float32, F64], ids=str)
def test_zero_outside_the_support(filter: Filter, dtype: torch.dtype) -> None:
    rx, ry = filter.radius
    beyond = torch.tensor([1 + 1e-6, 1.5, 1e3, 1e30], dtype=dtype)
    zero = torch.zeros(1, dtype=dtype)
    for sign in (-1, 1):
        assert not filter(sign * rx * beyond, zero).any()
        assert not filter(zero, sign * ry * beyond).any()
        assert not filter.pdf(sign * rx * beyond, zero).any()
    assert filter(zero, zero).dtype == dtype


@each([*CLOSED, Sinc()])
@settings(max_examples=50, deadline=None, derandomize=True)
@given(d=st.floats(allow_nan=False, allow_infinity=False, width=32))
def test_profile_is_finite_and_symmetric(filter: SeparableFilter, d: float) -> None:
    for dtype in (torch.float32, F64):
        left, right = filter.profile(torch.tensor([-d, d], dtype=dtype))
        assert torch.isfinite(left)
        assert left == right


# ---------------------------------------------------------------- sampling


def lobes(filter: SeparableFilter) -> list[float]:
    """Where in u the sample changes sign or jumps, by bisection, with 0 and 1."""
    u = torch.linspace(0, 1, 20001, dtype=F64)[:-1]
    d, sign = filter.profile_sample(u)
    jump = 0.1 * filter.half_width
    at = torch.nonzero((sign.diff() != 0) | (d.diff() > jump)).reshape(-1)
    low, high = u[at], u[at + 1]
    for _ in range(50):
        middle = (low + high) / 2
        there, its_sign = filter.profile_sample(middle)
        same = (its_sign == sign[at]) & (there - d[at] <= jump)
        low, high = torch.where(same, middle, low), torch.where(same, high, middle)
    return [0.0, *low.tolist(), 1.0]


MOMENTS: dict[str, Callable[[Tensor], Tensor]] = {
    "1": torch.ones_like,
    "d": lambda d: d,
    "d^2": lambda d: d**2,
    "d^4": lambda d: d**4,
    "cos d": torch.cos,
    "sin 3d": lambda d: torch.sin(3 * d),
}


@each(SAMPLED)
def test_moments_of_profile_samples(filter: SeparableFilter) -> None:
    """E[sign ∫|p| g(d)] against ∫ p g, by the midpoint rule in u between changes of sign, stretched at their ends.

    The rule's error is O(n⁻²) there and below 1e-9; the sampler promises 1e-8 of the moment's scale.
    """
    s = (torch.arange(1 << 15, dtype=F64) + 0.5) / (1 << 15)
    x, w = rule(filter.half_width)
    pieces = [(a + (b - a) * s * s * (3 - 2 * s), (b - a) * 6 * s * (1 - s)) for a, b in pairwise(lobes(filter))]
    for name, g in MOMENTS.items():
        expected = 0.0
        for u, stretch in pieces:
            d, sign = filter.profile_sample(u)
            expected += float((sign * stretch * g(d)).mean()) * filter.absolute_profile_integral
        truth = float((filter.profile(x) * w * g(x)).sum())
        scale = max(1.0, float(g(torch.tensor([filter.half_width], dtype=F64)).abs()))
        assert expected == pytest.approx(truth, abs=2e-8 * scale), name


@each([*SAMPLED, *GRIDS])
def test_float32_samples_follow_float64(filter: Filter) -> None:
    """The float32 map is the float64 one up to rounding, which near a zero of |w| moves a point by √ε."""
    u, v = uniforms(1 << 12, 5)
    low, high = filter.sample(u, v), filter.sample(u.double(), v.double())
    assert {t.dtype for t in low} == {torch.float32}
    assert {t.dtype for t in high} == {F64}
    step = torch.stack([(a - b).abs() for a, b in zip(low[:2], high[:2])]) / filter.radius[0]
    assert float(step.max()) < 4 * math.sqrt(torch.finfo(torch.float32).eps)
    assert float(step.median()) < 1e-6


@each([*SAMPLED, *GRIDS])
def test_chi_square_of_samples(filter: Filter) -> None:
    u, v = uniforms(1 << 17, 11)
    dx, dy, _ = filter.sample(u, v)
    dx64, dy64, weights = plane(filter)
    bins = 24
    probability = (filter.pdf(dx64, dy64) * weights).reshape(bins, 16, bins, 16).sum((1, 3))
    cell = [(((d / r + 1) / 2 * bins).long()).clamp(0, bins - 1) for d, r in zip((dx, dy), filter.radius)]
    counts = torch.bincount(cell[1] * bins + cell[0], minlength=bins * bins).double()
    expected = probability.reshape(-1) * len(u)
    large = expected >= 10
    counts = torch.cat([counts[large], counts[~large].sum()[None]])
    expected = torch.cat([expected[large], expected[~large].sum()[None]])
    used = expected > 0
    assert not counts[~used].any()
    statistic = float(((counts - expected) ** 2 / expected)[used].sum())
    assert stats.chi2.sf(statistic, int(used.sum()) - 1) > ALPHA


@each([*SAMPLED, *GRIDS])
def test_weighted_means_are_integrals(filter: Filter) -> None:
    def product(dx: Tensor, dy: Tensor) -> list[Tensor]:
        one = torch.ones_like(dx + dy)
        return [one, dx**2 * one, torch.cos(2 * dx + dy), dx * dy]

    u, v = uniforms(1 << 16, 17, F64)
    dx, dy, weight = filter.sample(u, v)
    x, y, w = plane(filter)
    bound = stats.norm.isf((1 - (1 - ALPHA) ** (1 / 4)) / 2)
    for sampled, exact in zip(product(dx, dy), product(x, y)):
        terms = weight * sampled
        truth = float((filter(x, y) * w * exact).sum())
        # 1e-9: rounding, where the terms are constant and their standard error is 0.
        assert abs(float(terms.mean()) - truth) <= bound * float(terms.std()) / math.sqrt(len(u)) + 1e-9


@each(SAMPLED)
def test_weights_are_constant_and_carry_the_sign(filter: Filter) -> None:
    dx, dy, weight = filter.sample(*uniforms(1 << 14, 23, F64))
    assert set((weight.abs() / filter.absolute_integral).tolist()) == {1.0}
    value = filter(dx, dy)
    # Rounding may carry a point across a zero of w, where |w| is as small.
    sure = value.abs() > 1e-9
    torch.testing.assert_close(weight.sign()[sure], value.sign()[sure], atol=0, rtol=0)
    torch.testing.assert_close(weight[sure] * filter.pdf(dx, dy)[sure], value[sure])


@each(GRIDS)
def test_weights_of_grids(filter: Filter) -> None:
    u = (torch.arange(1 << 9, dtype=F64) + 0.5) / (1 << 9)
    dx, dy, weight = filter.sample(*torch.meshgrid(u, u, indexing="ij"))
    torch.testing.assert_close(weight * filter.pdf(dx, dy), filter(dx, dy))
    x, y, w = plane(filter)
    assert float((filter.pdf(x, y) * w).sum()) == pytest.approx(1, abs=1e-12)
    # Midpoint rule on 512² points, of terms whose derivative is bounded except at corners.
    assert float(weight.abs().mean()) == pytest.approx(filter.absolute_integral, abs=1e-5)
    assert float(weight.mean()) == pytest.approx(1, abs=1e-5)


@each([*SAMPLED, *GRIDS])
def test_samples_are_monotone(filter: Filter) -> None:
    steps = torch.linspace(0, 1, 3001, dtype=F64)[:-1]
    for fixed in (0.0, 0.3, 0.9):
        other = torch.full_like(steps, fixed)
        assert (filter.sample(steps, other)[0].diff() >= -1e-12).all()
        assert (filter.sample(other, steps)[1].diff() >= -1e-12).all()


@each([*SAMPLED, *GRIDS])
@settings(max_examples=50, deadline=None, derandomize=True)
@given(u=st.floats(0, BELOW_ONE, width=32), v=st.sampled_from([0.0, 2.0**-24, 0.5, BELOW_ONE]))
def test_samples_lie_in_the_support(filter: Filter, u: float, v: float) -> None:
    for dtype in (torch.float32, F64):
        dx, dy, weight = filter.sample(torch.tensor(u, dtype=dtype), torch.tensor([v], dtype=dtype))
        assert (dx.abs() <= filter.radius[0]).all()
        assert (dy.abs() <= filter.radius[1]).all()
        assert torch.isfinite(weight).all()
        assert dx.shape in ((), (1,))


def test_shapes_are_kept() -> None:
    u = torch.rand(3, 4, 5, generator=torch.Generator().manual_seed(0)).transpose(0, 2)
    for filter in (Gaussian(), Lanczos(), *GRIDS):
        assert {t.shape for t in filter.sample(u, u)} == {u.shape}


@pytest.mark.parametrize("filter", [Gaussian(), Lanczos(), PROFILES[0]], ids=repr)
def test_traced_whole(filter: Filter) -> None:
    u, v = uniforms(64, 1)
    traced = torch.compile(lambda u, v: filter.sample(u, v), backend="eager", fullgraph=True)
    for ours, theirs in zip(filter.sample(u, v), traced(u, v)):
        torch.testing.assert_close(ours, theirs, atol=0, rtol=0)


# ---------------------------------------------------------------- objects


@each([*CLOSED, Sinc()])
def test_values(filter: SeparableFilter) -> None:
    again = eval(repr(filter), vars(filters))
    for other in (again, copy.deepcopy(filter), pickle.loads(pickle.dumps(filter))):
        assert other == filter
        assert hash(other) == hash(filter)
        assert repr(other) == repr(filter)
    d = torch.linspace(-2, 2, 9)
    torch.testing.assert_close(pickle.loads(pickle.dumps(filter)).profile(d), filter.profile(d), atol=0, rtol=0)
    assert len(pickle.dumps(filter)) < 500
    with pytest.raises(AttributeError):
        filter.anything = 1  # type: ignore[attr-defined]


def test_equality_is_by_value() -> None:
    assert len(set(CLOSED)) == len(CLOSED)
    assert Gaussian(0.5) == Gaussian(0.5, 2.5) != Gaussian(0.5, 3.0)
    assert CatmullRom() == Mitchell(0, 0.5)


@each([*PROFILES, *GRIDS])
def test_tabulated_objects(filter: Filter) -> None:
    assert filter == filter
    assert "samples" in repr(filter)
    u, v = uniforms(50, 2)
    for other in (copy.deepcopy(filter), pickle.loads(pickle.dumps(filter))):
        for ours, theirs in zip(filter.sample(u, v), other.sample(u, v)):
            torch.testing.assert_close(ours, theirs, atol=0, rtol=0)


# ---------------------------------------------------------------- closed forms


def at(filter: SeparableFilter, *d: float) -> list[float]:
    return filter.profile(torch.tensor(d, dtype=F64)).tolist()


def test_known_values() -> None:
    assert at(Box(), 0, 0.5, -0.5, 0.51) == [1, 1, 1, 0]
    assert at(Box(4.0), 1.9) == [0.25]
    assert at(Tent(2.0), 0, -1, 2) == [0.5, 0.25, 0]
    assert at(Mitchell(), 0, 1, 2) == pytest.approx([8 / 9, 1 / 18, 0], abs=1e-15)
    assert at(Mitchell(1, 0), 0, 1) == pytest.approx([2 / 3, 1 / 6], abs=1e-15)
    assert at(CatmullRom(), 0, 1, -1, 1.5) == pytest.approx([1, 0, 0, -1 / 16], abs=1e-15)
    assert at(Lanczos(3), 1, 2, -2, 3) == pytest.approx([0, 0, 0, 0], abs=1e-16)
    assert at(Sinc(), 0, 0.5, 7) == pytest.approx([1, 2 / math.pi, 0], abs=1e-15)
    assert at(Gaussian(0.5, 50.0), 0, 0.5) == pytest.approx([0.7978845608028654, 0.48394144903828673], abs=1e-15)
    assert at(BlackmanHarris(), 0, 2) == pytest.approx([1 / 0.35875 / 4, 6e-5 / 0.35875 / 4], abs=1e-12)


def test_lanczos_is_the_windowed_sinc() -> None:
    d = torch.linspace(-3, 3, 101, dtype=F64)
    ratio = Lanczos(3).profile(d) / (torch.sinc(d) * torch.sinc(d / 3))
    torch.testing.assert_close(ratio[5:-5], ratio[50].expand(91), atol=1e-9, rtol=0)
    # ∫ sinc² over [-1, 1] is (2/π) Si(2π).
    assert at(Lanczos(1), 0) == pytest.approx([math.pi / 2 / float(special.sici(2 * math.pi)[0])], abs=1e-14)


def test_absolute_integrals_in_closed_form() -> None:
    # The outer piece of Mitchell(0, c) integrates to -c/12 a side.
    assert CatmullRom().absolute_profile_integral == pytest.approx(1 + 4 * 0.5 / 12, abs=1e-12)
    assert Mitchell(0, 1).absolute_profile_integral == pytest.approx(1 + 4 / 12, abs=1e-12)
    assert Tabulated([-1.0, 1.0, 3.0, 1.0, -1.0]).absolute_profile_integral == pytest.approx(9 / 8 + 1 / 8, abs=1e-12)


@pytest.mark.parametrize("filter", [Box(2.0), Tent(), Mitchell(), Mitchell(-1, 3), CatmullRom()], ids=repr)
def test_partition_of_unity(filter: SeparableFilter) -> None:
    d = torch.linspace(0, 1, 57, dtype=F64)[1:-1]
    total = sum(filter.profile(d + k) for k in range(-3, 4))
    torch.testing.assert_close(total, torch.ones_like(d), atol=1e-13, rtol=0)


def test_gaussian_gradient() -> None:
    d = torch.linspace(-2.4, 2.4, 33, dtype=F64).requires_grad_()
    p = Gaussian(0.5).profile(d)
    (slope,) = torch.autograd.grad(p.sum(), d)
    torch.testing.assert_close(slope, (-d / 0.25 * p).detach())


def test_gaussian_float32_reaches_the_tails() -> None:
    u = torch.tensor([0.0, 2.0**-22, 2.0**-20, 1 - 2.0**-20, 1 - 2.0**-22])
    d, _ = Gaussian(1.0).profile_sample(u)
    cut = stats.norm.cdf(-5.0)
    truth = stats.norm.ppf(cut + u.double().numpy() * (1 - 2 * cut))
    torch.testing.assert_close(d.double(), torch.tensor(truth), atol=1e-6, rtol=0)


def test_sine_integral() -> None:
    x = torch.cat([torch.linspace(-60, 60, 20001, dtype=F64), torch.tensor([1e3, -1e6, 1e12, math.inf], dtype=F64)])
    torch.testing.assert_close(sine_integral(x), torch.tensor(special.sici(x.numpy())[0]), atol=2e-14, rtol=0)


def test_sinc_refuses_what_needs_its_absolute_integral() -> None:
    u, v = uniforms(4, 0)
    sinc = Sinc()
    assert sinc.half_width == math.inf
    for refused in (
        lambda: sinc.sample(u, v),
        lambda: sinc.profile_sample(u),
        lambda: sinc.absolute_integral,
        lambda: sinc.absolute_profile_integral,
        lambda: sinc.pdf(u, v),
    ):
        with pytest.raises(McaaError, match="not integrable over the plane"):
            refused()


def test_tabulated_convention() -> None:
    d = torch.linspace(-2, 2, 81, dtype=F64)
    torch.testing.assert_close(Tabulated([0, 5, 0], 1.5).profile(d), Tent(1.5).profile(d))
    torch.testing.assert_close(Tabulated(np.array([3.0, 3.0]), 0.5).profile(d), Box().profile(d))
    corner = Tabulated([[0.0, 0.0], [1.0, 0.0]])
    value = corner(torch.tensor([-1.0, 1.0, -1.0]), torch.tensor([1.0, -1.0, -1.0]))
    assert value.tolist() == [1.0, 0.0, 0.0]


def test_a_grid_of_a_product_is_the_product() -> None:
    samples = torch.tensor([0.5, -1.0, 0.2, 4.0, 3.0, -0.5, 1.0], dtype=F64)
    profile, grid = Tabulated(samples, 1.5), Tabulated(samples[:, None] * samples, 1.5)
    d = torch.linspace(-1.6, 1.6, 61, dtype=F64)
    torch.testing.assert_close(grid(d, d[:, None]), profile(d, d[:, None]))
    assert grid.absolute_integral == pytest.approx(profile.absolute_integral, abs=1e-10)
    for axis in (0, 1):
        torch.testing.assert_close(grid.beyond(d, d[:, None], axis), profile.beyond(d, d[:, None], axis), rtol=0, atol=1e-12)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("filter", [*GRIDS, Gaussian(0.5), Lanczos(3), CatmullRom()], ids=str)
def test_what_lies_beyond_a_place(filter: Filter, axis: int) -> None:
    """Against the trapezoid rule on 2^14 panels, and the rule that serves filters of one's own: within 1e-3, where w has kinks."""
    radius, across = filter.radius[axis], torch.tensor([-0.83, 0.0, 0.41], dtype=F64)
    along = torch.linspace(-radius, radius, (1 << 14) + 1, dtype=F64)
    values = filter(along, across[:, None]) if axis == 0 else filter(across[:, None], along)
    panels = torch.cumulative_trapezoid(values.flip(1), dx=float(along[1] - along[0])).flip(1)
    some = torch.arange(0, 1 << 14, 371)
    place = (along[some], across[:, None]) if axis == 0 else (across[:, None], along[some])
    torch.testing.assert_close(filter.beyond(*place, axis), panels[:, some], rtol=0, atol=1e-6)
    torch.testing.assert_close(Filter.beyond(filter, *place, axis), panels[:, some], rtol=0, atol=1e-3)


# ---------------------------------------------------------------- parsing and refusals


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("box", Box()),
        ("Box:2", Box(2.0)),
        ("tent:1.5", Tent(1.5)),
        ("gaussian:0.5", Gaussian(0.5)),
        ("gaussian: 0.5, 2", Gaussian(0.5, 2.0)),
        ("mitchell", Mitchell()),
        ("mitchell:0.333,0.333", Mitchell(0.333, 0.333)),
        ("mitchell:1/3, 1/3", Mitchell(1 / 3, 1 / 3)),
        ("catmull-rom", CatmullRom()),
        ("CatmullRom", CatmullRom()),
        ("lanczos:3", Lanczos(3)),
        ("blackman_harris", BlackmanHarris()),
        ("sinc", Sinc()),
    ],
)
def test_parse(text: str, expected: Filter) -> None:
    assert parse_filter(text) == expected


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("gausian:1", "'gausian'.*box, tent, gaussian, mitchell, catmull-rom, lanczos, blackman-harris, sinc"),
        ("", "no filter is named ''"),
        ("sinc:2", r"takes 0 argument\(s\).*received 1"),
        ("box:1,2", r"takes 1 argument\(s\) \(width\).*received 2"),
        ("box:wide", "must be numbers.*'wide'"),
        ("gaussian:nan", "std must be a number.*nan"),
        ("lanczos:2.5", "whole number.*2.5"),
    ],
)
def test_parse_refuses(text: str, message: str) -> None:
    with pytest.raises(McaaError, match=message):
        parse_filter(text)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Box(0.0), "Box: width must be .*received 0.0: pass the side in pixels"),
        (lambda: Box("1"), "received '1'"),  # type: ignore[arg-type]
        (lambda: Box(True), "received True"),
        (lambda: Tent(-1.0), "Tent: radius .*received -1.0"),
        (lambda: Tent(math.inf), "Tent: radius .*received inf"),
        (lambda: Gaussian(0.0), "Gaussian: std .*received 0.0"),
        (lambda: Gaussian(-1.0), "Gaussian: std .*received -1.0"),
        (lambda: Gaussian(math.nan), "Gaussian: std .*received nan"),
        (lambda: Gaussian(0.5, 0.0), "Gaussian: radius .*received 0.0.*None for 5 std"),
        (lambda: Gaussian(None), "Gaussian: std .*received None"),  # type: ignore[arg-type]
        (lambda: Mitchell(math.nan, 0), "Mitchell: b .*received nan"),
        (lambda: Mitchell(0, math.inf), "Mitchell: c .*received inf"),
        (lambda: Mitchell(11, 0), "Mitchell: b .*received 11"),
        (lambda: Lanczos(0), "Lanczos: lobes .*received 0"),
        (lambda: Lanczos(65), "Lanczos: lobes .*received 65"),
        (lambda: Lanczos(2.5), "Lanczos: lobes must be a whole number.*received 2.5"),  # type: ignore[arg-type]
        (lambda: Tabulated([1.0]), r"shape \(n,\).*received \(1,\)"),
        (lambda: Tabulated(1.0), r"received \(\)"),  # type: ignore[arg-type]
        (lambda: Tabulated(torch.ones(2, 2, 2)), r"received \(2, 2, 2\)"),
        (lambda: Tabulated([1.0, math.nan]), "must be finite; received 1 NaN or infinite"),
        (lambda: Tabulated([[1.0, math.inf], [math.inf, 0]]), "received 2 NaN or infinite"),
        (lambda: Tabulated([1.0, 0.0, -1.0]), "finite integral other than 0; received 0"),
        (lambda: Tabulated([0.0, 0.0]), "finite integral other than 0"),
        (lambda: Tabulated([1e308, 1e308], 1e3), "finite integral other than 0; received (inf|nan)"),
        (lambda: Tabulated(["a", "b"]), "must be an array of numbers; received list"),  # type: ignore[list-item]
        (lambda: Tabulated([1.0, 1.0], 0), "Tabulated: radius .*received 0"),
    ],
)
def test_bad_arguments(make: Callable[[], Filter], message: str) -> None:
    with pytest.raises(McaaError, match=message):
        make()
