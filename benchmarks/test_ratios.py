"""`pytest benchmarks --benchmark-only`: the ratios of `ratios.py` against the stored ones. `--store` makes what is measured the baseline.

Ratios are stored for each number of threads and compared with those of the same. One fails when it is over 1.3 times its baseline by more than
three of its own spreads. What it should reach is printed beside it; what cannot be measured here is missing, with the reason.
"""

from __future__ import annotations

import json
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
import torch

pytest.importorskip("pytest_benchmark")
if not (find_spec("numba") and find_spec("scipy")):
    pytest.skip("the ratios want numba and scipy: pip install '.[bench,test]'", allow_module_level=True)

# what the rows need is looked for first
from ratios import ROWS, Missing, Row, verdict

BASELINE = Path(__file__).parent / "results" / "baseline.json"


def stored() -> dict[str, Any]:
    """What is stored for this number of threads."""
    everything = json.loads(BASELINE.read_text(encoding="utf8")) if BASELINE.exists() else {}
    return everything.get(f"{torch.get_num_threads()} threads", {})


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name.replace(" ", "-"))
def test_ratio(row: Row, benchmark: Any, request: pytest.FixtureRequest) -> None:
    table = request.config.stash[request.config.ratios]  # type: ignore[attr-defined]
    try:
        found = benchmark.pedantic(row.measure, rounds=1)
    except Missing as missing:
        table.append((row, None, None, str(missing)))
        pytest.skip(str(missing))
    before = stored().get("ratios", {}).get(row.name, {}).get("ratio")
    benchmark.extra_info.update(ratio=found.value, spread=found.spread, baseline=before, reach=row.reach)
    said = verdict(found, before, row.reach)
    table.append((row, found, before, said))
    assert said != "WORSE", f"{row.name}: {found.value:.3g} +- {found.spread:.2g}, stored {before:.3g}"
