"""Exact pixel values of a texture that covers the screen, nearest or bilinear, under a box or a Gaussian.

Along one axis the texture is a sum of texels times B(s x - j - 1/2), s texels a pixel, B a unit box (nearest) or a unit tent
(bilinear). A pixel's value is linear in the texels, Wy @ image @ Wx.T with W[h, j] = ∫ B(s x - j - 1/2) profile(x - c_h) dx. A box
is a difference of steps and a tent a second difference of ramps, whose integrals against the profile are

    tail(t) = ∫_{d > t} profile(d) dd            rest(t) = ∫_{d > t} (d - t) profile(d) dd = ∫_t^∞ tail
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor


class Profile(NamedTuple):
    """A one-dimensional filter of integral 1: its tail, the integral of its tail, and how far it reaches (pixels)."""

    tail: Callable[[Tensor], Tensor]
    rest: Callable[[Tensor], Tensor]
    reach: float


def box(width: float) -> Profile:
    """1 / width over |d| <= width / 2."""

    def rest(t: Tensor) -> Tensor:
        inside = (width / 2 - t.clamp(min=-width / 2)).clamp(min=0)
        return inside**2 / (2 * width) + (-width / 2 - t).clamp(min=0)

    return Profile(lambda t: (0.5 - t / width).clamp(0, 1), rest, width / 2)


def gaussian(std: float, radius: float = math.inf) -> Profile:
    """Normal density cut at `radius` R and renormalised: ∫_t^R (d - t) φ(d/σ)/σ dd = σ (φ(t/σ) - φ(R/σ)) - t (Φ(R/σ) - Φ(t/σ))."""
    # an uncut normal is 0 in float64 beyond 39 standard deviations
    reach = min(radius, 39 * std)
    edge = torch.tensor(reach / std, dtype=torch.float64)
    mass = 1 - 2 * torch.special.ndtr(-edge)

    def density(z: Tensor) -> Tensor:
        return torch.exp(-z * z / 2) / math.sqrt(2 * math.pi)

    def tail(t: Tensor) -> Tensor:
        return (torch.special.ndtr(-(t / std).clamp(-edge, edge)) - torch.special.ndtr(-edge)) / mass

    def rest(t: Tensor) -> Tensor:
        z = (t / std).clamp(-edge, edge)
        return std * (density(z) - density(edge)) / mass - t * tail(t)

    return Profile(tail, rest, reach)


def weights(pixels: int, texels: int, profile: Profile, interpolation: str, wrap: str) -> Tensor:
    """(pixels, texels) float64: what each texel of one axis contributes to each pixel; the screen covers the texture once."""
    scale = texels / pixels
    first = math.floor(scale * (0.5 - profile.reach)) - 1
    last = math.ceil(scale * (pixels - 0.5 + profile.reach)) + 1
    virtual = torch.arange(first, last + 1)
    centre = torch.arange(pixels, dtype=torch.float64) + 0.5
    # where the virtual texel's centre lies, in pixels from the pixel's centre
    place = (virtual.double() + 0.5)[None, :] / scale - centre[:, None]
    half = 0.5 / scale
    if interpolation == "nearest":
        virtual_weights = profile.tail(place - half) - profile.tail(place + half)
    else:
        before, at, after = (profile.rest(place + shift) for shift in (-2 * half, 0, 2 * half))
        virtual_weights = scale * (before - 2 * at + after)
    real = [real_texel(int(j), texels, wrap) for j in virtual]
    kept = torch.tensor([j is not None for j in real])
    target = torch.tensor([j for j in real if j is not None])
    return torch.zeros(pixels, texels, dtype=torch.float64).index_add(1, target, virtual_weights[:, kept])


def pixel_values(image: Tensor, size: tuple[int, int], profile: Profile, interpolation: str, wrap: str) -> Tensor:
    """(C, H, W) float64: the exact picture of a (C, h, w) texture on a screen of `size` pixels; f goes on beyond the screen."""
    down = weights(size[0], image.shape[-2], profile, interpolation, wrap)
    across = weights(size[1], image.shape[-1], profile, interpolation, wrap)
    return down @ image.double() @ across.T


def real_texel(j: int, n: int, wrap: str) -> int | None:
    """The texel that virtual texel j stands for, by walking: None is a texel of 0."""
    if wrap == "zeros":
        return j if 0 <= j < n else None
    if wrap == "border":
        return min(max(j, 0), n - 1)
    if wrap == "repeat":
        return j % n
    tile, inside = divmod(j, n)
    return n - 1 - inside if tile % 2 else inside
