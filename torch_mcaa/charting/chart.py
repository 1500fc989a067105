"""`chart`: error against cost, every method over a range of budgets."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from torch_mcaa.charting.fit import Cell, Point, summary
from torch_mcaa.charting.instead import NAMES, Grid
from torch_mcaa.charting.measure import able, find_truths, machine, measure
from torch_mcaa.charting.methods import Method, estimated, plan
from torch_mcaa.charting.store import Store, plain
from torch_mcaa.charting.subject import Subject
from torch_mcaa.errors import McaaError, McaaWarning
from torch_mcaa.estimators import Estimator
from torch_mcaa.filters import Filter, Gaussian
from torch_mcaa.integrand import Function
from torch_mcaa.progress import Progress, Report

BUDGETS = (4, 8, 16, 32, 64)
_MOST = 2**28
"""Evaluations of a picture: 1 GiB a channel."""


@dataclass(frozen=True)
class Chart:
    """What `chart` measured.

    Attributes:
        folder: where its files lie.
        points: a line for each scene, method and budget, as in results.csv.
        cells: every run.
        settings: what was asked for, and the machine; as in results.json.
        left_out: why, by method, for those that cannot do this.
    """

    folder: Path
    points: tuple[Point, ...]
    cells: tuple[Cell, ...]
    settings: dict[str, Any]
    left_out: dict[str, str]


def chart(
    f: Function | Mapping[str, Function],
    size: tuple[int, int] = (256, 256),
    *,
    folder: Path | str = "mcaa-chart",
    filter: Filter | None = None,
    extent: tuple[float, float, float, float] | None = None,
    estimators: Mapping[str, Estimator] | None = None,
    budgets: Sequence[int] = BUDGETS,
    seeds: int = 3,
    force: bool = False,
    progress: Report | bool | None = None,
) -> Chart:
    """Chart error against evaluations and seconds, for every estimator and for what one would use instead, into a folder.

    Writes the files that `torch_mcaa.charting` lists. Called again with equal settings on the same machine it goes on where it was
    interrupted. The truth is `f.exact(cx, cy, filter)` where f has it, as built-in scenes do (float64 pixel centres (1, W) and
    (H, 1) to what expands to (C, H, W)), else `charting.truth.reference`. Pictures are
    float32, errors root mean squares over the pixels that are not flat: those where the truth differs by over a hundredth of its
    range within 3 x 3 pixels.

    Args:
        f: a function as `render` takes it, or several by name.
        size: (height, width) in pixels.
        folder: made if it is not there.
        filter: w, by default Gaussian(0.5).
        extent: (x0, x1, y0, y1), what the screen covers in f's coordinates.
        estimators: by the name to show, by default all with their defaults.
        budgets: evaluations a pixel, increasing; the grids take the largest square within each.
        seeds: how often each is measured, with seeds 0, 1, ...
        force: write over another chart.
        progress: None for a bar on a terminal when it takes long, True, False, or a function of the fraction done.

    Raises:
        McaaError: an argument that cannot be used, an f that breaks its contract, a folder that cannot be written or holds another chart.
        KeyboardInterrupt: Ctrl-C; what was measured is kept.

    >>> import tempfile, torch, torch_mcaa as mcaa
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     made = mcaa.chart(
    ...         lambda x, y: (x + 2 * y < 20.3).float(), (16, 16), folder=folder, estimators={"Shared()": mcaa.Shared()}, budgets=(4, 16), seeds=1
    ...     )
    >>> made.points[0].method, made.points[0].budget
    ('Shared()', 4)
    """
    functions = dict(f) if isinstance(f, Mapping) else {getattr(f, "__name__", type(f).__name__): f}
    _check(functions, folder, estimators, budgets, seeds)
    chosen = Gaussian(0.5) if filter is None else filter
    subjects = [Subject.of(name, function, size, chosen, extent) for name, function in functions.items()]
    if math.prod(subjects[0].size) * max(budgets) > _MOST:
        raise McaaError(
            f"the grids hold all evaluations at once, and {subjects[0].size} pixels of {max(budgets)} are over {_MOST}; ask for fewer"
        )
    methods: list[Method] = [*estimated(estimators), *(Grid(way) for way in NAMES)]
    methods, left_out = able(methods, subjects, budgets)
    settings = _settings(subjects, methods, list(budgets), seeds)
    store = Store(Path(folder), settings, force)
    total = len(subjects) * (1 + seeds * sum(len(used) for used in plan(methods, budgets).values())) + 1
    bar, done = Progress(progress, "charting"), 0

    def tell() -> None:
        nonlocal done
        done += 1
        bar.update(min(1.0, done / total))

    try:
        with warnings.catch_warnings():
            # what they say is in the figures, or in `left_out`
            warnings.simplefilter("ignore", McaaWarning)
            find_truths(subjects, budgets, store, tell)
            measure(subjects, methods, budgets, seeds, store, tell)
        points = summary(
            store.cells.values(),
            {name: (truth.typical, float(truth.value.abs().max())) for name, truth in store.truths.items()},
            list(settings["methods"]),
        )
        _draw(store, points, left_out)
        bar.update(1.0)
    finally:
        bar.close()
    return Chart(store.folder, tuple(points), tuple(store.cells.values()), settings, left_out)


def _draw(store: Store, points: list[Point], left_out: dict[str, str]) -> None:
    from torch_mcaa.charting.drawing import png_of, svg_of, whole
    from torch_mcaa.charting.page import page

    store.write(Path("chart.svg"), svg_of(whole(points, store)))
    store.write(Path("chart.png"), png_of(whole(points, store)))
    store.write(Path("chart.html"), page(points, store, left_out).encode())
    store.write_results(points, complete=True)


def _settings(subjects: list[Subject], methods: list[Method], budgets: list[int], seeds: int) -> dict[str, Any]:
    from torch_mcaa import __version__

    first = subjects[0]
    return {
        "scenes": {subject.name: subject.digest for subject in subjects},
        "size": list(first.size),
        "filter": repr(first.filter),
        "extent": None if first.extent is None else list(first.extent),
        "methods": {method.name: repr(getattr(method, "estimator", method)) for method in methods},
        "budgets": budgets,
        "seeds": seeds,
        "torch_mcaa": __version__,
        **machine(),
    }


def _check(functions: dict[str, Function], folder: object, estimators: object, budgets: Sequence[int], seeds: object) -> None:
    if not functions:
        raise McaaError("f must be a function, or a mapping with at least one, got an empty one; name a scene")
    if not all(isinstance(name, str) for name in functions):
        raise McaaError(f"f must be a function, or functions by name, got the names {list(functions)!r}; name them with strings")
    if not isinstance(folder, (str, os.PathLike)):
        raise McaaError(f"folder must be a path, got {folder!r}; pass a name such as 'mcaa-chart'")
    if len({plain(name) for name in functions}) < len(functions):
        raise McaaError(f"the names of the scenes must differ in letters and digits, got {', '.join(functions)}; rename one")
    if not (estimators is None or (isinstance(estimators, Mapping) and all(isinstance(e, Estimator) for e in estimators.values()))):
        raise McaaError(f"estimators must map names to estimators, such as {{'Shared()': Shared()}}, got {estimators!r}")
    if estimators is not None and len({plain(name) for name in (*estimators, *NAMES.values())}) < len(estimators) + len(NAMES):
        raise McaaError(f"the names of estimators must differ in letters and digits, got {', '.join(estimators)}; rename one")
    whole = isinstance(budgets, Sequence) and all(isinstance(b, int) and not isinstance(b, bool) and b > 0 for b in budgets)
    if not whole or not budgets or any(b <= a for a, b in pairwise(budgets)):
        raise McaaError(f"budgets must be increasing integers above 0, got {budgets!r}; for instance (4, 16, 64)")
    if isinstance(seeds, bool) or not isinstance(seeds, int) or seeds < 1:
        raise McaaError(f"seeds must be an integer of at least 1, got {seeds!r}; 3 is usual")
