"""The one loop over rounds and cells."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor

from torch_mcaa.allocation import Uniform
from torch_mcaa.errors import McaaError
from torch_mcaa.estimators import Estimate, Estimator, Pixelwise, PixelwiseRound, Round, Task
from torch_mcaa.estimators.base import MANY
from torch_mcaa.grid import Cell
from torch_mcaa.picture import add, blank, part_of
from torch_mcaa.progress import Progress
from torch_mcaa.rendering import Stopped
from torch_mcaa.replicates import Latest, agreed
from torch_mcaa.sharing_out import shared_out
from torch_mcaa.tolerance import Tolerance

_PILOT = 4
_BLOCK = 16
"""Px: the side of what is done, under a tolerance, when it meets it."""
_GROWTH, _SURE = 1.0, 1.1
"""A round is at most so many times what a cell has had; and what is added to what it is expected to need."""
_GROWTH_LOCATED = 4.0
_FEW_SHIFTS = (6.0, 2.78 / 2)
"""What a standard error from two shifts, one round, counts for, and from four (Student over normal): two may agree at a corner by chance."""
_STEPS = 2
"""Numbers of evaluations that a round may ask for, in each octave."""
_PILOT_SHARE = 4
"""One part in so many of the evaluations is the pilot that an allocation is made from."""


@dataclass
class Rounds:
    """The state of a rendering between rounds: the picture so far, and what each cell has had."""

    task: Task
    estimator: Estimator
    spp: int
    tolerance: Tolerance | None
    deadline: float | None
    bar: Progress
    cells: list[Cell] = field(init=False)
    weights: list[float] = field(init=False)
    sizes: list[float] = field(init=False)
    number: int = field(default=0, init=False)
    predicted_optimum: float | None = field(default=None, init=False)
    heavy: list[tuple[Cell, Tensor]] = field(default_factory=list, init=False)
    unseen: dict[int, Tensor] = field(default_factory=dict, init=False)
    model: Tensor | None = field(default=None, init=False)
    _picture: Estimate | None = field(default=None, init=False)
    _spent: float = field(default=0.0, init=False)
    _latest: dict[int, Latest] = field(default_factory=dict, init=False)
    _blind: dict[int, Tensor | None] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        adaptive = self.tolerance is not None or self.deadline is not None
        size = self.estimator.cell(self.task, self.spp, adaptive)
        # a part of a picture under an endless filter takes the samples of all of it
        cut = self.tolerance is not None and math.isfinite(max(self.task.filter.radius))
        self._side = _BLOCK if cut else max(size)
        self._areas: list[tuple[Cell, int]] = []
        self.cells = []
        for area in self.task.screen.cells(*size):
            blocks = area.blocks(self._side)
            self._areas.append((area, len(blocks)))
            self.cells += blocks
        self.weights, self.sizes, self._kept = ([0.0] * len(self.cells) for _ in range(3))
        self._counts = [0] * len(self.cells)
        chosen = self.estimator
        self.allocated = isinstance(chosen, Pixelwise) and not isinstance(chosen.allocation, Uniform)
        self.single = not adaptive and (not self.allocated or self._known is not None)
        self.pilot = self.spp
        if not self.single:
            self.pilot = max(chosen.fewest, min(self.spp, max(_PILOT, chosen.again)) if adaptive else self.spp // _PILOT_SHARE)
            if self.allocated and self.spp < self.pilot + self._floor:
                raise McaaError(
                    f"{chosen} has a pilot of {self.pilot} evaluations a pixel and then at least {self._floor}, got spp = {self.spp}; "
                    f"raise spp to {self.pilot + self._floor} or more, or take allocation=Uniform()"
                )

    def _parts(self, asked: dict[int, int]) -> Iterator[tuple[Cell, list[int]]]:
        """Rectangles of the cells that ask for one number of evaluations, inside the estimator's own cells, and the cells in each."""
        first = 0
        for area, count in self._areas:
            labels = [asked.get(index, 0) for index in range(first, first + count)]
            for part, inside in area.rectangles(self._side, labels):
                if labels[inside[0]]:
                    yield part, [first + index for index in inside]
            first += count

    def run(self) -> Stopped:
        """Rounds until the tolerance is met, or the evaluations or the time are spent.

        Each round asks for a number of evaluations in each pixel of the cells that are not done: under a tolerance for what each cell is
        expected to need, else for all that are left; or it shares out as many by the estimator's allocation.
        """
        pixels = self.task.screen.height * self.task.screen.width
        asked = dict.fromkeys(range(len(self.cells)), self.pilot)
        while True:
            began, before = time.perf_counter(), self.task.integrand.evaluations
            rounds: dict[int, Round] = {}
            parts, done = list(self._parts(asked)), 0
            spare = self.spp * pixels - self._spent - sum(each * self._pixels(index) for index, each in asked.items())
            spare = max(0, int(spare / sum(map(self._pixels, asked))))
            for part, inside in parts:
                each = asked[inside[0]]
                if each not in rounds:
                    alike = [other for other, within in parts if asked[within[0]] == each]
                    rounds[each] = self._round(each, alike, each + spare)
                if self.deadline is not None and time.perf_counter() > self.deadline:
                    return "seconds"
                found = rounds[each].estimate(part)
                for index in inside:
                    self._add(index, part_of(found, part, self.cells[index]), rounds[each].per_pixel)
                done += len(inside)
                self.bar.update(min(1.0, (self._spent / pixels) / self.spp) if self.number else done / len(asked))
            self.number += 1
            if self.single:
                return "spp"
            active = [index for index in asked if self.tolerance is None or not self._met(index)]
            if not active:
                return "tolerance"
            wanted = {index: self._needed(index) for index in active} if self.tolerance is not None else None
            asked = self._affordable(active, wanted, self.spp * pixels - self._spent)
            if not asked:
                return "spp"
            if self.deadline is not None:
                now = time.perf_counter()
                rate = (now - began) / max(1, self.task.integrand.evaluations - before)
                # where the time does not last for a round of all cells, it is for some of them: the loop above watches the clock
                asked = self._affordable(list(asked), asked, (self.deadline - now) / rate) or dict.fromkeys(asked, self._least)
                if now > self.deadline:
                    return "seconds"

    def _affordable(self, active: Sequence[int], wanted: dict[int, int] | None, left: float) -> dict[int, int]:
        """What each cell may ask for if the `left` evaluations are shared in proportion to what is wanted; those that get too few go."""
        least = self._least
        pixels = {index: self._pixels(index) for index in active}
        if wanted is None:
            wanted = dict.fromkeys(active, int(left // sum(pixels.values())))
        total = sum(wanted[index] * pixels[index] for index in active)
        share = min(1.0, left / max(1, total))
        return {index: int(wanted[index] * share) for index in active if int(wanted[index] * share) >= least}

    def _pixels(self, index: int) -> int:
        return self.cells[index].height * self.cells[index].width

    def _needed(self, index: int) -> int:
        """What a cell is expected to need more, on a grid of numbers, so that neighbours ask alike.

        Shared points come to a variance of n^-1.5 with all that a cell has had. Jumps are located anew each time, on lines that a corner's
        variance falls with the fourth power of.
        """
        assert self.tolerance is not None and self._picture is not None
        had = self.sizes[index]
        excess = self._excess(index)
        if self._located(index):
            # of the next one all that is asked is what two rounds have to show
            excess *= (_FEW_SHIFTS[1] / _FEW_SHIFTS[self._counts[index] > 1]) ** 2
            more = had * min(_GROWTH_LOCATED, _SURE * excess**0.25)
        else:
            more = had * min(_GROWTH, _SURE * excess ** (2 / 3) - 1)
        step = math.ceil(_STEPS * math.log2(max(1.0, more / self.estimator.again)))
        # one more than the first round had: another lattice
        return math.ceil(self.estimator.again * 2 ** (step / _STEPS)) + 1

    def _round(self, asked: int, active: Sequence[Cell], most: int) -> Round:
        """The next round of some parts of the screen, of at most `asked` evaluations a pixel and with all its points under the cap.

        Under a tolerance an estimator may take up to `most` where it pays.
        """
        left = int(self.spp * self.task.screen.height * self.task.screen.width - self._spent)
        if self.allocated and (self.number or self._known is not None):
            assert isinstance(self.estimator, Pixelwise)
            inside = torch.zeros(self.task.screen.height, self.task.screen.width, dtype=torch.bool, device=self.task.device)
            for cell in active:
                inside[cell.window] = True
            pixels = int(inside.sum())
            total = left if left < (asked + 1) * pixels else asked * pixels
            counts, self.predicted_optimum = shared_out(self.estimator.allocation, self._picture, inside, total, self._floor)
            return PixelwiseRound(self.estimator, self.task, total / pixels, self.number, counts)
        while True:
            if self.tolerance is None or most < asked:
                current = self.estimator.round(self.task, asked, self.number)
            else:
                current = self.estimator.round_within(self.task, asked, self.number, most)
            # a cut pattern can hold more than its share
            if asked == self.estimator.fewest or sum(current.points(cell) for cell in active) <= left:
                return current
            asked -= 1

    @property
    def _least(self) -> int:
        """The fewest evaluations a pixel of a later round."""
        return self._floor if self.allocated else self.estimator.again

    @property
    def _floor(self) -> int:
        """The fewest that an allocation gives a pixel: one evaluation alone has no variance."""
        return max(2, self.estimator.fewest)

    @property
    def _known(self) -> Tensor | None:
        return getattr(self.estimator.allocation, "known", None) if isinstance(self.estimator, Pixelwise) else None

    def _add(self, index: int, new: Estimate, points: float) -> None:
        """Merge a round into the picture, by default with weights fixed by the rounds' sizes alone, so that no value chooses its weight.

        n^1.5 is the inverse variance of a shared pattern on edges. An estimator that chooses its model is weighed with the inverse of the
        cell's mean variance, which may fall by orders of magnitude once jumps are located, or a lattice is fine enough for a smooth f;
        one weight for so many pixels depends on none of them.
        """
        cell = self.cells[index]
        if self._picture is None:
            self._picture = blank(self.task, len(new.value), new.diagnostics is not None)
        window = (slice(None), *cell.window)
        if new.model is not None:
            points = float(new.points.to(torch.float64).mean())
        replicated = new.diagnostics is None and new.value[0].numel() >= MANY and self.tolerance is not None
        latest = self._latest.get(index)
        if latest is not None and latest.outgrows(new.value, self._picture.value[window]):
            self._picture.value[window], self._picture.variance[window] = latest.found.value, latest.found.variance
            self.weights[index], self._kept[index] = latest.weight, latest.points
            self._blind[index] = latest.found.blind
            if latest.found.unseen is not None:
                self.unseen[index] = latest.found.unseen
        old, had = self.weights[index], self._kept[index]
        weight = points**1.5
        if new.model is not None and new.value[0].numel() >= MANY:
            told = new.variance[new.variance.isfinite()].to(torch.float64)
            weight = 1 / max(1e-300, float(told.mean())) if len(told) else 1e-300
            if had and new.blind is None and not self._located(index):
                # a finer lattice that sees more than those before it has met what they missed
                weight = max(weight, old * (points / had) ** 1.5)
        combine = self.estimator.combine if isinstance(self.estimator, Pixelwise) else "fixed"
        share: float | Tensor | None = weight / (old + weight)
        if old == 0 or combine == "discard_pilot":
            share = None
        elif combine == "pooled":
            share = new.points / (new.points + self._picture.points[cell.window])
        difference = new.value - self._picture.value[window]
        add(self._picture, cell, new, share, self.task.integrand.nonfinite == "propagate")
        if new.heavy is not None:
            self.heavy.append((cell, new.heavy))
        if new.unseen is not None:
            before = self.unseen.get(index)
            if before is not None and isinstance(share, float):
                self.unseen[index] = before * (1 - share) ** 2 + new.unseen * share**2
            else:
                self.unseen[index] = new.unseen
        if share is not None and replicated:
            floor = self.unseen.get(index, 0.0)
            doubted = not self._located(index) and (new.model is None or not self.estimator.locates(new.model))
            parts = [
                blind * part**2 for blind, part in ((self._blind.get(index), 1 - share), (new.blind, share)) if blind is not None
            ]
            self._blind[index] = sum(parts[1:], parts[0]) if parts else None
            reported = (self._picture.variance[window] - floor).clamp_min(0)
            self._picture.variance[window] = (
                agreed(difference, reported, points**1.5 / (had**1.5 + points**1.5), self._blind[index], doubted) + floor
            )
        if new.model is not None:
            if self.model is None:
                self.model = torch.zeros_like(self._picture.points, dtype=torch.uint8)
            self.model[cell.window] = new.model
        self.weights[index] = old + weight
        if share is not None and replicated and new.model is not None:
            told = self._picture.variance[window]
            self.weights[index] = min(old + weight, 1 / max(1e-300, float(told[told.isfinite()].mean(dtype=torch.float64))))
        self.sizes[index] += points
        self._kept[index] += points
        self._counts[index] += 1
        if replicated:
            if share is None:
                self._blind[index] = new.blind
            self._latest[index] = Latest(new, points, weight)
        self._spent += float(new.points.sum(dtype=torch.int64))

    def _met(self, index: int) -> bool:
        return self._excess(index) <= 1

    def _excess(self, index: int) -> float:
        """A cell's largest variance in parts of what is allowed, where it is told by two shifts at a few pixels with Student's quantile."""
        assert self.tolerance is not None
        excess = self.tolerance.excess(*self._seen(index))
        return _FEW_SHIFTS[self._counts[index] > 1] ** 2 * excess if self._located(index) else excess

    def _located(self, index: int) -> bool:
        return self.model is not None and self.estimator.locates(self.model[self.cells[index].window])

    def _seen(self, index: int) -> tuple[Tensor, Tensor]:
        """A cell's values, and their variances without the floor for the unseen, which no number of samples would end."""
        assert self._picture is not None
        window = (slice(None), *self.cells[index].window)
        value, variance = self._picture.value[window], self._picture.variance[window]
        # of few pixels the floor is all that is known
        return value, (variance - self.unseen.get(index, 0.0)).clamp_min(0) if value[0].numel() >= MANY else variance

    def picture(self) -> Estimate:
        """The picture so far; all NaN, in one channel, if not even one cell was done."""
        return self._picture or blank(self.task, max(1, self.task.integrand.channels), False)
