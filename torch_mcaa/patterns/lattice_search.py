"""The search for the generators in `lattice_table.py`: `python -m torch_mcaa.patterns.lattice_search` prints the table anew.

A strip lattice has `count` points (g i / count mod 1, period i / count), i = 0 .. count - 1, in a strip one pixel wide and `period` pixels
high, and repeats with that strip. Under a random shift the variance of the lattice rule is the sum of the power of f w over the dual
lattice {k : g k_x + period k_y = 0 mod count} without 0 (Sloan and Joe, Lattice Methods for Multiple Integration, 1994). For a straight edge at
angle t and a Gaussian w of standard deviation s that power is known: it falls as exp(-(2 pi s k_t)^2) along the edge and as k_n^-2 across it.
So a generator is good when its short dual vectors are long (smooth f) and lie off the directions in which people draw (edges).
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np

_STD = 0.5
_AXIS = np.array([0.0, math.pi / 2])
_NEAR = np.concatenate([_AXIS[:1] + np.linspace(-0.05, 0.05, 9), _AXIS[1:] + np.linspace(-0.05, 0.05, 9)])
_DIAGONAL = np.array([math.pi / 4, 3 * math.pi / 4])
_STEPS = np.stack(np.meshgrid(np.arange(-7, 8), np.arange(-7, 8)), -1).reshape(-1, 2)
_STEPS = _STEPS[(_STEPS != 0).any(1)]


def reduced_basis(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The two shortest independent vectors of the lattice spanned by a and b (Lagrange and Gauss)."""
    if a @ a > b @ b:
        a, b = b, a
    while True:
        b = b - round(float(a @ b) / float(a @ a)) * a
        if b @ b >= a @ a * (1 - 1e-12):
            return a, b
        a, b = b, a


def dual_vectors(count: int, generator: int, period: int) -> np.ndarray:
    """(M, 2) shortest non-zero dual vectors (cycles per pixel in x, y) of a strip lattice, in no particular order."""
    a, b = reduced_basis(np.array([1.0, -generator / period]), np.array([0.0, count / period]))
    return _STEPS @ np.stack([a, b])


def edge_power(dual: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """(A,): the variance of the lattice rule on an edge of 1, with its normal at each of the angles, from the power on the dual vectors."""
    normal = np.stack([np.cos(angles), np.sin(angles)])
    across, along = dual @ normal, dual @ np.stack([-normal[1], normal[0]])
    power = np.exp(-((2 * math.pi * _STD * along) ** 2)) / (4 * math.pi**2 * (across**2 + 0.1))
    return power.sum(0) * 0.5642


def _edge_error(dual: np.ndarray, angles: np.ndarray) -> float:
    return math.sqrt(edge_power(dual, angles).mean())


def badness(count: int, generator: int, period: int) -> float:
    """The worst of four errors over what a lattice of that density does on average: axis, near-axis, diagonal edges, high tones."""
    density = count / period
    dual = dual_vectors(count, generator, period)
    shortest = math.sqrt((dual**2).sum(1).min())
    tones = (1.035 * math.sqrt(density) / shortest) ** 5
    if tones > 2:
        return tones
    typical = 0.146 * density**-0.75
    return max(
        tones,
        _edge_error(dual, _AXIS) / (0.63 * typical),
        _edge_error(dual, _NEAR) / (0.42 * typical),
        _edge_error(dual, _DIAGONAL) / (1.2 * typical),
    )


@cache
def ranked_generators(count: int, period: int) -> list[tuple[float, int]]:
    """(badness, generator) of the strip lattices of `count` points in 1 x `period` pixels, the best first; mirror images left out.

    Generators with a factor in common with `count` put several points on one column, which smooth f in one pixel suffers from.
    """
    if count < 3:
        return [(math.inf, 1 % count)]
    usable = [g for g in range(1, count // 2 + 1) if period > 1 or math.gcd(g, count) == 1]
    return sorted((badness(count, g, period), g) for g in usable)


def best_generator(count: int, period: int) -> int:
    """The generator of the best strip lattice of `count` points in 1 x `period` pixels."""
    return ranked_generators(count, period)[0][1]


def search(spp: int, periods: range = range(1, 9)) -> tuple[int, int, int]:
    """(period, count, generator) for `spp` evaluations a pixel; count is odd, and no row of pixels is without a point.

    At least one evaluation of each strip is left over for an audit, but for spp = 1, which has none to spare.

    >>> search(16)
    (7, 111, 29)
    """
    candidates = []
    for period in periods:
        count = period if spp == 1 else spp * period - 1 - (spp * period) % 2
        if count % 2 and count >= max(period, 3):
            score, generator = ranked_generators(count, period)[0]
            # fewer points a pixel are paid for as the edges' n^-0.75 has it
            candidates.append((score * (spp * period / count) ** 0.75, period, count, generator))
    return min(candidates)[1:]


def tabulated() -> list[int]:
    """The numbers of evaluations a pixel for which the table has a generator."""
    return [*range(1, 65), *range(72, 129, 8), *range(144, 257, 16), 320, 384, 448, 512, 640, 768, 896, 1024]


if __name__ == "__main__":
    for spp in tabulated():
        print(f"    {spp}: {search(spp, range(1, 9) if spp <= 64 else range(1, 4 if spp <= 256 else 2))},", flush=True)
