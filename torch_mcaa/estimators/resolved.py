"""One lattice for a smooth f, and what vouches for it: its own samples near and about it, and a few pixels of another.

A lattice errs by the parts of f near its dual vectors. Its own samples, with signs that turn the lattice's double into zero, tell of all that
is not far from half of one, as every feature is that is thin or small; weighed by a wide window they tell nothing of an f that is resolved.
They cannot tell of what lies on a dual vector alone, and that is everywhere alike: another lattice sees it in a few pixels of each block.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from torch_mcaa import rng
from torch_mcaa.edges.pilot import Verdict
from torch_mcaa.estimators.bandwidth import Bandwidth
from torch_mcaa.estimators.base import Task, box3
from torch_mcaa.estimators.located.blocks import BLOCK, by_pixel, rectangles_of, shape_of
from torch_mcaa.estimators.located.counted import Counted
from torch_mcaa.estimators.paper.suited import Suited, choose
from torch_mcaa.estimators.parts import PLAIN, Part
from torch_mcaa.estimators.steepness import steepness_of
from torch_mcaa.filters import SeparableFilter
from torch_mcaa.grid import Cell
from torch_mcaa.patterns.nested import Nested
from torch_mcaa.tolerance import Tolerance

_CHECKED = 5
"""Px: the side of what another lattice checks in each block."""
_SHORTEST, _LONGEST = 1.0, 8.0
"""Cycles a pixel: of the other lattice's shortest dual vector."""
_TURN = 0x7074
Profile = Callable[[Tensor], Tensor]
"""Weights at distances along one axis."""


@dataclass(frozen=True)
class Grid:
    """f (C, H, W) at the offset (x, y) in each pixel from (row, col)."""

    x: float
    y: float
    row: int
    col: int
    values: Tensor

    def planes(self, cell: Cell, halo: int) -> Tensor:
        """(C, 1, h, w) in the pixels of a cell and `halo` more on each side."""
        top, left = cell.row - halo - self.row, cell.col - halo - self.col
        return self.values[:, None, top : top + cell.height + 2 * halo, left : left + cell.width + 2 * halo]


class Resolved:
    """Values and variances of cells in which a lattice resolves f, as far as it says itself."""

    def __init__(self, task: Task, bandwidth: Bandwidth, wanted: Tolerance, seed: int) -> None:
        assert isinstance(task.filter, SeparableFilter)
        self.task, self.filter, self.bandwidth, self.wanted, self.seed = task, task.filter, bandwidth, wanted, seed
        self.reach = math.ceil(task.filter.half_width - 0.5)
        self.halo = max(self.reach, math.ceil(bandwidth.span - 0.5))

    def seen(
        self, ask: Counted, cell: Cell, values: Tensor, grid: Grid | None, verdict: Tensor, more: int
    ) -> tuple[Tensor, list[tuple[Cell, Part]], int]:
        """How many points a pixel a lattice needs in each block of a cell, and what `parts` gives with `more` evaluations a pixel.

        values: (C, h, w), one sample a pixel, and the same with `halo` pixels around it in `grid`; without that no lattice is tried.
        verdict: (blocks,) on what the samples show of jumps.
        """
        steep = steepness_of(ask, cell, values, self.seed)
        allowed = self.wanted.allowed(steep.mean)
        counts = self.bandwidth.points(steep.frequency, steep.std, allowed)
        if grid is None:
            return counts, [], 0
        # beside an edge lines are better, that meet what the pilot missed of it
        jumps = bool((verdict == Verdict.JUMPS).any())
        smooth = verdict == Verdict.CONTINUOUS if jumps else verdict != Verdict.NOISE
        chosen = choose(self.bandwidth, steep, allowed, smooth.cpu())
        return counts, *self.parts(cell, chosen, grid, ask, more * cell.height * cell.width)

    def parts(
        self, cell: Cell, chosen: list[Suited | None], grid: Grid, ask: Counted, budget: int
    ) -> tuple[list[tuple[Cell, Part]], int]:
        """The blocks of a cell that are known well enough with the lattices `chosen` for them, or finer ones, and what all took.

        That is at most the `budget`, and counted in `ask`.
        """
        left = budget
        found: list[tuple[Cell, Part]] = []
        alike = [None if each is None else id(each.lattice) for each in chosen]
        todo = [
            (where, suited, grid.planes(where, self.halo), ask.beside(where))
            for where, inside in cell.rectangles(BLOCK, alike)
            if (suited := [each for block in inside if (each := chosen[block]) is not None])
        ]
        while todo:
            where, suited, samples, here = todo.pop()
            before = int(here.points.sum())
            more = (suited[0].lattice.count - samples.shape[1]) * where.height * where.width + self._check(suited) * len(suited)
            if more > left:
                ask.include(here)
                continue
            value, variance, blind, samples = self._estimate(where, suited, grid, samples, here)
            left -= int(here.points.sum()) - before
            excess = self.wanted.ratio(value, variance).sqrt().amax(0).masked_fill(here.invalid > 0, torch.inf)
            for block, had in zip(where.blocks(BLOCK), suited, strict=True):
                at = block.within(where)
                beyond = float(excess[at].max())
                if beyond <= 1:
                    model = torch.full_like(here.invalid[at], PLAIN, dtype=torch.uint8)
                    found.append((block, Part(value[:, *at], variance[:, *at], None, model, had.lattice.count, blind[:, *at])))
                    ask.include(here.cut(block))
                    continue
                finer = had.finer(beyond)
                if finer is None:
                    ask.include(here.cut(block))
                else:
                    (down, right), ring = (part.start for part in at), 2 * self.halo
                    cut = samples[..., down : down + block.height + ring, right : right + block.width + ring]
                    todo.append((block, [finer], cut, here.cut(block)))
        return found, budget - left

    def _check(self, suited: list[Suited]) -> int:
        """How many points the other lattice takes in a block, at most."""
        return math.ceil((_CHECKED + 2 * self.filter.half_width) ** 2 * _length(suited) ** 2)

    def _estimate(
        self, cell: Cell, suited: list[Suited], grid: Grid, samples: Tensor, ask: Counted
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Value, variance, and the part of the variance that the samples did not tell of, all (C, h, w), and all samples (C, n, H, W).

        samples: those of the lattice's first points, with `halo` pixels more on each side. ask: f in the cell, with no budget to speak of.
        """
        lattice = suited[0].lattice
        moved = np.stack([grid.x + lattice.x, grid.y + lattice.y], 1)
        # each point of the lattice in the pixel that it lies in
        places = moved - np.floor(moved)
        new = [ask.everywhere(float(x), float(y), cell.grown(self.halo)) for x, y in places[samples.shape[1] :]]
        samples = torch.cat([samples, *(values[:, None] for values in new)], 1)
        value = self._weighed(samples, places, cell, self.reach, self.filter.profile)
        own = self._disagreement(samples, places, cell, lattice, grid)
        other = self._checked(cell, suited, value, ask)
        return value, own + other, other, samples

    def _weighed(self, samples: Tensor, places: np.ndarray, cell: Cell, reach: int, profile: Profile) -> Tensor:
        """(C, h, w): the means of samples (C, n, H, W), of which `halo` lie beyond the cell, under the weights profile(x) profile(y)."""
        k = torch.arange(-reach, reach + 1, dtype=torch.float64)
        along_x, along_y = (profile(k + torch.from_numpy(places[:, axis])[:, None] - 0.5).detach().cpu() for axis in (0, 1))
        along_y = along_y / (along_x.sum(1) * along_y.sum(1)).sum()
        rows = samples[:, :, self.halo - reach : self.halo - reach + cell.height + 2 * reach]
        taps_x, taps_y = (taps.to(samples)[..., None, None] for taps in (along_x, along_y))
        across = torch.zeros_like(rows[..., : cell.width])
        for step in range(2 * reach + 1):
            across.addcmul_(rows.narrow(3, self.halo - reach + step, cell.width), taps_x[:, step])
        total = torch.zeros_like(across[:, 0, : cell.height])
        for step in range(2 * reach + 1):
            total.add_((across.narrow(2, step, cell.height) * taps_y[:, step]).sum(1))
        return total

    def _disagreement(self, samples: Tensor, places: np.ndarray, cell: Cell, lattice: Nested, grid: Grid) -> Tensor:
        """(C, h, w): the variance that the characters of the lattice modulo its double tell of, under the wide window."""
        reach = math.ceil(self.bandwidth.span - 0.5)
        centred = samples - samples.mean((1, 2, 3), keepdim=True)
        row = torch.arange(samples.shape[2])[:, None] + (cell.row - self.halo)
        col = torch.arange(samples.shape[3]) + (cell.col - self.halo)
        power = torch.zeros_like(samples[:, 0, : cell.height, : cell.width])
        for k in lattice.characters:
            # from the grid's point, in whole pixels and in parts of them
            moved = np.floor(np.stack([grid.x + lattice.x, grid.y + lattice.y]))
            phase = torch.from_numpy(np.rint(k @ (np.stack([lattice.x, lattice.y]) - moved))).long()[:, None, None]
            odd = (phase + int(k[0]) * col + int(k[1]) * row) % 2
            signed = centred * (1 - 2 * odd).to(samples)
            power.add_(self._weighed(signed, places, cell, reach, self.bandwidth.window).square())
        power *= self.bandwidth.told
        return torch.maximum(power, box3(power))

    def _checked(self, cell: Cell, suited: list[Suited], value: Tensor, ask: Counted) -> Tensor:
        """(C, h, w): by blocks, the mean squared difference from another lattice in a few pixels where f is steep; +inf in blocks too small."""
        margin = self.filter.half_width - 0.5
        ring = math.ceil(margin)
        row, col, height, width = rectangles_of(cell).unbind(1)
        x, y, weights = self._other(suited, margin)
        first, last = torch.full_like(height, ring), torch.stack([height, width]) - ring - _CHECKED
        steepest = torch.stack([each.steepest for each in suited], 1).floor().long() - torch.stack([row, col]) - _CHECKED // 2
        down, right = torch.maximum(first, torch.minimum(steepest, last))
        at = (((corner)[:, None] + place).flatten().to(value.device) for corner, place in ((col + right, x), (row + down, y)))
        theirs = ask(*at).view(len(value), len(row), -1).cpu().to(weights) @ weights.T
        i = torch.arange(_CHECKED)
        rows, cols = (row + down - cell.row)[:, None, None] + i[:, None], (col + right - cell.col)[:, None, None] + i
        ours = value.cpu()[:, rows.clamp_max(cell.height - 1), cols.clamp_max(cell.width - 1)].flatten(2)
        off = (ours.to(theirs) - theirs).square().mean(2)
        small = torch.minimum(height, width) < 2 * ring + _CHECKED
        off = torch.where(small, torch.inf, off).to(value)
        return by_pixel(off.unflatten(1, shape_of(cell)), cell)

    def _other(self, suited: list[Suited], margin: float) -> tuple[Tensor, Tensor, Tensor]:
        """Places x, y (J,) from a corner of what is checked, and the weights (pixels, J) of its pixels: a hexagonal lattice, turned at random."""
        turn, *shift = (
            float(rng.uniform(self.seed, _TURN, suited[0].lattice.count, axis, dtype=torch.float64)) for axis in (0, 1, 2)
        )
        length = _length(suited)
        angle = math.pi * turn + np.array([0, 2 * math.pi / 3])
        basis = np.linalg.inv(length * np.stack([np.cos(angle), np.sin(angle)], 1)).T
        most = math.ceil((_CHECKED + 2 * margin + 2) * length)
        i, j = np.meshgrid(np.arange(-most, most + 1), np.arange(-most, most + 1))
        x, y = ((np.stack([i.ravel() + shift[0], j.ravel() + shift[1]], 1) @ basis) + _CHECKED / 2).T
        inside = (np.abs(x - _CHECKED / 2) < _CHECKED / 2 + margin) & (np.abs(y - _CHECKED / 2) < _CHECKED / 2 + margin)
        x, y = torch.from_numpy(x[inside]), torch.from_numpy(y[inside])
        centre = torch.arange(_CHECKED, dtype=torch.float64)[:, None] + 0.5
        weight_x, weight_y = (self.filter.profile(at - centre).detach().cpu() for at in (x, y))
        weights = (weight_y[:, None] * weight_x).flatten(0, 1)
        return x, y, weights / weights.sum(1, keepdim=True)


def _length(suited: list[Suited]) -> float:
    """Cycles a pixel: the other lattice's shortest dual vector."""
    return max(_SHORTEST, min(_LONGEST, max(each.length for each in suited)))
