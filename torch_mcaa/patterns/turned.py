"""Strip lattices for edges of known directions: a lattice samples an edge badly that one of its short dual vectors crosses."""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from torch_mcaa.patterns.lattice_search import dual_vectors, edge_power

DIRECTIONS = 64
"""Of edges' normals, from -pi / 2 to pi / 2."""
FEWEST = 3
"""Points a pixel from which on there are lattices to choose from."""
_PERIODS, _LARGE = 8, 64
"""Px: the strips' heights, one to so many; up to a third of them from so many points a pixel on."""
_SPARED = 0.1
"""How many evaluations a pixel fewer than another a strip may have: its count is odd, and one point is the audit's."""
_SHORTEST, _MANY = 0.93, 48
"""How short a shortest dual vector may be, in parts of the longest, which smooth f need; and how many lattices are kept."""


def angles() -> np.ndarray:
    """(DIRECTIONS,) of the normals."""
    return (np.arange(DIRECTIONS) / DIRECTIONS - 0.5) * math.pi


def turned(spp: float, edges: np.ndarray) -> tuple[int, int, int]:
    """(period, count, generator) of the strip lattice of up to `spp` evaluations a pixel, one of each strip the audit's, that errs least.

    edges: (DIRECTIONS,) how much of them has each direction.
    """
    strips, power = _choices(spp)
    edges = edges / edges.sum()
    # of mirror images the normals are those of the edges mirrored
    score = np.stack([(power * some).sum(1) for some in (edges, edges[-np.arange(DIRECTIONS)])])
    # ties must not hang on the last bits
    best = int(np.argmin((score / score.min()).round(6)))
    period, count, generator = strips[best % len(strips)]
    return period, count, generator if best < len(strips) else -generator % count


@cache
def _choices(spp: float) -> tuple[list[tuple[int, int, int]], np.ndarray]:
    """The strips, and the power (strips, DIRECTIONS) that edges of each direction have on their dual vectors."""
    # points that leave one of the strip's evaluations, and are odd
    counts = {
        period: (math.floor(spp * period) - 2) // 2 * 2 + 1 for period in range(1, 1 + _PERIODS // (1 if spp <= _LARGE else 3))
    }
    usable = [(count, period) for period, count in counts.items() if count >= max(3, period)]
    most = max((count + 1) / period for count, period in usable)
    found = [
        (length, period, count, generator)
        for count, period in usable
        if (count + 1) / period >= most - _SPARED
        for generator, length in enumerate(_shortest(count, period), 1)
    ]
    longest = max(found)[0]
    kept = [each[1:] for each in sorted(found, reverse=True)[:_MANY] if each[0] >= _SHORTEST * longest]
    return kept, np.stack([edge_power(dual_vectors(count, g, period), angles()) for period, count, g in kept])


def _shortest(count: int, period: int) -> np.ndarray:
    """The lengths of the shortest dual vectors for the generators 1 .. count // 2."""
    generators = np.arange(1, count // 2 + 1)
    most = math.ceil(1.1 * math.sqrt(count / period))
    first = np.arange(0, most + 1)[:, None]
    second = (-generators * first % count).astype(np.float64)
    second = np.minimum(second, count - second)
    second[0] = count
    return np.hypot(first, second / period).min(0)
