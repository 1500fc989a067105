"""A cell's lattice corrected for the jumps that bisection finds along its lines; finer where two shifts of it disagree."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from torch_mcaa.edges.candidates import Finder, Segments
from torch_mcaa.edges.lines import Lines
from torch_mcaa.edges.pilot import Verdict, judge
from torch_mcaa.estimators.base import Task, dilated
from torch_mcaa.estimators.located.blocks import BLOCK, blocks_at, blocks_of, by_block, by_pixel, pixels_of, shape_of, sizes_of
from torch_mcaa.estimators.located.corrected import Corrected, beyond, merged
from torch_mcaa.estimators.located.counted import Counted, Spent
from torch_mcaa.estimators.located.jump_level import Axes, Level, Leveller
from torch_mcaa.estimators.located.sides import sides
from torch_mcaa.estimators.located.sparser import AROUND, sparser

JUDGED = 24
"""Candidates of a block that it is judged by."""
KEPT = 0.75
"""What is left has to be this much of what there was before blocks are judged, or it is not done: a few pixels cannot pay for it."""
STEPS = (14, 11, 8)
"""Halvings of a segment of 1 px: the most, fewer for the sake of more lines, and the fewest."""
_CROSSING, _CROSSING_STEP, _TOLD = -5.0, 2.0, 20.0
"""Evaluations that a crossing takes in two shifts: so many, and for each halving of its bracket; and one that f's margins tell, which was measured to
take 11 to 13: more lines for it would take more time and memory than the evaluations say."""
_AGAIN = 0.75
"""What a second shift takes, in parts of the first's cost, where segments are halved most: then foretelling, which the second has more of, saves
least."""
_ENOUGH = 2e-5
"""A standard error that is not worth refining, in ranges of the cell's values."""
_FINER = (3, 9)
"""How many times as many lines finer lattices have; the second where a tolerance asks for it."""
_UNCHECKED = 4.0
"""What the crossings of a block may take that no second shift checks, in parts of what its lattice does."""
_HIDDEN, _SEEN = 0.1, 0.3
"""Jumps beside candidates that do not stand out, in parts of those that do, from which on the lines of the other axis are relied on; and how many
these have to see, in parts of all that the first does."""
_TRUSTED = 16
"""How many times the variance of the samples has to be that of the corrected pixels, where two shifts tell it, for dearer ones to be used."""


class _Twice(NamedTuple):
    """The first of two shifts, what both give in its pixels, those (h, w) that the second has told of, and how many segments there were."""

    level: Level
    value: Tensor
    variance: Tensor
    checked: Tensor
    segments: int


class Corrector:
    """The correction of the cell that f is asked in.

    Args:
        base: the lattice that was sampled in the pixels whose jumps are to be corrected and `Window.halo` pixels around them.
        plain: (C, h, w) their weighted means; where there are none, any within their range.
        allowed: bool (h, w), pixels that may be corrected.
        steps: how often a segment of 1 px is halved, at most.
        jumping: bool (blocks,), those that are known to jump and are not judged again.
        enough: (C, h, w) standard errors that are not worth refining; None for a part in 50,000 of the cell's range of values.
        more: evaluations for what is worth it, beyond those of `ask`.
    """

    def __init__(
        self,
        ask: Counted,
        seed: int,
        base: Lines,
        plain: Tensor,
        allowed: Tensor,
        steps: int,
        jumping: Tensor,
        enough: Tensor | None = None,
        more: int = 0,
    ) -> None:
        self.enough, self.more = enough, more
        self.ask, self.cell, self.seed, self.base = ask, ask.cell, seed, base
        self.plain = plain.to(torch.float64)
        self.work = Leveller(ask, seed, self.plain)
        self.allowed, self.jumping = allowed, jumping.to(allowed.device)
        self.blocks = shape_of(ask.cell)
        self.most_steps = steps
        self.unlike = unlike(ask.task)
        # where there are pieces that had to be left to sampling, and what it would have taken not to
        self.missed = torch.zeros_like(allowed), 0.0

    def run(self, finder: Finder) -> Corrected | None:
        """Judge the blocks, and correct those that jump as far as the evaluations go; None where nothing is corrected.

        finder: has seen the samples.
        """
        found = self._twice(finder)
        again = sparser(self.work, self.base.count, *self.missed)
        if found is None:
            return again
        result = self._refined(*found) if isinstance(found, _Twice) else found
        return result if again is None else result.beside(again)

    def _twice(self, finder: Finder) -> _Twice | Corrected | None:
        """Two shifts of the lattice, or what is corrected by one that there is no second one for; None where nothing is."""
        hidden, found = finder.hidden(), finder.found()
        try:
            with self.ask.keeping(KEPT):
                if self.ask.task.followed is not None:
                    found = self.work.worthwhile(found)
                part = [blocks_of(self.cell, s) for s in found]
                verdict = self._judged(found, part)
        except Spent:
            return None
        beside = self._hidden(hidden, part)
        verdict[beside.all(0)] = Verdict.NOISE
        # an edge may reach into blocks without a candidate
        wanted = self.allowed & self._spread_out((verdict == Verdict.JUMPS) | (verdict == Verdict.NONE))
        # where f decides differently there is no doubt
        followed = [(verdict[block] == Verdict.JUMPS) | (s.decided > 0) for s, block in zip(found, part, strict=True)]
        if not any(bool(some.any()) for some in followed):
            return None
        if any(bool((s.decided > 0).any()) for s in found):
            wanted = self.allowed
        found = [s.take(some) for s, some in zip(found, followed, strict=True)]
        try:
            axes, wanted = self._planned(found, wanted, beside)
            if not bool(wanted.any()):
                return None
            before = self.ask.points.clone()
            first = self.work.first(self.base, found, axes, wanted)
        except Spent:
            return None
        self.missed = self.allowed & self.work.thin.lost & dilated(self.work.thin.hits, AROUND), self.work.thin.unpaid
        segments = sum(len(s) for s in found)
        # as large as all that is to come
        del found, part, followed
        first, known, checked, cheap = self._afforded(first, by_block(self.ask.points - before, self.cell))
        every, first = first, replace(first, near=first.near & cheap, core=first.core & cheap)
        unknown = Corrected.of(first, first.value, torch.full_like(first.value, torch.nan), torch.zeros_like(first.near))
        if not bool(known.any()):
            return unknown
        lost = self.work.thin.lost
        try:
            second = self.work.shift(self.base.count + self.unlike, 1, first.pixels.plane(known), first)
        except Spent:
            return unknown
        # a shift that lost thin pieces tells nothing of one that has them
        told = ~self.work.thin.lost | lost
        known, checked = known & told[first.pixels.rows, first.pixels.cols], checked & told
        if not bool(known.any()):
            return unknown
        first = replace(first, core=known)
        value, variance = merged(first, second)
        alone = (first.plain - first.pixels.of(second.pixels, second.plain, 0.0)).square() / 2
        level = self._kept(first, alone, (first.plain - value).square() - variance, variance)
        if float(torch.where(known, alone - _TRUSTED * variance, 0).sum()) > 0:
            # what is dear and cannot be checked is as good as what was
            level = replace(level, near=level.near | (every.near & ~cheap))
        return _Twice(level, value, variance, checked, segments)

    def _afforded(self, first: Level, spent: Tensor) -> tuple[Level, Tensor, Tensor, Tensor]:
        """The level without lost blocks; of those that can be checked, which took least, the core (P,) and all (h, w); and what is not dear (P,).

        spent: (blocks,) what its crossings took.
        """
        # with thin pieces that could not be followed samples do as well as lines that miss them
        whole = by_block(self.work.thin.lost, self.cell) == 0
        core = first.pixels.plane(first.core)
        count = self.base.count + self.unlike
        again = _AGAIN * (_halvings(self.work.finest) + STEPS[-1]) / (STEPS[0] + STEPS[-1])
        cost = again * count / self.base.count * spent + count * by_block(dilated(core, 2), self.cell)
        order = torch.argsort(cost)
        known = torch.zeros_like(cost, dtype=torch.bool)
        known[order] = (cost * whole)[order].cumsum(0) <= self.ask.left
        size = sizes_of(self.cell).to(cost.device)
        known &= whole
        at, checked = (first.pixels.rows, first.pixels.cols), self._spread_out(known)
        cheap = self._spread_out(known | (whole & (spent <= _UNCHECKED * self.base.count * size)))[at]
        whole = self._spread_out(whole)[at]
        return replace(first, near=first.near & whole, core=first.core & whole), first.core & checked[at], checked, cheap

    def _kept(self, first: Level, alone: Tensor, off: Tensor, variance: Tensor) -> Level:
        """The level without the blocks whose samples `alone`, by their variance, would do better with what is left.

        That is what two shifts of them tell or, of a thin piece that neither met, by how much they are `off`, squared.
        What the variance of samples falls with: their number to the power 1.5, as on edges.
        """
        if self.unlike:
            # the errors of two midpoint rules have one sign where f is smooth along the sides: they differ by less than either
            return first
        pixels = first.pixels
        worth = (self.base.count / (self.base.count + self.ask.left / max(1, int(self.allowed.count_nonzero())))) ** 1.5
        plain, unmet, corrected = (
            by_block(pixels.plane(torch.where(first.core, each, 0).sum(0)), self.cell) for each in (alone, off, variance)
        )
        better = worth * torch.maximum(plain, unmet) >= corrected
        kept = self._spread_out(better)[pixels.rows, pixels.cols]
        return replace(first, near=first.near & kept, core=first.core & kept)

    def _judged(self, found: list[Segments], part: list[Tensor]) -> Tensor:
        """The verdicts on the blocks, those that were judged before included."""
        new = [~self.jumping[block] & (s.decided == 0) for s, block in zip(found, part, strict=True)]
        segments = [s.take(here) for s, here in zip(found, new, strict=True)]
        blocks = [block[here] for block, here in zip(part, new, strict=True)]
        verdict = judge(self.ask, segments, blocks, self.blocks[0] * self.blocks[1], BLOCK, JUDGED, self.seed).verdict
        verdict[self.jumping] = Verdict.JUMPS
        return verdict

    def _refined(self, coarse: Level, value: Tensor, variance: Tensor, checked: Tensor, segments: int) -> Corrected:
        """With two shifts of a finer lattice where the standard error is largest."""
        fine = torch.zeros_like(coarse.near)
        if self.enough is None:
            finite = self.plain.nan_to_num(0.0, 0.0, 0.0)
            enough, levels = _ENOUGH * (finite.amax((1, 2)) - finite.amin((1, 2)))[:, None], _FINER[:1]
        else:
            enough, levels = self.enough[:, coarse.pixels.rows, coarse.pixels.cols], _FINER
            self.ask.left += self.more
        near = coarse.pixels.plane(coarse.near)
        density = segments / max(1, int(coarse.near.sum()))
        for level, finer in enumerate(levels):
            worst = torch.where(coarse.near, variance.sqrt() / enough.clamp_min(1e-300), 0).amax(0)
            count = finer * self.base.count
            count += 1 - count % 2
            for times in (1, 4, 16, 64, 256, 1024):
                chosen = near & dilated(coarse.pixels.plane(worst > times), 1 - level)
                pixels = int(dilated(chosen, self.work.window.halo).sum())
                if not pixels or 2 * pixels * count * (1 + density / self.base.count * STEPS[0]) < self.ask.left:
                    break
            else:
                break
            if not pixels:
                break
            self.work.finest = _finest(STEPS[0] if self.enough is None else _steps(self.plain, self.enough))
            try:
                third = self.work.shift(count, 2 + 2 * level, chosen)
                fourth = self.work.shift(count + self.unlike, 3 + 2 * level, chosen, third)
            except Spent:
                break
            core = replace(third, core=third.core & fourth.core)
            finer_value, finer_variance = (coarse.pixels.of(core.pixels, one, 0.0) for one in merged(core, fourth))
            # thin pieces with tips may have been lost on one of the finer lattices
            better = coarse.pixels.of(core.pixels, core.core, False) & (finer_variance <= variance).all(0)
            fine |= better
            value = torch.where(better, finer_value, value)
            variance = beyond(coarse, torch.where(better, finer_variance, variance), fine)
        result = Corrected.of(coarse, value, variance, fine)
        result.variance[:, ~checked[result.rows, result.cols]] = torch.nan
        return result

    def _hidden(self, hidden: list[Tensor], part: list[Tensor]) -> Tensor:
        """bool (2, blocks): along which axis edges hide; along both where the other one sees too few of them.

        hidden: for each axis, as `Finder.hidden`; part: for each axis the block of each candidate.
        """
        count = self.blocks[0] * self.blocks[1]
        seen = torch.stack([torch.bincount(each, minlength=count) for each in part])
        blocks = (blocks_at(self.cell, *pixels_of(self.cell, 0, *each)) for each in hidden)
        many = torch.stack([torch.bincount(each, minlength=count) for each in blocks])
        beside = many > _HIDDEN * seen
        return beside | (beside.flip(0) & (seen < _SEEN * (seen + many).flip(0)))

    def _planned(self, found: list[Segments], wanted: Tensor, beside: Tensor) -> tuple[Axes, Tensor]:
        """How exactly to bisect, and which blocks, so that two shifts can be paid for: the axes, and the pixels still wanted.

        beside: as `_hidden`.
        """
        axes, seen = self.work.axes(found)
        for axis in (0, 1):
            other = self._spread_out(beside[axis] & ~beside[1 - axis])[axes.pixels.rows, axes.pixels.cols]
            axes = replace(axes, share=axes.share.masked_fill(other, float(axis)), open=axes.open & ~other)
        counts, told = torch.zeros(2, self.blocks[0] * self.blocks[1], dtype=torch.int64, device=wanted.device)
        reached = torch.zeros_like(wanted)
        for segments, density in zip(found, seen, strict=True):
            used = axes.used(segments.axis, wanted)
            some = segments.take(self.work.reaching(segments, used))
            blocks = blocks_of(self.cell, some)
            counts += torch.bincount(blocks, minlength=len(counts))
            told += torch.bincount(blocks[some.decided > 0], minlength=len(told))
            reached |= used & axes.pixels.plane(density > 0)
        size = torch.bincount(blocks_at(self.cell, *reached.nonzero().unbind(1)), minlength=len(counts))
        cost, second = counts, 1 + self.unlike / (2 * self.base.count)
        for steps in (self.most_steps, *(s for s in STEPS if s < self.most_steps)):
            self.work.finest = _finest(steps)
            cost = counts * crossing(steps, told / counts.clamp_min(1)) * second + self.base.count * size
            if float(cost.sum()) <= self.ask.left:
                return axes, wanted
        # the first of the two at least
        cost = (cost - self.base.count * size) / (1 + _AGAIN)
        cheap = torch.argsort(cost)
        kept = torch.zeros_like(counts, dtype=torch.bool)
        kept[cheap] = cost[cheap].cumsum(0) <= self.ask.left
        return axes, wanted & self._spread_out(kept)

    def _spread_out(self, by_block: Tensor) -> Tensor:
        """(h, w): what each pixel's block has."""
        return by_pixel(by_block.view(self.blocks), self.cell)


def unlike(task: Task) -> int:
    """How many lines a second shift has more: as many, which lie alike about the sides of a box, would err alike."""
    return 0 if task.once(sides) is None else 2


def crossing(steps: int, told: Tensor) -> Tensor:
    """The evaluations that a crossing takes in two shifts of as many lines, with so many halvings, or, for a share `told`, from f's margins."""
    return torch.lerp(torch.full_like(told, _CROSSING + _CROSSING_STEP * steps), torch.full_like(told, _TOLD), told)


def _finest(steps: int) -> float:
    """Px; the quarters of a segment are a little larger or smaller than one."""
    return 1.1 * 2.0**-steps


def _steps(value: Tensor, enough: Tensor) -> int:
    """So many halvings that a bracket's width, times the values' range (C, h, w), is a standard error that is `enough`: lines err by far less."""
    finite = value.nan_to_num(0.0, 0.0, 0.0)
    ratio = (finite.amax((1, 2)) - finite.amin((1, 2))) / enough.amin((1, 2)).clamp_min(1e-300)
    return int(ratio.amax().clamp(2.0 ** STEPS[-1], 2.0 ** STEPS[0]).log2().ceil())


def _halvings(finest: float) -> float:
    """The steps of which `_finest` says how narrow brackets get."""
    return math.log2(1.1 / finest)
