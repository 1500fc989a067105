"""What one cell of a picture has had, and how another round is merged into it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from torch_mcaa.estimators import Estimate
from torch_mcaa.estimators.base import MANY
from torch_mcaa.grid import Cell
from torch_mcaa.picture import add
from torch_mcaa.replicates import Latest, agreed


@dataclass
class History:
    """The state of one cell between rounds.

    Attributes:
        weight: of the value that the picture has there.
        points: the evaluations a pixel so far, `kept` those that the value still rests on.
        rounds: how many there were.
        located: whether the last one located jumps, `jumps` whether any did. calm: whether it found none to be located.
        alone: whether it was the first, where f has detail that one lattice alone does not judge.
        unseen, blind: as in `Estimate`, of the value that the picture has.
        latest: the last round, if rounds are compared with each other.
    """

    cell: Cell
    weight: float = 0.0
    points: float = 0.0
    kept: float = 0.0
    rounds: int = 0
    located: bool = False
    jumps: bool = False
    calm: bool = False
    alone: bool = False
    unseen: Tensor | None = None
    blind: Tensor | None = None
    latest: Latest | None = None

    def merge(
        self,
        picture: Estimate,
        new: Estimate,
        points: float,
        *,
        combine: str,
        propagate: bool,
        compared: bool,
        located: bool,
        calm: bool,
        detailed: bool,
    ) -> None:
        """Merge a round of `points` evaluations a pixel into the picture, by default with weights fixed by the rounds' sizes alone.

        combine: of `Pixelwise`. propagate: whether NaN is to stay. compared: whether rounds tell each other's variance. located: whether the
        round located jumps.
        """
        window = (slice(None), *self.cell.window)
        if new.model is not None:
            points = float(new.points.to(torch.float64).mean())
        compared = compared and new.diagnostics is None and new.value[0].numel() >= MANY
        if self.latest is not None and self.latest.outgrows(new.value, picture.value[window]):
            self._begin_with(self.latest, picture)
        weight = self._weight_of(new, points)
        share: float | Tensor | None = None
        if self.weight and combine == "fixed":
            share = weight / (self.weight + weight)
        elif self.weight and combine == "pooled":
            share = new.points / (new.points + picture.points[self.cell.window])
        difference = new.value - picture.value[window] if compared else None
        add(picture, self.cell, new, share, propagate)
        if new.unseen is not None:
            self.unseen = _mixed(self.unseen, new.unseen, share) if isinstance(share, float) else new.unseen
        self.weight += weight
        if difference is not None and isinstance(share, float):
            self.blind = _mixed(self.blind, new.blind, share)
            floor = 0.0 if self.unseen is None else self.unseen
            reported = (picture.variance[window] - floor).clamp_min(0)
            by_size = points**1.5 / (self.kept**1.5 + points**1.5)
            told = agreed(difference, reported, by_size, self.blind, not (self.located or located)) + floor
            picture.variance[window] = told
            if new.model is not None:
                self.weight = min(self.weight, _inverse_mean(told))
        elif compared:
            self.blind = new.blind
        self.points += points
        self.kept += points
        self.rounds += 1
        self.located, self.calm = located, calm
        self.jumps |= located
        self.alone = detailed and self.rounds == 1
        if compared:
            self.latest = Latest(new, points, weight)

    def _weight_of(self, new: Estimate, points: float) -> float:
        """n^1.5 is the inverse variance of a shared pattern on edges. An estimator that chooses its model is weighed with the inverse of the
        cell's mean variance, which may fall by orders of magnitude once jumps are located, or a lattice is fine enough for a smooth f;
        one weight for so many pixels depends on none of them.
        """
        if new.model is None or new.value[0].numel() < MANY:
            return points**1.5
        weight = _inverse_mean(new.variance)
        if self.kept and new.blind is None and not self.located:
            # a finer lattice that sees more than those before it has met what they missed
            weight = max(weight, self.weight * (points / self.kept) ** 1.5)
        return weight

    def _begin_with(self, latest: Latest, picture: Estimate) -> None:
        """Drop all rounds before the latest."""
        window = (slice(None), *self.cell.window)
        picture.value[window], picture.variance[window] = latest.found.value, latest.found.variance
        self.weight, self.kept, self.blind = latest.weight, latest.points, latest.found.blind
        if latest.found.unseen is not None:
            self.unseen = latest.found.unseen


def _mixed(old: Tensor | None, new: Tensor | None, share: float) -> Tensor | None:
    """The variance of a mean in which the new one has the weight `share`; None counts nothing."""
    if old is None or new is None:
        if old is not None:
            return old * (1 - share) ** 2
        return None if new is None else new * share**2
    return old * (1 - share) ** 2 + new * share**2


def _inverse_mean(variance: Tensor) -> float:
    """One over the mean of the variances that are finite; next to nothing if none is."""
    mean = float(variance.mean(dtype=torch.float64))
    if not math.isfinite(mean):
        told = variance[variance.isfinite()]
        mean = float(told.mean(dtype=torch.float64)) if len(told) else math.inf
    return 1 / max(1e-300, min(mean, 1e300))
