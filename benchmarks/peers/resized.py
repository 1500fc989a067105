"""`F.interpolate(antialias=True)` and scikit-image's `resize(anti_aliasing=True)` of a k x k supersampled grid.

PyTorch's antialiased "bilinear" is a tent of 1 px each way (standard deviation 0.41 px), the nearest to the Gaussian of 0.5 px that it has; the
"bicubic" one is further off. It is another filter: its error does not go to 0 with k.
scikit-image blurs with a Gaussian whose standard deviation is given as 0.5 px, and then reads one value a pixel, for which k is odd.
Fair: float32; the first in bands of rows; both without the grid's margin resampled.
"""

from __future__ import annotations

import math

import torch
from torch.nn.functional import interpolate

from .base import STD, Outcome
from .cases import Case
from .grid import MARGIN, bands, samples


def _evaluations(case: Case, k: int) -> int:
    return sum((rows.stop - rows.start + 2 * MARGIN) * (case.size + 2 * MARGIN) * k * k for rows in bands(case.size, k))


def interpolated(case: Case, spp: int, seed: int) -> Outcome:
    k, size = math.isqrt(spp), case.size
    image = torch.empty(size, size)
    for rows in bands(size, k):
        height = rows.stop - rows.start
        values = samples(case.scene, rows, size, k)[None, None]
        small = interpolate(values, (height + 2 * MARGIN, size + 2 * MARGIN), mode="bilinear", antialias=True)
        image[rows] = small[0, 0, MARGIN:-MARGIN, MARGIN:-MARGIN]
    return Outcome(image, _evaluations(case, k))


def scikit(case: Case, spp: int, seed: int) -> Outcome:
    from skimage.transform import resize

    k, size = math.isqrt(spp), case.size
    k += 1 - k % 2
    image = torch.empty(size, size)
    for rows in bands(size, k):
        values = samples(case.scene, rows, size, k).numpy()
        shape = (rows.stop - rows.start + 2 * MARGIN, size + 2 * MARGIN)
        # it cuts its Gaussian at 4 standard deviations
        small = resize(values, shape, order=0, anti_aliasing=True, anti_aliasing_sigma=STD * k)
        image[rows] = torch.from_numpy(small[MARGIN:-MARGIN, MARGIN:-MARGIN])
    return Outcome(image, _evaluations(case, k))
