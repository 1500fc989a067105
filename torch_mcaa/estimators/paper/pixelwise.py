"""What the paper's estimators have in common: each pixel draws its own points, as many as it is given."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import MISSING, dataclass, field, fields
from typing import Literal

import torch
from torch import Tensor

from torch_mcaa.allocation import Allocation, Uniform
from torch_mcaa.errors import McaaError
from torch_mcaa.estimators.base import Diagnostics, Estimate, Estimator, Round, Task, pooled, settled, unseen
from torch_mcaa.estimators.paper.tail import without_moment
from torch_mcaa.estimators.points import evaluate_points
from torch_mcaa.filters import SeparableFilter
from torch_mcaa.grid import Cell
from torch_mcaa.integrand import BLOCK, width_of
from torch_mcaa.patterns import Pattern

Combine = Literal["discard_pilot", "fixed", "pooled"]
ROUNDS = 64
"""Inner rounds that one round may have, each with points of its own."""


@dataclass(frozen=True)
class Pixels:
    """P pixels of a cell that draw the same number of points; rows and cols are int64 (P,)."""

    task: Task
    cell: Cell
    rows: Tensor
    cols: Tensor
    number: int

    def __len__(self) -> int:
        return len(self.rows)

    def points(self, pattern: Pattern, n: int, inner: int = 0) -> tuple[Tensor, Tensor]:
        """u, v (n, P) in [0, 1), float64; another `inner` below `ROUNDS`, other points."""
        seed, round = self.task.seed, self.number * ROUNDS + inner
        u, v = pattern.points(n, self.rows[None], self.cols[None], seed=seed, round=round, dtype=torch.float64)
        return u.squeeze(1), v.squeeze(1)

    def evaluate(self, dx: Tensor, dy: Tensor) -> tuple[Tensor, Tensor | None]:
        """f at (n, P) offsets from the pixels' centres: (C, n, P) float64, and where it was finite, or None if it was everywhere."""
        values, _, bad = evaluate_points(self.task, self.cell, self.cols + (0.5 + dx), self.rows + (0.5 + dy))
        return values.to(torch.float64), None if bad is None else ~bad


@dataclass(frozen=True)
class Drawn:
    """What P pixels got from their points, float64.

    Attributes:
        value: (C, P) estimate of (1).
        variance: (C, P) its estimated variance.
        predicted: (C, P) the variance that the theory gives it: (10), (12), (17) with the second moments of the same points.
        ess: (P,) effective sample size of the weights w / w', (sum |w / w'|)^2 / sum (w / w')^2.
        pareto_k: (C, P) tail index of the terms, NaN where nothing can be said.
        invalid: (P,) how many values of f were not finite.
    """

    value: Tensor
    variance: Tensor
    predicted: Tensor
    ess: Tensor
    pareto_k: Tensor
    invalid: Tensor


def combined(rounds: Sequence[Drawn], weights: Sequence[float]) -> Drawn:
    """Rounds of the same pixels averaged with weights that no value chose; one of weight 0 counts for its `invalid` alone.

    A round without a value (all its samples were not finite) says nothing about the pixel.
    """
    used = [(weight, drawn) for weight, drawn in zip(weights, rounds, strict=True) if weight]
    shares = torch.stack([(~drawn.value.isnan()).to(torch.float64) * weight for weight, drawn in used])
    shares = shares / shares.sum(0)

    def mean(parts: list[Tensor], power: int) -> Tensor:
        return torch.where(shares > 0, torch.stack(parts) * shares**power, 0).sum(0).where(~shares[0].isnan(), torch.nan)

    tail = torch.stack([drawn.pareto_k for _, drawn in used]).nan_to_num(nan=-torch.inf).amax(0)
    return Drawn(
        mean([drawn.value for _, drawn in used], 1),
        mean([drawn.variance for _, drawn in used], 2),
        mean([drawn.predicted for _, drawn in used], 2),
        torch.stack([drawn.ess for _, drawn in used]).sum(0),
        torch.where(tail > -torch.inf, tail, torch.nan),
        torch.stack([drawn.invalid for drawn in rounds]).sum(0),
    )


@dataclass(frozen=True, repr=False)
class Pixelwise(Estimator):
    """An estimator whose pixels draw their own points, in rounds.

    Attributes:
        allocation: how the evaluations are shared out over the pixels: after a pilot of a quarter of them, even, whose variances decide
            the rest, or from variances that are known.
        combine: what becomes of the first round, the pilot. "fixed": rounds are averaged with weights known beforehand, unbiased;
            "discard_pilot": only the last counts, unbiased; "pooled": weighted by the evaluations each pixel had, which the pilot
            chose: biased, see `Rendering.bias`.
    """

    allocation: Allocation = field(default=Uniform(), kw_only=True)
    combine: Combine = field(default="fixed", kw_only=True)

    def __post_init__(self) -> None:
        if not isinstance(self.allocation, Allocation):
            raise McaaError(f"allocation must be Uniform(), EqualVariance() or Neyman(), got {self.allocation!r}")
        if self.combine not in ("discard_pilot", "fixed", "pooled"):
            raise McaaError(f"combine must be 'discard_pilot', 'fixed' or 'pooled', got {self.combine!r}")
        pattern = getattr(self, "pattern", None)
        if pattern is not None and not isinstance(pattern, Pattern):
            raise McaaError(f"pattern must be a pattern such as Sobol() or Independent(), got {pattern!r}")

    def __repr__(self) -> str:
        said = []
        for each in fields(self):
            value = getattr(self, each.name)
            default = each.default if each.default_factory is MISSING else each.default_factory()
            if value != default:
                said.append(f"{each.name}={value.__name__ if isinstance(value, type) else repr(value)}")
        return f"{type(self).__name__}({', '.join(said)})"

    @property
    def fewest(self) -> int:
        return 1

    def count(self, spp: int) -> int:
        """The largest number of evaluations of at most `spp` that a pixel can have."""
        return spp

    def check(self, task: Task) -> None:
        if task.boundary == "renormalize" and not isinstance(task.filter, SeparableFilter):
            raise McaaError(
                f"boundary='renormalize' needs the integral of w over the screen, known for separable filters only, not {task.filter}; use Shared"
            )

    def bias(self, task: Task, spp: int) -> tuple[str, ...]:
        if self.combine == "pooled" and not isinstance(self.allocation, Uniform):
            return (f"combine='pooled': the pilot chose the numbers of evaluations that weigh it ({self.allocation})",)
        return ()

    def cell(self, task: Task, spp: int, adaptive: bool) -> tuple[int, int]:
        # with an allocation, cells large enough that pixels of one count are many
        side = 32 if adaptive else 64 if isinstance(self.allocation, Uniform) else 256
        side *= math.isqrt(width_of(task.device))
        return side, side

    def round(self, task: Task, spp: int, number: int) -> Round:
        return PixelwiseRound(self, task, spp, number)

    @abstractmethod
    def draw(self, pixels: Pixels, n: int) -> Drawn:
        """Draw n points, `fewest` or more, in each of the pixels and estimate them."""


@dataclass(frozen=True, repr=False)
class Sequential(Pixelwise):
    """An estimator of rounds in each pixel, every one of which learns from those before it; for filters whose modulus can be sampled.

    Attributes:
        rounds: how many, 2 to `ROUNDS`.
    """

    rounds: int = 2

    def __post_init__(self) -> None:
        super().__post_init__()
        if isinstance(self.rounds, bool) or not isinstance(self.rounds, int) or not 2 <= self.rounds <= ROUNDS:
            raise McaaError(f"rounds must be an integer from 2 to {ROUNDS}, got {self.rounds!r}")

    @property
    def fewest(self) -> int:
        return 2 * self.rounds

    def check(self, task: Task) -> None:
        super().check(task)
        _ = task.filter.absolute_integral


class PixelwiseRound(Round):
    """`spp` evaluations in each pixel, or `counts` (H, W) of them, whose mean is `spp`."""

    def __init__(self, estimator: Pixelwise, task: Task, spp: float, number: int, counts: Tensor | None = None) -> None:
        self.estimator, self.task, self.number, self.counts = estimator, task, number, counts
        if counts is not None:
            asked, which = counts.unique(return_inverse=True)
            self.counts = torch.tensor([estimator.count(n) if n else 0 for n in asked.tolist()], device=counts.device)[which]
        self.per_pixel = float(spp if counts is not None else estimator.count(int(spp)))

    def points(self, cell: Cell) -> int:
        return int(self._counts(cell).sum())

    def estimate(self, cell: Cell) -> Estimate:
        task, counts = self.task, self._counts(cell).reshape(-1)
        rows = torch.arange(cell.row, cell.row + cell.height, device=task.device).repeat_interleave(cell.width)
        cols = torch.arange(cell.col, cell.col + cell.width, device=task.device).repeat(cell.height)
        order = counts.argsort(stable=True)
        parts, start = [], 0
        for n, pixels in zip(*(each.tolist() for each in counts.unique(return_counts=True)), strict=True):
            step = max(1, BLOCK * width_of(task.device) // n)
            for first in range(start, start + pixels, step):
                chosen = order[first : min(first + step, start + pixels)]
                parts.append(self.estimator.draw(Pixels(task, cell, rows[chosen], cols[chosen], self.number), n))
            start += pixels

        def plane(name: str, dtype: torch.dtype) -> Tensor:
            joined = torch.cat([getattr(part, name) for part in parts], -1)
            placed = torch.empty_like(joined)
            placed[..., order] = joined
            return placed.unflatten(-1, (cell.height, cell.width)).to(dtype)

        value, variance, predicted = (plane(name, torch.float64) for name in ("value", "variance", "predicted"))
        invalid, tail = plane("invalid", torch.int32), plane("pareto_k", torch.float32)
        variance = torch.where(without_moment(tail, value), torch.inf, variance)
        if task.boundary == "renormalize":
            norm = task.inside(cell)
            assert norm is not None
            value, variance, predicted = value / norm, variance / norm.square(), predicted / norm.square()
        if task.integrand.nonfinite == "propagate":
            value = torch.where(invalid > 0, torch.nan, value)
        points = counts.unflatten(0, (cell.height, cell.width)).to(torch.int32)
        variance = settled(pooled(variance), value, unseen(value, points))
        diagnostics = Diagnostics(predicted.to(task.dtype), plane("ess", torch.float32), tail)
        return Estimate(value.to(task.dtype), variance.to(task.dtype), points, invalid, diagnostics)

    def _counts(self, cell: Cell) -> Tensor:
        if self.counts is not None:
            return self.counts[cell.window]
        return torch.full((cell.height, cell.width), int(self.per_pixel), device=self.task.device)
