"""The one loop over rounds and cells."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import torch
from torch import Tensor

from torch_mcaa.allocation import Uniform
from torch_mcaa.errors import McaaError
from torch_mcaa.estimators import Estimate, Estimator, Pixelwise, PixelwiseRound, Round, Task
from torch_mcaa.estimators.base import MANY
from torch_mcaa.grid import Cell
from torch_mcaa.history import History
from torch_mcaa.picture import add, blank, check_size, part_of
from torch_mcaa.progress import Progress
from torch_mcaa.rendering import Stopped
from torch_mcaa.sharing_out import shared_out
from torch_mcaa.tolerance import FEW_SHIFTS, Tolerance

_PILOT = 4
_BLOCK = 16
"""Px: the side of what is done, under a tolerance, when it meets it."""
_GROWTH, _SURE = 1.0, 1.1
"""A round is at most so many times what a cell has had; and what is added to what it is expected to need."""
_GROWTH_LOCATED = 4.0
_LEAST_PLAIN = 3
"""The least of a round in which nothing is to be located."""
_TRUSTED = 3
"""Rounds of a cell with nothing to locate before it is looked for again."""
_STEPS = 2
"""Numbers of evaluations that a round may ask for, in each octave."""
_GLANCE, _GLANCE_SHARE = 4, 8
"""Evaluations a pixel, at most, of the first look at a picture that the time may not last for, and one part in so many of the cap."""
_TIMED = 16
"""Of the first round after it, if no tolerance asks for less: on fewer lines jumps are located little faster."""
_TIMED_CELL = 64
"""Evaluations a pixel that cells are made for where the time, and not the cap, is expected to end the work: smaller ones take longer."""
_PILOT_SHARE = 4
"""One part in so many of the evaluations is the pilot that an allocation is made from."""


class Asked(NamedTuple):
    """Evaluations a pixel, and whether there are jumps to be located; None if that is to be looked at."""

    points: int
    jumps: bool | None = None


@dataclass
class Rounds:
    """The state of a rendering between rounds: the picture so far, and what each cell has had."""

    task: Task
    estimator: Estimator
    spp: int
    tolerance: Tolerance | None
    bar: Progress
    histories: list[History] = field(init=False)
    number: int = field(default=0, init=False)
    bias: dict[str, None] = field(default_factory=dict, init=False)
    predicted_optimum: float | None = field(default=None, init=False)
    heavy: list[tuple[Cell, Tensor]] = field(default_factory=list, init=False)
    model: Tensor | None = field(default=None, init=False)
    _picture: Estimate | None = field(default=None, init=False)
    _spent: float = field(default=0.0, init=False)

    def __post_init__(self) -> None:
        check_size(self.task)
        adaptive = self.tolerance is not None or self.task.deadline is not None
        many = self.spp if self.task.deadline is None else min(self.spp, _TIMED_CELL)
        size = self.estimator.cell(self.task, many, adaptive)
        # a part of a picture under an endless filter takes the samples of all of it
        cut = self.tolerance is not None and math.isfinite(max(self.task.filter.radius))
        self._side = _BLOCK if cut else max(size)
        self._areas: list[tuple[Cell, int]] = []
        self.histories = []
        for area in self.task.screen.cells(*size):
            blocks = area.blocks(self._side)
            self._areas.append((area, len(blocks)))
            self.histories += map(History, blocks)
        chosen = self.estimator
        self.allocated = isinstance(chosen, Pixelwise) and not isinstance(chosen.allocation, Uniform)
        self.single = not adaptive and (not self.allocated or self._known is not None)
        self.pilot = self.spp
        if not self.single:
            least = max(_PILOT, chosen.again)
            if self.tolerance is None and chosen.glance(self.task) is not None:
                # what a second round would not be worth is had in the first
                least = _TIMED if self.spp >= 2 * _TIMED else self.spp
            self.pilot = max(chosen.fewest, min(self.spp, least) if adaptive else self.spp // _PILOT_SHARE)
            if self.allocated and self.spp < self.pilot + self._floor:
                raise McaaError(
                    f"{chosen} has a pilot of {self.pilot} evaluations a pixel and then at least {self._floor}, got spp = {self.spp}; "
                    f"raise spp to {self.pilot + self._floor} or more, or take allocation=Uniform()"
                )

    def _parts(self, asked: dict[int, Asked]) -> Iterator[tuple[Cell, list[int]]]:
        """Rectangles of the cells that ask for one number of evaluations, inside the estimator's own cells, and the cells in each."""
        first = 0
        for area, count in self._areas:
            labels = [asked.get(index) for index in range(first, first + count)]
            for part, inside in area.rectangles(self._side, labels):
                if labels[inside[0]] is not None:
                    yield part, [first + index for index in inside]
            first += count

    def run(self) -> Stopped:
        """Rounds until the tolerance is met, or the evaluations or the time are spent.

        Each round asks for a number of evaluations in each pixel of the cells that are not done: under a tolerance for what each cell is
        expected to need, else for all that are left; or it shares out as many by the estimator's allocation.
        """
        pixels = self.task.screen.height * self.task.screen.width
        if self.task.deadline is not None:
            self._glance()
        asked = dict.fromkeys(range(len(self.histories)), Asked(self.pilot))
        while True:
            began, before = time.perf_counter(), self.task.integrand.evaluations
            rounds: dict[Asked, Round] = {}
            parts, done = list(self._parts(asked)), 0
            spare = self.spp * pixels - self._spent - sum(each.points * self._pixels(index) for index, each in asked.items())
            spare = max(0, int(spare / sum(map(self._pixels, asked))))
            for part, inside in parts:
                each = asked[inside[0]]
                if each not in rounds:
                    alike = [other for other, within in parts if asked[within[0]] == each]
                    rounds[each] = self._round(each, alike, each.points + spare)
                if self.task.late:
                    return "seconds"
                found = rounds[each].estimate(part)
                for index in inside:
                    self._add(index, part_of(found, part, self.histories[index].cell), rounds[each].per_pixel)
                done += len(inside)
                self.bar.update(min(1.0, (self._spent / pixels) / self.spp) if self.number else done / len(asked))
            self.number += 1
            if self.single:
                return "spp"
            active = [index for index in asked if self.tolerance is None or not self._met(index)]
            if not active:
                return "tolerance"
            if self.task.integrand.evaluations == before:
                # nothing was asked of f, and another round would be the same
                return "spp"
            wanted = {index: self._needed(index) for index in active} if self.tolerance is not None else None
            asked = self._affordable(active, wanted, self.spp * pixels - self._spent)
            if not asked:
                # what the time did not last for may have been sampled in the place of being located
                return "seconds" if self.task.late else "spp"
            if self.task.deadline is not None:
                now = time.perf_counter()
                rate = (now - began) / max(1, self.task.integrand.evaluations - before)
                # where the time does not last for a round of all cells, it is for some of them: the loop above watches the clock
                asked = self._affordable(list(asked), asked, (self.task.deadline - now) / rate) or {
                    index: Asked(self._least(each.jumps), each.jumps) for index, each in asked.items()
                }
                if self.task.late:
                    return "seconds"

    def _glance(self) -> None:
        """A few evaluations in every pixel, before what takes long in each; the first round of a cell takes their place."""
        first, spp = self.estimator.glance(self.task), max(1, min(_GLANCE, self.spp // _GLANCE_SHARE))
        if first is None or self.spp < spp + self.estimator.fewest:
            return
        look = first.round(self.task, spp, 0)
        for cell in self.task.screen.cells(*first.cell(self.task, spp, True)):
            if self.task.late:
                return
            new = look.estimate(cell)
            if self._picture is None:
                self._picture = blank(self.task, len(new.value), False)
            add(self._picture, cell, new, None, False)
            self._spent += float(new.points.sum(dtype=torch.int64))

    def _affordable(self, active: Sequence[int], wanted: dict[int, Asked] | None, left: float) -> dict[int, Asked]:
        """What each cell may ask for if the `left` evaluations are shared in proportion to what is wanted; those that get too few go."""
        pixels = {index: self._pixels(index) for index in active}
        if wanted is None:
            wanted = dict.fromkeys(active, Asked(int(left // sum(pixels.values()))))
        total = sum(wanted[index].points * pixels[index] for index in active)
        share = min(1.0, left / max(1, total))
        cut = {index: Asked(int(wanted[index].points * share), wanted[index].jumps) for index in active}
        return {index: each for index, each in cut.items() if each.points >= self._least(each.jumps)}

    def _pixels(self, index: int) -> int:
        cell = self.histories[index].cell
        return cell.height * cell.width

    def _needed(self, index: int) -> Asked:
        """What a cell is expected to need more, on a grid of numbers, so that neighbours ask alike.

        Where there is nothing to be located the first round had what f's steepness asks for, and another lattice of that size has to agree.
        After that shared points come to a variance of n^-1.5 with all that a cell has had. Jumps are located anew each time, on lines that a
        corner's variance falls with the fourth power of.
        """
        assert self.tolerance is not None and self._picture is not None
        history, excess = self.histories[index], self._excess(index)
        had = history.points
        jumps = True if history.jumps else False if history.calm and history.rounds < _TRUSTED else None
        if history.located:
            # of the next one all that is asked is what two rounds have to show
            excess *= (FEW_SHIFTS[1] / FEW_SHIFTS[history.rounds > 1]) ** 2
            more = had * min(_GROWTH_LOCATED, _SURE * excess**0.25)
        elif jumps is False and history.rounds == 1:
            # less the pilot
            return Asked(max(_LEAST_PLAIN, round(had) - 1), False)
        else:
            more = had * min(_GROWTH, _SURE * excess ** (2 / 3) - 1)
        least = self._least(jumps)
        step = math.ceil(_STEPS * math.log2(max(1.0, more / least)))
        # one more than the first round had: another lattice
        return Asked(math.ceil(least * 2 ** (step / _STEPS)) + 1, jumps)

    def _round(self, wanted: Asked, active: Sequence[Cell], most: int) -> Round:
        """The next round of some parts of the screen, of at most `asked` evaluations a pixel and with all its points under the cap.

        Under a tolerance an estimator may take up to `most` where it pays.
        """
        left = int(self.spp * self.task.screen.height * self.task.screen.width - self._spent)
        asked = wanted.points
        if self.allocated and (self.number or self._known is not None):
            assert isinstance(self.estimator, Pixelwise)
            inside = torch.zeros(self.task.screen.height, self.task.screen.width, dtype=torch.bool, device=self.task.device)
            for cell in active:
                inside[cell.window] = True
            pixels = int(inside.sum())
            total = left if left < (asked + 1) * pixels else asked * pixels
            self.bias |= dict.fromkeys(self.estimator.bias(self.task, asked))
            counts, self.predicted_optimum = shared_out(self.estimator.allocation, self._picture, inside, total, self._floor)
            return PixelwiseRound(self.estimator, self.task, total / pixels, self.number, counts)
        while True:
            if self.tolerance is None or most < asked:
                current = self.estimator.round(self.task, asked, self.number)
            else:
                current = self.estimator.round_within(self.task, asked, self.number, most, self.tolerance, wanted.jumps)
            # a cut pattern can hold more than its share
            if asked == self.estimator.fewest or sum(current.points(cell) for cell in active) <= left:
                self.bias |= dict.fromkeys(self.estimator.bias(self.task, asked))
                return current
            asked -= 1

    def _least(self, jumps: bool | None) -> int:
        """The fewest evaluations a pixel of a later round."""
        return self._floor if self.allocated else _LEAST_PLAIN if jumps is False else self.estimator.again

    @property
    def _floor(self) -> int:
        """The fewest that an allocation gives a pixel: one evaluation alone has no variance."""
        return max(2, self.estimator.fewest)

    @property
    def _known(self) -> Tensor | None:
        return getattr(self.estimator.allocation, "known", None) if isinstance(self.estimator, Pixelwise) else None

    def _add(self, index: int, new: Estimate, points: float) -> None:
        """Merge a round of so many evaluations a pixel into the picture."""
        had = self.histories[index]
        if self._picture is None:
            self._picture = blank(self.task, len(new.value), new.diagnostics is not None)
        had.merge(
            self._picture,
            new,
            points,
            combine=self.estimator.combine if isinstance(self.estimator, Pixelwise) else "fixed",
            propagate=self.task.integrand.nonfinite == "propagate",
            compared=self.tolerance is not None,
            located=new.model is not None and self.estimator.locates(new.model),
            calm=new.model is not None and self.estimator.calm(new.model),
            detailed=new.model is not None and self.estimator.detailed(new.model),
        )
        if new.heavy is not None:
            self.heavy.append((had.cell, new.heavy))
        if new.model is not None:
            if self.model is None:
                self.model = torch.zeros_like(self._picture.points, dtype=torch.uint8)
            self.model[had.cell.window] = new.model
        self._spent += float(new.points.sum(dtype=torch.int64))

    def _met(self, index: int) -> bool:
        return not self.histories[index].alone and self._excess(index) <= 1

    def _excess(self, index: int) -> float:
        """A cell's largest variance in parts of what is allowed, where it is told by two shifts at a few pixels with Student's quantile."""
        assert self.tolerance is not None
        history, excess = self.histories[index], self.tolerance.excess(*self._seen(index))
        return FEW_SHIFTS[history.rounds > 1] ** 2 * excess if history.located else excess

    def _seen(self, index: int) -> tuple[Tensor, Tensor]:
        """A cell's values, and their variances without the floor for the unseen, which no number of samples would end."""
        assert self._picture is not None
        history = self.histories[index]
        window = (slice(None), *history.cell.window)
        value, variance = self._picture.value[window], self._picture.variance[window]
        if history.unseen is None or value[0].numel() < MANY:
            # of few pixels the floor is all that is known
            return value, variance
        return value, (variance - history.unseen).clamp_min(0)

    def picture(self) -> Estimate:
        """The picture so far; all NaN, in one channel, if not even one cell was done."""
        return self._picture or blank(self.task, max(1, self.task.integrand.channels), False)
