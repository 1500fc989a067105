"""What the blocks of a cell get for the evaluations there are."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

import torch_mcaa as mcaa
from torch_mcaa import scenes
from torch_mcaa.edges.pilot import Judged, Verdict
from torch_mcaa.estimators.plans import Plan, plans_of
from torch_mcaa.grid import Cell, Screen

CELL, BLOCKS = Cell(0, 0, 128, 128), 16


def planned(budget: int, crossings: dict[int, float], lines: dict[int, float], unmet: float = 0.0) -> tuple[list[Plan], Tensor]:
    """The plans for 16 blocks of 32 x 32 px of which those with crossings or lines across thin pieces jump, and the lines of each block.

    unmet: lines across thin pieces in each of the others.
    """
    verdict = torch.full((BLOCKS,), int(Verdict.NONE))
    crossed, thin = torch.zeros(BLOCKS, dtype=torch.float64), torch.zeros(BLOCKS, dtype=torch.float64)
    for counts, seen in ((crossings, crossed), (lines, thin)):
        for block, count in counts.items():
            verdict[block], seen[block] = int(Verdict.JUMPS), count
    jumps = verdict == Verdict.JUMPS
    thin += ~jumps * unmet
    judged = Judged(verdict, 24 * jumps, (crossed, crossed), thin, torch.zeros_like(thin), torch.zeros_like(thin), ~jumps)
    plans = plans_of(CELL, judged, torch.zeros(BLOCKS, dtype=torch.bool), budget * CELL.height * CELL.width, True, 5)
    found = torch.full((BLOCKS,), -1)
    for plan in plans:
        for part in plan.cells:
            rows, cols = (
                range(first // 32, (first + size) // 32) for first, size in ((part.row, part.height), (part.col, part.width))
            )
            found[[4 * row + col for row in rows for col in cols]] = plan.lines
    assert bool((found >= 0).all())
    return plans, found


def test_all_alike_where_it_can_be_paid_for() -> None:
    plans, found = planned(16, {5: 40.0, 6: 40.0}, {9: 30.0})
    assert len(plans) == 1 and int(found[0]) >= 5


def test_what_is_planned_can_be_paid_for() -> None:
    for budget in (6, 8, 12, 16, 32):
        for thin in (20.0, 60.0, 120.0, 400.0):
            plans, _ = planned(budget, {1: 30.0, 2: 60.0, 3: 300.0}, {8: thin, 9: 35.0, 10: 2 * thin})
            assert sum(plan.cost for plan in plans) <= budget * CELL.height * CELL.width


def test_blocks_dear_for_thin_pieces_are_followed_with_what_is_left() -> None:
    """What five times as many crossings make too dear is sampled; the same for a hairline's sake has three lines."""
    sampled, followed = (
        planned(8, {8: 30.0, 9: 30.0, **more}, {10: 35.0, **thin})[1] for more, thin in (({5: 330.0}, {}), ({}, {5: 130.0}))
    )
    assert int(sampled[5]) == 0 and int(followed[5]) == 3


def test_thin_pieces_have_lines_alike_that_all_of_them_can_pay_for() -> None:
    """Where samples met a few hairlines of a wire frame they do not have all the lines that only those could pay for."""
    few, many = (planned(16, {}, {5: 32.0, 6: 32.0, 9: 32.0}, unmet) for unmet in (0.0, 32.0))
    assert len(few[0]) == len(many[0]) == 1
    assert 3 <= int(many[1][0]) < int(few[1][0])
    for plans, _ in (few, many):
        assert sum(plan.cost for plan in plans) <= 16 * CELL.height * CELL.width


@pytest.mark.parametrize("spp", [5, 8])
def test_where_a_smooth_function_is_slow_there_are_points_enough(spp: int) -> None:
    """The middle of a zone plate changes a tenth as much as what is around it. With 2 points a pixel, in proportion, it errs by 1e-3."""
    scene = scenes.ZonePlate(0.03, 48.3, 47.6)
    x, y = Screen.of((96, 96)).centres()
    error = mcaa.render(scene, (96, 96), spp=spp, seed=1).image[0].double() - scene.exact(x, y[:, None], mcaa.Gaussian(0.5))
    assert float(error.square().mean().sqrt()) < 5e-6
