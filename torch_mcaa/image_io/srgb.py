"""The transfer curve of sRGB, IEC 61966-2-1."""

from __future__ import annotations

import torch
from torch import Tensor


def srgb_encode(linear: Tensor) -> Tensor:
    """Linear light to the sRGB curve, floats of any shape; 0 and 1 stay.

    Nothing is clipped: the power goes on above 1 and the line below 0, so `srgb_decode` undoes it.
    """
    power = 1.055 * linear.clamp(min=0.0031308).pow(1 / 2.4) - 0.055
    return torch.where(linear <= 0.0031308, 12.92 * linear, power)


def srgb_decode(encoded: Tensor) -> Tensor:
    """Inverse of `srgb_encode`, but for the 3e-8 by which the standard's two pieces miss each other."""
    power = ((encoded.clamp(min=0.04045) + 0.055) / 1.055).pow(2.4)
    return torch.where(encoded <= 0.04045, encoded / 12.92, power)
