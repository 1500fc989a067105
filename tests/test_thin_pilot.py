"""Thin pieces that the pilot's samples hit, followed over its lines."""

from __future__ import annotations

import torch
from torch import Tensor

import torch_mcaa as mcaa
from torch_mcaa.edges.candidates import candidates
from torch_mcaa.edges.lines import Everywhere
from torch_mcaa.edges.pilot import Judged, Verdict, judge
from torch_mcaa.estimators.base import Task
from torch_mcaa.estimators.located.blocks import BLOCK, blocks_of
from torch_mcaa.estimators.located.counted import Counted, Precision
from torch_mcaa.estimators.located.thin_pilot import with_thin_pieces
from torch_mcaa.grid import Cell, Screen
from torch_mcaa.integrand import Integrand

SIDE, BLOCKS, SEED = 128, 16, 3
X, Y = 0.3217, 0.7113


def hairline(x: Tensor, y: Tensor) -> Tensor:
    """0.1 px wide, 12 px from the left and nearly upright: samples hit it in the first rows only."""
    return ((x - (12.3 + 0.004 * y)).abs() < 0.05).to(torch.float64)


def before_and_after(budget: int) -> tuple[Judged, Judged, float]:
    """The verdicts on the blocks of 32 px without it and with it, and the share of what was left that it took."""
    cell = Cell(0, 0, SIDE, SIDE)
    integrand = Integrand(hairline)
    task = Task(Screen.of((SIDE, SIDE)), integrand, mcaa.Gaussian(0.5), "extend", SEED, torch.float64, torch.device("cpu"))
    ask = Counted(task, cell, budget, Precision())
    x, y = torch.tensor([X], dtype=torch.float64), torch.tensor([Y], dtype=torch.float64)
    values = ask.everywhere(X, Y, cell)
    samples = Everywhere(x, y, 0, 0, 0, values[:, :, None])
    found = [candidates(samples, axis) for axis in (0, 1)]
    judged = judge(ask, found, [blocks_of(cell, s) for s in found], BLOCKS, BLOCK, 24, SEED)
    left = ask.left
    after = with_thin_pieces(ask, judged, found, samples, SEED)
    return judged, after, 1 - ask.left / left


def test_blocks_that_a_thin_piece_crosses_unmet_are_known() -> None:
    """All 128 lines along x cross it, of which samples hit some 18: in the first block of four that lie below each other."""
    before, after, _ = before_and_after(16 * SIDE * SIDE)
    column = torch.arange(0, BLOCKS, 4)
    assert int((before.verdict == Verdict.JUMPS).sum()) == 1
    assert (after.verdict == Verdict.JUMPS).nonzero()[:, 0].tolist() == column.tolist()
    assert torch.allclose(after.lines[column], torch.full((4,), 32.0, dtype=torch.float64), atol=1.5)


def test_it_takes_a_twentieth_of_the_evaluations_or_nothing() -> None:
    assert 0 < before_and_after(16 * SIDE * SIDE)[2] <= 0.05
    before, after, took = before_and_after(SIDE * SIDE + 2500)
    assert took == 0 and after is before
