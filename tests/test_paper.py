"""The walk through the paper: what its closed forms predict is what the library does, within 5 %.

Squared errors over many pixels have a mean that scatters about the variance; each row of the example says by how much, and every row
that is compared here is known to a third of its tolerance or better. All seeds are fixed.
"""

from __future__ import annotations

import importlib.util
import math
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import torch

from torch_mcaa.image_io import read_image

EXAMPLE = Path(__file__).parents[1] / "examples" / "paper.py"


@pytest.fixture(scope="module")
def paper() -> Iterator[ModuleType]:
    spec = importlib.util.spec_from_file_location("examples_paper", EXAMPLE)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # where dataclasses look up annotations
    spec.loader.exec_module(module)
    yield module
    del sys.modules[spec.name]


def close(row: Any, tolerance: float = 0.05, slack: float = 0.0) -> None:
    """Within the tolerance, and within 4 standard errors (1 in 16,000) of what is right but for `slack`."""
    assert row.spread <= tolerance / 3, row
    assert abs(row.ratio - 1) < min(tolerance, 4 * row.spread + slack), row


@pytest.mark.parametrize("b", [0.13, 0.2, 0.4, (0.3, 0.6)])
@pytest.mark.parametrize("centre", [(0.0, 0.0), (0.2, -0.1)])
def test_second_moment_is_the_integral(paper: ModuleType, b: float | tuple[float, float], centre: tuple[float, float]):
    """(11), (13) against a trapezoidal rule over 16 standard deviations of w² / w', exact to rounding for such an integrand."""
    t = torch.linspace(-60, 60, 60_001, dtype=torch.float64)
    wanted = 1.0
    for v, d in zip(b if isinstance(b, tuple) else (b, b), centre, strict=True):
        exponent = -t.square() / paper.A + (t - d).square() / (2 * v)
        wanted *= float(exponent.exp().sum() * (t[1] - t[0])) * math.sqrt(v) / (paper.A * math.sqrt(2 * math.pi))
    assert paper.second_moment(b, centre) == pytest.approx(wanted, rel=1e-9)


def test_second_moment_is_infinite_for_narrow_strata(paper: ModuleType):
    """(28) with two strata or more: 2 b <= a."""
    assert paper.second_moment(paper.A / 2) == paper.second_moment(paper.A / 4) == math.inf


@pytest.mark.parametrize("equation", [29, 30])
def test_moments_as_printed_are_the_closed_forms(paper: ModuleType, equation: int):
    """w is cut at 5 std and scaled up by 6e-7 an axis; what is left out of the integral is below 1e-4."""
    if equation == 29:
        printed, b = paper.printed_moment(0.4, (1.25, 0.8)), (0.4 / 1.25**2, 0.4 / 0.8**2)
        assert printed == pytest.approx(paper.second_moment(b), rel=1e-4)
    else:
        printed = paper.printed_moment(0.8, m=2, centre=(0.25, 0.0))
        assert printed == pytest.approx(paper.second_moment(0.4, (0.25, 0.0)), rel=1e-4)


@pytest.mark.parametrize("part", ["importance", "stratified"])
def test_10_and_12(paper: ModuleType, part: str):
    """Rows of variances and of means: f = 1 under normal densities, half-planes, (29) and (30) as printed."""
    rows = getattr(paper, part)()
    assert len(rows) >= 6
    for row in rows:
        close(row)


def test_balance_heuristic(paper: ModuleType):
    """V for narrow and for matched strata."""
    narrow, matched = paper.balance()
    close(narrow)
    close(matched)
    assert narrow.predicted > 3 * matched.predicted


def test_17(paper: ModuleType):
    """Optimal counts chosen from a pilot of 32 in each stratum; (17) is a lower bound that they miss by 1 or 2 %."""
    whole, equal, observed = paper.between_strata()
    assert whole.ratio == pytest.approx(1, abs=1e-3)
    assert equal.ratio > 1.2
    close(observed, slack=0.02)


def test_20(paper: ModuleType):
    (row,) = paper.both()
    close(row, slack=0.02)


def test_15_and_neyman(paper: ModuleType):
    """φ(1 - φ) / n_h of the counts that were given has no noise; the errors have, some 1 %."""
    common, largest, total, least = paper.between_pixels()
    close(common, slack=0.02)
    close(total, slack=0.01)
    # flat pixels take two evaluations each, and counts within 7 % of each other are evened out
    assert 1 <= largest.ratio < 1.5
    assert 1 <= least.ratio < 1.08
    assert largest.ratio < 1.09 and least.ratio < 1.02


def test_pilots(paper: ModuleType):
    """Fixed weights and the second round alone are right within 4 standard errors; pooled is not, and says so."""
    *unbiased, pooled = paper.pilots()
    assert all(abs(row.ratio - 1) < 4 * row.spread < 0.04 for row in unbiased)
    assert pooled.ratio < 0.9
    assert "Rendering.bias" in pooled.what and not any("Rendering.bias" in row.what for row in unbiased)


def test_sign_of_the_control_variate(paper: ModuleType):
    plus, minus = paper.signs()
    close(plus)
    close(minus)
    assert minus.predicted == plus.predicted - 2 * 2


def test_crude(paper: ModuleType):
    for row in paper.crude():
        close(row, 0.07)


def test_gains(paper: ModuleType):
    """Every strategy is below independent importance sampling in mean squared error, but for strata by (28); by 5 standard errors."""
    rows = {row.what: row for row in paper.gains() if "largest" not in row.what}
    narrow = next(what for what in rows if "(28)" in what)
    assert rows.pop(narrow).ratio > 1.5
    for row in rows.values():
        assert row.ratio + (2 if "matched" in row.what else 5) * row.spread < 1, row
    assert rows["quadratic: ControlVariate()"].ratio < 1e-9


def test_refusals(paper: ModuleType):
    crude, narrow, minus, biased = paper.refusals()
    assert "reaches 2.5 px" in crude
    assert "inf" in narrow and "too narrow" in narrow
    assert "(3)" in minus and "does not hold" in minus
    assert "Rendering.bias" in biased and "box of the pixel" in biased


def test_pictures(paper: ModuleType, tmp_path: Path):
    """Three panels with both stages of each allocation, two with known variances; the pilot is one grey, the second stage is not."""
    known, stages = (read_image(path) for path in paper.pictures(tmp_path, side=24, spp=16))
    panel = 4 * 24 + 8
    assert known.shape == (1, 2 * panel, 2 * panel)
    assert stages.shape == (1, 2 * panel, 3 * panel)
    inner = stages[0, 4 : panel - 4]
    pilot, second = inner[:, panel + 4 : 2 * panel - 4], inner[:, 2 * panel + 4 : 3 * panel - 4]
    assert float(pilot.std()) < 1e-6 < float(pilot.mean())
    assert float(second.max()) == 1 > float(second.min())


def test_table(paper: ModuleType, capsys: pytest.CaptureFixture[str]):
    rows: list[Any] = [paper.Row("(10)", "what", 2.0, 3.0, 0.25)]
    show: Callable[..., None] = paper.table
    show("Title", "predicted", "observed", rows)
    title, row = capsys.readouterr().out.strip().splitlines()
    assert title.split() == ["Title", "predicted", "observed", "ratio", "±"]
    assert row.split() == ["(10)", "what", "2", "3", "1.500", "0.250"]
    assert math.isclose(rows[0].ratio, 1.5)
