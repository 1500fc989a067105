"""The methods of a chart: every estimator, and what one would use instead."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torch_mcaa.charting.subject import Subject
from torch_mcaa.estimators import (
    AdaptiveImportance,
    Auto,
    ControlVariate,
    Crude,
    Estimator,
    Importance,
    JumpCorrected,
    OrderedStrata,
    Shared,
    Stratified,
)
from torch_mcaa.patterns import Independent, Sobol
from torch_mcaa.render import render

ESTIMATORS: dict[str, Estimator] = {
    "Auto()": Auto(),
    "JumpCorrected()": JumpCorrected(),
    "Shared(Lattice())": Shared(),
    "Shared(Sobol())": Shared(Sobol()),
    "Importance(Sobol())": Importance(),
    "Importance(Independent())": Importance(Independent()),
    "Stratified()": Stratified(),
    "AdaptiveImportance()": AdaptiveImportance(),
    "ControlVariate()": ControlVariate(),
    "OrderedStrata()": OrderedStrata(),
    "Crude(biased_ok=True)": Crude(biased_ok=True),
}
"""All but `Pairs`, which is whatever pairs of functions it is given."""


@dataclass(frozen=True)
class Shot:
    """What one run of a method gives.

    Attributes:
        image: (C, H, W).
        stderr: (C, H, W) reported standard error, or None where the method has none.
        unseen: (C, H, W) the part of it that stands for what no sample met, or None.
        spp: (H, W) evaluations in each pixel.
        evaluations: points f was asked for in all.
    """

    image: Tensor
    stderr: Tensor | None
    unseen: Tensor | None
    spp: Tensor
    evaluations: int


class Method(ABC):
    """A way to a picture: a name, and a run with a budget of evaluations a pixel."""

    name: str

    @abstractmethod
    def spent(self, budget: int) -> int | None:
        """What of the budget is used, None where it is too small; budgets of which equal parts are used need one run."""

    @abstractmethod
    def run(self, subject: Subject, budget: int, seed: int) -> Shot:
        """Make the picture.

        Raises:
            McaaError: what the method cannot do; an f that breaks its contract.
            KeyboardInterrupt: Ctrl-C.
        """


@dataclass(frozen=True)
class Estimated(Method):
    """An estimator of this package."""

    name: str
    estimator: Estimator

    def spent(self, budget: int) -> int | None:
        return budget if budget >= self.estimator.fewest else None

    def run(self, subject: Subject, budget: int, seed: int) -> Shot:
        picture = render(
            subject.f,
            subject.size,
            filter=subject.filter,
            extent=subject.extent,
            estimator=self.estimator,
            spp=budget,
            seed=seed,
            progress=False,
        )
        if picture.stopped == "interrupted":
            raise KeyboardInterrupt
        return Shot(picture.image, picture.stderr, picture.unseen, picture.spp, picture.evaluations)


def plan(methods: Sequence[Method], budgets: Sequence[int]) -> dict[str, list[int]]:
    """The budgets at which each method is run, by its name."""
    chosen: dict[str, list[int]] = {}
    for method in methods:
        used: dict[int, int] = {}
        for budget in budgets:
            spent = method.spent(budget)
            if spent is not None:
                used.setdefault(spent, budget)
        chosen[method.name] = sorted(used.values())
    return chosen


def estimated(estimators: Mapping[str, Estimator] | None) -> list[Method]:
    return [Estimated(name, estimator) for name, estimator in (ESTIMATORS if estimators is None else estimators).items()]


def side(budget: int) -> int | None:
    """k of the largest k x k grid within the budget; None for less than 2 x 2, which is no supersampling."""
    k = math.isqrt(budget)
    return k if k >= 2 else None


def asked(subject: Subject, cols: Tensor, rows: Tensor) -> tuple[Tensor, int]:
    """(C, rows, cols) float32 values of f on a grid of float64 screen places, and how many there are."""
    task = subject.task()
    x, y = task.screen.x_of(cols).float(), task.screen.y_of(rows).float()
    with torch.no_grad():
        values = torch.stack(task.integrand(x.expand(len(y), -1), y[:, None]))
    return values, task.integrand.evaluations
