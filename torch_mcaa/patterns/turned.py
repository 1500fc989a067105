"""Strip lattices for edges of known directions: a lattice samples an edge badly that one of its short dual vectors crosses."""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import numpy as np

from torch_mcaa.patterns.lattice import CHARACTER_RATIO
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
_GAIN = 1.5
"""How much less power edges must have on a lattice for it to be taken and not that of the longest shortest dual vector."""
_ELSEWHERE, _EVERYWHERE = 0.1, 7.0
"""The part of the edges that may have any direction, and `CHARACTER_RATIO` as foretold where all of them do, the same for all lattices."""


class Turned(NamedTuple):
    """(period, count, generator), and what the squares of the character sums are expected to be over the variance, for `CHARACTER_RATIO`."""

    strip: tuple[int, int, int]
    ratio: float


def angles() -> np.ndarray:
    """(DIRECTIONS,) of the normals."""
    return (np.arange(DIRECTIONS) / DIRECTIONS - 0.5) * math.pi


def turned(spp: float, edges: np.ndarray, rows: int) -> Turned:
    """The strip lattice of up to `spp` evaluations a pixel, one of each strip the audit's, that errs least on edges.

    A lattice that errs little on edges of some directions says so by its character sums only in part: these are edges' power on half of its
    dual vectors, which it was not chosen for.

    edges: (DIRECTIONS,) how much of them has each direction. rows: those of pixels to be covered, by whole strips.
    """
    strips, power, halves = _choices(spp)
    covered = np.array([math.ceil(rows / period) * period for period, _, _ in strips])
    # what points that are not needed would lower the variance by
    weighed = power * ((covered / rows) ** 1.5)[:, None]
    edges = edges / edges.sum()
    blurred = (1 - _ELSEWHERE) * edges + _ELSEWHERE / DIRECTIONS
    # of mirror images the normals are those of the edges mirrored
    mirrored = -np.arange(DIRECTIONS)
    score = np.concatenate([(weighed * some).sum(1) for some in (edges, edges[mirrored])])
    # ties must not hang on the last bits
    best = int(np.argmin((score / score.min()).round(6)))
    longest = 0 if score[0] <= score[len(strips)] else len(strips)
    if score[longest] < _GAIN * score[best]:
        best = longest
    number, mirror = best % len(strips), best >= len(strips)
    period, count, generator = strips[number]
    directions = blurred[mirrored] if mirror else blurred
    beside, own = (float((plane[number] * directions).sum()) for plane in (halves, power))
    ratio = CHARACTER_RATIO / _EVERYWHERE * beside / own
    return Turned((period, count, -generator % count if mirror else generator), ratio)


@cache
def _choices(spp: float) -> tuple[list[tuple[int, int, int]], np.ndarray, np.ndarray]:
    """The strips, that of the longest shortest dual vector first, and the power (strips, DIRECTIONS) that edges of each direction have on
    their dual vectors, and on the halves of these that are none.
    """
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
    duals = [dual_vectors(count, g, period) for period, count, g in kept]
    power = np.stack([edge_power(dual, angles()) for dual in duals])
    return kept, power, np.stack([edge_power(dual / 2, angles()) for dual in duals]) - power


def _shortest(count: int, period: int) -> np.ndarray:
    """The lengths of the shortest dual vectors for the generators 1 .. count // 2."""
    generators = np.arange(1, count // 2 + 1)
    most = math.ceil(1.1 * math.sqrt(count / period))
    first = np.arange(0, most + 1)[:, None]
    second = (-generators * first % count).astype(np.float64)
    second = np.minimum(second, count - second)
    second[0] = count
    return np.hypot(first, second / period).min(0)
