"""`render`: the one loop over rounds and cells."""

from __future__ import annotations

import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from numbers import Integral, Real
from typing import Literal

import torch
from torch import Tensor

from torch_mcaa.allocation import Uniform, dense
from torch_mcaa.arguments import task_of
from torch_mcaa.errors import McaaError, McaaWarning
from torch_mcaa.estimators import Auto, Estimate, Estimator, Pixelwise, PixelwiseRound, Round, Task
from torch_mcaa.estimators.base import pooled
from torch_mcaa.filters import Filter, Gaussian
from torch_mcaa.grid import Cell, Screen
from torch_mcaa.integrand import Function, Nonfinite
from torch_mcaa.picture import add, blank
from torch_mcaa.progress import Progress, Report
from torch_mcaa.rendering import Rendering, Stopped
from torch_mcaa.tolerance import Tolerance

_PILOT = 4
_PILOT_SHARE = 4
"""One part in so many of the evaluations is the pilot that an allocation is made from."""
_CAP = 64
"""What one pixel may be given by an estimated variance, in evaluations over the mean: a tail that was met once does not draw them all."""


def render(
    f: Function,
    size: tuple[int, int],
    *,
    filter: Filter | None = None,
    estimator: Estimator | None = None,
    spp: int = 16,
    tolerance: float | Tolerance | None = None,
    seconds: float | None = None,
    extent: tuple[float, float, float, float] | None = None,
    boundary: Literal["extend", "zero", "renormalize"] = "extend",
    nonfinite: Nonfinite = "raise",
    seed: int = 0,
    dtype: torch.dtype = torch.float32,
    device: torch.device | str | None = None,
    compile: Literal["auto", False] = "auto",
    progress: Report | bool | None = None,
) -> Rendering:
    """Render f(x, y) as an anti-aliased picture of `size` = (height, width), with the standard error of every pixel.

    The value of pixel h is (1): the integral of f times the filter centred on the pixel. The picture is a pure function of the arguments:
    bit for bit the same for every number of threads and order of work, on one build of PyTorch and one kind of processor, unless
    `seconds` or Ctrl-C ended it.

    Args:
        f: two tensors of one shape (x right, y down; pixel (i, j) covers [j, j + 1] x [i, i + 1]) to a tensor of that shape, a tuple of C
            such tensors (one a channel), or a (C, *shape) tensor. A `Texture` covers the screen once, unless `extent`
            says where in it the screen lies, in texels.
        size: (height, width) in pixels.
        filter: w, by default Gaussian(0.5).
        estimator: by default Auto().
        spp: a cap on the mean number of evaluations of f in a pixel.
        tolerance: work until P(|error| <= 2 tolerance) >= 0.95 for every pixel and channel, or the cap is reached.
        seconds: wall time after which the work ends.
        extent: (x0, x1, y0, y1), what the screen covers in f's coordinates.
        boundary: "extend" asks f beyond the screen, "zero" takes f = 0 there, "renormalize" divides by the filter's share on the screen.
        nonfinite: "raise" on NaN or infinities from f, "ignore" those samples (counted in `invalid`) or let them "propagate".
        seed: 0 <= seed < 2^64; another seed, other points.
        dtype: torch.float32 or torch.float64, of the picture.
        device: where f is asked, by default the CPU.
        compile: "auto" or False; f runs eagerly.
        progress: None for a bar on a terminal when it takes long, True, False, or a function of the fraction done.

    Raises:
        McaaError: an argument that cannot be used, or an f that breaks its contract; the message says which, what was received, the mend.

    Ctrl-C ends the work and returns what is done, with a `McaaWarning`; pixels without a value are NaN.

    >>> import torch, torch_mcaa as mcaa
    >>> picture = mcaa.render(lambda x, y: (torch.hypot(x - 8, y - 8) < 5).float(), (16, 16), spp=16)
    >>> tuple(picture.image.shape), picture.stopped
    ((1, 16, 16), 'spp')
    >>> abs(float(picture.image.sum()) - 25 * torch.pi) < 0.5
    True
    """
    start = time.perf_counter()
    chosen = Auto() if estimator is None else estimator
    screen = Screen.of(size, extent)
    task = task_of(f, screen, Gaussian(0.5) if filter is None else filter, boundary, nonfinite, seed, dtype, device, extent is None)
    if not isinstance(chosen, Estimator):
        raise McaaError(f"estimator must be an estimator such as Auto() or Shared(), got {chosen!r}")
    if isinstance(spp, bool) or not isinstance(spp, Integral) or spp < 1:
        raise McaaError(f"spp must be an integer of at least 1, got {spp!r}")
    if seconds is not None and not (isinstance(seconds, Real) and seconds > 0):
        raise McaaError(f"seconds must be above 0, got {seconds!r}")
    if compile not in ("auto", False):
        raise McaaError(f"compile must be 'auto' or False, got {compile!r}")
    if tolerance is not None and not isinstance(tolerance, Tolerance):
        tolerance = Tolerance(absolute=tolerance)
    if spp < chosen.fewest:
        raise McaaError(f"{chosen} needs at least {chosen.fewest} evaluations a pixel, got spp = {spp}")
    chosen.check(task)
    bar = Progress(progress)
    work = _Work(task, chosen, spp, tolerance, None if seconds is None else start + seconds, bar)
    with torch.no_grad():
        try:
            stopped = work.run()
            bar.update(1.0)
        except KeyboardInterrupt:
            warnings.warn("interrupted: pixels without a value are NaN, with a standard error of +inf", McaaWarning, stacklevel=2)
            stopped = "interrupted"
        finally:
            bar.close()
    return _rendering(work, stopped, time.perf_counter() - start)


def _rendering(work: _Work, stopped: Stopped, seconds: float) -> Rendering:
    picture, task = work.picture(), work.task
    bias = list(work.estimator.bias(task))
    if work.number > 1 and (work.tolerance is not None or work.deadline is not None):
        bias.append("rounds ended where the samples themselves said so")
    if task.integrand.nonfinite == "ignore" and bool(picture.invalid.any()):
        bias.append("samples that were not finite were left out")
    diagnostics = picture.diagnostics
    without = picture.variance.isinf() & picture.value.isfinite()
    # one evaluation has no variance either, whatever f is
    without &= picture.points > 1 if diagnostics is None else diagnostics.pareto_k > 0.5
    heavy = int(without.any(0).sum())
    if heavy:
        warnings.warn(
            f"in {heavy} pixels the samples look as if f had no second moment: their standard error is +inf; "
            "clamp f, take more samples, or another density",
            McaaWarning,
            stacklevel=3,
        )
    return Rendering(
        image=picture.value,
        stderr=picture.variance.sqrt_(),
        spp=picture.points,
        invalid=picture.invalid,
        model=torch.zeros(task.screen.height, task.screen.width, dtype=torch.uint8, device=task.device),
        models=(repr(work.estimator),),
        evaluations=task.integrand.evaluations,
        seconds=seconds,
        stopped=stopped,
        bias=tuple(bias),
        predicted_variance=None if diagnostics is None else diagnostics.predicted,
        ess=None if diagnostics is None else diagnostics.ess,
        pareto_k=None if diagnostics is None else diagnostics.pareto_k,
        predicted_optimum=work.predicted_optimum,
    )


@dataclass
class _Work:
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
            return self._shared_out(asked, left, active)
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

    def _shared_out(self, asked: int, left: int, active: Sequence[int]) -> Round:
        """A round whose evaluations the estimator's allocation shares out over the pixels of the active cells."""
        chosen, screen = self.estimator, self.task.screen
        assert isinstance(chosen, Pixelwise)
        inside = torch.zeros(screen.height, screen.width, dtype=torch.bool, device=self.task.device)
        for index in active:
            inside[self.cells[index].window] = True
        pixels = int(inside.sum())
        total = left if left < (asked + 1) * pixels else asked * pixels
        if self._known is not None and self._known.shape != inside.shape:
            raise McaaError(
                f"the known variances of {chosen.allocation} have shape {tuple(self._known.shape)}, the picture {tuple(inside.shape)}"
            )
        spread = self._known.to(inside.device) if self._known is not None else self._spread()
        cap = None if self._known is not None else _CAP * -(-total // pixels)
        shares = chosen.allocation.counts(spread[inside][None], total, self._floor, cap)
        self.predicted_optimum = chosen.allocation.predicted(spread[inside][None], total)
        counts = torch.zeros_like(inside, dtype=torch.int64)
        counts[inside] = dense(shares[0])
        return PixelwiseRound(chosen, self.task, total / pixels, self.number, counts)

    def _spread(self) -> Tensor:
        """(H, W) float64: the variance of one evaluation, the mean over the channels, as far as the rounds so far tell.

        Pooled over 3 x 3 pixels, and with one more observation of the variance that half the range of the values would have: a flat
        pilot of n points says that the variance is small, not that it is 0.
        """
        assert self._picture is not None and self._picture.diagnostics is not None
        n = self._picture.points.to(torch.float64)
        value = self._picture.value.to(torch.float64).nan_to_num(nan=0.0, posinf=0.0, neginf=0.0)
        assert isinstance(self.estimator, Pixelwise)
        half = ((value.amax((1, 2)) - value.amin((1, 2))) / 2).square()[:, None, None] * self.estimator.allocation.unseen
        own = self._picture.diagnostics.predicted.to(torch.float64) * n
        return ((9 * n * pooled(own) + half) / (9 * n + 1)).mean(0)

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
