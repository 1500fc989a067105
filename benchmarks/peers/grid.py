"""k x k samples in every pixel, in bands of rows that stay in the cache: what several peers begin with."""

from __future__ import annotations

import torch
from torch import Tensor

from .base import RADIUS
from .cases import Field

MARGIN = 2
"""Whole pixels around the picture; the filter reaches half a pixel less far from the outermost pixels' own sides."""
BAND = 2**20
"""Samples at a time; fastest of 2^17 to 2^21 with 1 MiB of second-level cache a core."""


def taps(k: int, std: float) -> Tensor:
    """The Gaussian at the samples that a pixel sees, over their sum."""
    d = (torch.arange((2 * MARGIN + 1) * k) + 0.5) / k - MARGIN - 0.5
    weight = torch.exp(-0.5 * (d / std) ** 2) * (d.abs() <= RADIUS)
    return weight / weight.sum()


def places(first: int, pixels: int, k: int) -> Tensor:
    """Along one axis, from the pixel `first` on."""
    return first + (torch.arange(pixels * k) + 0.5) / k


def samples(f: Field, rows: slice, width: int, k: int) -> Tensor:
    """f on the grid of some rows of pixels and `MARGIN` around them, ((rows + 2 MARGIN) k, (width + 2 MARGIN) k)."""
    x = places(-MARGIN, width + 2 * MARGIN, k)
    y = places(rows.start - MARGIN, rows.stop - rows.start + 2 * MARGIN, k)
    return f(x[None, :].expand(len(y), -1), y[:, None].expand(-1, len(x)))


def bands(size: int, k: int, band: int = BAND) -> list[slice]:
    rows = max(4, band // (k * k * (size + 2 * MARGIN)))
    return [slice(start, min(start + rows, size)) for start in range(0, size, rows)]
