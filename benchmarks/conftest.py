"""The table of ratios at the end of `pytest benchmarks --benchmark-only`, and `--store`."""

from __future__ import annotations

import json
import math
from typing import Any

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--store", action="store_true", help="make the ratios measured the stored baseline")


def pytest_configure(config: pytest.Config) -> None:
    config.ratios = pytest.StashKey[list[Any]]()  # type: ignore[attr-defined]
    config.stash[config.ratios] = []  # type: ignore[attr-defined]


@pytest.hookimpl(trylast=True)
def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    table = config.stash[config.ratios]  # type: ignore[attr-defined]
    if not table:
        return
    terminalreporter.section("ratios: ours over theirs")
    terminalreporter.write_line(f"{'':62} {'now':>7} {'spread':>7} {'stored':>7} {'reach':>7}")
    for row, found, before, verdict in table:
        now = (f"{found.value:7.3f}", f"{found.spread:7.3f}") if found else ("missing", "")
        stored = "" if before is None else f"{before:7.3f}"
        reach = "" if row.reach == math.inf else f"{row.reach:.3f}"
        terminalreporter.write_line(f"{row.name:62} {now[0]:>7} {now[1]:>7} {stored:>7} {reach:>7}  {verdict}")
    if config.getoption("--store"):
        _store(table)


def _store(table: list[Any]) -> None:
    from peers.machine import facts
    from test_ratios import BASELINE, stored

    everything = json.loads(BASELINE.read_text(encoding="utf8")) if BASELINE.exists() else {}
    machine = facts("numba", "scipy")
    ratios = stored().get("ratios", {})
    for row, found, _, _ in table:
        if found:
            ratios[row.name] = {"ratio": float(f"{found.value:.3g}"), "spread": float(f"{found.spread:.1g}")}
    everything[f"{machine['threads']} threads"] = {"machine": machine, "ratios": ratios}
    BASELINE.write_text(json.dumps(everything, indent=1) + "\n", encoding="utf8")
