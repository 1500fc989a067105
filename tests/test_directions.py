"""Directions of edges, from one sample a pixel and from jumps."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

import torch_mcaa as mcaa
from torch_mcaa.edges.pilot import Judged
from torch_mcaa.estimators.directions import directions, faced
from torch_mcaa.estimators.located.counted import Counted
from torch_mcaa.grid import Cell
from torch_mcaa.patterns.turned import DIRECTIONS, angles

CELL = Cell(5, 9, 40, 70)


def _values(f, ring: int = 2) -> torch.Tensor:
    x = torch.arange(CELL.col - ring, CELL.col + CELL.width + ring, dtype=torch.float64) + 0.3
    y = torch.arange(CELL.row - ring, CELL.row + CELL.height + ring, dtype=torch.float64) + 0.8
    return f(x.expand(len(y), -1), y[:, None].expand(-1, len(x)))[None]


@pytest.mark.parametrize("turn", [-1.5, -1.0, -0.3, 0.0, 0.7, 1.2])
def test_the_edges_of_stripes_have_one_direction(turn: float) -> None:
    """Of their normals: most of it within a tenth of a turn and the middle to a fiftieth of one, though one sample a pixel makes steps of them."""
    found = directions(
        _values(lambda x, y: torch.remainder(x * math.cos(turn) + y * math.sin(turn), 9) < 4), CELL.row - 2, CELL.col - 2, CELL
    )
    assert found.shape == (2 * 3, DIRECTIONS)
    # angles of normals are alike after half a turn
    total, twice = found.sum(0), torch.from_numpy(2 * angles())
    middle = torch.atan2((total * twice.sin()).sum(), (total * twice.cos()).sum()) / 2
    off = torch.remainder(middle - turn + math.pi / 2, math.pi) - math.pi / 2
    assert abs(float(off)) < math.pi / 50
    apart = torch.remainder(twice / 2 - turn + math.pi / 2, math.pi) - math.pi / 2
    assert float(total[apart.abs() < math.pi / 10].sum() / total.sum()) > 0.8


def test_each_block_has_its_own() -> None:
    """Upright edges in the first column of blocks, a level one in the last; none where the samples end."""

    def f(x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        left = (x < CELL.col + 28) & (torch.remainder(x, 8) < 4)
        return (left | ((x > CELL.col + 60) & (y > 20))).double()

    found = directions(_values(f), CELL.row - 2, CELL.col - 2, CELL).view(2, 3, DIRECTIONS)
    assert int(found[0, 0].argmax()) == DIRECTIONS // 2 and int(found[0, 2].argmax()) == 0
    # samples beyond a closed screen are those at its border
    assert float(directions(torch.ones(1, 40, 70), CELL.row, CELL.col, CELL).sum()) == 0


@pytest.mark.parametrize("turn", [-1.1, 0.4, 0.9, 1.2])
def test_jumps_tell_the_directions_of_edges_closer_than_samples(turn: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Stripes every 2.1 px, of which one sample a pixel shows others: nine tenths within two of the 64 directions, and before next to none."""
    seen = []

    def noted(ask: Counted, judged: Judged, wanted: torch.Tensor, edges: torch.Tensor, seed: int) -> torch.Tensor:
        found = faced(ask, judged, wanted, edges, seed)
        seen.append((edges.sum(0), found.sum(0)))
        return found

    monkeypatch.setattr("torch_mcaa.estimators.piloted.faced", noted)
    mcaa.render(lambda x, y: (torch.remainder(x * math.cos(turn) + y * math.sin(turn), 2.1) < 0.9).to(x.dtype), (64, 64), spp=16)
    near = torch.from_numpy(np.abs((angles() - turn + math.pi / 2) % math.pi - math.pi / 2) < 2.1 * math.pi / DIRECTIONS)
    ((before, after),) = seen
    assert float(after[near].sum() / after.sum()) > 0.9
    assert float(before[near].sum() / before.sum()) < 0.35
    assert float(after.sum()) == pytest.approx(float(before.sum()))


def test_checkerboards_that_cannot_be_followed_are_sampled_by_a_lattice_that_misses_their_edges() -> None:
    """Turned by any angle, 4 to 8 px wide: the root mean square error is below that of the plain lattice with as many evaluations."""
    squares = torch.zeros(2, dtype=torch.float64)
    for seed in range(6):
        turn, side = torch.rand(2, generator=torch.Generator().manual_seed(seed), dtype=torch.float64).tolist()
        c, s = math.cos(6 * turn), math.sin(6 * turn)
        side = 4 + 4 * side

        def f(x: torch.Tensor, y: torch.Tensor, c: float = c, s: float = s, side: float = side) -> torch.Tensor:
            return torch.remainder(torch.floor((x * c + y * s) / side) + torch.floor((y * c - x * s) / side), 2)

        truth = mcaa.render(f, (64, 64), estimator=mcaa.Shared(), spp=512, seed=9).image
        for k, estimator in enumerate((mcaa.Shared(), mcaa.Auto())):
            picture = mcaa.render(f, (64, 64), estimator=estimator, spp=16, seed=seed)
            assert float(picture.spp.double().mean()) <= 16
            squares[k] += (picture.image - truth).square().mean()
    assert float((squares[1] / squares[0]).sqrt()) < 1
