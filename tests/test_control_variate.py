"""Moments of filters by closed form, and the control variate: exact where it can be, unbiased, calibrated, and never singular."""

from __future__ import annotations

import math

import pytest
import torch

import torch_mcaa as mcaa
from torch_mcaa import scenes
from torch_mcaa.errors import McaaError
from torch_mcaa.estimators.paper.control_variate import ControlVariate, _fitted
from torch_mcaa.filters import Filter
from torch_mcaa.filters.gauss import legendre
from torch_mcaa.filters.moments import moment, variance
from torch_mcaa.scenes import Scene

F64 = torch.float64
WIDE = mcaa.Gaussian(0.5, radius=4.0)
GRID = mcaa.Tabulated(torch.randn(5, 7, generator=torch.Generator().manual_seed(3)) + 1, 1.5)
ALPHA = 1e-5
"""For each test, over all its pixels (Bonferroni), two-sided."""


def quantile(tests: int, alpha: float = ALPHA) -> float:
    return -float(torch.special.ndtri(torch.tensor(alpha / tests / 2, dtype=F64)))


def centres(height: int, width: int) -> tuple[torch.Tensor, torch.Tensor]:
    return torch.arange(width, dtype=F64)[None] + 0.5, torch.arange(height, dtype=F64)[:, None] + 0.5


def picture(f: object, side: int, spp: int, seed: int = 0, filter: Filter = WIDE, **options: object) -> mcaa.Rendering:
    chosen = options.pop("estimator", ControlVariate())
    return mcaa.render(f, (side, side), filter=filter, estimator=chosen, spp=spp, seed=seed, dtype=F64, **options)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("filter", "second", "fourth"),
    [
        (mcaa.Box(), 1 / 12, 1 / 80),
        (mcaa.Box(3.3), 3.3**2 / 12, 3.3**4 / 80),
        (mcaa.Tent(1.37), 1.37**2 / 6, 1.37**4 / 15),
        (mcaa.Gaussian(0.5, radius=5.0), 0.25, 3 / 16),
        (mcaa.Gaussian(1e-3, radius=5.0), 1e-6, 3e-12),
        (mcaa.Mitchell(1.0, 0.0), 1 / 3, 0.3),  # the cubic B-spline is a sum of four uniforms
        (mcaa.CatmullRom(), 0.0, None),  # keeps quadratics
        (mcaa.Mitchell(), 1 / 9, None),  # linear in b
        (mcaa.Tabulated([0.0, 1.0, 0.0], 2.0), 4 / 6, 16 / 15),
    ],
    ids=repr,
)
def test_moments_in_closed_form(filter: Filter, second: float, fourth: float | None):
    assert moment(filter, 0, 0) == pytest.approx(1, abs=1e-12)
    assert moment(filter, 1, 0) == pytest.approx(0, abs=1e-12)
    assert moment(filter, 2, 0) == pytest.approx(second, rel=1e-10, abs=1e-12)
    assert moment(filter, 2, 2) == pytest.approx(second**2, rel=1e-10, abs=1e-12)
    if fourth is not None:
        assert moment(filter, 0, 4) == pytest.approx(fourth, rel=1e-10)
    if filter.absolute_integral < 1 + 1e-9:
        assert variance(filter) == pytest.approx((second, second), rel=1e-10)


def test_moments_of_a_grid_are_those_of_its_separable_twin():
    profile = torch.tensor([0.1, 0.6, 1.0, -0.2, 0.3], dtype=F64)
    one, two = mcaa.Tabulated(profile, 1.5), mcaa.Tabulated(profile[:, None] * profile, 1.5)
    for i, j in ((0, 0), (1, 0), (0, 1), (1, 2), (3, 3), (6, 0)):
        assert moment(two, i, j) == pytest.approx(moment(one, i, j), rel=1e-12, abs=1e-13)
    # the modulus has creases inside the cells of the grid
    assert variance(two) == pytest.approx(variance(one), rel=1e-4)


def test_moments_are_not_symmetric_in_their_indices():
    grid = mcaa.Tabulated([[0.0, 0.0, 0.0], [0.0, 1.0, 3.0], [0.0, 0.0, 0.0]], 1.0)
    # mass 1 and 3 / 2 of the two columns, whose hats have means 0 and 2 / 3
    assert moment(grid, 1, 0) == pytest.approx(3 / 5 * 2 / 3, rel=1e-12)
    assert moment(grid, 0, 1) == pytest.approx(0, abs=1e-14)


@pytest.mark.parametrize("ask", [lambda f: moment(f, 2, 0), variance])
def test_moments_of_the_sinc_are_refused(ask: object):
    with pytest.raises(McaaError, match="not finite"):
        ask(mcaa.Sinc())  # type: ignore[operator]


@pytest.mark.parametrize("filter", [WIDE, mcaa.Box(), mcaa.Mitchell(), mcaa.Lanczos(3), GRID], ids=repr)
@pytest.mark.parametrize("order", [1, 2, 3])
def test_polynomials_are_exact(order: int, filter: Filter):
    """Up to the rounding of 64 terms of the size of f; by the tables of the inverse CDFs nothing is lost."""

    def f(x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        return 1 + (x - 2.2) ** order - 0.3 * (y - 1) * (x + y - 4) ** (order - 1)

    def exact(c: torch.Tensor, r: torch.Tensor) -> torch.Tensor:
        # by the quadrature of the filter's support with which the moments were made, of f itself
        nodes, weight = legendre(torch.linspace(-filter.radius[0], filter.radius[0], 241, dtype=F64), 4)
        dx, dy = nodes[None], nodes[:, None]
        w = filter(dx, dy) * weight * weight[:, None]
        return torch.stack([torch.stack([(w * f(x + dx, y + dy)).sum() / w.sum() for x in c[0]]) for y in r[:, 0]])

    result = picture(f, 4, 64, filter=filter, estimator=ControlVariate(order))
    # 240 panels of 4 nodes leave 1e-9 on the smooth ones
    torch.testing.assert_close(result.image[0], exact(*centres(4, 4)), rtol=1e-8, atol=1e-8)


def test_a_quadratic_costs_a_tenth_of_the_variance_at_most():
    scene = scenes.Quadratic(5.2, 4.1, 0.3, -0.2, 0.1, 0.4)
    truth = scene.exact(*centres(9, 9), WIDE)
    for spp, most in ((16, 0.1), (64, 1e-20)):
        errors = [
            torch.stack([picture(scene, 9, spp, s, estimator=e).image[0] - truth for s in range(8)]).square().mean()
            for e in (ControlVariate(), mcaa.Importance(mcaa.Independent()))
        ]
        assert float(errors[0] / errors[1]) < most


def test_an_edge_is_not_much_worse_than_without():
    """Two nets of half the points cost a factor of 2^0.5 to 2 of the variance; 2.5 leaves the noise of 8 x 24 pixels."""
    scene = scenes.HalfPlane(0.4, 12 * (math.cos(0.4) + math.sin(0.4)))
    truth = scene.exact(*centres(24, 24), WIDE)
    errors = [
        torch.stack([picture(scene, 24, 64, s, estimator=e).image[0] - truth for s in range(8)]).square().mean()
        for e in (ControlVariate(), mcaa.Importance(mcaa.Sobol()))
    ]
    assert float(errors[0] / errors[1]) < 2.5


@pytest.mark.parametrize("pattern", [mcaa.Independent(), mcaa.Sobol(), mcaa.Jittered(), mcaa.Lattice()], ids=repr)
@pytest.mark.parametrize("spp", [6, 16])
def test_unbiased(spp: int, pattern: mcaa.Sobol):
    """z of the mean of 256 seeds, in each pixel that the disc's edge passes well inside and for their sum; t of 255 degrees adds 4 %."""
    scene, seeds = scenes.Disc(3.6, 3.2, 2.3), 256
    truth = scene.exact(*centres(7, 7), WIDE)
    inner = (truth > 0.05) & (truth < 0.95)
    images = [picture(scene, 7, spp, s, estimator=ControlVariate(2, pattern)).image[0] for s in range(seeds)]
    error = (torch.stack(images) - truth)[:, inner]
    error = torch.cat([error, error.sum(1, keepdim=True)], 1)
    z = error.mean(0) / (error.std(0) / math.sqrt(seeds))
    assert float(z.abs().max()) < 1.04 * quantile(error.shape[1])


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("filter", [WIDE, mcaa.Lanczos(3), GRID], ids=repr)
def test_unbiased_where_a_fit_to_its_own_points_is_not(filter: Filter, order: int):
    """f of the period of a pixel looks the same from every pixel: one value, 32 x 32 x 12 independent estimates of it.

    Even about the pixel's centre, f lies off a plane where the leverage is large, and so is its fourth power off a paraboloid.
    """

    def f(x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        return torch.cos(2 * math.pi * (x - 0.5)) + torch.cos(2 * math.pi * (y - 0.5)) ** 2 + 1

    nodes, weight = legendre(torch.linspace(-filter.radius[0], filter.radius[0], 241, dtype=F64), 8)
    w = filter(nodes[None], nodes[:, None]) * weight * weight[:, None]
    truth = float((w * f(0.5 + nodes[None], 0.5 + nodes[:, None])).sum())
    chosen = ControlVariate(order, mcaa.Independent())
    values = torch.stack([picture(f, 32, 24, s, filter=filter, estimator=chosen).image for s in range(12)]).flatten()
    z = float((values.mean() - truth) / (values.std() / math.sqrt(len(values))))
    assert abs(z) < quantile(1)


def test_the_sign_is_a_plus():
    """With a minus the value would be off by twice the integral of psi, nearly twice the value."""
    scene = scenes.Ramp(0.1, 0.2, 5.0)
    torch.testing.assert_close(picture(scene, 5, 16).image[0], scene.exact(*centres(5, 5), WIDE))


@pytest.mark.filterwarnings("ignore:.*no second moment")  # some pixels of the blob's rim; their share is asserted
@pytest.mark.parametrize("scene", [scenes.Disc(8.3, 7.9, 5.1), scenes.Blob(8.0, 7.0, 2.5), scenes.Sinusoid(0.9, 0.8)], ids=repr)
@pytest.mark.parametrize("spp", [16, 64])
def test_standard_error_is_calibrated(spp: int, scene: Scene):
    """The 95 % interval covers 0.9 at least, and the standard error is not below 0.75 of the error nor above 3 times."""
    truth = scene.exact(*centres(16, 16), WIDE)
    results = [picture(scene, 16, spp, s) for s in range(24)]
    seen = (truth > 1e-3) & (truth < 1 - 1e-3)
    error = torch.stack([r.image[0] - truth for r in results])[:, seen]
    stderr = torch.stack([r.stderr[0] for r in results])[:, seen]
    finite = torch.isfinite(stderr)
    assert float(finite.to(F64).mean()) > 0.99
    assert float((error.abs() <= 1.96 * stderr)[finite].to(F64).mean()) > 0.9
    assert 0.75 < float((stderr[finite].square().mean() / error[finite].square().mean()).sqrt()) < 3


def test_few_points_are_importance_sampling():
    for spp in (1, 2, 3, 13):
        one, two = picture(scenes.Disc(4, 4, 2.5), 8, spp), picture(scenes.Disc(4, 4, 2.5), 8, spp, estimator=mcaa.Importance())
        assert torch.equal(one.image, two.image) and torch.equal(one.stderr, two.stderr)


def fit(points: torch.Tensor, values: torch.Tensor, weight: torch.Tensor, order: int = 2) -> torch.Tensor:
    """`_fitted` at points (n, 2) of one pixel."""
    x, y = points[:, :1], points[:, 1:]
    columns = [[x ** (d - j) * y**j for j in range(d + 1)] for d in range(order + 1)]
    return _fitted(columns, [[0.0] * (d + 1) for d in range(order + 1)], values[None, :, None], weight[:, None])[0][0, :, 0]


def test_singular_designs_lower_the_order():
    generator = torch.Generator().manual_seed(1)
    points = torch.randn(40, 2, generator=generator, dtype=F64)
    values = points[:, 0] * points[:, 1] + points[:, 0]
    kept = torch.ones(40, dtype=F64)
    torch.testing.assert_close(fit(points, values, kept), values)
    collinear = torch.stack([points[:, 0], 2 * points[:, 0] + 1e-9 * points[:, 1]], 1)
    mean = values.mean().expand(40)
    torch.testing.assert_close(fit(collinear, values, kept), mean)
    torch.testing.assert_close(fit(points[:1].expand(40, 2), values, kept), mean)
    # of 40 points that are evaluated, so many are fitted: 11 do not carry 6 terms, 5 not 3, 1 has no leave-one-out, 0 no mean
    for count, terms in ((12, 6), (11, 3), (5, 1), (1, 1)):
        few = (torch.arange(40) < count).to(F64)
        basis = torch.stack([torch.ones(40, dtype=F64), *points.T, points[:, 0] ** 2, points.prod(1), points[:, 1] ** 2], 1)[
            :, :terms
        ]
        found = basis @ torch.linalg.lstsq(basis[:count], values[:count, None]).solution[:, 0]
        own = fit(points, values, few)
        if terms == 3:  # PRESS may prefer the mean to the slope
            assert torch.allclose(own, found) or torch.allclose(own, values[:count].mean().expand(40))
        else:
            torch.testing.assert_close(own, found)
    assert torch.equal(fit(points, values, 0 * kept), 0 * values)


def test_press_refuses_noise():
    generator = torch.Generator().manual_seed(2)
    points, noise = torch.randn(14, 2, generator=generator, dtype=F64), torch.randn(14, 200, generator=generator, dtype=F64)
    fits = torch.stack([fit(points, noise[:, k], torch.ones(14, dtype=F64)) for k in range(200)])
    constant = (fits - fits[:, :1]).abs().amax(1) < 1e-12
    assert float(constant.to(F64).mean()) > 0.5


def test_the_fit_has_no_look_at_what_it_corrects():
    generator = torch.Generator().manual_seed(3)
    points, values = torch.randn(40, 2, generator=generator, dtype=F64), torch.randn(40, generator=generator, dtype=F64)
    weight = (torch.arange(40) < 20).to(F64)
    changed = torch.where(weight > 0, values, 1e6)
    torch.testing.assert_close(fit(points, changed, weight), fit(points, values, weight), rtol=0, atol=0)


def test_samples_that_are_not_finite_are_left_out():
    """A quadratic with NaN on every other hair: what is left is still on the quadratic."""
    scene = scenes.Quadratic(3.1, 2.7, 0.3, 0.1, -0.2, 1.0)

    def f(x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        return torch.where(torch.remainder(x * 7, 1) < 0.3, torch.nan, scene(x, y))

    result = picture(f, 6, 64, nonfinite="ignore")
    assert int(result.invalid.min()) > 0
    torch.testing.assert_close(result.image[0], scene.exact(*centres(6, 6), WIDE))
    nothing = picture(lambda x, y: torch.full_like(x, torch.nan), 3, 16, nonfinite="ignore")
    assert bool(nothing.image.isnan().all()) and bool(nothing.stderr.isinf().all())
    assert bool(picture(f, 6, 64, nonfinite="propagate").image.isnan().all())


def test_channels_are_fitted_each_by_itself():
    disc, ramp = scenes.Disc(4, 4, 2.5), scenes.Ramp(0.1, 0.2)
    both = picture(lambda x, y: (disc(x, y), ramp(x, y)), 8, 32)
    for channel, scene in zip(both.image, (disc, ramp), strict=True):
        torch.testing.assert_close(channel, picture(scene, 8, 32).image[0], rtol=0, atol=1e-13)


@pytest.mark.parametrize("boundary", ["zero", "renormalize"])
def test_boundaries(boundary: str):
    """f = 1: the filter's share on the screen, or 1; z of 64 seeds in each pixel and of their sum."""
    cdf = WIDE.profile_cdf
    one = torch.arange(4, dtype=F64) + 0.5
    share = cdf(4 - one) - cdf(-one)
    truth = share * share[:, None] if boundary == "zero" else torch.ones(4, 4, dtype=F64)
    images = torch.stack([picture(lambda x, y: torch.ones_like(x), 4, 32, s, boundary=boundary).image[0] for s in range(64)])
    error = (images - truth).flatten(1)
    error = torch.cat([error, error.sum(1, keepdim=True)], 1)
    z = error.mean(0) / (error.std(0) / 8)
    # t of 63 degrees adds a fifth at this quantile
    assert float(z.abs().max()) < 1.2 * quantile(17)


@pytest.mark.parametrize("pattern", [mcaa.Sobol(), mcaa.Jittered(), mcaa.MultiJittered(), mcaa.Lattice()], ids=repr)
def test_count_is_what_is_drawn(pattern: mcaa.Sobol):
    chosen = ControlVariate(1, pattern)
    for spp in (1, 2, 5, 9, 15, 16, 40):
        count = chosen.count(spp)
        assert 0.5 * spp <= count <= spp
        for filter in (mcaa.Box(), mcaa.Mitchell()):
            assert int(picture(scenes.Ramp(1, 1), 2, spp, filter=filter, estimator=chosen).spp.max()) == count


@pytest.mark.parametrize("order", [-1, 4, 1.0, True, "2"])
def test_orders_that_are_not(order: object):
    with pytest.raises(McaaError, match="order must be 0, 1, 2 or 3"):
        ControlVariate(order)  # type: ignore[arg-type]


def test_the_sinc_is_refused_with_the_reason():
    with pytest.raises(McaaError, match="moments of Sinc.* are not finite"):
        picture(scenes.Ramp(1, 1), 4, 16, filter=mcaa.Sinc(), boundary="zero")
