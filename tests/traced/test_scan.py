"""Lines and segments: what they meet is the same in every tiling, and thin pieces count for those that were missed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

import torch_mcaa as mcaa
from torch_mcaa.grid import Cell, Screen
from torch_mcaa.picking import one_of_each
from torch_mcaa.traced.boundary import Elements, elements
from torch_mcaa.traced.scan import share

SCREEN = Screen.of((24, 20))
FILTER = mcaa.Gaussian(0.5)
Function = Callable[[Tensor, Tensor], Any]


def rings(x: Tensor, y: Tensor) -> Tensor:
    return torch.floor(torch.hypot(x - 9.3, y - 11.2) / 3) + (torch.hypot(x - 9.3, y - 11.2) - 5).abs().lt(0.1)


def met(f: Function, cells: list[Cell], seed: int = 1, **arguments: Any) -> list[Elements]:
    return [elements(f, SCREEN, cell, FILTER, seed, 3, fixed=True, dtype=torch.float64, **arguments) for cell in cells]


def table(found: list[Elements]) -> Tensor:
    """(N, 5) column, row, jump, weight and cause, in the order of the first two."""
    rows = torch.cat([torch.stack([e.col, e.row, e.jump[0], e.weight, e.cause.double()], 1) for e in found])
    order = torch.argsort(rows[:, 1], stable=True)
    return rows[order[torch.argsort(rows[order, 0], stable=True)]]


WHOLE = [Cell(0, 0, 24, 20)]


@pytest.mark.parametrize("closed", [False, True])
@pytest.mark.parametrize("size", [(24, 7), (5, 20), (8, 8), (1, 3)])
def test_every_tiling_meets_the_same(size: tuple[int, int], closed: bool) -> None:
    """Bit for bit: f and its decisions are computed point by point, and at no place otherwise than at another, but where changes crowd."""

    def alone(x: Tensor, y: Tensor) -> Tensor:
        return torch.floor(torch.hypot(x - 9.3, y - 11.2) / 3)

    whole = table(met(alone, WHOLE, closed=closed))
    tiled = table(met(alone, list(SCREEN.cells(*size)), closed=closed))
    assert torch.equal(whole, tiled) and len(whole) > 300


def test_the_same_seed_meets_the_same_and_another_one_other_places() -> None:
    one, again, other = (table(met(rings, WHOLE, seed=seed)) for seed in (1, 1, 2))
    assert torch.equal(one, again)
    assert not set(one[:, 0].tolist()) & set(other[:, 0].tolist())


def test_a_closed_screen_is_asked_nowhere_else_and_an_open_one_as_far_as_the_filter_reaches() -> None:
    places = []
    met(rings, WHOLE, closed=True, tally=lambda col, row: places.append(torch.stack([col, row])))
    col, row = torch.cat(places, 1)
    assert float(col.min()) >= 0 and float(col.max()) < 20 and float(row.min()) >= 0 and float(row.max()) < 24
    (found,) = met(lambda x, y: x + y > 0, WHOLE)
    assert float(found.col.min()) < -1.9 and float(found.row.min()) < -1.9


def test_the_number_of_evaluations() -> None:
    """A half-plane: 6 a pixel, for each crossing one between the ends, and the two sides of it, and a close look at one in eight at least.

    A block's crossings are in four parts, by axis and every other line; a look is at 3 pixels in quarters, and a quarter on either side.
    """
    count = [0]

    def tally(col: Tensor, row: Tensor) -> None:
        count[0] += len(col)

    (found,) = met(lambda x, y: 0.8 * x + 0.6 * y > 13.1, WHOLE, tally=tally)
    # lines reach 2 px beyond the screen; segments begin 3 px before it, one more is looked at on either side, and each has two ends
    samples = 3 * ((24 + 4) * (20 + 4 + 1 + 2 + 1) + (20 + 4) * (24 + 4 + 1 + 2 + 1))
    parts = 4 * len(torch.stack([found.col, found.row]).div(8, rounding_mode="floor").unique(dim=1).T)
    assert samples + 3 * len(found) <= count[0] <= samples + 3 * len(found) + 40 + 14 * (parts + len(found) // 8)


def test_shares_of_thin_pieces() -> None:
    """On line 0 A|B|A of 0.3 px; on 1 A|B|C|A of 0.5 px; on 2 A|B|C; on 3 A|B|A of 1.2 px; on 4 a piece each of two lines."""
    line = torch.tensor([0, 0, 1, 1, 1, 2, 2, 3, 3, 4, 5])
    place = torch.tensor([2.0, 2.3, 1.0, 1.2, 1.5, 4.0, 4.1, 3.0, 4.2, 7.0, 7.1], dtype=torch.float64)
    before = torch.tensor([1, 2, 1, 2, 3, 1, 2, 1, 2, 1, 2])
    after = torch.tensor([2, 1, 2, 3, 1, 2, 3, 2, 1, 2, 1])
    expected = torch.tensor([0.3, 0.3, 0.5, 0.5, 0.5, 1, 1, 1, 1, 1, 1], dtype=torch.float64)
    assert torch.allclose(share(line, place, before, after), expected)


def test_noise_is_asked_at_a_bounded_number_of_places() -> None:
    """Every segment changes, and every part of it: 2^10 changes a segment would be met by bisection alone."""
    count = [0]

    def tally(col: Tensor, row: Tensor) -> None:
        count[0] += len(col)

    met(lambda x, y: torch.floor(torch.sin(x * 12.9898e3 + y * 78.233e3) * 43758.5453), WHOLE, tally=tally)
    assert count[0] < 125 * 24 * 20


def test_nothing_jumps() -> None:
    (found,) = met(lambda x, y: (torch.sin(x), torch.cos(y)), WHOLE)
    assert len(found) == 0 and found.jump.shape == (2, 0) and found.problems == ()


@pytest.mark.parametrize("value", ["maximum", "abs", "sorted", "floor"])
def test_a_switch_without_a_jump_is_none(value: str) -> None:
    """Continuous at its decisions: what is met has jumps of the order of the brackets' width, 2^-10 px, or none."""

    def f(x: Tensor, y: Tensor) -> Tensor:
        h = 0.3 * x - 0.2 * y
        pair = torch.stack([h, -h])
        return {
            "maximum": pair.max(0).values,
            "abs": torch.where(h > 0, h, -h),
            "sorted": pair.sort(0).values[0],
            "floor": (h - torch.floor(h)) * (1 + torch.floor(h) - h),
        }[value]

    (found,) = met(f, WHOLE)
    assert len(found) == 0 or float(found.jump.abs().max()) < 2e-3


def test_borders_of_a_continuous_texture_are_hardly_followed_and_those_of_another_are() -> None:
    """At a texel a pixel every segment crosses one or two: following all of them takes 82 evaluations a pixel."""
    screen, image = Screen.of((48, 48)), torch.rand(1, 48, 48, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    turn = torch.tensor([[1.0, 0.2, 0.3], [-0.2, 1.0, 9.7], [0, 0, 1]], dtype=torch.float64)
    spent, jumps = {}, {}
    for interpolation in ("bilinear", "nearest"):
        count = [0]

        def tally(col: Tensor, row: Tensor, count: list[int] = count) -> None:
            count[0] += len(col)

        f = mcaa.Texture(image, interpolation, "repeat", transform=turn)  # pyright: ignore[reportArgumentType]
        found = elements(f, screen, Cell(0, 0, 48, 48), FILTER, 1, 3, fixed=True, dtype=torch.float64, tally=tally)
        spent[interpolation], jumps[interpolation] = count[0] / 48**2, float(found.jump.abs().max())
    assert spent["bilinear"] < 30 < spent["nearest"] < 90
    assert jumps["bilinear"] < 5e-3 and jumps["nearest"] > 0.9


def test_elements_that_were_left_out_count() -> None:
    """Dense stripes, three changes in every segment: those kept stand for all, so that the total length of the edges comes out.

    4.42 standard errors of the mean over 40 seeds.
    """
    width = torch.tensor(0.31, dtype=torch.float64)
    screen = Screen.of((40, 40))

    def f(x: Tensor, y: Tensor) -> Tensor:
        return torch.floor((0.8 * x + 0.6 * y) / width) % 2

    totals, kept = [], []
    for seed in range(40):
        found = elements(f, screen, Cell(0, 0, 40, 40), mcaa.Box(), seed, 3, fixed=True, dtype=torch.float64, closed=True)
        # weights are what a unit of the margin's slope is worth: |g| = 1 / width px
        totals.append(float(found.weight.sum()) / float(width))
        kept.append(len(found))
    length = 40 * 40 / float(width)
    mean, error = sum(totals) / 40, float(torch.tensor(totals).std()) / 40**0.5
    assert abs(mean - length) < 4.42 * error and error < 0.02 * length
    assert max(kept) < 0.8 * 3 * 40 * 40 * 1.4 / float(width)


@pytest.mark.parametrize(("count", "runs"), [(7, 7), (10, 4), (1000, 37)])
def test_one_of_each_run_counts_for_all_of_it(count: int, runs: int) -> None:
    """Each run has one, the chances are those of its size, and what is taken counts for as many as there are."""
    at, chance = one_of_each(count, runs, torch.rand(runs, generator=torch.Generator().manual_seed(3), dtype=torch.float64))
    ends = torch.arange(runs + 1) * count // runs
    assert bool(((at >= ends[:-1]) & (at < ends[1:])).all())
    assert float((1 / chance).sum()) == pytest.approx(count)
    last, _ = one_of_each(count, runs, torch.full((runs,), 1 - 2.0**-53, dtype=torch.float64))
    assert torch.equal(last, ends[1:] - 1)
