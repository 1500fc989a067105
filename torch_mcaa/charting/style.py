"""How the methods of a chart are told apart: colours of Okabe and Ito (2008), line styles by family, markers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from torch_mcaa.charting.instead import NAMES, Way
from torch_mcaa.charting.methods import ESTIMATORS

INK = "#010203"
"""Text, axes and what is neither one colour nor another: the page replaces it by its own."""


GLYPHS = {"o": "●", "s": "■", "D": "◆", "^": "▲", "v": "▼", "<": "◀", ">": "▶"}
"""The markers as text."""


GROUND = "#fdfeff"
"""Within hollow points; likewise."""


@dataclass(frozen=True)
class Style:
    """Of one method's line."""

    color: str
    dashes: str
    marker: str
    width: float


_KNOWN = {
    "Auto()": Style("#0072b2", "-", "o", 2.4),
    "JumpCorrected()": Style("#56b4e9", "-", "s", 1.3),
    "Shared(Lattice())": Style("#d55e00", "-", "o", 2.4),
    "Shared(Sobol())": Style("#e69f00", "-", "s", 1.3),
    "Importance(Sobol())": Style("#009e73", "-", "^", 1.3),
    "Importance(Independent())": Style("#009e73", ":", "v", 1.3),
    "Stratified()": Style("#cc79a7", "-", "D", 1.3),
    "AdaptiveImportance()": Style("#cc79a7", ":", "s", 1.3),
    "ControlVariate()": Style("#8a63a8", "-", "<", 1.3),
    "OrderedStrata()": Style("#8a63a8", ":", ">", 1.3),
    "Crude(biased_ok=True)": Style("#999999", ":", "D", 1.3),
}
assert list(_KNOWN) == list(ESTIMATORS)
_INSTEAD: dict[Way, Style] = {
    "blur": Style(INK, "--", "s", 1.3),
    "stride": Style(INK, "--", "o", 1.3),
    "resize": Style("#999999", "--", "D", 1.3),
}
_CYCLE = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#8a63a8"]
_MARKERS = "osD^v<>"


def styles(methods: Sequence[str]) -> dict[str, Style]:
    """By name of method; those of a user's own names take colours in turn."""
    known = {**_KNOWN, **{NAMES[way]: style for way, style in _INSTEAD.items()}}
    new = [name for name in methods if name not in known]
    turns = {name: Style(_CYCLE[i % 7], ("-", ":")[i // 7 % 2], _MARKERS[i % 7], 1.6) for i, name in enumerate(new)}
    return {name: known.get(name) or turns[name] for name in methods}
