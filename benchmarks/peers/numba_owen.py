"""A numba `prange` kernel, with SVML: per pixel, Owen-scrambled Sobol' points drawn from w, mean and second moment.

Fair: hash, Gaussian's inverse, f and moments are one loop over the pixels of a row, which is vectorised, and samples are the outer loop; the
inverse is Giles's single-precision polynomial, cheaper than any library call; nothing but two rows of sums is written;
`fastmath`; float32. Compiling is not timed.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
import torch

from .base import STD, Outcome
from .cases import Case
from .compiler import numba
from .kernels import compiled
from .sobol import reversed_bits
from .sobol_pixels import WITHIN


@cache
def kernel(name: str) -> Any:
    nb, f = numba(), compiled(name)
    u32, f32 = np.uint32, np.float32

    @nb.njit(inline="always")
    def scrambled(x: Any, seed: Any) -> Any:
        """Laine and Karras's hash of reversed bits (Burley 2020), and the bits turned round."""
        x = u32(x + seed)
        x = u32(x ^ u32(x * u32(0x6C50B47C)))
        x = u32(x ^ u32(x * u32(0xB82F1E52)))
        x = u32(x ^ u32(x * u32(0xC7AFE638)))
        x = u32(x ^ u32(x * u32(0x8D22F6E6)))
        x = u32(((x >> u32(1)) & u32(0x55555555)) | ((x & u32(0x55555555)) << u32(1)))
        x = u32(((x >> u32(2)) & u32(0x33333333)) | ((x & u32(0x33333333)) << u32(2)))
        x = u32(((x >> u32(4)) & u32(0x0F0F0F0F)) | ((x & u32(0x0F0F0F0F)) << u32(4)))
        x = u32(((x >> u32(8)) & u32(0x00FF00FF)) | ((x & u32(0x00FF00FF)) << u32(8)))
        return u32((x >> u32(16)) | (x << u32(16)))

    @nb.njit(inline="always")
    def hashed(x: Any) -> Any:
        x = u32(x ^ (x >> u32(16)))
        x = u32(x * u32(0x7FEB352D))
        x = u32(x ^ (x >> u32(15)))
        x = u32(x * u32(0x846CA68B))
        return u32(x ^ (x >> u32(16)))

    @nb.njit(inline="always", fastmath=True)
    def normal(bits: Any) -> Any:
        """std times the inverse of the cut normal distribution function (Giles, 2010)."""
        p = f32(np.int32(bits)) * f32(WITHIN * 2.0**-31)
        w = -math.log((f32(1) - p) * (f32(1) + p))
        a, b = w - f32(2.5), math.sqrt(w) - f32(3)
        near, far = f32(2.81022636e-08), f32(-0.000200214257)
        for c in (
            3.43273939e-07,
            -3.5233877e-06,
            -4.39150654e-06,
            0.00021858087,
            -0.00125372503,
            -0.00417768164,
            0.246640727,
            1.50140941,
        ):
            near = near * a + f32(c)
        for c in (
            0.000100950558,
            0.00134934322,
            -0.00367342844,
            0.00573950773,
            -0.0076224613,
            0.00943887047,
            1.00167406,
            2.83297682,
        ):
            far = far * b + f32(c)
        return (near if w < f32(5) else far) * p * f32(STD * math.sqrt(2))

    @nb.njit(fastmath=True, parallel=True)
    def moments(first: Any, second: Any, mean: Any, square: Any, seed: Any, n: Any) -> None:
        height, width = mean.shape
        for r in nb.prange(height):
            total, squares = np.zeros(width, np.float32), np.zeros(width, np.float32)
            row = u32(seed + u32(r) * u32(0x9E3779B9))
            for k in range(len(first)):
                for c in range(width):
                    one = hashed(u32(row ^ u32(c)))
                    dx = normal(scrambled(first[k], one))
                    dy = normal(scrambled(second[k], hashed(one)))
                    value = f(f32(c) + f32(0.5) + dx, f32(r) + f32(0.5) + dy, n)
                    total[c] += value
                    squares[c] += value * value
            for c in range(width):
                mean[r, c] = total[c] / f32(len(first))
                square[r, c] = squares[c] / f32(len(first))

    return moments


def picture(case: Case, spp: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Means and mean squares, (H, W) float32."""
    mean, square = (np.empty((case.size, case.size), np.float32) for _ in range(2))
    kernel(case.kernel)(*reversed_bits(spp), mean, square, np.uint32(seed), case.numbers)
    return mean, square


def render(case: Case, spp: int, seed: int) -> Outcome:
    return Outcome(torch.from_numpy(picture(case, spp, seed)[0]), spp * case.size**2)
