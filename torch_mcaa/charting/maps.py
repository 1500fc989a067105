"""Pictures and maps of a chart's page as PNG: what is seen, the error and the evaluations on logarithmic scales."""

from __future__ import annotations

import io
import math

import numpy as np
import torch
from torch import Tensor

from torch_mcaa.charting.truth import Truth
from torch_mcaa.image_io import to_srgb8

SIDE = 256
"""The page shows the middle of a larger picture."""
DECADES = 7
"""Of the error's scale, which ends at the range of the values."""
BEYOND = 4
"""Times the largest budget, where the scale of evaluations ends; it begins at 1."""
_LEVELS = 64


def picture_png(image: Tensor, truth: Truth) -> bytes:
    """(C, H, W) on the sRGB curve; values outside 0..1 by more than a quarter are scaled to the truth's range, all pictures alike."""
    low, high = float(truth.value.min()), float(truth.value.max())
    shown = _middle(image).double()
    if low < -0.25 or high > 1.25:
        shown = (shown - low) / (high - low or 1.0)
    pixels = to_srgb8(shown if len(shown) in (1, 3, 4) else shown[:1])
    return _png(pixels[..., 0] if pixels.shape[-1] == 1 else pixels)


def error_map(image: Tensor, truth: Truth) -> bytes:
    """Root mean square over the channels of the difference from the truth, over the range of its values."""
    error = _middle((image.double() - truth.value).square().mean(0).sqrt() / truth.span)
    return _mapped(1 + torch.log10(error.clamp_min(1e-30)) / DECADES, "magma")


def evaluations_map(spp: Tensor, most: int) -> bytes:
    """(H, W) evaluations in each pixel; `most` is the largest budget."""
    return _mapped(torch.log(_middle(spp).double().clamp_min(1)) / math.log(BEYOND * most), "viridis")


def scale(name: str) -> list[str]:
    """The colours of a map from low to high, as #rrggbb."""
    return [f"#{red:02x}{green:02x}{blue:02x}" for red, green, blue in _palette(name)]


def _middle(plane: Tensor) -> Tensor:
    top, left = (max(0, (side - SIDE) // 2) for side in plane.shape[-2:])
    return plane[..., top : top + SIDE, left : left + SIDE]


def _palette(name: str) -> list[tuple[int, ...]]:
    from matplotlib import colormaps

    colors = colormaps[name](np.linspace(0, 1, _LEVELS))[:, :3]
    return [tuple(round(255 * c) for c in color) for color in colors]


def _mapped(plane: Tensor, name: str) -> bytes:
    levels = (plane.clamp(0, 1) * (_LEVELS - 1)).round().to(torch.uint8).numpy()
    return _png(levels, [c for color in _palette(name) for c in color])


def _png(pixels: np.ndarray, palette: list[int] | None = None) -> bytes:
    from PIL import Image

    picture = Image.fromarray(pixels)
    if palette is not None:
        picture = picture.convert("P")
        picture.putdata(pixels.reshape(-1).tolist())
        picture.putpalette(palette)
    buffer = io.BytesIO()
    picture.save(buffer, "png", optimize=True)
    return buffer.getvalue()
