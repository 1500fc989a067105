"""benchmarks/estimators.py: its tables have their rows, and its figures are those of the theory."""

from __future__ import annotations

import json
import math
from pathlib import Path

import estimators
import pytest
import torch
from estimators import COLUMNS, COUNTS, DEFAULT, ESTIMATORS, FILTERS, PLAIN, against_plain, allocated, measured
from families import FAMILIES, FILTER, GROUPS, SIZE, cases

PIXELS = 768


def _ratio(name: str, n: int, column: str) -> float:
    found = against_plain(name, n, column, PIXELS)
    assert found is not None
    return found.rmse


def _cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip().strip("|").split(" | ")]


def test_the_command_prints_every_row_and_concludes_from_them(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(estimators, "FAMILIES", {family: FAMILIES[family] for family in ("random edges", "discs")})
    monkeypatch.setattr(estimators, "GROUPS", {group: draws[:1] for group, draws in GROUPS.items()})
    estimators.main(["--quick", "--pixels", "8"])
    tables = [part.splitlines() for part in capsys.readouterr().out.strip().split("\n\n")[1:]]
    errors, quality, allocations, conclusion = tables
    for table in (errors, quality):
        assert [_cells(line)[0] for line in table[2:]] == [f"`{name}`" for name in ESTIMATORS]
        assert _cells(table[0])[1:5] == list(COLUMNS)
    assert len(allocations) == 2 + 2 and all(len(_cells(line)) == len(_cells(allocations[0])) for line in allocations[2:])

    figures = {}
    for line, name in zip(errors[2:], ESTIMATORS, strict=True):
        rows = [cell.split(" / ") for cell in _cells(line)[1:]]
        for row in rows:
            assert [figure == "–" for figure in row] == [ESTIMATORS[name].fewest > n for n in COUNTS]
        figures[name] = [[math.nan if figure == "–" else float(figure) for figure in row] for row in rows]
    assert figures[PLAIN] == [[1.0] * len(COUNTS)] * len(COLUMNS)
    for k, n in enumerate(COUNTS):
        said = conclusion[k].removeprefix(f"Least at {n} a pixel: ").split("; ")
        for c, column in enumerate(COLUMNS):
            least = min(row[c][k] for row in figures.values() if not math.isnan(row[c][k]))
            _, name, shown = said[c].removesuffix(".").split("`")
            assert said[c].startswith(column) and float(shown) == least == figures[name][c][k]
    assert [line.startswith(f"{name}, both: `{DEFAULT}`") for line, name in zip(conclusion[3:], FILTERS, strict=True)] == [
        True,
        True,
    ]


@pytest.mark.parametrize("draw", GROUPS["EDGE"])
def test_plain_monte_carlo_has_the_variance_of_a_binomial(draw):
    # the mean square of N normal errors has a relative standard deviation of sqrt(2 / N), and its root half of that; 4.5 sigma for 4, since
    # the errors of unlike pixels have a little more kurtosis
    made = cases(draw, FILTERS["box"], PIXELS)
    truth = torch.cat([case.truth[case.counted] for case in made])
    expected = float((truth * (1 - truth)).mean().div(64).sqrt())
    assert len(truth) >= PIXELS / 3
    assert measured(PLAIN, 64, draw, FILTERS["box"], PIXELS).rmse == pytest.approx(expected, rel=4.5 / math.sqrt(2 * len(truth)))


@pytest.mark.parametrize(("name", "n", "expected"), [("Importance(Jittered())", 16, 1 / 4), ("Importance(Jittered())", 64, 1 / 8)])
def test_jitter_divides_the_error_of_a_linear_function_by_the_cells_of_an_axis(name, n, expected):
    # 4 sigma of a ratio of two root mean squares over 3 x 768 pixels is 8 %; that the scenes bend a little within a pixel, as much again
    assert _ratio(name, n, "box SMOOTH") == pytest.approx(expected, rel=0.16)


def test_two_by_two_strata_halve_the_error_of_a_linear_function():
    assert _ratio("Stratified()", 64, "box SMOOTH") == pytest.approx(1 / 2, rel=0.16)


def test_published_figures():
    # 768 pixels an edge touches: the ratio has a relative standard deviation of 5 % (kurtosis of the errors of stratified points about 5),
    # and the angles of 15 scenes a family as much again; 3 sigma of both is 21 %
    assert _ratio("Importance(Jittered())", 64, "box EDGE") == pytest.approx(0.44, rel=0.21)
    assert _ratio("Importance(Sobol())", 64, "box EDGE") == pytest.approx(0.38, rel=0.21)
    assert _ratio("Importance(Sobol())", 64, "Gauss(0.5) SMOOTH") <= 0.25
    assert _ratio(DEFAULT, 64, "Gauss(0.5) EDGE") < 0.2
    # a lattice of 64 points integrates these exactly
    assert _ratio(DEFAULT, 64, "Gauss(0.5) SMOOTH") < 1e-11


def test_allocation_gains_no_more_than_the_theory_allows():
    # the closed form of the scene that `allocated` draws first; Neyman's least mean variance over that of equal counts
    scene = FAMILIES["random edges"](torch.Generator().manual_seed(20260103))
    centre = torch.arange(SIZE, dtype=torch.float64) + 0.5
    truth = scene.exact(centre, centre[:, None], FILTER)
    variance = truth * (1 - truth)
    least = float(variance.clamp_min(0).sqrt().mean().square() / variance.mean())
    # 8 repetitions of some 80 pixels: 4 sigma of the ratio of two mean squares is 32 %
    for mean, _ in allocated("random edges", 1, 8).values():
        assert 0.68 * least < mean < 0.6


def test_the_readme_has_the_times_of_the_baseline():
    """Every row of its table of times is one of `benchmarks/results/baseline.json` on two threads, and every one of these is there."""
    root = Path(__file__).parents[1]
    table = (root / "README.md").read_text(encoding="utf8").split("<!-- times -->")[1].split("<!-- end of times -->")[0]
    baseline = json.loads((root / "benchmarks" / "results" / "baseline.json").read_text(encoding="utf8"))
    said = dict(_cells(line) for line in table.strip().splitlines()[2:])
    assert said == {
        name: " ± ".join(f"{value:.2g}" if value < 10 else f"{value:.0f}" for value in (row["ratio"], row["spread"]) if value)
        for name, row in baseline["2 threads"]["ratios"].items()
    }
