"""The scenes of `cases.py` as scalar functions f(x, y, numbers) that numba inlines and vectorises; float32."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np

from .compiler import numba

ONE, ZERO, HALF = np.float32(1), np.float32(0), np.float32(0.5)


def stripe(x: Any, y: Any, n: Any) -> Any:
    return ONE if abs(x * n[0] + y * n[1] - n[2]) <= n[3] else ZERO


def disc(x: Any, y: Any, n: Any) -> Any:
    dx, dy = x - n[0], y - n[1]
    return ONE if dx * dx + dy * dy <= n[2] * n[2] else ZERO


def polygon(x: Any, y: Any, n: Any) -> Any:
    """Five sides, turning the same way: inside is on one side of each."""
    inside = ONE
    for side in range(5):
        ax, ay, bx, by = n[4 * side], n[4 * side + 1], n[4 * side + 2], n[4 * side + 3]
        inside = inside if (bx - ax) * (y - ay) - (by - ay) * (x - ax) >= ZERO else ZERO
    return inside


def zone_plate(x: Any, y: Any, n: Any) -> Any:
    dx, dy = x - n[1], y - n[2]
    return HALF + HALF * math.cos(n[0] * (dx * dx + dy * dy))


def two_tones(x: Any, y: Any, n: Any) -> Any:
    first, second = math.cos(n[0] * x + n[1] * y + n[2]), math.cos(n[3] * x + n[4] * y + n[5])
    return HALF + np.float32(0.25) * (first + second)


def grain(x: Any, y: Any, n: Any) -> Any:
    column, row = np.int32(math.floor(x * n[0])) & np.int32(255), np.int32(math.floor(y * n[0])) & np.int32(255)
    return n[1 + row * np.int32(256) + column]


@cache
def compiled(name: str) -> Any:
    return numba().njit(inline="always", fastmath=True)(globals()[name])
