"""A cell's lattice corrected for the jumps that bisection finds along its lines; finer where two shifts of it disagree."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torch_mcaa import rng
from torch_mcaa.edges.bisect import Crossings, bisect_all, joined
from torch_mcaa.edges.candidates import Segments, candidates
from torch_mcaa.edges.correction import Window
from torch_mcaa.edges.ends import ends
from torch_mcaa.edges.foretell import narrowed_all
from torch_mcaa.edges.lines import Samples, norm, scattered, weighed
from torch_mcaa.edges.pilot import Verdict, judge
from torch_mcaa.edges.thin import complete, thin_pieces, unfollowed
from torch_mcaa.estimators.base import box3, dilated, greatest
from torch_mcaa.estimators.counted import Counted, Spent, on_screen
from torch_mcaa.filters import SeparableFilter
from torch_mcaa.grid import Cell
from torch_mcaa.patterns import Lattice

BLOCK = 32
"""Px: the side of the blocks that are judged, corrected or given up as a whole."""
JUDGED = 24
"""Candidates of a block that it is judged by."""
KEPT = 0.75
"""What is left has to be this much of what there was before blocks are judged, or it is not done: a few pixels cannot pay for it."""
STEPS = (14, 11, 8)
"""Halvings of a segment of 1 px, the first that can be paid for."""
_FIRST, _AGAIN = 0.45, 0.75
"""The share of what is left that a first shift may spend on thin pieces; and what a second shift takes, in parts of the first's cost."""
_THIN = 2.0**-12
"""Px: how exactly the ends of thin pieces have to be known to be followed from line to line."""
_PREFERRED = 1.15
"""What the horizontal lines' density of jumps is multiplied by, so that chance does not choose where both are alike."""
_CORE = 0.03
"""A pixel's share of the greatest density of jumps around it, from which on a second shift is made for it."""
_NONE = 0.05
_ENOUGH = 2e-5
"""A standard error that is not worth refining, in ranges of the cell's values."""
_FINER = 3
_SHIFT = 0x11E5


@dataclass(frozen=True)
class Level:
    """One shift's result at some pixels.

    Attributes:
        value: (C, h, w); `spread` the variance of its brackets.
        near: bool (h, w), the pixels whose filter reaches a crossing; `core` those where it weighs much.
        crossings: along either axis.
        share: (h, w), what those along x count for in each pixel; for another shift, one axis alone where thin pieces are.
    """

    value: Tensor
    spread: Tensor
    near: Tensor
    core: Tensor
    crossings: list[Crossings]
    share: Tensor


@dataclass(frozen=True)
class Corrected:
    """Of one cell.

    Attributes:
        value, variance: (C, h, w) float64, of the pixels in `near`; no variance if a second shift could not be paid for, which would tell it.
        near: bool (h, w), the pixels in which jumps were corrected; `fine` those of them by the finer lattice.
    """

    value: Tensor
    variance: Tensor | None
    near: Tensor
    fine: Tensor


class Corrector:
    """The correction of one cell.

    Args:
        base: samples of the cell and `Window.halo` pixels around it.
        plain: (C, h, w) their weighted means.
        allowed: bool (h, w), pixels that may be corrected.
        steps: how often a segment of 1 px is halved, at most.
        jumping: bool (blocks,), those that are known to jump and are not judged again.
    """

    def __init__(
        self,
        ask: Counted,
        cell: Cell,
        filter: SeparableFilter,
        seed: int,
        base: Samples,
        plain: Tensor,
        allowed: Tensor,
        steps: int,
        jumping: Tensor,
    ) -> None:
        self.ask, self.cell, self.seed, self.base, self.plain = ask, cell, seed, base, plain.to(torch.float64)
        self.window = Window(cell.row, cell.col, cell.height, cell.width, filter, plain.device)
        self.allowed, self.jumping = allowed, jumping
        self.blocks = -(-cell.height // BLOCK), -(-cell.width // BLOCK)
        self.steps = self.most_steps = steps
        self.followed = True

    def run(self) -> Corrected:
        """Judge the blocks, and correct those that jump as far as the evaluations go."""
        none = torch.zeros_like(self.allowed)
        found = [candidates(self.base, axis) for axis in (0, 1)]
        part = [blocks_of(self.cell, s) for s in found]
        nothing = Corrected(self.plain, None, none, none)
        new = [~self.jumping[block] for block in part]
        try:
            with self.ask.keeping(KEPT):
                judged = (
                    [s.take(here) for s, here in zip(found, new, strict=True)],
                    [b[here] for b, here in zip(part, new, strict=True)],
                )
                verdict = judge(self.ask, *judged, self.blocks[0] * self.blocks[1], JUDGED, self.seed).verdict
        except Spent:
            return nothing
        verdict[self.jumping] = Verdict.JUMPS
        # an edge may reach into blocks without a candidate
        wanted = self.allowed & self._spread_out((verdict == Verdict.JUMPS) | (verdict == Verdict.NONE))
        if not bool((verdict == Verdict.JUMPS).any()):
            return nothing
        found = [s.take(verdict[block] == Verdict.JUMPS) for s, block in zip(found, part, strict=True)]
        try:
            share, open_, wanted = self._planned(found, wanted)
            if not bool(wanted.any()):
                return nothing
            before = self.ask.left
            first = self._level(self.base, self.plain, found, share, open_, wanted)
            again = _AGAIN * (before - self.ask.left) + self.base.count * int(dilated(first.core, 2).sum())
        except Spent:
            return nothing
        if not self.followed:
            # thin pieces everywhere: samples do as well as lines that miss them
            return nothing
        result = Corrected(first.value, None, first.near, none)
        if not bool(first.near.any()) or again > self.ask.left:
            return result
        try:
            second = self._shift(self.base.count, 1, first.core, first)
        except Spent:
            return result
        value, variance = _merged(first, second, first.core)
        result = Corrected(value, variance, first.near, none)
        return self._refined(result, variance, sum(len(s) for s in found))

    def _refined(self, coarse: Corrected, doubt: Tensor, segments: int) -> Corrected:
        """Two shifts of a finer lattice where the standard error is largest."""
        count = _FINER * self.base.count
        count += 1 - count % 2
        finite = self.plain.nan_to_num(0.0, 0.0, 0.0)
        span = (finite.amax((1, 2)) - finite.amin((1, 2)))[:, None, None]
        worst = torch.where(coarse.near, doubt.sqrt() / span.clamp_min(1e-300), 0).amax(0)
        density = segments / max(1, int(coarse.near.sum()))
        for times in (1, 4, 16, 64, 256, 1024):
            chosen = coarse.near & dilated(worst > _ENOUGH * times, 2)
            pixels = int(dilated(chosen, self.window.halo).sum())
            if not pixels:
                return coarse
            if 2 * pixels * count * (1 + density / self.base.count * STEPS[0]) < self.ask.left:
                break
        else:
            return coarse
        self.steps = STEPS[0]
        try:
            third = self._shift(count, 2, chosen)
            fourth = self._shift(count, 3, chosen, third)
        except Spent:
            return coarse
        fine = third.core & fourth.core
        value, variance = _merged(third, fourth, fine)
        # thin pieces with tips may have been lost on one of the finer lattices
        fine = fine & (variance <= doubt).all(0)
        return Corrected(
            torch.where(fine, value, coarse.value),
            torch.where(fine, variance, doubt),
            coarse.near,
            fine,
        )

    def _planned(self, found: list[Segments], wanted: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """How exactly to bisect, and which blocks, so that two shifts can be paid for: share, open, and the pixels still wanted."""
        share, open_, seen = self._axes(found)
        counts = torch.zeros(self.blocks[0] * self.blocks[1], dtype=torch.int64, device=wanted.device)
        reached = torch.zeros_like(wanted)
        for segments, weight, density in zip(found, (share, 1 - share), seen, strict=True):
            used = wanted & ((weight > 0) | open_)
            taken = segments.take(self._reaching(segments, used))
            counts += torch.bincount(blocks_of(self.cell, taken), minlength=len(counts))
            reached |= used & (density > 0)
        rows, cols = reached.nonzero().unbind(1)
        size = torch.bincount(rows // BLOCK * self.blocks[1] + cols // BLOCK, minlength=len(counts))
        cost = counts
        for self.steps in (s for s in STEPS if s <= self.most_steps):
            cost = counts * (2 * self.steps - 6) + self.base.count * size
            if float(cost.sum()) <= self.ask.left:
                return share, open_, wanted
        cheap = torch.argsort(cost)
        kept = torch.zeros_like(counts, dtype=torch.bool)
        kept[cheap] = cost[cheap].cumsum(0) <= self.ask.left
        return share, open_, wanted & self._spread_out(kept)

    def _axes(self, found: list[Segments]) -> tuple[Tensor, Tensor, list[Tensor]]:
        """The share (h, w) that crossings along x have in each pixel, where it has to be left open, bool (h, w), and what either axis sees."""
        seen = [
            self.window.density(s.axis, (s.low + s.high) / 2, s.across, (s.after - s.before).abs().amax(0).to(torch.float64))
            for s in found
        ]
        share, open_ = _share(*seen), seen[0] + seen[1] == 0
        # how often samples hit a thin piece says little of its direction
        for segments in found:
            single = segments.take(segments.single)
            if len(single):
                open_ |= (
                    self.window.density(single.axis, (single.low + single.high) / 2, single.across, torch.ones_like(single.low)) > 0
                )
        return share, open_, seen

    def _shift(self, count: int, number: int, wanted: Tensor, known: Level | None = None) -> Level:
        """A shift of a lattice of `count`, asked as far as the pixels `wanted` (h, w) need it; the axes of `known` are taken over."""
        window, halo = self.window, self.window.halo
        sx, sy = (float(rng.uniform(self.seed, _SHIFT, number, axis, dtype=torch.float64)) for axis in (0, 1))
        strip = Lattice().strip(count, number, False, (sx, sy), lines=True)
        x, y = (torch.from_numpy(places).to(window.device) for places in (strip.x, strip.y))
        asked = dilated(torch.nn.functional.pad(wanted, (halo,) * 4), max(1, halo - 1))
        row, col = window.row - halo, window.col - halo
        asked &= on_screen(self.ask.task, row, col, (asked.shape[0], asked.shape[1]))
        samples = scattered(self.ask, x, y, row, col, asked, number)
        rows, cols = wanted.nonzero().unbind(1)
        plain = torch.zeros_like(self.plain)
        plain[:, rows, cols] = weighed(samples, window.filter.profile, rows + window.row, cols + window.col, window.halo)
        found = [candidates(samples, axis) for axis in (0, 1)]
        if known is None:
            return self._level(samples, plain, found, *self._axes(found)[:2], wanted)
        return self._level(samples, plain, found, known.share, torch.zeros_like(wanted), wanted, known.crossings)

    def _level(
        self,
        samples: Samples,
        plain: Tensor,
        found: list[Segments],
        share: Tensor,
        open_: Tensor,
        wanted: Tensor,
        known: list[Crossings] | None = None,
    ) -> Level:
        """Correct one shift: bisect the candidates of the axis that each pixel takes, and add what they miss."""
        window, seed = self.window, self.seed + samples.number
        used = [((weight > 0) | open_) & wanted for weight in (share, 1 - share)]
        taken = [segments.take(self._reaching(segments, here)) for segments, here in zip(found, used, strict=True)]
        first = _FIRST if known is None else 1.0
        every = [
            self._completed(crossings, samples, here, seed, first)
            for crossings, here in zip(self._bisected(taken, samples, known, seed), used, strict=True)
        ]
        densities = [window.density(c.axis, c.place, c.across, c.jump.abs().amax(0).to(torch.float64)) for c in every]
        # now that all is known, the mixture where both axes were followed
        share = torch.where(((share > 0) & (share < 1)) | open_, _share(*densities), share)
        value, spread, scale = plain.clone(), torch.zeros_like(plain), norm(samples, window.filter.profile, window.halo)
        mixed = bool(((share > 0) & (share < 1)).any())
        for crossings, weight in zip(every, (share, 1 - share), strict=True):
            correction, doubt = window.correction(crossings, scale)
            if mixed:
                correction += ends(window, every[1 - crossings.axis], samples)
            value += weight * correction
            spread += weight**2 * doubt
        density = torch.lerp(densities[1], densities[0], share)
        near = (density > 0) & wanted
        core = near & (density > _CORE * greatest(density, window.reach))
        # where both axes have followed thin pieces and see them alike, one does for the next shift, the same all along a piece
        alike = open_ & (share > 0) & (share < 1)
        if bool((alike & near).any()):
            smooth = [torch.nn.functional.avg_pool2d(d[None], 9, 1, 4)[0] for d in densities]
            share = torch.where(alike, (_PREFERRED * smooth[0] >= smooth[1]).to(share), share)
        return Level(value, spread, near, core, every, share)

    def _completed(self, crossings: Crossings, samples: Samples, used: Tensor, seed: int, share: float) -> Crossings:
        """The crossings with thin pieces followed, or left to sampling where that takes more than a share of what is left."""
        if not thin_pieces(crossings, samples):
            return crossings
        without, cost = unfollowed(crossings, samples)
        if cost <= share * self.ask.left:
            reach = self.window.reach + 1
            wide = dilated(torch.nn.functional.pad(used, (reach,) * 4), reach)
            origin = self.window.row - reach, self.window.col - reach
            try:
                with self.ask.keeping(1 - share):
                    return complete(self.ask, crossings, samples, wide, origin, min(self._finest, _THIN), seed)
            except Spent:
                pass
        self.followed = self.followed and len(without) == len(crossings)
        return without

    def _bisected(self, segments: list[Segments], samples: Samples, known: list[Crossings] | None, seed: int) -> list[Crossings]:
        """The crossings of the segments along either axis; without any known, every second line foretells the others."""
        apart = 2.5 / samples.count
        if known is not None:
            return bisect_all(self.ask, narrowed_all(self.ask, segments, known, apart, seed), self._finest, seed)
        odd = [
            torch.argsort(torch.argsort(across))[s.key[:, 0]] % 2 == 1
            for s, across in zip(segments, (samples.y, samples.x), strict=True)
        ]
        first = bisect_all(self.ask, [s.take(~o) for s, o in zip(segments, odd, strict=True)], self._finest, seed)
        rest = narrowed_all(self.ask, [s.take(o) for s, o in zip(segments, odd, strict=True)], first, apart, seed)
        second = bisect_all(self.ask, rest, self._finest, seed)
        return [joined([a, b]) for a, b in zip(first, second, strict=True)]

    @property
    def _finest(self) -> float:
        """Px; the quarters of a segment are a little larger or smaller than one."""
        return 1.1 * 2.0**-self.steps

    def _reaching(self, segments: Segments, wanted: Tensor) -> Tensor:
        """Which segments begin where the filter of a pixel `wanted` (h, w) reaches; bool (S,)."""
        reach = self.window.reach + 1
        wide = dilated(torch.nn.functional.pad(wanted, (reach,) * 4), reach)
        x, y = (segments.low, segments.across) if segments.axis == 0 else (segments.across, segments.low)
        row = (y.floor().long() - self.window.row + reach).clamp(0, wide.shape[0] - 1)
        col = (x.floor().long() - self.window.col + reach).clamp(0, wide.shape[1] - 1)
        return wide[row, col]

    def _spread_out(self, by_block: Tensor) -> Tensor:
        """(h, w): what each pixel's block has."""
        plane = by_block.view(self.blocks).repeat_interleave(BLOCK, 0).repeat_interleave(BLOCK, 1)
        return plane[: self.cell.height, : self.cell.width]


def windows_of(cell: Cell) -> list[tuple[slice, slice]]:
    """The blocks of a cell, row by row: the slices that cut them out of its planes."""
    return [
        (slice(row, min(row + BLOCK, cell.height)), slice(col, min(col + BLOCK, cell.width)))
        for row in range(0, cell.height, BLOCK)
        for col in range(0, cell.width, BLOCK)
    ]


def blocks_of(cell: Cell, segments: Segments) -> Tensor:
    """The block of the cell (S,), counted row by row, that each segment begins in, or the one that is nearest."""
    x, y = (segments.low, segments.across) if segments.axis == 0 else (segments.across, segments.low)
    row = (y.floor().long() - cell.row).clamp(0, cell.height - 1) // BLOCK
    col = (x.floor().long() - cell.col).clamp(0, cell.width - 1) // BLOCK
    return row * -(-cell.width // BLOCK) + col


def blocks_in(cell: Cell, part: Cell) -> Tensor:
    """The numbers of the blocks of a cell that are those of a part of it, which begins with a block."""
    rows = torch.arange((part.row - cell.row) // BLOCK, -(-(part.row - cell.row + part.height) // BLOCK))
    cols = torch.arange((part.col - cell.col) // BLOCK, -(-(part.col - cell.col + part.width) // BLOCK))
    return (rows[:, None] * -(-cell.width // BLOCK) + cols).flatten()


def _share(horizontal: Tensor, vertical: Tensor) -> Tensor:
    """What the horizontal lines' crossings count for: sharply, by the eighth powers of what the lines see of the edges."""
    a, b = (density.square().square().square() for density in (horizontal, vertical))
    share = a / (a + b).clamp_min(1e-300)
    return torch.where(share < _NONE, 0, torch.where(share > 1 - _NONE, 1, share))


def _merged(first: Level, second: Level, core: Tensor) -> tuple[Tensor, Tensor]:
    """The mean of two shifts in the core, and its variance, pooled over neighbours in the core and with that of the brackets as a floor.

    Elsewhere the first shift's, and the pooled variance of the core around.
    """
    squared = torch.where(core, (first.value - second.value).square() / 4, 0)
    near, weight = core, core[None].to(torch.float64)
    pooled = box3(squared) / box3(weight).clamp_min(1e-9)
    around = pooled * core
    for _ in range(2):
        around, weight = box3(around), box3(weight)
    outside = around / weight.clamp_min(1e-9)
    value = torch.where(core, (first.value + second.value) / 2, first.value)
    brackets = torch.where(core, (first.spread + second.spread) / 4, first.spread)
    return value, torch.where(near, torch.maximum(pooled, squared), outside) + brackets
