"""From cells to the lines of a chart: means over seeds, spreads, exponents."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

FLOAT32 = 8 * 2.0**-23
"""Of the magnitude of the values: an error this small may be one of rounding, in the sums or in f (a zone plate of 128 px has 5 of them)."""

_APART = 2
"""Times: costs that differ by less, as the seconds of small pictures do by chance, tell no exponent."""


@dataclass(frozen=True)
class Cell:
    """One run. Errors are root mean squares over the pixels that are not flat, all channels alike.

    Attributes:
        budget: evaluations a pixel that were allowed.
        evaluations: that f was asked for, over the number of pixels; margins included.
        seconds: wall time, the median of the repeats.
        rmse: of the picture.
        rmse_all: over all pixels.
        reported: standard error, what no sample met aside; None where the method reports none.
        reported_whole: with what no sample met.
        coverage: share of the values within 1.96 `reported_whole` of the truth.
    """

    scene: str
    method: str
    budget: int
    seed: int
    evaluations: float
    seconds: float
    rmse: float
    rmse_all: float
    reported: float | None
    reported_whole: float | None
    coverage: float | None


@dataclass(frozen=True)
class Point:
    """A method at a budget: over its seeds errors are root mean squares, seconds and evaluations medians; low and high are the extremes.

    Attributes:
        ratio: reported over true error; None where either is not known.
        limit: "truth" where the error is not above twice the truth's own, "float32" where it may be one of rounding, else "": what it is
            below that is not known.
        per_evaluation, per_second: p of error ~ cost^-p, fitted to the method's points of this scene without a limit; None for under 3.
    """

    scene: str
    method: str
    budget: int
    evaluations: float
    seconds: float
    seconds_low: float
    seconds_high: float
    rmse: float
    rmse_low: float
    rmse_high: float
    rmse_all: float
    reported: float | None
    reported_whole: float | None
    ratio: float | None
    coverage: float | None
    limit: str
    per_evaluation: float | None = None
    per_evaluation_error: float | None = None
    per_second: float | None = None
    per_second_error: float | None = None


def exponent(costs: Sequence[float], errors: Sequence[float]) -> tuple[float, float] | None:
    """p of error ~ cost^-p by least squares on logarithms, and its standard error; None for fewer than 3 points, or costs that are nearly one."""
    if len(costs) < 3 or max(costs) < _APART * min(costs):
        return None
    x, y = [math.log(c) for c in costs], [math.log(e) for e in errors]
    mx, my = statistics.fmean(x), statistics.fmean(y)
    spread = math.fsum((a - mx) ** 2 for a in x)
    slope = math.fsum((a - mx) * (b - my) for a, b in zip(x, y, strict=True)) / spread
    left = math.fsum((b - my - slope * (a - mx)) ** 2 for a, b in zip(x, y, strict=True))
    return -slope, math.sqrt(left / (len(x) - 2) / spread)


def summary(cells: Iterable[Cell], truths: Mapping[str, tuple[float, float]], methods: Sequence[str]) -> list[Point]:
    """The points of a chart: scene by scene, in the order of `methods`, by budget.

    truths: by scene the truth's typical error and the magnitude of its values.
    """
    groups: dict[tuple[str, str, int], list[Cell]] = {}
    for cell in cells:
        groups.setdefault((cell.scene, cell.method, cell.budget), []).append(cell)
    lines: dict[tuple[str, str], list[Point]] = {}
    for (scene, method, _), group in sorted(groups.items(), key=lambda item: item[0][2]):
        lines.setdefault((scene, method), []).append(_point(group, *truths[scene]))
    return [point for scene in truths for method in methods for point in _fitted(lines.get((scene, method), []))]


def _point(group: list[Cell], truth: float, magnitude: float) -> Point:
    first = group[0]
    rmse = _rms([cell.rmse for cell in group])
    reported = _rms_known([cell.reported for cell in group])
    limit = "truth" if rmse <= 2 * truth else "float32" if rmse <= FLOAT32 * magnitude else ""
    seconds = [cell.seconds for cell in group]
    coverage = [cell.coverage for cell in group if cell.coverage is not None]
    return Point(
        scene=first.scene,
        method=first.method,
        budget=first.budget,
        evaluations=statistics.median(cell.evaluations for cell in group),
        seconds=statistics.median(seconds),
        seconds_low=min(seconds),
        seconds_high=max(seconds),
        rmse=rmse,
        rmse_low=min(cell.rmse for cell in group),
        rmse_high=max(cell.rmse for cell in group),
        rmse_all=_rms([cell.rmse_all for cell in group]),
        reported=reported,
        reported_whole=_rms_known([cell.reported_whole for cell in group]),
        ratio=None if reported is None or limit else reported / rmse,
        coverage=statistics.fmean(coverage) if coverage else None,
        limit=limit,
    )


def _fitted(line: list[Point]) -> list[Point]:
    known = [point for point in line if not point.limit]
    errors = [point.rmse for point in known]
    found = {
        "per_evaluation": exponent([point.evaluations for point in known], errors),
        "per_second": exponent([point.seconds for point in known], errors),
    }
    values = {key: pair[0] for key, pair in found.items() if pair is not None}
    values |= {f"{key}_error": pair[1] for key, pair in found.items() if pair is not None}
    return [Point(**{**vars(point), **values}) for point in line]


def _rms(values: Sequence[float]) -> float:
    return math.sqrt(statistics.fmean(value * value for value in values))


def _rms_known(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return _rms(known) if known else None
