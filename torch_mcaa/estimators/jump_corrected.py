"""`JumpCorrected`: a shared lattice plus what it misses at jumps, which are located rather than sampled."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from torch import Tensor

from torch_mcaa.errors import McaaError
from torch_mcaa.estimators.base import Estimator, Round, Task
from torch_mcaa.estimators.narrow import LEAST, check_held, held
from torch_mcaa.estimators.parts import MODELS, cell_of, lines_for, located
from torch_mcaa.estimators.piloted import PilotedRound
from torch_mcaa.estimators.shared import Shared
from torch_mcaa.patterns import Lattice

_FEWEST = 6


@dataclass(frozen=True)
class JumpCorrected(Estimator):
    """Line sampling as a correction of a shared lattice: where f jumps, what the lattice misses is known to a part in 10^6.

    The n points of a lattice are that many horizontal lines in a pixel, and vertical ones, with samples 1 px apart. Two neighbours on a line
    that differ by more than three times their neighbourhood may have a jump between them; bisection locates it, and each pixel is given
    what the samples miss of the integral beyond it: linear in f, and 0 where nothing jumps. Along the axis that the pixel's edges cross. A
    second lattice, of another shift, where there are jumps gives the standard error; where they disagree two finer ones do. Pieces
    thinner than the samples' distance are followed from line to line. It is the ordering of section 10 of Halton's paper and the correlated
    sampling of its section 9 in one, with a psi that is a sum of steps.

    Where a look at some candidates finds f continuous, or noise, or the evaluations do not suffice, the lattice is pooled with another that
    has the rest, as in `Shared(Lattice())`. Not labelled unbiased: where to look is decided by the samples.

    For filters that separate and end. Under those that end in a step and are whole pixels wide, as the box is, the lines lie alike about
    every pixel's sides, so that their mean errs by the order of n^-2, which a second lattice of more lines tells; under those of other
    widths edges across the lines keep an error of 0.3 / n: whether a line lies just inside or outside is not corrected. Few pixels, under
    256, are sampled plainly.

    Attributes:
        base: the pattern whose samples lie on lines along both axes: a rank-1 lattice.
    """

    base: Lattice = field(default_factory=Lattice)

    def __post_init__(self) -> None:
        if not isinstance(self.base, Lattice):
            raise McaaError(f"base must be a Lattice, whose points lie on lines along both axes, got {self.base!r}; pass Lattice()")

    @property
    def fewest(self) -> int:
        return _FEWEST

    @property
    def models(self) -> tuple[str, ...]:
        return MODELS

    def locates(self, model: Tensor) -> bool:
        return bool(located(model).any())

    def check(self, task: Task) -> None:
        if math.isinf(max(task.filter.radius)):
            raise McaaError(f"JumpCorrected needs a filter of finite width, got {task.filter}; use Shared()")

    def glance(self, task: Task) -> Estimator | None:
        return Shared() if held(task, 1) >= LEAST else None

    def bias(self, task: Task, spp: int) -> tuple[str, ...]:
        return ("JumpCorrected: the samples themselves decide where jumps are looked for",)

    def cell(self, task: Task, spp: int, adaptive: bool) -> tuple[int, int]:
        return cell_of(task, spp, adaptive)

    def round(self, task: Task, spp: int, number: int) -> Round:
        check_held(task, lines_for(spp), repr(self))
        return PilotedRound(task, spp, number, plain=False)
