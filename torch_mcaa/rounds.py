"""The one loop over rounds and cells."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor

from torch_mcaa.allocation import Uniform
from torch_mcaa.errors import McaaError
from torch_mcaa.estimators import Estimate, Estimator, Pixelwise, PixelwiseRound, Round, Task
from torch_mcaa.grid import Cell
from torch_mcaa.picture import add, blank
from torch_mcaa.progress import Progress
from torch_mcaa.rendering import Stopped
from torch_mcaa.sharing_out import shared_out
from torch_mcaa.tolerance import Tolerance

_PILOT = 4
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
    cells: Sequence[Cell] = field(init=False)
    weights: list[float] = field(init=False)
    number: int = field(default=0, init=False)
    predicted_optimum: float | None = field(default=None, init=False)
    heavy: list[tuple[Cell, Tensor]] = field(default_factory=list, init=False)
    _picture: Estimate | None = field(default=None, init=False)
    _spent: float = field(default=0.0, init=False)

    def __post_init__(self) -> None:
        adaptive = self.tolerance is not None or self.deadline is not None
        self.cells = list(self.task.screen.cells(*self.estimator.cell(self.task, adaptive)))
        self.weights = [0.0] * len(self.cells)
        chosen = self.estimator
        self.allocated = isinstance(chosen, Pixelwise) and not isinstance(chosen.allocation, Uniform)
        self.single = not adaptive and (not self.allocated or self._known is not None)
        self.pilot = self.spp
        if not self.single:
            self.pilot = max(chosen.fewest, min(self.spp, _PILOT) if adaptive else self.spp // _PILOT_SHARE)
            if self.allocated and self.spp < self.pilot + self._floor:
                raise McaaError(
                    f"{chosen} has a pilot of {self.pilot} evaluations a pixel and then at least {self._floor}, got spp = {self.spp}; "
                    f"raise spp to {self.pilot + self._floor} or more, or take allocation=Uniform()"
                )

    def run(self) -> Stopped:
        """Rounds until the tolerance is met, or the evaluations or the time are spent.

        Each round asks for a fixed number of evaluations in each pixel of the cells that are not done, or shares out as many by the
        estimator's allocation: twice what the round before asked for, while the cap and the time allow it.
        """
        active = list(range(len(self.cells)))
        pixels = self.task.screen.height * self.task.screen.width
        asked = self.pilot
        while True:
            began, before = time.perf_counter(), self.task.integrand.evaluations
            current = self._round(asked, active)
            for done, index in enumerate(active):
                if self.deadline is not None and time.perf_counter() > self.deadline:
                    return "seconds"
                self._add(index, current.estimate(self.cells[index]), current.per_pixel)
                self.bar.update(min(1.0, (self._spent / pixels) / self.spp) if self.number else (done + 1) / len(active))
            self.number += 1
            if self.single:
                return "spp"
            if self.tolerance is not None:
                active = [index for index in active if not self._met(index)]
                if not active:
                    return "tolerance"
            left = self.spp * pixels - self._spent
            room = int(left // sum(self.cells[index].height * self.cells[index].width for index in active))
            asked = room if self.tolerance is None else min(room, 2 * asked)
            fewest = self._floor if self.allocated else self.estimator.fewest
            if asked < fewest:
                return "spp"
            if self.deadline is not None:
                now = time.perf_counter()
                rate = (now - began) / max(1, self.task.integrand.evaluations - before)
                reach = sum(self.cells[index].height * self.cells[index].width for index in active) * rate
                asked = int(min(asked, (self.deadline - now) / reach))
                if asked < fewest:
                    return "seconds"

    def _round(self, asked: int, active: Sequence[int]) -> Round:
        """The next round, of at most `asked` evaluations a pixel and with all its points under the cap."""
        left = int(self.spp * self.task.screen.height * self.task.screen.width - self._spent)
        if self.allocated and (self.number or self._known is not None):
            assert isinstance(self.estimator, Pixelwise)
            inside = torch.zeros(self.task.screen.height, self.task.screen.width, dtype=torch.bool, device=self.task.device)
            for index in active:
                inside[self.cells[index].window] = True
            pixels = int(inside.sum())
            total = left if left < (asked + 1) * pixels else asked * pixels
            counts, self.predicted_optimum = shared_out(self.estimator.allocation, self._picture, inside, total, self._floor)
            return PixelwiseRound(self.estimator, self.task, total / pixels, self.number, counts)
        while True:
            current = self.estimator.round(self.task, asked, self.number)
            # a cut pattern can hold more than its share
            if asked == self.estimator.fewest or sum(current.points(self.cells[index]) for index in active) <= left:
                return current
            asked -= 1

    @property
    def _floor(self) -> int:
        """The fewest that an allocation gives a pixel: one evaluation alone has no variance."""
        return max(2, self.estimator.fewest)

    @property
    def _known(self) -> Tensor | None:
        return getattr(self.estimator.allocation, "known", None) if isinstance(self.estimator, Pixelwise) else None

    def _add(self, index: int, new: Estimate, points: float) -> None:
        """Merge a round into the picture, by default with weights fixed by the rounds' sizes alone, so that no value chooses its weight.

        n^1.5 is the inverse variance of a shared pattern on edges.
        """
        cell = self.cells[index]
        if self._picture is None:
            self._picture = blank(self.task, len(new.value), new.diagnostics is not None)
        old, weight = self.weights[index], points**1.5
        combine = self.estimator.combine if isinstance(self.estimator, Pixelwise) else "fixed"
        share: float | Tensor | None = weight / (old + weight)
        if old == 0 or combine == "discard_pilot":
            share = None
        elif combine == "pooled":
            share = new.points / (new.points + self._picture.points[cell.window])
        add(self._picture, cell, new, share, self.task.integrand.nonfinite == "propagate")
        if new.heavy is not None:
            self.heavy.append((cell, new.heavy))
        self.weights[index] = old + weight
        self._spent += float(new.points.sum(dtype=torch.int64))

    def _met(self, index: int) -> bool:
        assert self.tolerance is not None
        assert self._picture is not None
        window = (slice(None), *self.cells[index].window)
        return self.tolerance.met(self._picture.value[window], self._picture.variance[window])

    def picture(self) -> Estimate:
        """The picture so far; all NaN, in one channel, if not even one cell was done."""
        return self._picture or blank(self.task, max(1, self.task.integrand.channels), False)
