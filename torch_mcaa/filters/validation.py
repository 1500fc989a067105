"""Checks of what a user passes to the constructor of a filter or a density."""

from __future__ import annotations

from numbers import Real

from torch_mcaa.errors import McaaError

SMALLEST, LARGEST = 1e-6, 1e6


def number(owner: str, name: str, value: object, low: float, high: float, mend: str) -> float:
    """`value` as a float when it is a number in [low, high], else McaaError."""
    if not isinstance(value, Real) or isinstance(value, bool) or not low <= float(value) <= high:
        raise McaaError(f"{owner}: {name} must be a number in [{low:g}, {high:g}]; received {value!r}: {mend}")
    return float(value)


def pixels(owner: str, name: str, value: object, mend: str) -> float:
    """`value` as a length in pixels. Lengths beyond [1e-6, 1e6] are refused: powers of them leave float32."""
    return number(owner, name, value, SMALLEST, LARGEST, mend)


def integer(owner: str, name: str, value: object, low: int, high: int, mend: str) -> int:
    """`value` as an int when it is a whole number in [low, high], else McaaError."""
    checked = number(owner, name, value, low, high, mend)
    if checked % 1 != 0:
        raise McaaError(f"{owner}: {name} must be a whole number in [{low}, {high}]; received {value!r}: {mend}")
    return int(checked)
