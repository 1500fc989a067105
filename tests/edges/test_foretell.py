"""Brackets foretold by the crossings of neighbouring lines."""

from __future__ import annotations

import dataclasses
import math

import torch
from on_lines import FINEST, Ask, all_lines, crossings, sampled, step
from torch import Tensor

from torch_mcaa.edges.bisect import Crossings, bisect
from torch_mcaa.edges.candidates import Segments, candidates
from torch_mcaa.edges.foretell import narrowed_all

SLOPE, LINES = 0.37, 5


def edge(y: Tensor) -> Tensor:
    return 4.1 + SLOPE * y


def inside(found: Segments, place: Tensor) -> Tensor:
    """Which places are not so close to an end of their segment that a bracket about them would not fit: 2^-8 px, and what one may be off."""
    return torch.minimum(place - found.low, found.high - place) > 2.0**-7


def slanted() -> tuple[Ask, Segments, Crossings, Tensor]:
    """A straight edge, its segments on the odd lines, the exact crossings of the even ones, and the exact places on the odd ones."""
    f = Ask(lambda x, y: 3 * step(x > edge(y)))
    samples = sampled(f, LINES, cols=16)
    found = candidates(samples, 0)
    lines = all_lines(samples, 0)
    order = torch.searchsorted(lines, found.across - 1e-9)
    found = found.take((order % 2 == 1) & (order < len(lines) - 1))
    found = found.take(inside(found, edge(found.across)))
    even = lines[::2]
    known = crossings(0, even, edge(even), torch.full((1, len(even)), 3.0, dtype=torch.float64), samples)
    f.count = 0
    return f, found, known, edge(found.across)


def narrowed(f: Ask, found: Segments, known: Crossings, apart: float, seed: int) -> Segments:
    return narrowed_all(f, [found], [known], apart, seed)[0]


def same(a: Segments, b: Segments) -> bool:
    return all(
        torch.equal(x, y) if isinstance(x, Tensor) else x == y
        for x, y in ((getattr(a, field.name), getattr(b, field.name)) for field in dataclasses.fields(a))
    )


def test_a_straight_edge_is_foretold() -> None:
    """Two evaluations a line make brackets of 2^-8 px, at most an eighth more, and each holds its crossing: 9 evaluations in all, not 15."""
    f, found, known, place = slanted()
    assert len(found) >= 25
    short = narrowed(f, found, known, 2.5 / LINES, 1)
    assert f.count == 2 * len(found)
    assert bool(((short.low < place) & (place < short.high)).all())
    width = short.high - short.low
    assert float(width.min()) >= 2.0**-8 and float(width.max()) <= 1.125 * 2.0**-8 + 1e-12
    assert bool((short.before == 0).all()) and bool((short.after == 3).all())
    assert len(torch.unique((width * 1e9).round())) > len(found) // 2  # no two alike, but by chance
    got = bisect(f, short, FINEST, 1)
    assert torch.equal(got.segment, torch.arange(len(found)))
    assert bool(((got.place - place).abs() <= got.width / 2 + 1e-12).all())
    assert f.count <= 9 * len(found)


def test_all_the_rest_of_a_segment_stays() -> None:
    f, found, known, _ = slanted()
    short = narrowed(f, found, known, 2.5 / LINES, 1)
    for name in ("across", "least", "phase", "key", "single"):
        assert torch.equal(getattr(short, name), getattr(found, name))


def test_a_bracket_that_does_not_hold_leaves_the_segment_whole() -> None:
    """Crossings foretold 0.01 px off, five times the half-width: asked for, and not believed. Those of other lines are."""
    f, found, known, place = slanted()
    wrong = known.place.clone()
    middle = len(wrong) // 2
    wrong[:middle] += 0.01
    short = narrowed(f, found, dataclasses.replace(known, place=wrong), 2.5 / LINES, 1)
    assert f.count == 2 * len(found)
    misled = found.across < known.across[middle]
    # between the last wrong one and the first right one the foretold place is 0.005 px off: not believed either
    assert same(short.take(misled), found.take(misled))
    right = short.take(~misled)
    assert bool((right.high - right.low < 0.01).all())
    got = bisect(f, short, FINEST, 1)
    assert bool(((got.place - place).abs() <= got.width / 2 + 1e-12).all())


def test_the_places_between_unequal_distances_are_weighed() -> None:
    """Known lines 0.05 and 0.3 px off: a mean of the two would be SLOPE / 8 = 0.046 px off, and not believed."""
    f, found, _, place = slanted()
    across = torch.cat([found.across - 0.05, found.across + 0.3])
    order = torch.argsort(across)
    known = Crossings(
        0,
        across[order],
        edge(across[order]),
        torch.zeros(len(across), dtype=torch.float64),
        torch.zeros(1, len(across), dtype=torch.float64),
        torch.full((1, len(across)), 3.0, dtype=torch.float64),
        torch.zeros(len(across), dtype=torch.float64),
        torch.arange(len(across)),
    )
    # only their own neighbours on either side are near enough
    one = found.take(torch.arange(0, len(found), 2))
    short = narrowed(f, one, known, 0.35, 1)
    where = place[::2]
    assert bool((short.high - short.low < 0.01).all())
    assert bool(((short.low < where) & (where < short.high)).all())


def test_what_foretells_nothing_costs_nothing() -> None:
    """Lines too far off, lines on one side only, other jumps, segments beside a lone sample, no crossings, no segments."""
    f, found, known, _ = slanted()
    below = found.take(found.across < 6)
    above, beneath = known.take(known.across > 6), known.take(known.across < 5)
    above_all = found.take(found.across > 5)
    none = torch.tensor([], dtype=torch.long)
    cases = [
        (found, known, 0.9 / LINES),
        (below, above, 2.5 / LINES),
        (above_all, beneath, 2.5 / LINES),
        (found, dataclasses.replace(known, after=known.after / 2), 2.5 / LINES),
        (found, dataclasses.replace(known, before=known.after, after=known.before), 2.5 / LINES),
        (dataclasses.replace(found, single=torch.ones_like(found.single)), known, 2.5 / LINES),
        (found, known.take(none), 2.5 / LINES),
        (found.take(none), known, 2.5 / LINES),
    ]
    for some, by, apart in cases:
        assert same(narrowed(f, some, by, apart, 1), some)
    assert f.count == 0


def test_a_circle_of_three_pixels_is_foretold_by_another_shift() -> None:
    """Lines half a spacing h on either side: chords bend by (h/2)² / 2R = 0.0017 px for h = 1/5 in the middle, within 2^-9 = 0.00195.

    Along the lines the circle bends by R² / (R² - d²)^1.5: 15 % more, and no longer within it, at d = 0.9 px from the middle.
    """
    radius, cx, cy = 3.0, 7.9, 7.5
    f = Ask(lambda x, y: step((x - cx).square() + (y - cy).square() < radius**2))
    samples = sampled(f, LINES, 16, 16)
    found = candidates(samples, 0)
    found = found.take(((found.across - cy).abs() < 0.9) & (found.low > cx))
    exact = cx + (radius**2 - (found.across - cy).square()).sqrt()
    chosen = inside(found, exact)
    found, exact = found.take(chosen), exact[chosen]
    assert len(found) >= 7
    lines = torch.unique((torch.cat([found.across - 0.1, found.across + 0.1]) * 1e6).round()) / 1e6
    place = cx + (radius**2 - (lines - cy).square()).sqrt()
    known = crossings(0, lines, place, torch.full((1, len(lines)), -1.0, dtype=torch.float64), samples)
    short = narrowed(f, found, known, 2.5 / LINES, 1)
    assert bool((short.high - short.low < 0.01).all())
    assert bool(((short.low < exact) & (exact < short.high)).all())
    assert math.isclose((1 / LINES / 2) ** 2 / (2 * radius), 0.0017, rel_tol=0.03)


def test_vertical_lines_too() -> None:
    f = Ask(lambda x, y: step(y > edge(x)))
    samples = sampled(f, LINES, rows=16)
    found = candidates(samples, 1)
    found = found.take((found.across > 1) & (found.across < 11) & inside(found, edge(found.across)))
    lines = all_lines(samples, 1)
    known = crossings(1, lines + 0.03, edge(lines + 0.03), torch.ones(1, len(lines), dtype=torch.float64), samples)
    short = narrowed(f, found, known, 2.5 / LINES, 1)
    place = edge(found.across)
    assert bool((short.high - short.low < 0.01).all())
    assert bool(((short.low < place) & (place < short.high)).all())
