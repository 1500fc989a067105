"""Every pattern against its contract: random access, independence, uniformity, strata, unbiased means, convergence and
the calibration of its reported variance.

All seeds are fixed. Statistical tests have significance 1e-5, shared out (Sidak) where many statistics are looked at together.
The integrands are closed forms over the unit square, one random instance a pixel.
"""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable

import pytest
import torch
from scipy import stats
from torch import Tensor

from torch_mcaa.errors import McaaError
from torch_mcaa.patterns import Independent, Jittered, MultiJittered, Pattern, Sobol
from torch_mcaa.patterns.jittered import strata

ALPHA = 1e-5
PATTERNS: list[Pattern] = [Independent(), Jittered(), MultiJittered(), Sobol()]
STRATIFIED: list[Pattern] = [Jittered(), MultiJittered()]
SIDE = 64
ROWS, COLS = torch.arange(SIDE) - 20, torch.arange(SIDE) + 1000

every_pattern = pytest.mark.parametrize("pattern", PATTERNS, ids=lambda p: type(p).__name__)
Case = tuple[Callable[[Tensor, Tensor], Tensor], Tensor]


def points(pattern: Pattern, n: int, seed: int = 1, round: int = 0, dtype: torch.dtype = torch.float64) -> tuple[Tensor, Tensor]:
    return pattern.points(n, ROWS, COLS, seed=seed, round=round, dtype=dtype)


def z_bound(tests: int) -> float:
    return float(stats.norm.isf((1 - (1 - ALPHA) ** (1 / tests)) / 2))


# --- integrands over the unit square: one a pixel, with their integrals -----------------------------------------


def draw(seed: int, count: int) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(count, SIDE, SIDE, generator=generator, dtype=torch.float64)


def half_planes(seed: int) -> Case:
    angle, x0, y0 = draw(seed, 3)
    c, s = torch.cos(2 * math.pi * angle), torch.sin(2 * math.pi * angle)
    level = c * x0 + s * y0

    def square(t: Tensor) -> Tensor:
        return t.clamp(min=0).square()

    a, b = c.abs(), s.abs()
    t = level + (-c).clamp(min=0) + (-s).clamp(min=0)
    below = (square(t) - square(t - a) - square(t - b) + square(t - a - b)) / (2 * a * b)
    return lambda x, y: (c * x + s * y > level).to(x), 1 - below


def discs(seed: int) -> Case:
    radius, cx, cy = draw(seed, 3)
    radius = 0.1 + 0.35 * radius
    cx, cy = radius + (1 - 2 * radius) * cx, radius + (1 - 2 * radius) * cy
    return lambda x, y: (torch.hypot(x - cx, y - cy) < radius).to(x), math.pi * radius.square()


def quadratics(seed: int) -> Case:
    k = draw(seed, 6) * 2 - 1
    integral = k[0] + (k[1] + k[2]) / 2 + (k[3] + k[5]) / 3 + k[4] / 4
    return lambda x, y: k[0] + k[1] * x + k[2] * y + k[3] * x * x + k[4] * x * y + k[5] * y * y, integral


def blobs(seed: int) -> Case:
    cx, cy, s = draw(seed, 3)
    s = 0.2 + 0.4 * s
    ix, iy = (s * math.sqrt(math.pi) / 2 * (torch.erf((1 - c) / s) + torch.erf(c / s)) for c in (cx, cy))
    return lambda x, y: torch.exp(-((x - cx).square() + (y - cy).square()) / s.square()), ix * iy


def tones(seed: int) -> Case:
    frequency, angle, phase = draw(seed, 3)
    a = 6 * frequency * torch.cos(2 * math.pi * angle)
    b = 6 * frequency * torch.sin(2 * math.pi * angle)
    phase = 2 * math.pi * phase
    # torch.sinc is sin(pi x) / (pi x): no difference of large numbers where a or b is small
    integral = torch.sinc(a / (2 * math.pi)) * torch.sinc(b / (2 * math.pi)) * torch.cos(phase + (a + b) / 2)
    return lambda x, y: torch.cos(a * x + b * y + phase), integral


EDGE, SMOOTH = [half_planes, discs], [quadratics, blobs, tones]
FAMILIES = {"edge": EDGE, "smooth": SMOOTH}


def outcome(pattern: Pattern, n: int, families: list[Callable[[int], Case]], seed: int = 3) -> tuple[Tensor, Tensor]:
    """The errors of the means and their reported variances, (families, R, C)."""
    errors, variances = [], []
    for number, family in enumerate(families):
        f, integral = family(seed + 10 * number)
        u, v = points(pattern, n, seed=seed, round=number)
        terms = f(u, v) / n
        errors.append(terms.sum(0) - integral)
        variances.append(pattern.variance(terms, u, v))
    return torch.stack(errors), torch.stack(variances)


# --- the contract ---------------------------------------------------------------------------------------------


@every_pattern
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("n", [1, 2, 16, 60])
def test_shape_dtype_and_range(pattern: Pattern, n: int, dtype: torch.dtype) -> None:
    n = pattern.count(n)
    for coordinate in pattern.points(n, ROWS[:7], COLS[:5], seed=2**64 - 1, round=3, dtype=dtype):
        assert coordinate.shape == (n, 7, 5) and coordinate.dtype == dtype
        assert coordinate.min() >= 0 and coordinate.max() < 1


@every_pattern
def test_random_access(pattern: Pattern) -> None:
    u, v = points(pattern, 16, dtype=torch.float32)
    order = torch.tensor([40, 3, 3, 63, 0])
    again = pattern.points(16, ROWS[order], COLS[order.flip(0)], seed=1, round=0, dtype=torch.float32)
    assert torch.equal(again[0], u[:, order][:, :, order.flip(0)])
    assert torch.equal(again[1], v[:, order][:, :, order.flip(0)])
    single = pattern.points(16, ROWS[9:10], COLS[50:51], seed=1, round=0, dtype=torch.float32)
    assert torch.equal(single[0][:, 0, 0], u[:, 9, 50]) and torch.equal(single[1][:, 0, 0], v[:, 9, 50])


@every_pattern
def test_float32_points_are_the_float64_points(pattern: Pattern) -> None:
    """Up to four roundings to 2**-24 in float32 (sums of strata), and the cut to 24 bits."""
    for single, double in zip(points(pattern, 16, dtype=torch.float32), points(pattern, 16), strict=True):
        assert (single - double).abs().max() < 4 * 2.0**-24


@every_pattern
def test_global_generator_is_left_alone(pattern: Pattern) -> None:
    before = torch.get_rng_state()
    points(pattern, 16)
    assert torch.equal(before, torch.get_rng_state())


@every_pattern
def test_value_semantics(pattern: Pattern) -> None:
    copy = pickle.loads(pickle.dumps(pattern))
    assert copy == pattern and hash(copy) == hash(pattern) and repr(pattern) == f"{type(pattern).__name__}()"
    assert torch.equal(points(copy, 4)[0], points(pattern, 4)[0])
    with pytest.raises(AttributeError):
        pattern.count = None  # type: ignore[method-assign]


@every_pattern
def test_bad_arguments(pattern: Pattern) -> None:
    for n in (0, -3):
        with pytest.raises(McaaError, match=rf"n = {n}"):
            pattern.count(n)
    with pytest.raises(McaaError, match="float16"):
        points(pattern, 4, dtype=torch.float16)
    with pytest.raises(McaaError, match="seed"):
        points(pattern, 4, seed=-1)
    with pytest.raises(McaaError, match=r"rows and cols .*\(64, 1\)"):
        pattern.points(4, ROWS[:, None], COLS, seed=0, round=0)
    with pytest.raises(McaaError, match="float32"):
        pattern.points(4, ROWS.float(), COLS, seed=0, round=0)


def test_counts() -> None:
    assert [Independent().count(n) for n in range(1, 8)] == [Sobol().count(n) for n in range(1, 8)] == list(range(1, 8))
    for pattern in STRATIFIED:
        usable = [1, 2, 4, 6, 8, 9, 12, 15, 16, 18, 20, 24, 25, 28, 30, 32]
        assert sorted({pattern.count(n) for n in range(1, 34)}) == usable
        assert all(pattern.count(n) == max(m for m in usable if m <= n) for n in range(1, 34))
        assert pattern.count(256) == 256
        with pytest.raises(McaaError, match=r"count\(7\) = 6"):
            points(pattern, 7)
    for n in range(1, 300):
        rows, columns = strata(n)
        assert rows <= columns <= 2 * rows and rows * columns <= n


# --- distribution ---------------------------------------------------------------------------------------------


@every_pattern
@pytest.mark.parametrize("n", [9, 16])
def test_each_point_is_uniform_over_pixels(pattern: Pattern, n: int) -> None:
    """Chi-squared of point i over 4,096 pixels in 8 x 8 cells: for Jittered the points of a cell pooled, n of a pixel in all."""
    u, v = points(pattern, n)
    cells = (u * 8).long() * 8 + (v * 8).long()
    if isinstance(pattern, Independent | Sobol):
        for i in range(n):
            counts = torch.bincount(cells[i].flatten(), minlength=64).double()
            assert stats.chi2.sf(float(((counts - 64) ** 2 / 64).sum()), 63) > ALPHA / n
    # The offsets inside the cells of the pattern's own strata.
    rows, columns = strata(n)
    inside = (torch.frac(u * columns) * 16).long() * 16 + (torch.frac(v * rows) * 16).long()
    for i in range(n):
        counts = torch.bincount(inside[i].flatten(), minlength=256).double()
        assert stats.chi2.sf(float(((counts - 16) ** 2 / 16).sum()), 255) > ALPHA / n


@every_pattern
@pytest.mark.parametrize("n", [4, 16])
def test_pixels_rounds_and_seeds_are_independent(pattern: Pattern, n: int) -> None:
    """Correlations of point i's u, v with those of the pixel to the right, below and across, the next round, and seed."""
    u, v = points(pattern, n)
    center = torch.stack([u, v]) - torch.stack([u, v]).mean((2, 3), keepdim=True)
    others = [center.roll(shift, (2, 3)) for shift in ((0, 1), (1, 0), (1, 1))]
    for other in (points(pattern, n, round=1), points(pattern, n, seed=2), points(pattern, n, seed=1 + 2**32)):
        stacked = torch.stack(other)
        others.append(stacked - stacked.mean((2, 3), keepdim=True))
    others.append(center.transpose(2, 3))  # (r, c) with (c, r): each pair counts twice, so z is sqrt(2) too large
    for number, other in enumerate(others):
        for partner in (other, other.flip(0)):
            z = (center * partner).mean((2, 3)) / (center.std((2, 3)) * partner.std((2, 3))) * SIDE
            z = z / 2**0.5 if number == len(others) - 1 else z
            assert z.abs().max() < z_bound(2 * 2 * n * len(others))


@pytest.mark.parametrize("power", range(9))
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_sobol_elementary_intervals(power: int, dtype: torch.dtype) -> None:
    """Every interval of area 2**-k, of each of the k + 1 shapes, holds one of 2**k points in each pixel; aligned blocks too."""
    n = 1 << power
    u, v = points(Sobol(), 4 * n, dtype=dtype)
    for first in range(0, 4 * n, n):
        for wide in range(power + 1):
            columns, rows = 1 << wide, 1 << (power - wide)
            cell = (u[first : first + n] * columns).long() * rows + (v[first : first + n] * rows).long()
            assert torch.equal(cell.sort(dim=0).values, torch.arange(n)[:, None, None].expand_as(cell))


def test_sobol_points_are_the_sequence_up_to_the_scramble() -> None:
    """Digit k of two points agrees after the scramble iff it does before, where all earlier digits agree (Owen)."""
    n = 64
    index = torch.arange(n)
    first = sum(((index >> k & 1) << (31 - k)) for k in range(6))
    pascal = [sum((math.comb(col, row) & 1) << (31 - row) for row in range(col + 1)) for col in range(6)]
    second = torch.zeros_like(index)
    for k in range(6):
        second ^= (index >> k & 1) * pascal[k]
    for plain, scrambled in zip((first, second), points(Sobol(), n), strict=True):
        words = (scrambled[:, :4, :4] * 2**32).long()
        for digits in range(1, 33):
            same = (plain[:, None] >> (32 - digits)) == (plain >> (32 - digits))
            after = (words[:, None] >> (32 - digits)) == (words >> (32 - digits))
            wanted = same[..., None, None].expand_as(after)
            assert torch.equal(after, wanted) if digits <= 6 else bool((after <= wanted).all())


def test_sobol_scramble_flips_each_digit_fairly_and_by_its_prefix() -> None:
    """Over 4,096 pixels every node of the first four levels of the tree is flipped half of the time, independently."""
    for coordinate in points(Sobol(), 16):
        prefix = (coordinate * 16).long()  # a permutation of 0 .. 15 in the order of the sequence
        reverse = torch.tensor([int(f"{i:04b}"[::-1], 2) for i in range(16)])
        if coordinate is points(Sobol(), 16)[0]:
            prefix = prefix[reverse]
        flips = []
        for level in range(4):
            leaders = prefix[:: 16 >> level] >> (3 - level) & 1  # the first point of each node of this level
            flips.append(leaders.double() * 2 - 1)
        flips = torch.cat(flips).flatten(1)
        z = flips @ flips.T / SIDE
        z.fill_diagonal_(0)
        z = torch.cat([z.triu(1).flatten(), flips.sum(1) / SIDE])
        assert z.abs().max() < z_bound(15 * 14 // 2 + 15)


@pytest.mark.parametrize("pattern", STRATIFIED, ids=lambda p: type(p).__name__)
@pytest.mark.parametrize("n", [1, 2, 6, 15, 64])
def test_one_point_in_each_cell_in_row_major_order(pattern: Pattern, n: int) -> None:
    rows, columns = strata(n)
    u, v = points(pattern, n)
    cell = (v * rows).long() * columns + (u * columns).long()
    assert torch.equal(cell, torch.arange(n)[:, None, None].expand_as(cell))


@pytest.mark.parametrize("n", [1, 2, 6, 15, 64])
def test_multi_jittered_is_latin(n: int) -> None:
    for coordinate in points(MultiJittered(), n):
        strip = (coordinate * n).long().sort(dim=0).values
        assert torch.equal(strip, torch.arange(n)[:, None, None].expand_as(strip))


def test_multi_jittered_permutations_are_uniform() -> None:
    """All 24 orders of the four rows' fine columns are equally frequent, and independent of the columns' fine rows."""
    u, v = points(MultiJittered(), 16)
    fine_column, fine_row = (u * 16).long() % 4, (v * 16).long() % 4
    grid = fine_column.unflatten(0, (4, 4))
    assert torch.equal(grid, grid[:, :1].expand_as(grid)), "cells of a row share their fine column"
    weights = torch.tensor([64, 16, 4, 1])[:, None, None]
    orders = [(grid[:, 0] * weights).sum(0).flatten(), (fine_row[:4] * weights).sum(0).flatten()]
    codes = [order.unique(return_inverse=True)[1] for order in orders]
    joint = torch.bincount(codes[0] * 24 + codes[1], minlength=576).double()
    assert all(code.max() == 23 for code in codes)
    expected = SIDE**2 / 576
    assert stats.chi2.sf(float(((joint - expected) ** 2 / expected).sum()), 575) > ALPHA


# --- estimates ------------------------------------------------------------------------------------------------


@every_pattern
@pytest.mark.parametrize("n", [1, 4, 15, 64])
def test_means_are_unbiased(pattern: Pattern, n: int) -> None:
    """z-test of the mean error over 4,096 pixels with five families of random integrands."""
    errors, _ = outcome(pattern, n, EDGE + SMOOTH)
    z = errors.mean((1, 2)) / errors.std((1, 2)) * SIDE
    assert z.abs().max() < z_bound(5)


# Exponents of the RMSE: -1/2 for independent points; an edge meets about sqrt(n) of n cells, so -3/4; one jittered point a cell of
# side n**-1/2 on smooth f, -1; a scrambled net -3/2 up to a logarithm (Owen 1997), which reads -1.4 at these n.
EXPONENTS = {
    (Independent, "edge"): -0.5,
    (Independent, "smooth"): -0.5,
    (Jittered, "edge"): -0.75,
    (Jittered, "smooth"): -1.0,
    (MultiJittered, "edge"): -0.75,
    (Sobol, "edge"): -0.75,
    (Sobol, "smooth"): -1.4,
}


@pytest.mark.parametrize(("kind", "family"), EXPONENTS, ids=lambda x: getattr(x, "__name__", x))
def test_convergence(kind: type[Pattern], family: str) -> None:
    """Slope of log RMSE over n = 16, 64, 256: an RMSE of 8,192 errors is known to about 1 % and the slope to 0.005.

    The tolerance of 0.04 is for the next order in n (and 0.08 for the net's logarithm).
    """
    sizes = (16, 64, 256)
    rmse = [outcome(kind(), n, FAMILIES[family])[0].square().mean((1, 2)).log2().mean().item() / 2 for n in sizes]
    slope = (rmse[2] - rmse[0]) / 4
    assert slope == pytest.approx(EXPONENTS[kind, family], abs=0.08 if kind is Sobol else 0.04)


def test_stratified_points_beat_independent_ones() -> None:
    """RMSE over that of independent points at n = 64."""
    for family, bounds in {"edge": (0.5, 0.4, 0.45), "smooth": (0.25, 0.25, 0.08)}.items():
        errors = [outcome(p, 64, FAMILIES[family])[0].square().mean().sqrt() for p in PATTERNS]
        assert all(error < bound * errors[0] for error, bound in zip(errors[1:], bounds, strict=True))
