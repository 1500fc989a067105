"""A numba `prange` kernel, with SVML, that does the shared lattice's whole job: evaluate, splat, standard error.

n points of a rank-1 lattice under one random shift, the same in every pixel; the Gaussian's taps of each, along x and then y; the sums over
the even and the odd points apart, whose difference, pooled over 3 x 3 pixels, is the standard error.
Fair: f is inlined and vectorised; each point is evaluated once but for the margin of a tile; a tile's samples and sums stay in the second-level
cache (tiles of 64 x 256 pixels were the fastest of 32 x 128 to 128 x 512); no pass over the picture is made twice;
`fastmath`; float32. Compiling is not timed.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
import torch

from torch_mcaa.patterns.lattice_search import best_generator

from .base import RADIUS, STD, Outcome
from .cases import Case
from .compiler import numba
from .kernels import compiled

ROWS, COLUMNS, REACH = 64, 256, 3
TAPS = 2 * REACH


@cache
def kernel(name: str) -> Any:
    nb, f = numba(), compiled(name)

    @nb.njit(fastmath=True, inline="always")
    def plane(
        image: Any, top: Any, left: Any, height: Any, width: Any, u: Any, v: Any, wx: Any, wy: Any, line: Any, rows: Any, n: Any
    ) -> None:
        """Add one plane of samples, at (u, v) in every pixel, to a tile of sums."""
        for r in range(height + TAPS - 1):
            y = np.float32(top + r - REACH) + v
            x = np.float32(left - REACH) + u
            for c in range(width + TAPS - 1):
                line[c] = f(x + np.float32(c), y, n)
            for c in range(width):
                total = wx[0] * line[c]
                for t in range(1, TAPS):
                    total += wx[t] * line[c + t]
                rows[r, c] = total
        for r in range(height):
            for c in range(width):
                total = wy[0] * rows[r, c]
                for t in range(1, TAPS):
                    total += wy[t] * rows[r + t, c]
                image[r, c] += total

    @nb.njit(fastmath=True, parallel=True)
    def sums(out: Any, square: Any, us: Any, vs: Any, wx: Any, wy: Any, n: Any) -> None:
        """out: (H, W) the values; square: (H, W) the squared half differences of the even and the odd points."""
        size_y, size_x = out.shape
        down, across = (size_y + ROWS - 1) // ROWS, (size_x + COLUMNS - 1) // COLUMNS
        for tile in nb.prange(down * across):
            top, left = tile // across * ROWS, tile % across * COLUMNS
            height, width = min(ROWS, size_y - top), min(COLUMNS, size_x - left)
            halves = np.zeros((2, ROWS, COLUMNS), np.float32)
            line = np.empty(COLUMNS + TAPS, np.float32)
            rows = np.empty((ROWS + TAPS, COLUMNS), np.float32)
            for k in range(len(us)):
                plane(halves[k % 2], top, left, height, width, us[k], vs[k], wx[k], wy[k], line, rows, n)
            for r in range(height):
                for c in range(width):
                    a, b = halves[0, r, c], halves[1, r, c]
                    out[top + r, left + c] = np.float32(0.5) * (a + b)
                    square[top + r, left + c] = np.float32(0.25) * (a - b) * (a - b)

    @nb.njit(fastmath=True, parallel=True)
    def pooled(square: Any, stderr: Any) -> None:
        height, width = square.shape
        for r in nb.prange(height):
            low, high = max(r - 1, 0), min(r + 1, height - 1)
            for c in range(width):
                a, b = max(c - 1, 0), min(c + 1, width - 1)
                total = square[low, a] + square[low, c] + square[low, b] + square[r, a] + square[r, c] + square[r, b]
                total += square[high, a] + square[high, c] + square[high, b]
                stderr[r, c] = math.sqrt(total * np.float32(1 / 9))

    return sums, pooled


def taps(offsets: np.ndarray, half: int) -> np.ndarray:
    """(n, TAPS) weights of the samples at `offsets` in the pixels -REACH to REACH - 1 around; their sum, over a half of the points, is 1."""
    d = np.arange(TAPS)[None, :] - REACH + offsets[:, None] - 0.5
    weight = np.exp(-0.5 * (d / STD) ** 2) * (np.abs(d) <= RADIUS)
    return weight / math.sqrt(half)


def picture(case: Case, spp: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Values and standard errors, (H, W) float32; spp is even."""
    generator, index = best_generator(spp - 1 + spp % 2, 1), np.arange(spp)
    shift = np.random.default_rng(seed).random(2)
    u, v = (generator * index / spp + shift[0]) % 1, (index / spp + shift[1]) % 1
    wx, wy = taps(u, 1), taps(v, 1)
    for half in (slice(0, None, 2), slice(1, None, 2)):
        wx[half] /= float((wx[half].sum(1) * wy[half].sum(1)).sum())
    sums, pooled = kernel(case.kernel)
    out, square, stderr = (np.empty((case.size, case.size), np.float32) for _ in range(3))
    sums(out, square, *(a.astype(np.float32) for a in (u, v, wx, wy)), case.numbers)
    pooled(square, stderr)
    return out, stderr


def render(case: Case, spp: int, seed: int) -> Outcome:
    tiles = math.ceil(case.size / ROWS), math.ceil(case.size / COLUMNS)
    margin = (case.size + tiles[0] * (TAPS - 1)) * (case.size + tiles[1] * (TAPS - 1))
    return Outcome(torch.from_numpy(picture(case, spp, seed)[0]), spp * margin)
