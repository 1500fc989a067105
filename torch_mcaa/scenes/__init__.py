"""Integrands whose pixel values are known: what the checks, the charts and `mcaa demo` render.

A scene is called like any integrand, `scene(x, y)`; `scene.exact(cx, cy, filter)` is the value of the pixel
centred there.
"""

from __future__ import annotations

from torch_mcaa.scenes.base import Scene
from torch_mcaa.scenes.disc import ColorDisc, Disc
from torch_mcaa.scenes.mandelbrot import Mandelbrot
from torch_mcaa.scenes.placed import gallery
from torch_mcaa.scenes.polygon import Polygon
from torch_mcaa.scenes.smooth import Blob, Highlights, Quadratic, Ramp
from torch_mcaa.scenes.straight import Checkerboard, Hairlines, HalfPlane, Stripe
from torch_mcaa.scenes.waves import Sinusoid, ZonePlate

__all__ = [
    "Blob",
    "Checkerboard",
    "ColorDisc",
    "Disc",
    "Hairlines",
    "HalfPlane",
    "Highlights",
    "Mandelbrot",
    "Polygon",
    "Quadratic",
    "Ramp",
    "Scene",
    "Sinusoid",
    "Stripe",
    "ZonePlate",
    "gallery",
]
