"""When steep ramps of an f are looked for, which costs more than a step of training does."""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Iterator
from typing import Any

_DEPTH = 3


class Looks:
    """The calls of every f so far, by what it runs."""

    def __init__(self) -> None:
        self._calls: Counter[int] = Counter()

    def due(self, f: object) -> bool:
        """Whether it is f's first, second, fourth, eighth ... call: ramps may get steeper as it is trained."""
        code = hash(_code(f, _DEPTH))
        self._calls[code] += 1
        return self._calls[code].bit_count() == 1


def _code(f: object, depth: int) -> Hashable:
    """What f runs: its own code, and that of the functions that it was made around."""
    around = tuple(_code(inner, depth - 1) for inner in _held(f) if callable(inner)) if depth else ()
    return getattr(f, "__code__", type(f)), around


def _held(f: object) -> Iterator[Any]:
    for name in ("func", "__wrapped__"):
        if hasattr(f, name):
            yield getattr(f, name)
    for cell in getattr(f, "__closure__", None) or ():
        try:
            yield cell.cell_contents
        except ValueError:
            # a variable that has no value yet
            continue
