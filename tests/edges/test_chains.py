"""Edges followed from line to line where the samples do not show them."""

from __future__ import annotations

import math

import pytest
import torch
from on_lines import FINEST, Ask, all_lines, crossings, sampled
from torch import Tensor

from torch_mcaa.edges.bisect import Crossings, bisect
from torch_mcaa.edges.candidates import candidates
from torch_mcaa.edges.chains import between, continued, linked
from torch_mcaa.edges.pieces import Numbered

SLOPE, LINES, SIZE = 0.37, 5, 24
WANTED = torch.ones(SIZE, SIZE, dtype=torch.bool)


def edge(y: Tensor) -> Tensor:
    return 6.1 + SLOPE * y + 0.004 * y * y


def patterned(level: float) -> Ask:
    """Tones of 0.16 cycles a pixel that meet at an edge: what f changes by between samples is about what it jumps by."""
    return Ask(
        lambda x, y: torch.where(
            x > edge(y),
            0.5 * torch.cos(2 * math.pi * (0.15 * y - 0.05 * x)) + level,
            0.5 * torch.cos(2 * math.pi * (0.1 * x + 0.05 * y)),
        )
    )


def jump(f: Ask, lines: Tensor) -> Tensor:
    place = edge(lines)
    return (f(place + 1e-9, lines) - f(place - 1e-9, lines))[0].abs()


def missing(found: Crossings, lines: Tensor) -> Tensor:
    """Which of the lines have no crossing where the edge is."""
    near = (found.across[:, None] - lines).abs() < 1e-9
    return ~(near & ((found.place - edge(found.across)).abs() < 2 * FINEST)[:, None]).any(0)


def test_candidates_alone_miss_most_of_an_edge_between_patterns_and_following_finds_it() -> None:
    f = patterned(1.0)
    samples = sampled(f, LINES, rows=SIZE, cols=SIZE)
    lines = all_lines(samples, 0)[3:-3]
    found = bisect(f, candidates(samples, 0), FINEST, 1)
    large = jump(f, lines) > 0.05
    assert int((missing(found, lines) & large).sum()) >= 0.25 * len(lines)
    followed = continued(f, found, samples, WANTED, (0, 0), FINEST, 1)
    assert not bool((missing(followed, lines) & large).any())
    true = (followed.place - edge(followed.across)).abs() < 2 * FINEST
    key = followed.across[true]
    assert len(torch.unique((key * 1e6).round())) == len(key)  # none twice


def known_edge(f: Ask, rows: int = SIZE) -> tuple[Crossings, Tensor]:
    samples = sampled(f, LINES, rows=rows, cols=SIZE)
    lines = all_lines(samples, 0)
    return crossings(0, lines, edge(lines), (f(edge(lines) + 1e-9, lines) - f(edge(lines) - 1e-9, lines)), samples), lines


@pytest.mark.parametrize("more", [1, 3])
def test_known_crossings_foretell_those_of_another_lattice(more: int) -> None:
    """Two evaluations for each line between two of the old ones; the bracket holds the crossing where the edge bends by less than its half width."""
    f = Ask(lambda x, y: 3 * (x > edge(y)).to(x.dtype))
    old = sampled(f, LINES, rows=SIZE, cols=SIZE)
    known, lines = known_edge(f)
    new = sampled(f, more * LINES, rows=SIZE, cols=SIZE, shift=(0.127, 0.393), number=1)
    none = candidates(new, 0).take(torch.zeros(0, dtype=torch.int64))
    f.count = 0
    told = between(f, known, old, new, none)
    expected = all_lines(new, 0)
    expected = expected[(expected >= lines[0]) & (expected < lines[-1])]
    assert torch.allclose(torch.sort(told.across).values, expected, atol=1e-9)
    assert f.count == 2 * len(told)
    place = edge(told.across)
    assert bool(((told.low < place) & (place < told.high)).all())
    assert bool(((told.after - told.before) == 3).all())
    # what the samples show is left to them
    assert len(between(f, known, old, new, candidates(new, 0))) == 0


def test_links_need_jumps_alike_and_places_near() -> None:
    f = Ask(lambda x, y: 3 * (x > edge(y)).to(x.dtype))
    samples = sampled(f, LINES, rows=SIZE, cols=SIZE)
    known, lines = known_edge(f)
    grid = Numbered(samples, 0)
    assert linked(known, grid, 1)[0].tolist() == [*range(1, len(lines)), -1]
    other = crossings(0, lines[::2], edge(lines[::2]), torch.full((1, len(lines[::2])), 3.0, dtype=torch.float64), samples)
    assert (linked(other, grid, 1)[0] == -1).all()


def test_the_parts_of_a_steep_step_are_no_edges_of_their_own() -> None:
    f = Ask(lambda x, y: 3 * (x > edge(y)).to(x.dtype))
    samples = sampled(f, LINES, rows=SIZE, cols=SIZE)
    lines = all_lines(samples, 0)
    twice, place = lines.repeat(2), torch.cat([edge(lines), edge(lines) + 0.03])
    known = crossings(0, twice, place, torch.ones(1, len(twice), dtype=torch.float64), samples)
    assert (linked(known, Numbered(samples, 0), 1)[0] == -1).all()


def test_where_an_edge_ends_following_ends_soon() -> None:
    """Beyond the end it is looked for on three lines, in two widths of four places."""
    f = Ask(lambda x, y: ((x > edge(y)) & (y < 12)).to(x.dtype))
    samples = sampled(f, LINES, rows=SIZE, cols=SIZE)
    lines = all_lines(samples, 0)
    lines = lines[lines < 12]
    known = crossings(0, lines, edge(lines), torch.ones(1, len(lines), dtype=torch.float64), samples)
    f.count = 0
    followed = continued(f, known, samples, WANTED, (0, 0), FINEST, 1)
    assert len(followed) == len(known)
    assert f.count <= 2 * 3 * 8
