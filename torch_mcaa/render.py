"""`render`: the one loop over rounds and cells."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from numbers import Integral, Real
from typing import Literal

import torch
from torch import Tensor

from torch_mcaa.errors import McaaError, McaaWarning
from torch_mcaa.estimators import Auto, Estimate, Estimator, Round, Task
from torch_mcaa.filters import Filter, Gaussian
from torch_mcaa.grid import Cell, Screen
from torch_mcaa.integrand import Function, Integrand, Nonfinite
from torch_mcaa.progress import Progress, Report
from torch_mcaa.rendering import Rendering, Stopped
from torch_mcaa.texture import Texture

_PILOT = 4


@dataclass(frozen=True)
class Tolerance:
    """How far off a pixel may be: by `absolute`, or `relative` times its modulus, whichever is larger.

    Raises:
        McaaError: a tolerance that is negative or not finite, or neither above 0.
    """

    absolute: float = 0.0
    relative: float = 0.0

    def __post_init__(self) -> None:
        for name, value in (("absolute", self.absolute), ("relative", self.relative)):
            if isinstance(value, bool) or not isinstance(value, Real) or not math.isfinite(value) or value < 0:
                raise McaaError(f"the {name} tolerance must be a number of at least 0, got {value!r}")
        if self.absolute == 0 and self.relative == 0:
            raise McaaError("a tolerance must be above 0, got 0; for instance tolerance=1e-3")

    def met(self, value: Tensor, variance: Tensor) -> bool:
        """Whether every pixel's standard error is within the tolerance."""
        allowed = (self.relative * value.abs()).clamp_min(self.absolute)
        return bool((variance <= allowed * allowed).all())


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
    task = _task(f, screen, Gaussian(0.5) if filter is None else filter, boundary, nonfinite, seed, dtype, device, extent is None)
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
    picture = work.picture()
    return Rendering(
        image=picture.value,
        stderr=picture.variance.sqrt_(),
        spp=picture.points,
        invalid=picture.invalid,
        model=torch.zeros(screen.height, screen.width, dtype=torch.uint8, device=task.device),
        models=(repr(chosen),),
        evaluations=task.integrand.evaluations,
        seconds=time.perf_counter() - start,
        stopped=stopped,
    )


def _task(
    f: Function,
    screen: Screen,
    filter: Filter,
    boundary: str,
    nonfinite: str,
    seed: int,
    dtype: torch.dtype,
    device: torch.device | str | None,
    placed_once: bool = True,
) -> Task:
    if not callable(f):
        raise McaaError(f"f must be a function of two tensors x, y, got {type(f).__name__}; wrap an image in Texture(image)")
    if isinstance(f, type):
        raise McaaError(f"f must be a function of two tensors x, y, got the class {f.__name__}; pass an instance of it")
    if not isinstance(filter, Filter):
        raise McaaError(f"filter must be a filter such as Gaussian(0.5) or Box(), got {filter!r}")
    if boundary not in ("extend", "zero", "renormalize"):
        raise McaaError(f"boundary must be 'extend', 'zero' or 'renormalize', got {boundary!r}")
    if nonfinite not in ("raise", "ignore", "propagate"):
        raise McaaError(f"nonfinite must be 'raise', 'ignore' or 'propagate', got {nonfinite!r}")
    if isinstance(seed, bool) or not isinstance(seed, int) or not 0 <= seed < 2**64:
        raise McaaError(f"seed must be an integer from 0 to 2^64 - 1, got {seed!r}")
    if dtype not in (torch.float32, torch.float64):
        raise McaaError(f"dtype must be torch.float32 or torch.float64, got {dtype}; f itself may return any real dtype")
    if math.isinf(max(filter.radius)) and boundary != "zero":
        raise McaaError(
            f"{filter} reaches over the whole plane, where |w| has no finite integral, so no estimate of it has a finite variance; "
            f"got boundary={boundary!r}: pass boundary='zero', or take Lanczos(3)"
        )
    try:
        placed = torch.empty(0, device="cpu" if device is None else device).device
    except (RuntimeError, TypeError, AssertionError) as error:
        raise McaaError(
            f"device {device!r} cannot be used: {str(error).splitlines()[0]}; pass device='cpu' or one that is there"
        ) from error
    if placed.type == "meta":
        raise McaaError("device 'meta' cannot be used: it holds no values; pass device='cpu'")
    bound = f
    if placed_once and isinstance(f, Texture):
        bound = f.on((screen.height, screen.width))
    return Task(screen, Integrand(bound, dtype, nonfinite), filter, boundary, seed, dtype, placed)


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
    _picture: Estimate | None = field(default=None, init=False)
    _spent: float = field(default=0.0, init=False)

    def __post_init__(self) -> None:
        adaptive = self.tolerance is not None or self.deadline is not None
        self.cells = list(self.task.screen.cells(*self.estimator.cell(self.task, adaptive)))
        self.weights = [0.0] * len(self.cells)
        self.pilot = max(self.estimator.fewest, min(self.spp, _PILOT)) if adaptive else self.spp

    def run(self) -> Stopped:
        """Rounds until the tolerance is met, or the evaluations or the time are spent.

        Each round asks for a fixed number of evaluations in each pixel of the cells that are not done: twice what the round before
        asked for, while the cap and the time allow it.
        """
        active = list(range(len(self.cells)))
        pixels = self.task.screen.height * self.task.screen.width
        asked, number = self.pilot, 0
        while True:
            began, before = time.perf_counter(), self.task.integrand.evaluations
            current = self._affordable(asked, number, active)
            for done, index in enumerate(active):
                if self.deadline is not None and time.perf_counter() > self.deadline:
                    return "seconds"
                self._add(index, current.estimate(self.cells[index]), current.per_pixel)
                self.bar.update(min(1.0, (self._spent / pixels) / self.spp) if number else (done + 1) / len(active))
            number += 1
            if self.tolerance is None and self.deadline is None:
                return "spp"
            if self.tolerance is not None:
                active = [index for index in active if not self._met(index)]
                if not active:
                    return "tolerance"
            left = self.spp * pixels - self._spent
            room = int(left // sum(self.cells[index].height * self.cells[index].width for index in active))
            asked = room if self.tolerance is None else min(room, 2 * asked)
            if asked < self.estimator.fewest:
                return "spp"
            if self.deadline is not None:
                now = time.perf_counter()
                rate = (now - began) / max(1, self.task.integrand.evaluations - before)
                reach = sum(self.cells[index].height * self.cells[index].width for index in active) * rate
                asked = int(min(asked, (self.deadline - now) / reach))
                if asked < self.estimator.fewest:
                    return "seconds"

    def _affordable(self, asked: int, number: int, active: Sequence[int]) -> Round:
        """The round of at most `asked` evaluations a pixel whose points fit under the cap; a cut pattern can hold more than its share."""
        left = self.spp * self.task.screen.height * self.task.screen.width - self._spent
        while True:
            current = self.estimator.round(self.task, asked, number)
            if asked == self.estimator.fewest or sum(current.points(self.cells[index]) for index in active) <= left:
                return current
            asked -= 1

    def _add(self, index: int, new: Estimate, points: float) -> None:
        """Merge a round into the picture with weights fixed by the numbers of evaluations alone, so that no value chooses its weight.

        n^1.5 is the inverse variance of a shared pattern on edges.
        """
        screen, cell = self.task.screen, self.cells[index]
        if self._picture is None:
            self._picture = _blank(screen, len(new.value), self.task)
        picture, window = self._picture, (slice(None), *cell.window)
        old, weight = self.weights[index], points**1.5
        if old == 0:
            picture.value[window], picture.variance[window] = new.value, new.variance
        else:
            share = weight / (old + weight)
            value, variance = picture.value[window], picture.variance[window]
            merged = value + (new.value - value) * share
            spread = variance * (1 - share) ** 2 + new.variance * share**2
            if self.task.integrand.nonfinite != "propagate":
                # a round in which no sample met the pixel's filter says nothing about it
                for empty, other in ((value.isnan(), new), (new.value.isnan(), Estimate(value, variance, new.points, new.invalid))):
                    merged, spread = torch.where(empty, other.value, merged), torch.where(empty, other.variance, spread)
            picture.value[window], picture.variance[window] = merged, spread
        self.weights[index] = old + weight
        picture.points[cell.window] += new.points
        picture.invalid[cell.window] += new.invalid
        self._spent += float(new.points.sum(dtype=torch.int64))

    def _met(self, index: int) -> bool:
        assert self.tolerance is not None
        assert self._picture is not None
        window = (slice(None), *self.cells[index].window)
        return self.tolerance.met(self._picture.value[window], self._picture.variance[window])

    def picture(self) -> Estimate:
        """The picture so far; all NaN, in one channel, if not even one cell was done."""
        return self._picture or _blank(self.task.screen, max(1, self.task.integrand.channels), self.task)


def _blank(screen: Screen, channels: int, task: Task) -> Estimate:
    shape = (channels, screen.height, screen.width)
    try:
        return _empty(shape, task)
    except RuntimeError as error:
        raise McaaError(
            f"a picture of {screen.height} x {screen.width} pixels in {channels} channels does not fit into memory; ask for a smaller size"
        ) from error


def _empty(shape: tuple[int, int, int], task: Task) -> Estimate:
    counts = torch.zeros(2, *shape[1:], dtype=torch.int32, device=task.device)
    return Estimate(
        torch.full(shape, torch.nan, dtype=task.dtype, device=task.device),
        torch.full(shape, torch.inf, dtype=task.dtype, device=task.device),
        counts[0],
        counts[1],
    )
