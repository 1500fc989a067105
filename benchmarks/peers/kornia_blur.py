"""What people do by hand: a k x k grid in every pixel, `kornia.filters.gaussian_blur2d`, and every k-th value.

Fair: kornia blurs separably; k is odd, so that a sample lies in the middle of every pixel; the kernel ends where the others' does;
float32, in bands of rows.
"""

from __future__ import annotations

import math

import torch

from .base import RADIUS, STD, Outcome
from .cases import Case, Field
from .grid import BAND, MARGIN, bands, samples


def picture(f: Field, size: int, k: int, std: float = STD, band: int = BAND) -> torch.Tensor:
    """(size, size); k is odd."""
    from kornia.filters import gaussian_blur2d

    image, reach = torch.empty(size, size), 2 * int(RADIUS * k) + 1
    for rows in bands(size, k, band):
        # what it pads around the edges lies in the margin, but for half a pixel that weighs less than 1e-5
        blurred = gaussian_blur2d(samples(f, rows, size, k)[None, None], (reach, reach), (std * k, std * k))
        first = MARGIN * k + k // 2
        image[rows] = blurred[0, 0, first::k, first::k][: rows.stop - rows.start, :size]
    return image


def render(case: Case, spp: int, seed: int) -> Outcome:
    k = math.isqrt(spp)
    k += 1 - k % 2
    evaluations = sum((rows.stop - rows.start + 2 * MARGIN) * (case.size + 2 * MARGIN) * k * k for rows in bands(case.size, k))
    return Outcome(picture(case.scene, case.size, k), evaluations)
