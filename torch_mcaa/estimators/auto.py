"""`Auto`: what to use when one does not want to choose."""

from __future__ import annotations

import math
from dataclasses import dataclass

from torch import Tensor

from torch_mcaa.estimators.base import Estimator, Round, Task
from torch_mcaa.estimators.located.sides import ends_in_step, sides
from torch_mcaa.estimators.narrow import LEAST, WORTH, DrawnRound, held
from torch_mcaa.estimators.paper.importance import Importance
from torch_mcaa.estimators.parts import CROWDED, DRAWN, EXACT, MODELS, SAMPLED, cell_of, located
from torch_mcaa.estimators.piloted import PilotedRound
from torch_mcaa.estimators.shared import Shared
from torch_mcaa.estimators.texels import SIDE, Texels, TexelsRound, axes_of
from torch_mcaa.filters import SeparableFilter
from torch_mcaa.tolerance import Tolerance

_FEWEST = 5
"""Evaluations a pixel for a pilot and a lattice of 3 with room to locate its jumps; with fewer there is no pilot."""
_AGAIN = 6
"""The least of a round that is merged with others: a plain one would spoil jumps that have been located."""


@dataclass(frozen=True)
class Auto(Estimator):
    """The default. One sample a pixel tells what each block of 32 x 32 pixels needs.

    Where f is flat, smooth or jumps: a lattice corrected for its jumps, as in `JumpCorrected`, of as many lines as can be paid for.
    Where it is noise, has detail everywhere, or jumps more often than can be followed: a shared lattice with all evaluations that are
    left, which suits the directions of the edges that the pilot saw. `Rendering.model` says which. Filters that do not end, or end in a
    step and are not products that are whole pixels wide, pictures of under 256 pixels, and fewer than 5 evaluations a pixel, are
    `Shared(Lattice())` throughout. Of
    filters narrower than a pixel those that end in a step, or hold too few points of a lattice, have points of their own: `Importance()`.

    A `Texture` whose rows and columns are the screen's is not sampled at all: its picture is a sum over texels, exact but for rounding, under
    every filter that separates and ends.

    Not labelled unbiased otherwise: what is done is decided by the samples.
    """

    @property
    def fewest(self) -> int:
        return 1

    @property
    def again(self) -> int:
        return _AGAIN

    @property
    def models(self) -> tuple[str, ...]:
        return MODELS

    def locates(self, model: Tensor) -> bool:
        return bool(located(model).any())

    def calm(self, model: Tensor) -> bool:
        return not self.locates(model) and not bool((model == CROWDED).any())

    def detailed(self, model: Tensor) -> bool:
        return bool(((model == SAMPLED) | (model == CROWDED)).any())

    def check(self, task: Task) -> None:
        Shared().check(task)

    def glance(self, task: Task) -> Estimator | None:
        return Shared() if _can_locate(task) and task.once(axes_of) is None and held(task, 1) >= LEAST else None

    def bias(self, task: Task, spp: int) -> tuple[str, ...]:
        if task.once(axes_of) is not None:
            return ()
        if _drawn(task, spp):
            return Importance().bias(task, spp)
        if spp < _FEWEST or not _can_locate(task):
            return Shared().bias(task, spp)
        return ("Auto: the samples themselves decide where jumps are looked for", *Shared().bias(task, spp))

    def cell(self, task: Task, spp: int, adaptive: bool) -> tuple[int, int]:
        if task.once(axes_of) is not None:
            return SIDE, SIDE
        if _drawn(task, spp):
            return Importance().cell(task, spp, adaptive)
        if not _can_locate(task):
            return Shared().cell(task, spp, adaptive)
        return cell_of(task, spp, adaptive)

    def round(self, task: Task, spp: int, number: int) -> Round:
        if texels := Texels.of(task):
            return TexelsRound(texels, EXACT)
        if _drawn(task, spp):
            return DrawnRound(task, spp, number, DRAWN)
        if spp < _FEWEST or not _can_locate(task):
            return Shared().round(task, spp, number)
        return PilotedRound(task, spp, number)

    def round_within(self, task: Task, spp: int, number: int, most: int, wanted: Tolerance, jumps: bool | None) -> Round:
        if not _can_locate(task) or task.once(axes_of) is not None or _drawn(task, spp):
            return self.round(task, spp, number)
        return PilotedRound(task, spp, number, most=most, wanted=wanted, jumps=jumps if spp >= _FEWEST else False)


def _can_locate(task: Task) -> bool:
    """Whether the mean of the lines is good once jumps are located: where w ends in a step, lines must lie alike about its sides."""
    if math.isinf(max(task.filter.radius)):
        return False
    return not task.once(ends_in_step) or task.once(sides) is not None


def _drawn(task: Task, spp: int) -> bool:
    """Whether the filter is so narrow that points drawn from it do better than a lattice.

    Where jumps cannot be located nothing but sharing makes up for the points beside it.
    """
    if task.boundary == "renormalize" and not isinstance(task.filter, SeparableFilter):
        return False
    inside = held(task, spp)
    return inside < (LEAST if spp < _FEWEST else WORTH) if _can_locate(task) else inside < math.inf
