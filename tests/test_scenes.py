"""Closed forms of the built-in scenes, against integrals of what the scenes return and known special cases.

Tolerances: the quadratures below are of Gauss and Legendre between all points where the integrand has a kink,
in float64, and converge to about 1e-13; 1e-10 leaves room for rounding at coordinates of some tens of pixels.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest
import torch
from scipy.special import chndtr
from torch import Tensor

from torch_mcaa import scenes
from torch_mcaa.errors import McaaError
from torch_mcaa.filters import Box, Filter, Gaussian, Tent

STD, WIDTH = 0.6, 1.3
FAR = 8.5 * STD
CENTRES = [(7.5, 6.5), (8.5, 9.5), (5.5, 8.5), (10.5, 7.5)]
NODES, WEIGHTS = np.polynomial.legendre.leggauss(64)
FINE_NODES, FINE_WEIGHTS = np.polynomial.legendre.leggauss(300)

Line = tuple[float, float, float]
"""a x + b y = c"""
Circle = tuple[float, float, float]
"""centre x, y and radius"""
Profile = Callable[[np.ndarray], np.ndarray]
Piecewise = tuple[scenes.Scene, list[Line], list[Circle]]


def profile(t: np.ndarray) -> np.ndarray:
    return np.exp(-0.5 * (t / STD) ** 2) / (STD * math.sqrt(2 * math.pi))


def gaussian_cdf(t: np.ndarray) -> np.ndarray:
    return torch.special.ndtr(torch.as_tensor(t) / STD).numpy()


def exact(scene: scenes.Scene, centre: tuple[float, float], filter: Filter) -> float:
    value = scene.exact(torch.tensor(centre[0]), torch.tensor(centre[1]), filter)
    return value.item()


def call(scene: scenes.Scene, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    value = scene(torch.tensor(x, dtype=torch.float64), torch.tensor(y, dtype=torch.float64))
    assert isinstance(value, Tensor)
    return value.numpy()


def integral_between(
    scene: scenes.Scene,
    lines: list[Line],
    circles: list[Circle],
    centre: tuple[float, float],
    half: float,
    cdf: Profile,
    pdf: Profile,
) -> float:
    """∫∫ scene · pdf(x − cx) pdf(y − cy) over a square, scene constant between the given lines and circles.

    Along x: the scene's own value midway between neighbouring boundaries, times the difference of cdf.
    Along y: Gauss and Legendre between the heights at which boundaries meet each other or the square, in
    y = sin θ (for roots at the ends).
    """
    (cx, cy), sides = centre, (centre[0] - half, centre[0] + half)
    kinks = {cy - half, cy + half}
    for a, b, c in lines:
        kinks |= {(c - a * side) / b for side in sides if abs(b) > 1e-14}
    for (a, b, c), (d, e, f) in itertools.combinations(lines, 2):
        if abs(a * e - b * d) > 1e-14:
            kinks.add((a * f - c * d) / (a * e - b * d))
    for x, y, r in circles:
        kinks |= {y - r, y + r}
        kinks |= {y + s * math.sqrt(r**2 - (side - x) ** 2) for side in sides for s in (-1, 1) if abs(side - x) < r}
    heights = sorted(k for k in kinks if cy - half <= k <= cy + half)
    total = 0.0
    for low, high in itertools.pairwise(heights):
        theta = NODES * math.pi / 2
        y = (low + high) / 2 + (high - low) / 2 * np.sin(theta)
        weight = WEIGHTS * math.pi / 2 * np.cos(theta) * (high - low) / 2 * pdf(y - cy)
        bounds = [np.full_like(y, side) for side in sides]
        bounds += [(c - b * y) / a for a, b, c in lines if abs(a) > 1e-14]
        for x0, y0, r in circles:
            root = np.sqrt(np.maximum(r**2 - (y - y0) ** 2, 0))
            bounds += [x0 - root, x0 + root]
        x = np.sort(np.clip(np.stack(bounds), *sides), axis=0)
        values = call(scene, (x[1:] + x[:-1]) / 2, np.broadcast_to(y, x[1:].shape))
        total += float(np.sum(weight * np.sum(values * np.diff(cdf(x - cx), axis=0), axis=0)))
    return total


def line(angle: float, offset: float) -> Line:
    return math.cos(angle), math.sin(angle), offset


def through(p: tuple[float, float], q: tuple[float, float]) -> Line:
    a, b = q[1] - p[1], p[0] - q[0]
    return a, b, a * p[0] + b * p[1]


def polygon(*vertices: tuple[float, float]) -> Piecewise:
    edges = zip(vertices, (*vertices[1:], vertices[0]), strict=True)
    return scenes.Polygon(vertices), [through(p, q) for p, q in edges], []


PIECEWISE: dict[str, Piecewise] = {
    "half-plane": (scenes.HalfPlane(0.4, 9.9), [line(0.4, 9.9)], []),
    "half-plane to the left": (scenes.HalfPlane(math.pi, -7.7), [line(math.pi, -7.7)], []),
    "half-plane nearly along x": (
        scenes.HalfPlane(math.pi / 2 - 1e-6, 8.2),
        [line(math.pi / 2 - 1e-6, 8.2)],
        [],
    ),
    "stripe": (scenes.Stripe(1.1, 10.2, 0.8), [line(1.1, 9.8), line(1.1, 10.6)], []),
    "hairlines": (
        scenes.Hairlines(1.9, (4.0, 3.1, 5.5), 0.1),
        [line(1.9, o + s) for o in (4.0, 3.1, 5.5) for s in (-0.05, 0.05)],
        [],
    ),
    "disc": (scenes.Disc(7.3, 8.1, 2.2), [], [(7.3, 8.1, 2.2)]),
    "small disc": (scenes.Disc(7.3, 6.6, 0.2), [], [(7.3, 6.6, 0.2)]),
    "large disc": (scenes.Disc(30.0, -12.0, 29.5), [], [(30.0, -12.0, 29.5)]),
    "triangle": polygon((6.1, 5.2), (10.9, 7.7), (7.4, 10.3)),
    "rectangle": polygon((6.2, 5.8), (6.2, 9.1), (9.7, 9.1), (9.7, 5.8)),
    "concave polygon": polygon((4.0, 4.0), (12.0, 5.0), (8.0, 7.2), (11.5, 11.0), (7.6, 8.3), (4.4, 9.9)),
    "needle": polygon((-40.0, 3.0), (90.0, 17.0), (90.0, 17.3)),
    "checkerboard": (
        scenes.Checkerboard(3.1, (0.3, 0.7)),
        [line(0, 0.3 + 1.55 * i) for i in range(-2, 14)] + [(0.0, 1.0, 0.7 + 1.55 * i) for i in range(-2, 14)],
        [],
    ),
}


@pytest.mark.parametrize("name", PIECEWISE)
@pytest.mark.parametrize("centre", CENTRES)
def test_piecewise_constant_under_gaussian(name: str, centre: tuple[float, float]) -> None:
    scene, lines, circles = PIECEWISE[name]
    truth = integral_between(scene, lines, circles, centre, FAR, gaussian_cdf, profile)
    assert exact(scene, centre, Gaussian(STD)) == pytest.approx(truth, rel=0, abs=1e-10)


@pytest.mark.parametrize("name", PIECEWISE)
@pytest.mark.parametrize("centre", CENTRES)
def test_piecewise_constant_under_box(name: str, centre: tuple[float, float]) -> None:
    scene, lines, circles = PIECEWISE[name]
    truth = integral_between(scene, lines, circles, centre, WIDTH / 2, lambda t: t / WIDTH, lambda t: np.full_like(t, 1 / WIDTH))
    assert exact(scene, centre, Box(WIDTH)) == pytest.approx(truth, rel=0, abs=1e-10)


def test_gaussian_cut_at_five_std_differs_by_what_the_docstring_says() -> None:
    kept = 1 - 2 * float(torch.special.ndtr(torch.tensor(-5.0, dtype=torch.float64)))
    largest = 0.0
    for scene, lines, circles in PIECEWISE.values():
        for centre in CENTRES[:2]:
            cut = integral_between(scene, lines, circles, centre, 5 * STD, gaussian_cdf, profile) / kept**2
            largest = max(largest, abs(cut - exact(scene, centre, Gaussian(STD))))
    assert 1e-8 < largest < 1.2e-6


SMOOTH: dict[str, scenes.Scene] = {
    "sinusoid": scenes.Sinusoid(0.31, -0.17, 0.7),
    "sinusoid along x": scenes.Sinusoid(0.8, 0.0),
    "zone plate": scenes.ZonePlate(0.21, 6.1, 7.9),
    "zone plate, negative": scenes.ZonePlate(-0.4, 6.1, 7.9),
    "ramp": scenes.Ramp(0.3, -0.2, 1.5),
    "quadratic": scenes.Quadratic(6.3, 7.1, 0.4, -0.3, 0.2, 1.1),
    "blob": scenes.Blob(7.1, 7.9, 0.9, 2.0),
    "highlights": scenes.Highlights((scenes.Blob(7.2, 6.9, 0.15, 5000.0), scenes.Blob(8.8, 9.4, 0.2, 50.0)), 0.05),
}


def integral_smooth(scene: scenes.Scene, centre: tuple[float, float], half: float, pdf: Profile) -> float:
    t = half * FINE_NODES
    x, y = np.meshgrid(centre[0] + t, centre[1] + t)
    weight = half * FINE_WEIGHTS * pdf(t)
    return float(weight @ call(scene, x, y) @ weight)


@pytest.mark.parametrize("name", SMOOTH)
@pytest.mark.parametrize("centre", CENTRES)
def test_smooth_under_gaussian(name: str, centre: tuple[float, float]) -> None:
    truth = integral_smooth(SMOOTH[name], centre, FAR, profile)
    assert exact(SMOOTH[name], centre, Gaussian(STD)) == pytest.approx(truth, rel=1e-10, abs=1e-10)


@pytest.mark.parametrize("name", [name for name in SMOOTH if not name.startswith("zone")])
@pytest.mark.parametrize("centre", CENTRES)
def test_smooth_under_box(name: str, centre: tuple[float, float]) -> None:
    truth = integral_smooth(SMOOTH[name], centre, WIDTH / 2, lambda t: np.full_like(t, 1 / WIDTH))
    assert exact(SMOOTH[name], centre, Box(WIDTH)) == pytest.approx(truth, rel=1e-10, abs=1e-10)


@pytest.mark.parametrize("filter", [Gaussian(0.5), Box(1.0)])
@pytest.mark.parametrize("angle", [0.0, 0.3, math.pi / 4, math.pi / 2, 2.0, math.pi, -1.2])
def test_edge_through_the_centre_covers_half(angle: float, filter: Filter) -> None:
    scene = scenes.HalfPlane(angle, 3.5 * math.cos(angle) + 8.5 * math.sin(angle))
    # the offset is rounded to 1e-15 of its size, which moves the edge by as much
    assert exact(scene, (3.5, 8.5), filter) == pytest.approx(0.5, abs=1e-14)


@pytest.mark.parametrize("r", [0.01, 0.5, 1.0, 3.0, 200.0])
def test_disc_around_the_centre(r: float) -> None:
    value = exact(scenes.Disc(3.5, 8.5, r), (3.5, 8.5), Gaussian(0.5))
    assert value == pytest.approx(-math.expm1(-2 * r**2), rel=1e-12)


@pytest.mark.parametrize("r", [0.1, 1.0, 4.2, 9.0, 30.0])
def test_disc_is_a_noncentral_chi_square(r: float) -> None:
    d = np.linspace(max(r - 4, 0), r + 4, 41)
    value = scenes.Disc(0.0, 0.0, r).exact(torch.as_tensor(d), torch.tensor(0.0), Gaussian(0.5))
    # 1e-9: what chndtr itself is good to at a noncentrality of some thousands
    np.testing.assert_allclose(value.numpy(), chndtr((2 * r) ** 2, 2, (2 * d) ** 2), rtol=0, atol=1e-9)


def centres(height: int, width: int) -> tuple[Tensor, Tensor]:
    cy, cx = torch.meshgrid(
        torch.arange(height, dtype=torch.float64) + 0.5,
        torch.arange(width, dtype=torch.float64) + 0.5,
        indexing="ij",
    )
    return cx, cy


def test_pixels_of_a_box_add_up_to_the_area() -> None:
    cx, cy = centres(40, 40)
    corners = ((5.2, 6.1), (31.7, 9.9), (20.0, 20.0), (27.3, 33.3), (8.8, 25.0))
    edges = zip(corners, (*corners[1:], corners[0]), strict=True)
    shoelace = 0.5 * abs(sum(ax * by - bx * ay for (ax, ay), (bx, by) in edges))
    for scene, area in [
        (scenes.Disc(19.3, 20.8, 10.0), 100 * math.pi),
        (scenes.Disc(20.0, 20.0, 12.0), 144 * math.pi),
        (scenes.Disc(19.3, 20.8, 0.3), 0.09 * math.pi),
        (scenes.Polygon(corners), shoelace),
        (scenes.Polygon(corners[::-1]), shoelace),
    ]:
        assert scene.exact(cx, cy, Box()).sum().item() == pytest.approx(area, rel=0, abs=1e-10)


def test_checkerboard_under_box_is_grey_at_a_period_of_one_and_itself_at_two() -> None:
    cx, cy = centres(6, 6)
    assert torch.allclose(scenes.Checkerboard(1.0).exact(cx, cy, Box(1.0)), torch.tensor(0.5).double(), atol=1e-14)
    board = scenes.Checkerboard(2.0).exact(cx, cy, Box(1.0))
    assert torch.equal(board, scenes.Checkerboard(2.0)(cx, cy))
    assert board[0].tolist() == [1, 0, 1, 0, 1, 0]


def test_sinusoid_of_a_whole_period_vanishes_under_box() -> None:
    assert exact(scenes.Sinusoid(1.0, 0.3), (2.5, 3.5), Box(1.0)) == pytest.approx(0.5, abs=1e-15)


def test_polygon_inside_agrees_with_the_sum_of_angles() -> None:
    scene, *_ = PIECEWISE["concave polygon"]
    assert isinstance(scene, scenes.Polygon)
    generator = torch.Generator().manual_seed(1)
    x, y = 4 + 8 * torch.rand(2, 4000, dtype=torch.float64, generator=generator)
    rays = [torch.complex(vx - x, vy - y) for vx, vy in scene.vertices]
    turned = sum((b / a).angle() for a, b in zip(rays, [*rays[1:], rays[0]], strict=True))
    assert isinstance(turned, Tensor)
    inside = (turned.abs() > math.pi).double()
    assert torch.equal(scene(x, y), inside)
    assert torch.equal(scenes.Polygon(scene.vertices[::-1])(x, y), inside)


def test_mandelbrot_against_a_plain_loop() -> None:
    scene = scenes.Mandelbrot(0.0, 0.0, 1.0, real=0.0, iterations=60)
    points = [0.3 + 0.6j, -0.8 + 0.2j, 0.5 + 0.1j, 1.5 + 1j, -0.1 + 0.1j, 40j, 300 + 0j]
    x, y = (torch.tensor([getattr(c, part) for c in points], dtype=torch.float64) for part in ("real", "imag"))
    values = scene(x, y)
    for c, value in zip(points, values.tolist(), strict=True):
        z, n = c, 0
        while abs(z) <= 256 and n < 60:
            z, n = z * z + c, n + 1
        smooth = max(n - math.log2(math.log(abs(z)) / math.log(256)), 0.0) if abs(z) > 256 else 0.0
        assert value == pytest.approx(math.sqrt(smooth / 60), abs=1e-12)
    assert 0 in values.tolist()
    assert values.max() > 0


def test_mandelbrot_counts_without_steps() -> None:
    x = torch.linspace(1.0, 4.0, 20001, dtype=torch.float64)
    count = 200 * scenes.Mandelbrot(0.0, 0.0, 1.0, real=0.0)(x, torch.zeros_like(x)) ** 2
    # the true slope is below 10 a unit here, 1.5e-3 a sample; an unsmoothed count would step by 1, and
    # smoothing leaves |c| / |z| of that, some 1e-3
    assert count.diff().abs().max() < 1e-2


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("size", [(24, 32), (1, 1), (7, 60)])
def test_gallery(size: tuple[int, int], dtype: torch.dtype) -> None:
    cx, cy = centres(*size)
    gallery = scenes.gallery(size)
    assert len(gallery) >= 14
    for name, scene in gallery.items():
        assert name == name.lower()
        assert " " not in name
        assert "_" not in name
        value = scene(cx.to(dtype), cy.to(dtype))
        channels = value if isinstance(value, tuple) else (value,)
        assert len(channels) == (3 if name == "color-disc" else 1)
        for channel in channels:
            assert channel.dtype == dtype
            assert channel.shape == cx.shape
            assert channel.isfinite().all()
            assert channel.min() >= 0
            assert channel.max() <= 1 + 1e-6 or name == "highlights"
        if name == "mandelbrot":
            with pytest.raises(McaaError, match="under no filter, got Gaussian"):
                scene.exact(cx, cy, Gaussian(0.5))
        else:
            truth = scene.exact(cx.to(dtype), cy.to(dtype), Gaussian(0.5))
            assert truth.dtype == torch.float64
            assert truth.shape == ((3, *size) if name == "color-disc" else size)
            assert truth.isfinite().all()
            assert truth.min() > -1e-12


def test_gallery_holds_a_range_of_a_thousand() -> None:
    cx, cy = centres(64, 64)
    truth = scenes.gallery((64, 64))["highlights"].exact(cx, cy, Gaussian(0.5))
    assert truth.max() / truth.min() > 1e3


def test_gallery_against_plain_monte_carlo() -> None:
    """A mean of n values in [0, 1] misses φ by more than √(2 φ (1 − φ) L / n) + L / 3n with p < 2 exp(−L).

    (Bernstein's inequality.) L = 20 gives 4e-9 a pixel, below 1e-6 for all of them.
    """
    generator = torch.Generator().manual_seed(7)
    cx, cy = torch.tensor([20.5, 9.5, 33.5, 25.5]).double(), torch.tensor([11.5, 20.5, 17.5, 2.5]).double()
    n, bound = 20000, 20.0
    gauss = 0.5 * torch.randn(2, n, 4, dtype=torch.float64, generator=generator)
    box = torch.rand(2, n, 4, dtype=torch.float64, generator=generator) - 0.5
    for name, scene in scenes.gallery((30, 40)).items():
        for filter, (dx, dy) in [(Gaussian(0.5), gauss), (Box(1.0), box)]:
            if name in ("mandelbrot", "highlights") or (name == "zone-plate" and isinstance(filter, Box)):
                continue
            value = scene(cx + dx, cy + dy)
            samples = torch.stack(value) if isinstance(value, tuple) else value
            truth = scene.exact(cx, cy, filter)
            limit = (2 * truth * (1 - truth) * bound / n).clamp_min(0).sqrt() + bound / (3 * n)
            assert ((samples.mean(-2) - truth).abs() < limit).all(), name


def test_exact_broadcasts_its_centres() -> None:
    for scene, *_ in PIECEWISE.values():
        cx, cy = centres(5, 6)
        whole = scene.exact(cx, cy, Gaussian(0.5))
        assert torch.equal(whole, scene.exact(cx[:1], cy[:, :1], Gaussian(0.5)))
        assert scene.exact(cx[0, 0], cy[0, 0], Box(1.0)).shape == ()


def test_errors() -> None:
    c = torch.tensor(0.5)
    with pytest.raises(McaaError, match=r"ZonePlate has a closed form under Gaussian, got Box\(width=1.0\)"):
        scenes.ZonePlate(0.1, 0.0, 0.0).exact(c, c, Box(1.0))
    with pytest.raises(McaaError, match="Gaussian and Box, got Tent"):
        scenes.Disc(0.0, 0.0, 1.0).exact(c, c, Tent())
    with pytest.raises(McaaError, match=r"at least 5 std = 2.5 px, got Gaussian\(std=0.5, radius=1.0\)"):
        scenes.Disc(0.0, 0.0, 1.0).exact(c, c, Gaussian(0.5, radius=1.0))
    for bad in (0.0, -1.0, math.nan, math.inf):
        for make in (
            lambda v: scenes.Disc(0.0, 0.0, v),
            lambda v: scenes.Stripe(0.0, 0.0, v),
            lambda v: scenes.Checkerboard(v),
            lambda v: scenes.Blob(0.0, 0.0, v),
            lambda v: scenes.Mandelbrot(0.0, 0.0, v),
        ):
            with pytest.raises(McaaError, match="above 0"):
                make(bad)
    with pytest.raises(McaaError, match="further apart"):
        scenes.Hairlines(0.0, (1.0, 1.05), 0.1)
    with pytest.raises(McaaError, match="three or more vertices"):
        scenes.Polygon(((0.0, 0.0), (1.0, 1.0), (2.0, 2.0)))
    with pytest.raises(McaaError, match="one length"):
        scenes.ColorDisc(scenes.Disc(0.0, 0.0, 1.0), (1.0, 0.5), (0.0,))
    with pytest.raises(McaaError, match="one or more blobs"):
        scenes.Highlights((), 0.1)
    with pytest.raises(McaaError, match=r"whole numbers above 0, got \(0, 5\)"):
        scenes.gallery((0, 5))
