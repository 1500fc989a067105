"""Strip lattices: their geometry, their characters, their dual, and the table against its search."""

from __future__ import annotations

import math

import numpy as np
import pytest

from torch_mcaa.patterns import Lattice
from torch_mcaa.patterns.lattice import CHARACTER_RATIO
from torch_mcaa.patterns.lattice_search import badness, best_generator, dual_vectors, edge_power, reduced_basis, search, tabulated
from torch_mcaa.patterns.lattice_table import STRIPS
from torch_mcaa.patterns.turned import DIRECTIONS, angles, turned


def test_the_table_is_what_the_search_finds():
    assert sorted(STRIPS) == tabulated()
    for spp in (1, 3, 8, 16, 31):
        assert STRIPS[spp] == search(spp)


@pytest.mark.parametrize("spp", sorted(STRIPS))
def test_a_strip_is_odd_has_a_point_in_each_row_and_leaves_one_for_the_audit(spp: int):
    period, count, _ = STRIPS[spp]
    assert count % 2 == 1
    assert max(period, spp * period - 2) <= count < spp * period + (spp == 1)


@pytest.mark.parametrize("spp", [2, 5, 16, 64])
def test_dual_vectors_are_constant_on_the_points(spp: int):
    strip = Lattice().strip(spp, 0, True, (0.3, 0.8))
    dual = dual_vectors(*(STRIPS[spp][i] for i in (1, 2, 0)))
    phase = dual[:, :1] * (strip.x - strip.x[0]) + dual[:, 1:] * (strip.y - strip.y[0])
    np.testing.assert_allclose(phase, phase.round(), atol=1e-9)


@pytest.mark.parametrize("spp", [4, 16, 64])
def test_short_dual_vectors_are_long(spp: int):
    # the longest that any lattice of this density can have is that of the hexagonal one
    period, count, generator = STRIPS[spp]
    shortest = np.hypot(*dual_vectors(count, generator, period).T).min()
    assert shortest > 0.85 * math.sqrt(2 / math.sqrt(3) * count / period)


@pytest.mark.parametrize(
    ("spp", "replicate", "audited"), [(16, 0, True), (16, 1, True), (8, 0, False), (8, 3, False), (5, 2, False)]
)
def test_the_basis_spans_the_lattice(spp: int, replicate: int, audited: bool):
    strip = Lattice().strip(spp, replicate, audited, (0.61, 0.17))
    assert abs(np.linalg.det(strip.basis)) == pytest.approx(strip.period / strip.count, rel=1e-12)
    places = np.stack([strip.x - strip.x[0], strip.y - strip.y[0]], -1) @ np.linalg.inv(strip.basis)
    np.testing.assert_allclose(places, places.round(), atol=1e-8)


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.37, 0.91), (0.999, 0.5)])
@pytest.mark.parametrize("spp", [3, 16])
def test_characters_are_those_of_the_lattice_modulo_its_double(spp: int, shift: tuple[float, float]):
    """Two points, in any column and strip, have the same three signs exactly when they differ by twice a lattice vector."""
    strip = Lattice().strip(spp, 0, True, shift)
    points, signs = [], []
    for column in range(3):
        for row in range(3):
            points.append(np.stack([strip.x + column, strip.y + row * strip.period], -1))
            change = np.array([(-1) ** (a * column + b * row) for a, b in strip.parities])
            signs.append(strip.characters * change[:, None])
    place, sign = np.concatenate(points), np.concatenate(signs, 1)
    steps = ((place - place[0]) @ np.linalg.inv(strip.basis)).round().astype(int) % 2
    same_coset = (steps == 0).all(1)
    same_signs = (sign == sign[:, :1]).all(0)
    np.testing.assert_array_equal(same_signs, same_coset)
    # a quarter of the points are in each coset of 2 L
    assert same_coset.mean() == pytest.approx(0.25, abs=4 / len(place))


def test_replicates_have_other_generators():
    """No short dual vector of one replicate is on the dual of another, so no tone is constant on all of them."""
    strips = [Lattice().strip(8, r, False, (0.0, 0.0)) for r in range(4)]
    duals = []
    for strip in strips:
        basis = np.linalg.inv(strip.basis).T
        steps = np.stack(np.meshgrid(range(-3, 4), range(-3, 4)), -1).reshape(-1, 2)
        vectors = steps[(steps != 0).any(1)] @ basis
        duals.append({tuple(v) for v in vectors.round(6) if np.hypot(*v) < 5})
    assert not set.intersection(*duals)


def test_reduced_basis_is_shortest():
    generator = np.random.default_rng(1)
    for _ in range(20):
        a, b = generator.normal(size=(2, 2))
        short, second = reduced_basis(a, b)
        steps = np.stack(np.meshgrid(range(-6, 7), range(-6, 7)), -1).reshape(-1, 2)
        lengths = np.sort(np.hypot(*(steps[(steps != 0).any(1)] @ np.stack([short, second])).T))
        assert np.hypot(*short) == pytest.approx(lengths[0])
        assert abs(short @ second) <= short @ short / 2 + 1e-12


def test_best_generator_is_the_least_bad():
    assert badness(47, best_generator(47, 3), 3) == min(badness(47, g, 3) for g in range(1, 47))


def test_count_is_odd():
    assert [Lattice().count(n) for n in (1, 2, 3, 16, 17)] == [1, 1, 3, 15, 17]


def _power(chosen: tuple[int, int, int], edges: np.ndarray) -> float:
    """The variance on edges of each direction, in the shares `edges` (DIRECTIONS,)."""
    period, count, generator = chosen
    return float(edge_power(dual_vectors(count, generator, period), angles()) @ (edges / edges.sum()))


@pytest.mark.parametrize("spp", [*np.arange(3, 20, 0.25), 29.5, 64.0, 70.25, 250.0])
def test_a_lattice_turned_for_edges_is_a_strip_of_so_many_evaluations(spp: float):
    (period, count, generator), _ = turned(spp, np.ones(DIRECTIONS), 512)
    assert count % 2 == 1 and 0 < generator < count
    assert spp - 0.3 < (count + 1) / period <= spp
    strip = Lattice().strip(spp, 0, True, (0.3, 0.8), mirrored=True, chosen=(period, count, generator))
    assert (strip.period, strip.count) == (period, count)


@pytest.mark.parametrize("spp", [8.0, 14.75, 31.5])
def test_edges_of_known_directions_are_missed(spp: int):
    """Two directions at right angles, any of 16: a third of the error of the table's lattice at as many evaluations, on average, or less."""
    ours, table = 0.0, 0.0
    period, count, generator = STRIPS[int(spp)]
    for first in range(0, DIRECTIONS // 2, 2):
        edges = np.zeros(DIRECTIONS)
        edges[[first, first + DIRECTIONS // 2]] = 1
        ours += _power(turned(spp, edges, 512).strip, edges)
        table += _power((period, count, generator), edges)
    assert ours < 0.45 * table


@pytest.mark.parametrize("spp", [8.0, 14.75, 31.5, 60.0])
def test_of_edges_of_all_directions_the_lattice_is_that_for_smooth_f(spp: float):
    """Nothing is gained for edges, so the longest shortest dual vector counts; and its character sums say what others' do."""
    (period, count, generator), ratio = turned(spp, np.ones(DIRECTIONS), 512)
    longest = max(np.hypot(*dual_vectors(n, g, p).T).min() for p, n in _strips(spp) for g in range(1, n // 2 + 1))
    assert np.hypot(*dual_vectors(count, generator, period).T).min() == pytest.approx(longest, rel=1e-9)
    assert ratio == pytest.approx(CHARACTER_RATIO, rel=0.1)


def _strips(spp: float) -> list[tuple[int, int]]:
    """(period, count), of odd counts with one evaluation left for the audit, as many as fit."""
    each = [(p, int(spp * p - 2) // 2 * 2 + 1) for p in range(1, 9)]
    most = max((n + 1) / p for p, n in each)
    return [(p, n) for p, n in each if (n + 1) / p >= most - 0.1]


@pytest.mark.parametrize("spp", [14.75, 31.5])
def test_character_sums_of_a_lattice_for_some_edges_say_more_than_it_errs(spp: float):
    """By what is foretold for edges that have the directions asked for but one in ten: more than over edges of all directions."""
    ratios = []
    for first in range(0, DIRECTIONS // 2, 2):
        edges = np.zeros(DIRECTIONS)
        edges[first] = 1
        (period, count, generator), ratio = turned(spp, edges, 512)
        blurred = 0.9 * edges + 0.1 / DIRECTIONS
        halves = dual_vectors(count, generator, period) / 2
        expected = edge_power(halves, angles()) @ blurred / _power((period, count, generator), blurred) - 1
        assert ratio == pytest.approx(CHARACTER_RATIO * expected / 7, rel=1e-9)
        ratios.append(ratio)
    assert np.median(ratios) > 1.5 * CHARACTER_RATIO


def test_mirrored_edges_have_the_mirror_image():
    edges = np.exp(-0.1 * np.arange(DIRECTIONS))
    other = turned(14.75, edges[-np.arange(DIRECTIONS)], 512).strip
    assert _power(turned(14.75, edges, 512).strip, edges) == pytest.approx(_power(other, edges[-np.arange(DIRECTIONS)]), rel=1e-9)
