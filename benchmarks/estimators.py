"""Every estimator against plain Monte Carlo: `python benchmarks/estimators.py [--pixels 4096] [--quick]` prints three tables.

Small pictures of random scenes, rendered with equal evaluations a pixel and compared with closed forms in float64: edges (half-planes, discs,
lines) in the pixels that they touch, and smooth functions (quadratics, blobs, slow sinusoids) in all pixels. What `Shared` evaluates around
a picture is not counted; it is 1.6 % of one of 512 x 512.

By a bootstrap over the scenes, the ratios of 4096 pixels have a relative standard error of 2 to 3 % on edges and 7 % on smooth functions, and those
of `Shared`, whose neighbouring pixels err alike, of up to 14 %.
"""

from __future__ import annotations

import argparse
import math
import statistics
import time
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache

import torch
from families import FAMILIES, FILTER, GROUPS, SIZE, SMALL, Draw, Score, cases

import torch_mcaa as mcaa
from torch_mcaa import scenes
from torch_mcaa.estimators import Estimator
from torch_mcaa.filters import Filter

COUNTS = (16, 64, 256)
PLAIN, DEFAULT = "Importance(Independent())", "Shared(Lattice())"
ESTIMATORS: dict[str, Estimator] = {
    PLAIN: mcaa.Importance(mcaa.Independent()),
    "Importance(Jittered())": mcaa.Importance(mcaa.Jittered()),
    "Importance(MultiJittered())": mcaa.Importance(mcaa.MultiJittered()),
    "Importance(Sobol())": mcaa.Importance(mcaa.Sobol()),
    "Importance(Lattice())": mcaa.Importance(mcaa.Lattice()),
    'Stratified(weights="balance")': mcaa.Stratified(weights="balance"),
    "Stratified()": mcaa.Stratified(),
    'Stratified((4, 4), counts="optimal")': mcaa.Stratified((4, 4), counts="optimal"),
    "AdaptiveImportance()": mcaa.AdaptiveImportance(),
    "AdaptiveImportance(density=Mixture)": mcaa.AdaptiveImportance(density=mcaa.Mixture),
    "ControlVariate()": mcaa.ControlVariate(),
    "OrderedStrata()": mcaa.OrderedStrata(),
    "Shared(Sobol())": mcaa.Shared(mcaa.Sobol()),
    DEFAULT: mcaa.Shared(mcaa.Lattice()),
}
FILTERS: dict[str, Filter] = {"box": mcaa.Box(), "Gauss(0.5)": FILTER}
COLUMNS: dict[str, tuple[Filter, str]] = {
    f"{name} {group}": (filter, group) for name, filter in FILTERS.items() for group in GROUPS
}
TOGETHER = {f"{name}, both": [f"{name} {group}" for group in GROUPS] for name in FILTERS}


@dataclass(frozen=True)
class Measured:
    """RMSE; and, where the standard error is finite, reported over true standard error and coverage; the share of pixels where it is not."""

    rmse: float
    ratio: float
    coverage: float
    infinite: float


@cache
def measured(name: str, n: int, draw: Draw, filter: Filter, pixels: int) -> Measured:
    """An estimator with n evaluations a pixel, over the pixels that count of the scenes that `draw` makes."""
    errors, reported = [], []
    for seed, case in enumerate(cases(draw, filter, pixels)):
        picture = _render(case.scene, SMALL, filter, ESTIMATORS[name], n, seed)
        errors.append((picture.image[0] - case.truth)[case.counted])
        reported.append(picture.stderr[0][case.counted])
    error, stderr = torch.cat(errors), torch.cat(reported)
    known = stderr.isfinite()
    score = Score.of(error[known], stderr[known])
    return Measured(Score.of(error, stderr).rmse, score.ratio, score.coverage, 1 - float(known.to(torch.float64).mean()))


def _render(scene: scenes.Scene, side: int, filter: Filter, estimator: Estimator, spp: int, seed: int) -> mcaa.Rendering:
    with warnings.catch_warnings():
        # of heavy tails; their standard error is +inf, and is counted
        warnings.simplefilter("ignore", mcaa.McaaWarning)
        return mcaa.render(scene, (side, side), filter=filter, estimator=estimator, spp=spp, seed=seed, dtype=torch.float64)


def against_plain(name: str, n: int, column: str, pixels: int) -> Measured | None:
    """RMSE over plain Monte Carlo's and the rest, the families of the column counted alike; None if n is too few for the estimator."""
    if ESTIMATORS[name].fewest > n:
        return None
    filter, group = COLUMNS[column]
    own, plain = ([measured(each, n, draw, filter, pixels) for draw in GROUPS[group]] for each in (name, PLAIN))
    return Measured(
        _root_mean_square([one.rmse / base.rmse for one, base in zip(own, plain, strict=True)]),
        _root_mean_square([one.ratio for one in own]),
        statistics.mean(one.coverage for one in own),
        statistics.mean(one.infinite for one in own),
    )


def _root_mean_square(values: Sequence[float]) -> float:
    return math.sqrt(statistics.mean(value * value for value in values))


def timed(spp: int, side: int, runs: int) -> dict[str, tuple[float, float, float]]:
    """ns an evaluation, the same over plain Monte Carlo's and over f's alone: medians over runs that take turns.

    Of `render` as it comes, float32 and Gaussian(0.5), with standard errors; a disc on side x side pixels.
    """
    scene = scenes.Disc(side / 2, side / 2, side / 3)
    x, y = torch.rand(2, 1 << 17, generator=torch.Generator().manual_seed(1)) * side

    def clocked(work: Callable[[], object]) -> float:
        began = time.perf_counter()
        work()
        return time.perf_counter() - began

    def nanoseconds(estimator: Estimator) -> float:
        def work() -> None:
            mcaa.render(scene, (side, side), estimator=estimator, spp=spp)

        return clocked(work) / (side * side * spp) * 1e9

    taken: dict[str, list[tuple[float, float, float]]] = {name: [] for name in ESTIMATORS}
    for run in range(runs + 1):
        for name, estimator in ESTIMATORS.items():
            # each beside its own comparison, since a busy machine changes its pace
            alone = min(clocked(lambda: scene(x, y)) for _ in range(3)) / x.numel() * 1e9
            plain, own = nanoseconds(ESTIMATORS[PLAIN]), nanoseconds(estimator)
            if run:
                taken[name].append((own, 1.0 if name == PLAIN else own / plain, own / alone))
    return {
        name: (statistics.median(a), statistics.median(b), statistics.median(c))
        for name, (a, b, c) in ((name, zip(*rows, strict=True)) for name, rows in taken.items())
    }


def allocated(family: str, scene_count: int, repeats: int, spp: int = 64) -> dict[str, tuple[float, float]]:
    """(mean, largest) variance of a pixel over that with equal counts, each a mean over scenes, by allocation.

    The largest is that of the pixel which has the largest mean square error in one half of the repetitions, measured in the other half:
    the largest of many noisy figures would be too large.
    """
    kinds = {"Uniform()": mcaa.Uniform(), "EqualVariance()": mcaa.EqualVariance(), "Neyman()": mcaa.Neyman()}
    generator = torch.Generator().manual_seed(20260103)
    centre = torch.arange(SIZE, dtype=torch.float64) + 0.5
    sums = {name: [0.0, 0.0] for name in kinds}
    for scene in [FAMILIES[family](generator) for _ in range(scene_count)]:
        truth = scene.exact(centre, centre[:, None], FILTER)
        for name, kind in kinds.items():
            pictures = [
                _render(scene, SIZE, FILTER, mcaa.Importance(mcaa.Independent(), allocation=kind), spp, seed)
                for seed in range(repeats)
            ]
            squares = torch.stack([(picture.image[0] - truth).square() for picture in pictures]).flatten(1)
            halves = squares[::2].mean(0), squares[1::2].mean(0)
            sums[name][0] += float(squares.mean())
            sums[name][1] += float(halves[0][halves[1].argmax()] + halves[1][halves[0].argmax()]) / 2
    mean, largest = sums["Uniform()"]
    return {name: (own[0] / mean, own[1] / largest) for name, own in sums.items() if name != "Uniform()"}


def _shown(value: float) -> str:
    return f"{value:.2f}" if 0.095 <= value < 99.5 else f"{value:.1e}" if value < 1e-4 or value > 9999 else f"{value:.2g}"


def _row(cells: Iterable[str]) -> None:
    print("| " + " | ".join(cells) + " |", flush=True)


def _heading(cells: Sequence[str]) -> None:
    print()
    _row(cells)
    print("|" + "---|" * len(cells))


def _quality(one: Measured | None) -> str:
    if one is None:
        return "–"
    return f"{_shown(one.ratio)}, {one.coverage:.1%}" + (f" ({one.infinite:.1%} +inf)" if one.infinite else "")


def _conclusion(rows: dict[str, dict[str, list[Measured | None]]]) -> None:
    """The least of every column at each n, and under each filter that of both its columns, their root mean square."""
    best: dict[str, list[str]] = {}
    for index, n in enumerate(COUNTS):
        said = []
        for title, columns in {**{column: [column] for column in COLUMNS}, **TOGETHER}.items():
            together = {}
            for name, row in rows.items():
                found = [one.rmse for column in columns if (one := row[column][index]) is not None]
                if found:
                    together[name] = _root_mean_square(found)
            name = min(together, key=together.__getitem__)
            best.setdefault(title, []).append(name)
            said.append(f"{title} `{name}` {_shown(together[name])}")
        print(f"Least at {n} a pixel: {'; '.join(said)}.")
    for title in TOGETHER:
        won = [str(n) for n, name in zip(COUNTS, best[title], strict=True) if name == DEFAULT]
        lost = [f"{n} (`{name}`)" for n, name in zip(COUNTS, best[title], strict=True) if name != DEFAULT]
        verdict = " and ".join(
            [*([f"least at {', '.join(won)}"] if won else []), *([f"not least at {', '.join(lost)}"] if lost else [])]
        )
        print(f"{title}: `{DEFAULT}`, which is what `Auto()` chooses, is {verdict} a pixel.")


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pixels", type=int, default=4096, help="of each column; of the edges, those that an edge touches")
    parser.add_argument("--quick", action="store_true", help="an eighth of the pixels, and fewer repetitions of the rest")
    asked = parser.parse_args(arguments)
    pixels = max(1, asked.pixels // 8) if asked.quick else asked.pixels
    print(f"torch {torch.__version__}, {torch.get_num_threads()} threads, {pixels} pixels of each column")

    _heading([f"RMSE over plain Monte Carlo's, {' / '.join(map(str, COUNTS))} a pixel", *COLUMNS])
    rows: dict[str, dict[str, list[Measured | None]]] = {}
    for name in ESTIMATORS:
        rows[name] = {column: [against_plain(name, n, column, pixels) for n in COUNTS] for column in COLUMNS}
        errors = ([None if one is None else one.rmse for one in by_n] for by_n in rows[name].values())
        _row([f"`{name}`", *(" / ".join("–" if error is None else _shown(error) for error in by_n) for by_n in errors)])

    times = timed(64, 16 if asked.quick else 96, 1 if asked.quick else 5)
    _heading(
        [
            "reported / true standard error, coverage of the 95 % interval; 64 a pixel",
            *COLUMNS,
            *("ns per evaluation", "/ of plain Monte Carlo", "/ of f alone"),
        ]
    )
    for name, by_column in rows.items():
        ns, over_plain, over_f = times[name]
        quality = (_quality(by_n[COUNTS.index(64)]) for by_n in by_column.values())
        _row([f"`{name}`", *quality, f"{ns:.0f}", f"{over_plain:.2f}", f"{over_f:.0f}"])

    _heading(["variance over that of equal counts: mean, largest pixel; 64 a pixel, Gauss(0.5)", *FAMILIES])
    shares = {family: allocated(family, *((1, 2) if asked.quick else (6, 16))) for family in FAMILIES}
    for name in next(iter(shares.values())):
        cells = (", ".join(map(_shown, by_name[name])) for by_name in shares.values())
        _row([f"`Importance(Independent(), allocation={name})`", *cells])

    print()
    _conclusion(rows)


if __name__ == "__main__":
    main()
