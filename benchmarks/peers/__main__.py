"""`python -m benchmarks.peers`: every peer that is installed and our own, in one run and on the same scenes.

Prints errors, times, evaluations and the time to an RMSE of 2e-3 over the pixels that are not flat, and writes them to
`benchmarks/results/peers.json`. `--check` only says what is installed, and fails where a required peer is missing.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path

from rich.console import Console
from rich.table import Table

import torch_mcaa as mcaa

from . import CASES, PEERS
from .machine import facts
from .ours import COMPILED, OURS, uncompiled
from .race import TARGET, Runner, race

RESULTS = Path(__file__).parents[1] / "results"


def check(console: Console) -> bool:
    """Say which peers are installed; whether all required ones are."""
    for peer in PEERS:
        state = peer.installed or ("MISSING, required" if peer.required else "missing, optional")
        console.print(f"{peer.name:45} {peer.distribution:14} {state}", highlight=False)
    return all(peer.installed for peer in PEERS if peer.required)


def _seconds(value: float) -> str:
    return "not reached" if math.isinf(value) else f"{value:.3g}"


def _table(name: str, runners: list[Runner]) -> Table:
    table = Table("method", "evaluations a pixel", "RMSE", "seconds", f"seconds to {TARGET:g}", title=name)
    for runner in runners:
        if runner.error:
            table.add_row(runner.peer.name, "", "", "", runner.error)
        for number, point in enumerate(runner.points):
            last = _seconds(runner.time_to(TARGET)) if number + 1 == len(runner.points) else ""
            table.add_row(
                runner.peer.name if number == 0 else "",
                f"{point.evaluations:.1f}",
                f"{point.rmse:.1e}",
                f"{point.seconds:.3g}",
                last,
            )
    return table


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.peers", description=__doc__)
    parser.add_argument("--check", action="store_true")
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--repetitions", type=int, default=3)
    parser.add_argument("--cases", nargs="*", default=list(CASES), choices=list(CASES))
    arguments = parser.parse_args()
    console = Console(width=None if sys.stdout.isatty() else 132)
    whole = check(console)
    if arguments.check:
        sys.exit(0 if whole else 1)
    refused = uncompiled(mcaa.Shared())
    ours = OURS if refused else [*OURS, COMPILED]
    console.print(f"{COMPILED.name:45} {'':14} {'MISSING: ' + refused if refused else 'compiles'}", highlight=False)
    ready = [peer for peer in PEERS if peer.installed]
    summary = Table(
        "case", "best peer", "its seconds", "Auto()", "ratio", "our best", "ratio", title=f"seconds to an RMSE of {TARGET:g}"
    )
    report: dict[str, object] = {
        "machine": facts("torchquad", "vegas", "kornia", "scipy", "numba", "mitsuba", "scikit-image"),
        "size": arguments.size,
        "missing": [peer.name for peer in PEERS if not peer.installed] + ([COMPILED.name] if refused else []),
    }
    for name in arguments.cases:
        runners = race(CASES[name](arguments.size), ours + ready, arguments.repetitions)
        console.print(_table(name, runners))
        best = min(runners[len(ours) :], key=lambda runner: runner.time_to(TARGET))
        mine = min(runners[: len(ours)], key=lambda runner: runner.time_to(TARGET))
        auto, mines, theirs = (runner.time_to(TARGET) for runner in (runners[0], mine, best))
        summary.add_row(
            *(name, best.peer.name, _seconds(theirs), _seconds(auto), f"{auto / theirs:.3g}"),
            *(mine.peer.name, f"{mines / theirs:.3g}"),
        )
        report[name] = {
            "best peer": best.peer.name,
            "methods": {
                runner.peer.name: {
                    "seconds to target": None if math.isinf(runner.time_to(TARGET)) else round(runner.time_to(TARGET), 5),
                    "error": runner.error or None,
                    "budgets": [
                        {
                            "evaluations": round(p.evaluations, 2),
                            "rmse": float(f"{p.rmse:.3g}"),
                            "seconds": float(f"{p.seconds:.3g}"),
                        }
                        for p in runner.points
                    ],
                }
                for runner in runners
            },
        }
        # after every case, since all of them take long
        RESULTS.mkdir(exist_ok=True)
        (RESULTS / "peers.json").write_text(json.dumps(report, indent=1) + "\n", encoding="utf8")
    console.print(summary)


if __name__ == "__main__":
    main()
