"""A round that looks first: one sample a pixel, and then each part of a cell in the way that this tells to suit it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import torch
from torch import Tensor

from torch_mcaa import rng
from torch_mcaa.edges.candidates import Segments, candidates
from torch_mcaa.edges.correction import Window
from torch_mcaa.edges.lines import Everywhere
from torch_mcaa.edges.pilot import Judged, Verdict, judge
from torch_mcaa.estimators.base import Estimate, Round, Task, dilated
from torch_mcaa.estimators.differences import Differences
from torch_mcaa.estimators.directions import directions, faced
from torch_mcaa.estimators.further import poorest_of, sampled_first, sampled_further
from torch_mcaa.estimators.lattice.audit import tile_means
from torch_mcaa.estimators.located.blocks import BLOCK, blocks_in, blocks_of, by_block, by_pixel, shape_of
from torch_mcaa.estimators.located.counted import Counted, Spent, hold_to_rounding, is_random
from torch_mcaa.estimators.located.jump_corrector import JUDGED, KEPT, unlike
from torch_mcaa.estimators.parts import CROWDED, PLAIN, SAMPLED, Part, Parts, located
from torch_mcaa.estimators.plans import plans_of
from torch_mcaa.filters import SeparableFilter
from torch_mcaa.grid import Cell
from torch_mcaa.tolerance import Tolerance

# a tolerance's part, which pictures without one do not need
if TYPE_CHECKING:
    from torch_mcaa.estimators.resolved import Resolved

_PILOT = 0x9110
_SURE = 12
"""Candidates from which on a block that was found to jump is not judged again."""
_RING = 2
"""Pixels around a cell that the pilot has samples in."""
_FEW = 256
"""Pixels of a cell that cannot pay for a look at their candidates: they are sampled plainly."""
_MARGIN, _RESERVED = 1.2, 0.9
"""What a part whose jumps are located may cost over what is expected where others are sampled plainly, which have what it leaves; and the
part of their own share that these keep in any case."""


class _Seen(NamedTuple):
    """What is known of the blocks of a cell after its pilot.

    Attributes:
        jumping: which are known to jump, decisions aside.
        samples: (C, H, W), one in each pixel, and the row and column of the first.
        counts: under a tolerance how many points a pixel a lattice needs, in the first round.
        done: blocks that are known well enough already, and what these and the attempt at others have `taken`.
    """

    judged: Judged
    jumping: Tensor
    differences: Differences
    samples: tuple[Tensor, int, int]
    counts: Tensor | None
    done: list[tuple[Cell, Part]]
    taken: int


class PilotedRound(Round):
    """A pilot of one sample a pixel in each cell, and then each of its parts in its own way, or, without `plain`, all as one located part.

    Under a tolerance, what is `wanted`, blocks whose jumps could not be located with `spp` evaluations a pixel have up to `most`, and where
    nothing is to be located as many as f's steepness asks for; in the first round one lattice is tried where f is smooth, and is enough if it
    says so itself. If there are no `jumps` there is a plain lattice alone; None is to look.
    """

    def __init__(
        self,
        task: Task,
        spp: int,
        number: int,
        plain: bool = True,
        most: int | None = None,
        wanted: Tolerance | None = None,
        jumps: bool | None = None,
    ) -> None:
        self.task, self.spp, self.plain, self.parts = task, spp, plain, Parts(task, number, audited=not plain)
        self.most, self.wanted, self.jumps = most, wanted, jumps
        self.per_pixel = float(spp)
        self.first = number == 0
        self.resolved: Resolved | None = None
        # what f's frequencies ask for is known of products alone
        if wanted is not None and jumps is not False and self.first and isinstance(task.filter, SeparableFilter):
            from torch_mcaa.estimators.bandwidth import Bandwidth
            from torch_mcaa.estimators.resolved import Resolved

            self.resolved = Resolved(task, Bandwidth(task.filter), wanted, self.parts.seed)

    def points(self, cell: Cell) -> int:
        return self.spp * cell.height * cell.width

    def estimate(self, cell: Cell) -> Estimate:
        pixels = cell.height * cell.width
        ask = self.parts.ask(cell, self.spp * pixels)
        if pixels < _FEW or self.jumps is False:
            return self._plainly(ask, self.spp)
        self.parts.random = is_random(ask, self.parts.seed)
        try:
            seen = self._pilot(cell, ask)
        except Spent:
            return self._plainly(ask, ask.left // pixels)
        audits = 0 if self.plain else pixels
        second = 2 * Window.halo_of(self.task.filter) + 1
        judged, done = seen.judged, seen.done
        smooth, texture = torch.zeros_like(seen.jumping), seen.differences.texture
        for where, _ in done:
            smooth[blocks_in(cell, where)] = True
        most = None if self.most is None else self.most - -(-seen.taken // pixels)
        plans = plans_of(
            cell,
            judged,
            texture,
            ask.left - audits,
            self.plain,
            second,
            unlike(self.task),
            most or 0,
            smooth,
            self.parts.fewest,
        )
        located = [plan for plan in plans if plan.lines]
        plain = [plan for plan in plans if not plan.lines]
        left, expected = ask.left, sum(plan.cost for plan in located)
        reserved = sum(plan.cost for plan in plain)
        # what the pilot took counts
        room = left if most is None else left + (most - self.spp) * pixels
        if most is not None:
            left = max(left, min(room, int(_MARGIN * expected + reserved)))
        for plan in located:
            budget = int(
                plan.cost / expected * (left - reserved) if not plain else min(_MARGIN * plan.cost, left - reserved * _RESERVED)
            )
            size = sum(each.height * each.width for each in plan.cells)
            more = 0 if most is None else max(0, room * size // pixels - budget)
            parts, took = self.parts.located(ask, plan.cells, plan.lines, budget, plan.steps, seen.jumping, self.wanted, more)
            done += parts
            left, expected = left - min(budget, took), expected - plan.cost
        part = self.parts.joined(cell, done)
        if seen.counts is None or self.most is None:
            ways = poorest_of(self.parts, part, ask, seen.differences, judged)
            if ways:
                edges, left = self._edges(seen, part, ask, left)
                slow = judged.slow & ~texture
                sampled_further(self.parts, part, ask, ways, edges, slow, left, None if most is None else self.spp)
        else:
            sampled_first(self.parts, part, ask, seen.counts, self.most * pixels - int(ask.points.sum()))
        _mark_crowded(part.model, cell, judged.verdict, self.wanted is not None)
        return part.estimate(ask)

    def _plainly(self, ask: Counted, spp: float) -> Estimate:
        """The cell by a plain lattice."""
        part, _ = self.parts.sampled(ask, ask.cell, spp, ask.left)
        return self.parts.joined(ask.cell, [(ask.cell, part)]).estimate(ask)

    def _edges(self, seen: _Seen, part: Part, ask: Counted, left: int) -> tuple[Tensor | None, int]:
        """As in `directions`, those of the jumps that were found where nothing of a block was located, and the evaluations then left.

        None where rounds are compared: these must have other lattices.
        """
        if self.wanted is not None or not self.first:
            return None, left
        edges = directions(*seen.samples, ask.cell).cpu()
        if not seen.judged.sharp:
            return edges, left
        more = self.parts.ask(ask.cell, left)
        plainly = tile_means((part.model != PLAIN).to(torch.float32), BLOCK, BLOCK).flatten() == 0
        edges = faced(more, seen.judged, plainly, edges, self.parts.seed)
        ask.include(more)
        return edges, more.left

    def _pilot(self, cell: Cell, ask: Counted) -> _Seen:
        """What one sample a pixel tells of the blocks."""
        parts = self.parts
        x, y = (rng.uniform(parts.seed, _PILOT, axis, dtype=torch.float64) for axis in (0, 1))
        # a closed screen has no samples about it
        resolved = self.resolved if self.task.boundary == "extend" else None
        ring = _RING if resolved is None else max(_RING, resolved.halo)
        around = self.task.around(cell, ring)
        row, col = around.row, around.col
        values = ask.everywhere(float(x), float(y), around)
        hold_to_rounding(ask, float(x), float(y), row, col, values, parts.seed)
        channels = self.task.integrand.channels
        codes = values[channels:, :, None] if self.task.followed else None
        values = values[:channels]
        place = float(x), float(y), row, col, values
        x, y = x[None].to(self.task.device), y[None].to(self.task.device)
        samples = Everywhere(x, y, 0, row, col, values[:, :, None], codes=codes)
        found = [_about(cell, candidates(samples, axis)) for axis in (0, 1)]
        with ask.keeping(KEPT):
            if codes is not None:
                from torch_mcaa.estimators.located.decided import worthwhile

                found, _, _ = worthwhile(ask, cell, found, parts.seed)
            judged = judge(ask, found, [blocks_of(cell, s) for s in found], math.prod(shape_of(cell)), BLOCK, JUDGED, parts.seed)
        if self.jumps:
            judged.verdict.fill_(Verdict.JUMPS)
            judged.tried.fill_(_SURE)
        jumping = _jumping(cell, judged)
        if codes is not None:
            judged = _decided(judged, torch.cat([blocks_of(cell, s) for s in found]), torch.cat([s.decided > 0 for s in found]))
        samples = values, row, col
        values = values[:, cell.row - row :, cell.col - col :][:, : cell.height, : cell.width]
        counts, done, taken = None, [], 0
        if self.resolved is not None:
            from torch_mcaa.estimators.resolved import Grid

            assert self.most is not None
            grid = None if resolved is None or parts.random else Grid(*place)
            counts, done, taken = self.resolved.seen(ask, cell, values, grid, judged.verdict, self.most - self.spp)
        # a few numbers a block, of which the CPU makes plans
        return _Seen(
            judged.cpu(),
            jumping.cpu(),
            Differences(values),
            samples,
            counts,
            done,
            taken,
        )


def _mark_crowded(model: Tensor, cell: Cell, verdict: Tensor, again: bool) -> None:
    """Where f jumps and was sampled: there by design, or, if there may be another round, as all that came of locating jumps in a block."""
    jumps = (verdict == Verdict.JUMPS).to(model.device)
    without = jumps & (by_block(located(model), cell) == 0) & again
    crowded, empty = (by_pixel(some.view(shape_of(cell)), cell) for some in (jumps, without))
    model[(crowded & (model == SAMPLED)) | (empty & (model == PLAIN))] = CROWDED


def _jumping(cell: Cell, judged: Judged) -> Tensor:
    """The blocks that are known to jump: many candidates say so, or of a block beside, into which an edge that few of its own met goes on."""
    size = shape_of(cell)
    sure = (judged.verdict == Verdict.JUMPS) & (judged.tried >= _SURE)
    beside = dilated(sure.view(size), 1).flatten()
    return sure | (beside & ((judged.verdict == Verdict.JUMPS) | (judged.verdict == Verdict.NONE)))


def _decided(judged: Judged, blocks: Tensor, decided: Tensor) -> Judged:
    """Where f is seen to decide there is no doubt that it jumps; `blocks` (S,) of the candidates, of which some are `decided`."""
    verdict = judged.verdict.clone()
    verdict[blocks[decided]] = Verdict.JUMPS
    every, told = (torch.bincount(some, minlength=len(verdict)) for some in (blocks, blocks[decided]))
    return replace(judged, verdict=verdict, told=told / every.clamp_min(1))


def _about(cell: Cell, segments: Segments) -> Segments:
    """Those that touch the cell: the last ones of the samples have no neighbours to be judged by."""
    row, col = segments.key[:, 1], segments.key[:, 2]
    inside = (row >= cell.row - 1) & (row < cell.row + cell.height) & (col >= cell.col - 1) & (col < cell.col + cell.width)
    return segments.take(inside)
