"""Measuring the cells of a chart, interleaved, so that what else the machine does falls on all methods alike."""

from __future__ import annotations

import os
import platform
import statistics
import time
import warnings
from collections.abc import Callable, Iterator, Sequence

import torch

from torch_mcaa.charting.fit import Cell
from torch_mcaa.charting.maps import error_map, evaluations_map, picture_png
from torch_mcaa.charting.methods import Method, Shot, plan
from torch_mcaa.charting.store import Store
from torch_mcaa.charting.subject import Subject
from torch_mcaa.charting.truth import Truth, closed_form, reference
from torch_mcaa.errors import McaaError, McaaWarning

_SHORT = 0.1
"""Seconds: a run that takes less is repeated."""
_REPEATS = 3


def machine() -> dict[str, object]:
    """What times depend on; nothing that names the machine."""
    return {"torch": torch.__version__, "threads": torch.get_num_threads(), "device": "cpu", "processor": _processor()}


def _processor() -> str:
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as lines:
            names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    except OSError:
        names = []
    return f"{names[0] if names else platform.processor() or platform.machine()}, {os.cpu_count()} logical"


def able(methods: Sequence[Method], subjects: Sequence[Subject], budgets: Sequence[int]) -> tuple[list[Method], dict[str, str]]:
    """The methods that can do this, and why the others are left out.

    Raises:
        McaaError: none of them can, or f breaks its contract.
    """
    chosen, refused = [], {}
    for method in methods:
        usable = [budget for budget in budgets if method.spent(budget) is not None]
        if not usable:
            refused[method.name] = f"needs more than {max(budgets)} evaluations a pixel"
            continue
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", McaaWarning)
                # f has been asked before: what is refused on a pixel is the filter
                for subject in subjects:
                    method.run(_pixel(subject), usable[0], 0)
        except McaaError as error:
            refused[method.name] = str(error)
            continue
        chosen.append(method)
    if not chosen:
        raise McaaError(f"no method can make this chart: {next(iter(refused.values()))}")
    return chosen, refused


def _pixel(subject: Subject) -> Subject:
    return Subject(subject.name, subject.f, (1, 1), subject.filter, subject.extent, subject.digest, subject.channels)


def find_truths(subjects: Sequence[Subject], budgets: Sequence[int], store: Store, tell: Callable[[], object]) -> None:
    """The truth of every scene, from the store, its closed form or a reference, which is kept."""
    for subject in subjects:
        truth = closed_form(subject) or store.truth(subject.name, subject.digest)
        if truth is None:
            truth = reference(subject, max(budgets))
            store.keep_truth(subject.name, subject.digest, truth)
        store.truths[subject.name] = truth
        tell()


def measure(
    subjects: Sequence[Subject],
    methods: Sequence[Method],
    budgets: Sequence[int],
    seeds: int,
    store: Store,
    tell: Callable[[], object],
) -> None:
    """Run every cell that the store has not; `tell` is called for each.

    Every method has run once, untimed, before it is timed. The seeds are the outermost loop and the methods the innermost.

    Raises:
        McaaError: an f that breaks its contract; what has been measured is kept.
        KeyboardInterrupt: Ctrl-C; likewise.
    """
    budgets_of = plan(methods, budgets)
    warm: set[tuple[str, str]] = set()
    for seed, budget, subject, method in _order(subjects, methods, budgets, seeds):
        if budget not in budgets_of[method.name]:
            continue
        if (subject.name, method.name, budget, seed) not in store.cells:
            if (subject.name, method.name) not in warm:
                method.run(subject, budgets_of[method.name][0], seed)
                warm.add((subject.name, method.name))
            shot, seconds = _timed(method, subject, budget, seed)
            truth = store.truths[subject.name]
            if seed == 0:
                _keep_pictures(store, subject, method, budget, shot, truth, max(budgets))
            store.add(_cell(subject, method.name, budget, seed, shot, seconds, truth))
        tell()


def _order(
    subjects: Sequence[Subject], methods: Sequence[Method], budgets: Sequence[int], seeds: int
) -> Iterator[tuple[int, int, Subject, Method]]:
    return (
        (seed, budget, subject, method) for seed in range(seeds) for budget in budgets for subject in subjects for method in methods
    )


def _timed(method: Method, subject: Subject, budget: int, seed: int) -> tuple[Shot, float]:
    times: list[float] = []
    while True:
        start = time.perf_counter()
        shot = method.run(subject, budget, seed)
        times.append(time.perf_counter() - start)
        if times[0] >= _SHORT or len(times) == _REPEATS:
            return shot, statistics.median(times)


def _cell(subject: Subject, method: str, budget: int, seed: int, shot: Shot, seconds: float, truth: Truth) -> Cell:
    busy = truth.busy
    error = shot.image.double() - truth.value
    reported = whole = coverage = None
    if shot.stderr is not None and shot.unseen is not None:
        stderr = shot.stderr.double()[busy]
        seen = (stderr.square() - shot.unseen.double()[busy].square()).clamp_min(0)
        finite = stderr.isfinite()
        if bool(finite.any()):
            reported, whole = (float(square[finite].mean().sqrt()) for square in (seen, stderr.square()))
        coverage = float((error[busy].abs() <= 1.96 * stderr).double().mean())
    return Cell(
        scene=subject.name,
        method=method,
        budget=budget,
        seed=seed,
        evaluations=shot.evaluations / (subject.size[0] * subject.size[1]),
        seconds=seconds,
        rmse=float(error[busy].square().mean().sqrt()),
        rmse_all=float(error.square().mean().sqrt()),
        reported=reported,
        reported_whole=whole,
        coverage=coverage,
    )


def _keep_pictures(store: Store, subject: Subject, method: Method, budget: int, shot: Shot, truth: Truth, most: int) -> None:
    made = {
        "picture": picture_png(shot.image, truth),
        "error": error_map(shot.image, truth),
        "evaluations": evaluations_map(shot.spp, most),
    }
    for kind, content in made.items():
        store.write(store.picture_file(subject.name, method.name, budget, kind), content)
