"""`render`: from a function to a picture."""

from __future__ import annotations

import dataclasses
import time
from numbers import Integral, Real
from typing import Literal

import torch

from torch_mcaa.arguments import task_of
from torch_mcaa.errors import McaaError, warn
from torch_mcaa.estimators import Auto, Estimate, Estimator
from torch_mcaa.filters import Filter, Gaussian
from torch_mcaa.grid import Screen
from torch_mcaa.integrand import Function, Nonfinite
from torch_mcaa.progress import Progress, Report
from torch_mcaa.rendering import Rendering, Stopped
from torch_mcaa.rounds import Rounds
from torch_mcaa.tolerance import Tolerance

_MANY = 2**30
"""Evaluations from which on compiling pays: it costs 3 to 30 s, and saves some 8 ns an evaluation of a cheap f."""


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
    compile: Literal["auto"] | bool = "auto",
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
        spp: a cap on the mean number of evaluations of f in a pixel. What the filter needs about the picture, and about the cells that large ones
            are made in, and points that fill a vector up, come on top, and `Rendering.evaluations` counts them, too: up to 9 % in
            256 x 256 pixels at 16, more in small pictures.
        tolerance: work until P(|error| <= 2 tolerance) >= 0.95 for every pixel and channel, or the cap is reached.
        seconds: wall time after which the work ends.
        extent: (x0, x1, y0, y1), what the screen covers in f's coordinates.
        boundary: "extend" asks f beyond the screen, "zero" takes f = 0 there, "renormalize" divides by the filter's share on the screen.
        nonfinite: "raise" on NaN or infinities from f, "ignore" those samples (counted in `invalid`) or let them "propagate".
        seed: 0 <= seed < 2^64; another seed, other points.
        dtype: torch.float32 or torch.float64, of the picture.
        device: where f is asked, by default the CPU.
        compile: whether f is compiled into one graph with the sums of `Shared(Lattice())`, the only estimator that has one, under `spp`
            alone. "auto": from 2^30 evaluations on, on the CPU. It costs seconds, once for an f and a shape of picture, and is made up for in
            rounding; where the compiler refuses f, or takes over 90 s, f runs eagerly, with a `McaaWarning`.
        progress: None for a bar on a terminal when it takes long, True, False, or a function of the fraction done.

    Raises:
        McaaError: an argument that cannot be used, or an f that breaks its contract; the message says which, what was received, the mend.

    Ctrl-C ends the work and returns what is done, with a `McaaWarning`; pixels without a value are NaN. So are those that `seconds` did not
    last for.

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
    if seconds is not None and (isinstance(seconds, bool) or not (isinstance(seconds, Real) and seconds > 0)):
        raise McaaError(f"seconds must be above 0, got {seconds!r}")
    if not (isinstance(compile, bool) or compile == "auto"):
        raise McaaError(f"compile must be 'auto', True or False, got {compile!r}")
    if tolerance is not None and not isinstance(tolerance, Tolerance):
        tolerance = Tolerance(absolute=tolerance)
    if spp < chosen.fewest:
        raise McaaError(f"{chosen} needs at least {chosen.fewest} evaluations a pixel, got spp = {spp}")
    chosen.check(task)
    unfused = "a compiled picture has its evaluations fixed by spp alone: leave out tolerance and seconds"
    if tolerance is None and seconds is None:
        unfused = chosen.unfused(task)
    if compile is True and unfused:
        raise McaaError(f"compile=True cannot be done: {unfused}; or pass compile='auto'")
    many = task.device.type == "cpu" and spp * screen.height * screen.width >= _MANY
    if compile is True or (compile == "auto" and not unfused and many):
        task = dataclasses.replace(task, compiled=True)
    if seconds is not None:
        task = dataclasses.replace(task, deadline=start + seconds)
    bar = Progress(progress)
    work = Rounds(task, chosen, spp, tolerance, bar)
    with torch.no_grad():
        try:
            stopped = work.run()
            bar.update(1.0)
        except KeyboardInterrupt:
            warn("interrupted: pixels without a value are NaN, with a standard error of +inf")
            stopped = "interrupted"
        finally:
            bar.close()
    return _rendering(work, stopped, time.perf_counter() - start)


def _rendering(work: Rounds, stopped: Stopped, seconds: float) -> Rendering:
    picture, task = work.picture(), work.task
    empty = int(((picture.points == 0) & picture.value.isnan().all(0)).sum()) if stopped == "seconds" else 0
    if empty:
        warn(
            f"the time was up before {empty} of {picture.points.numel()} pixels had a sample: they are NaN, with a standard error of +inf; "
            "give more seconds, or ask for fewer pixels"
        )
    bias = list(work.bias)
    if work.number > 1 and (work.tolerance is not None or task.deadline is not None):
        bias.append("rounds ended where the samples themselves said so")
    if task.integrand.nonfinite == "ignore" and bool(picture.invalid.any()):
        bias.append("samples that were not finite were left out")
    if task.integrand.random:
        warn(
            "f is random: it returned two values for one point; its jumps were not looked for, and its noise is part of the standard error"
        )
    if task.integrand.refused:
        warn(f"f was not compiled and ran eagerly: {task.integrand.refused}; compile=False says nothing")
    diagnostics = picture.diagnostics
    heavy = _without_moment(work, picture)
    if heavy:
        warn(
            f"in {heavy} pixels the samples look as if f had no second moment: their standard error is +inf; "
            "clamp f, take more samples, or another density"
        )
    # differences of infinite variances say nothing
    stderr = picture.variance.nan_to_num_(nan=torch.inf, posinf=torch.inf).sqrt_()
    if bool(stderr.amax().isinf()):
        largest = picture.value.nan_to_num(0.0).abs().amax()
        if bool(largest.square().isinf()):
            warn(
                f"f has values of {float(largest):.3g}, whose squares are beyond {picture.value.dtype}: standard errors of +inf; scale f, or "
                "take float64"
            )
    return Rendering(
        image=picture.value,
        stderr=stderr,
        spp=picture.points,
        invalid=picture.invalid,
        model=torch.zeros_like(picture.points, dtype=torch.uint8) if work.model is None else work.model,
        models=work.estimator.models,
        evaluations=task.integrand.evaluations,
        seconds=seconds,
        stopped=stopped,
        bias=tuple(bias),
        predicted_variance=None if diagnostics is None else diagnostics.predicted,
        ess=None if diagnostics is None else diagnostics.ess,
        pareto_k=None if diagnostics is None else diagnostics.pareto_k,
        predicted_optimum=work.predicted_optimum,
        floors=tuple((had.cell, had.unseen.sqrt()) for had in work.histories if had.unseen is not None),
    )


def _without_moment(work: Rounds, picture: Estimate) -> int:
    """How many pixels have no standard error because f was found to have no second moment there."""
    if picture.diagnostics is not None:
        return int(picture.without_moment.sum())
    if not work.heavy:
        return 0
    lost = torch.zeros_like(picture.points, dtype=torch.bool)
    for cell, there in work.heavy:
        lost[cell.window] |= there
    return int(lost.sum())
