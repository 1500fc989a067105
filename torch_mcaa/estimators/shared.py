"""`Shared`: one evaluation of f serves every pixel whose filter covers it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from torch_mcaa.errors import McaaError
from torch_mcaa.estimators.base import Estimator, Round, Task
from torch_mcaa.estimators.lattice.fused import Fused
from torch_mcaa.estimators.lattice.shared_lattice import LatticeRound, ReplicatedRound
from torch_mcaa.estimators.lattice.shared_points import SharedPointsRound
from torch_mcaa.estimators.narrow import check_held
from torch_mcaa.integrand import width_of
from torch_mcaa.patterns import Lattice, Pattern

_SAMPLES, _SIDE, _VECTOR = 2**21, 512, 16
"""A compiled cell has at most about so many samples, to stay in the cache, and one of eager blocks, which stay there, twice as many; either is
at most so many pixels wide and tall, and a multiple of the last wide."""


@dataclass(frozen=True)
class Shared(Estimator):
    """Points spread over the whole screen, each weighed with w for every pixel it serves.

    With a `Lattice` the weights are the same for all pixels and the estimate is a convolution. Its standard error comes from the sums over
    the cosets of the lattice's double, pooled over 3 x 3 pixels, and from one point in each strip off the lattice, which sees noise and
    tones on the dual vectors. Other patterns report their own standard error for the points of each source pixel. A filter narrower than a pixel that
    on average holds fewer than 2 points is refused.

    Attributes:
        pattern: where the points of a pixel lie.
        replicates: with R >= 2 and a `Lattice`, R lattices of spp / R points with different generators and independent shifts, and the
            standard error between them: independent of any model of f, for a larger error.
    """

    pattern: Pattern = field(default_factory=Lattice)
    replicates: int = 1

    def __post_init__(self) -> None:
        if isinstance(self.replicates, bool) or not isinstance(self.replicates, int) or self.replicates < 1:
            raise McaaError(f"replicates must be an integer of at least 1, got {self.replicates!r}")
        if self.replicates > 1 and not isinstance(self.pattern, Lattice):
            raise McaaError(
                f"replicates are for a Lattice, whose points depend on one another; {self.pattern} with replicates={self.replicates} is not needed"
            )

    @property
    def fewest(self) -> int:
        return self.replicates

    def check(self, task: Task) -> None:
        if math.isinf(max(task.filter.radius)) and not isinstance(self.pattern, Lattice):
            raise McaaError(
                f"{task.filter} reaches over the whole screen, which only Shared(Lattice()) can afford; got {self.pattern}"
            )

    def bias(self, task: Task, spp: int) -> tuple[str, ...]:
        return ("the weights of shared points are divided by their sum, a ratio: the bias is small beside the standard error",)

    def cell(self, task: Task, spp: int, adaptive: bool) -> tuple[int, int]:
        if math.isinf(max(task.filter.radius)):
            return task.screen.height, task.screen.width
        scale = math.isqrt(width_of(task.device))
        if adaptive or not isinstance(self.pattern, Lattice):
            side = scale * (32 if adaptive and not isinstance(self.pattern, Lattice) else 64)
            return side, side
        # whole strips, and parts of the screen that are about as large: one graph serves them all
        side = min(_SIDE * scale, int(scale * math.sqrt((2 - task.compiled) * _SAMPLES / spp)))
        return _part(task.screen.height, side, self.pattern.period(spp // self.replicates)), _part(task.screen.width, side, _VECTOR)

    def unfused(self, task: Task) -> str | None:
        if not isinstance(self.pattern, Lattice) or self.replicates > 1:
            return super().unfused(task)
        return Fused.unfit(task)

    def round(self, task: Task, spp: int, number: int) -> Round:
        check_held(task, spp // self.replicates, repr(self))
        if not isinstance(self.pattern, Lattice):
            return SharedPointsRound(task, self.pattern, self.pattern.count(spp), number)
        if self.replicates == 1:
            return LatticeRound(task, spp, number)
        return ReplicatedRound(task, spp, number, self.replicates)


def _part(whole: int, most: int, unit: int) -> int:
    """The largest of about equal parts of a side, of at most about `most` pixels, in whole units."""
    return -(-whole // (-(-whole // most) * unit)) * unit
