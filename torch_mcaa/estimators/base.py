"""What an estimator is: a round of so many evaluations a pixel turns a cell of the screen into values and variances."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, TypeVar

import torch
from torch import Tensor

from torch_mcaa.filters import Filter, SeparableFilter
from torch_mcaa.grid import Cell, Screen
from torch_mcaa.integrand import Integrand
from torch_mcaa.tolerance import Tolerance
from torch_mcaa.traced.followed import Followed

MANY = 100
"""Pixels that bear each other out: fewer say little of what none of them met, or of which of two estimates is better."""
Boundary = Literal["extend", "zero", "renormalize"]
Fact = TypeVar("Fact")


@dataclass(frozen=True)
class Task:
    """All that a picture depends on, but for the number of evaluations."""

    screen: Screen
    integrand: Integrand
    filter: Filter
    boundary: Boundary
    seed: int
    dtype: torch.dtype
    device: torch.device
    compiled: bool = False
    """Whether f is compiled into the estimator's graph, where the estimator has one."""
    deadline: float | None = None
    """When to end, by `time.perf_counter`."""

    @cached_property
    def _known(self) -> dict[Callable[[Task], Any], Any]:
        return {}

    def once(self, fact: Callable[[Task], Fact]) -> Fact:
        """What a function says of the task, which is asked the first time and remembered for as long as the task."""
        if fact not in self._known:
            self._known[fact] = fact(self)
        return self._known[fact]

    @property
    def late(self) -> bool:
        """Whether the time is up."""
        return self.deadline is not None and time.perf_counter() > self.deadline

    @property
    def followed(self) -> Followed | None:
        """f, if all its decisions are known."""
        return self.integrand.function if isinstance(self.integrand.function, Followed) else None

    def around(self, cell: Cell, by: int) -> Cell:
        """The cell and so many pixels around it, not beyond a closed screen."""
        around = cell.grown(by)
        return around if self.boundary == "extend" else around.overlap(self.screen.whole)

    def inside(self, cell: Cell) -> Tensor | None:
        """(h, w) float64: the integral of w over the screen, of each pixel; None for a filter that does not separate."""
        filter, screen = self.filter, self.screen
        if not isinstance(filter, SeparableFilter):
            return None

        def share(first: int, count: int, size: int) -> Tensor:
            centre = torch.arange(first, first + count, dtype=torch.float64) + 0.5
            return filter.profile_cdf(size - centre) - filter.profile_cdf(-centre)

        across, down = share(cell.col, cell.width, screen.width), share(cell.row, cell.height, screen.height)
        return (down[:, None] * across).to(self.device)

    def coded(self, x: Tensor, y: Tensor) -> list[Tensor]:
        """As `integrand`, and where f is `followed` one channel more, of codes that are equal where it decided alike."""
        if self.followed is None:
            return self.integrand(x, y)
        coded = replace(self.integrand, function=self.followed.coded)
        values = coded(x, y)
        self.integrand.evaluations += coded.evaluations
        self.integrand.channels = len(values) - 1
        return values


@dataclass(frozen=True)
class Diagnostics:
    """What the importance weights of one round say about each pixel.

    Attributes:
        predicted: (C, h, w) the variance that the theory gives the value, in the task's dtype.
        ess: (h, w) float32 effective sample size.
        pareto_k: (C, h, w) float32 tail index of the terms, NaN where nothing can be said.
    """

    predicted: Tensor
    ess: Tensor
    pareto_k: Tensor


@dataclass(frozen=True)
class Estimate:
    """One round's result in one cell.

    Attributes:
        value: (C, h, w) estimate of (1), in the task's dtype.
        variance: (C, h, w) estimated variance of `value`; never 0.
        points: (h, w) int32, the evaluations of f that lie in each pixel.
        invalid: (h, w) int32, how many of them were not finite.
        diagnostics: of estimators that draw points for each pixel, else None.
        heavy: (h, w) bool, the pixels in which f was found to have no second moment by an estimator without diagnostics; None if in none.
        unseen: (C, 1, 1) or (C, h, w) the part of `variance` that stands for what no sample met; None if that is not told apart.
        blind: (C, h, w) the part of `variance` that points off a lattice have seen and the lattice has not; None if there is none.
        model: (h, w) uint8, what was used: an index into the estimator's `models`; None for the first.
    """

    value: Tensor
    variance: Tensor
    points: Tensor
    invalid: Tensor
    diagnostics: Diagnostics | None = None
    heavy: Tensor | None = None
    unseen: Tensor | None = None
    model: Tensor | None = None
    blind: Tensor | None = None

    @property
    def without_moment(self) -> Tensor:
        """(h, w) bool: the pixels whose variance is +inf since the diagnostics found that f has no second moment there."""
        assert self.diagnostics is not None
        return ((self.diagnostics.pareto_k > 0.5) & self.variance.isinf()).any(0)


class Round(ABC):
    """One round of an estimator: a pure function of (task, spp, number) and the cell."""

    per_pixel: float
    """Evaluations a pixel, but for what a border cuts."""

    @abstractmethod
    def points(self, cell: Cell) -> int:
        """How many evaluations will lie in the pixels of `cell`."""

    @abstractmethod
    def estimate(self, cell: Cell) -> Estimate:
        """Evaluate f in and around `cell` and estimate its pixels."""


class Estimator(ABC):
    """A way to estimate (1) for every pixel, with its variance. Estimators are stateless values."""

    @property
    @abstractmethod
    def fewest(self) -> int:
        """The least number of evaluations a pixel that a round can have."""

    @abstractmethod
    def check(self, task: Task) -> None:
        """Refuse what this estimator cannot do, with the reason.

        Raises:
            McaaError: for instance a filter whose modulus is not integrable, or a boundary that it would need.
        """

    @property
    def again(self) -> int:
        """The least number of evaluations a pixel of a round that is merged with others."""
        return self.fewest

    def glance(self, task: Task) -> Estimator | None:
        """What gives a first value in every pixel where a round of this one takes long; None if it does not."""
        return None

    def unfused(self, task: Task) -> str | None:
        """Why it has no graph that f could be compiled into for this task; None if it has one."""
        return f"{self} has no graph to compile f into: take Shared(Lattice())"

    @property
    def models(self) -> tuple[str, ...]:
        """The names of what it may use in a pixel."""
        return (repr(self),)

    def locates(self, model: Tensor) -> bool:
        """Whether jumps were located in any of the pixels that `model` (h, w) is of."""
        return False

    def calm(self, model: Tensor) -> bool:
        """Whether a later round need not look for jumps in the pixels that `model` (h, w) is of."""
        return False

    def detailed(self, model: Tensor) -> bool:
        """Whether f has so much detail in the pixels that `model` (h, w) is of that one lattice alone does not tell how far it is off."""
        return False

    def bias(self, task: Task, spp: int) -> tuple[str, ...]:
        """Why the mean of a round of `spp` evaluations a pixel may differ from (1), a line a reason; empty if it does not."""
        return ()

    @abstractmethod
    def cell(self, task: Task, spp: int, adaptive: bool) -> tuple[int, int]:
        """(height, width) of the canonical cells for `spp` evaluations a pixel; smaller where these may differ between cells."""

    @abstractmethod
    def round(self, task: Task, spp: int, number: int) -> Round:
        """Round `number` (0, 1, ...) with at most `spp` >= `fewest` evaluations a pixel; rounds are independent of one another."""

    def round_within(self, task: Task, spp: int, number: int, most: int, wanted: Tolerance, jumps: bool | None) -> Round:
        """A round under a tolerance, where evaluations may be spent unevenly: parts that pay for it have up to `most` a pixel.

        jumps: whether earlier rounds have found any to be located, or None if that is to be looked at.
        """
        return self.round(task, spp, number)


def pooled(variance: Tensor) -> Tensor:
    """The larger of each pixel's variance and the mean over its 3 x 3 neighbours inside the cell; (C, h, w). NaN and +inf do not spread."""
    around = box3(torch.nan_to_num(variance, nan=0.0, posinf=0.0))
    return torch.maximum(around, variance)


def settled(variance: Tensor, value: Tensor, floor: Tensor) -> Tensor:
    """The variance, in place, with the floor that `unseen` gives, so that it is never 0 by ignorance; +inf where there is no value."""
    variance.add_(floor)
    if not math.isfinite(value.sum().item()):
        variance.masked_fill_(~torch.isfinite(value), torch.inf)
    return variance


def unseen(value: Tensor, spp: float | Tensor) -> Tensor:
    """(C, 1, 1), or (C, h, w) for `spp` (h, w): the variance that stands for what no sample met.

    The square of a hundredth of the cell's range of values over the evaluations a pixel: a feature of full contrast and a
    hundredth of a sample's area; one over the number of pixels where they are fewer than a hundred, to bear each other out. A constant
    cell's range is taken as its magnitude, and 1 where that is 0 too. Falls as 1/n^2: a standard error that falls as 1/n.
    """
    # `aminmax` along a dimension takes ten times as long
    low, high = value.amin((-2, -1), keepdim=True), value.amax((-2, -1), keepdim=True)
    if not bool((low.isfinite() & high.isfinite()).all()):
        low = torch.nan_to_num(value, nan=torch.inf, posinf=torch.inf, neginf=-torch.inf).amin((-2, -1), keepdim=True)
        high = torch.nan_to_num(value, nan=-torch.inf, posinf=torch.inf, neginf=-torch.inf).amax((-2, -1), keepdim=True)
    span = torch.nan_to_num(high - low, nan=0.0, posinf=0.0, neginf=0.0)
    magnitude = torch.nan_to_num(high.abs(), nan=0.0, posinf=0.0)
    rounding = 64 * torch.finfo(value.dtype).eps
    scale = torch.where(span > rounding * magnitude, span, torch.where(magnitude > 0, magnitude, torch.ones_like(magnitude)))
    # squares of less are 0
    return ((scale / (spp * min(MANY, value[0].numel()))) ** 2).clamp_min(torch.finfo(value.dtype).tiny)


def box3(plane: Tensor) -> Tensor:
    """The mean over each pixel's 3 x 3 neighbours inside the cell, of a (C, h, w) tensor."""
    for dim in (-2, -1):
        size, total = plane.shape[dim], plane.clone()
        total.narrow(dim, 1, size - 1).add_(plane.narrow(dim, 0, size - 1))
        total.narrow(dim, 0, size - 1).add_(plane.narrow(dim, 1, size - 1))
        # the first and the last have a neighbour less
        for side in {0, size - 1}:
            total.narrow(dim, side, 1).mul_(1.5 if size > 1 else 3.0)
        plane = total
    return plane.mul_(1 / 9)


def dilated(mask: Tensor, by: int) -> Tensor:
    """The pixels at most `by` rows and columns from one of the mask, bool (h, w)."""
    mask = torch.nn.functional.pad(mask, (by,) * 4)
    for dim in (0, 1):
        wide = 1
        while wide < 2 * by + 1:
            step = min(wide, 2 * by + 1 - wide)
            size = mask.shape[dim] - step
            mask = mask.narrow(dim, 0, size) | mask.narrow(dim, step, size)
            wide += step
    return mask
