"""The picture of a texture that covers the screen once, by `kornia.filters.filter2d` with exactly integrated kernels.

Of h texels for H pixels, in lowest terms p texels for q pixels, every q-th pixel lies at the same place of its texel: one kernel for each
of the q x q places, whose weights are integrals of the filter against a texel's box (nearest) or tent (bilinear), and of its result every
p-th value.
"""

from __future__ import annotations

import math

import kornia
import texture_truth
import torch
from texture_truth import Profile
from torch import Tensor


def tent(radius: float = 1.0) -> Profile:
    """(1 - |d|/r)/r: its integrals beyond t are (1 - z)^2 / 2 and r (1 - z)^3 / 6 for z = t / r in [0, 1], and by symmetry."""

    def tail(t: Tensor) -> Tensor:
        z = (t / radius).clamp(-1, 1)
        return torch.where(z >= 0, (1 - z) ** 2 / 2, 1 - (1 + z) ** 2 / 2)

    def rest(t: Tensor) -> Tensor:
        z = (t / radius).clamp(-1, 1)
        return radius * torch.where(z >= 0, (1 - z) ** 3 / 6, (1 + z) ** 3 / 6 - z) + (-radius - t).clamp(min=0)

    return Profile(tail, rest, radius)


PROFILES = {"box": texture_truth.box(1.0), "tent": tent(), "gaussian": texture_truth.gaussian(0.5, 2.5)}


def kernel(profile: Profile, scale: float, place: float, interpolation: str) -> Tensor:
    """Weights of the texels around the one in which a pixel's centre lies, `place` beyond its left edge; `scale` texels a pixel."""
    half, reach = 0.5 / scale, math.ceil(scale * profile.reach + 1.5)
    texels = (torch.arange(-reach, reach + 1, dtype=torch.float64) + 0.5 - place) / scale
    if interpolation == "nearest":
        return profile.tail(texels - half) - profile.tail(texels + half)
    before, at, after = (profile.rest(texels + shift) for shift in (-2 * half, 0, 2 * half))
    return scale * (before - 2 * at + after)


def filtered(image: Tensor, size: tuple[int, int], profile: Profile, interpolation: str) -> Tensor:
    """(C, H, W) of a texture (C, h, w), float64; the last texel goes on beyond the border."""
    places = []
    for texels, pixels in zip(image.shape[-2:], size, strict=True):
        common = math.gcd(texels, pixels)
        cycle = [(k, (k + 0.5) * texels / pixels) for k in range(pixels // common)]
        kernels = [(k, math.floor(at), kernel(profile, texels / pixels, at % 1, interpolation)) for k, at in cycle]
        places.append((texels // common, pixels // common, kernels))
    (down, high, rows), (over, wide, cols) = places
    out = image.new_zeros(image.shape[0], *size)
    for row, first_row, vertical in rows:
        for col, first_col, horizontal in cols:
            whole = kornia.filters.filter2d(image[None], (vertical[:, None] * horizontal)[None], border_type="replicate")[0]
            out[:, row::high, col::wide] = whole[:, first_row::down, first_col::over]
    return out
