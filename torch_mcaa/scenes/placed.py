"""The built-in scenes, placed in a picture."""

from __future__ import annotations

import math

from torch_mcaa.errors import McaaError
from torch_mcaa.scenes.base import Scene
from torch_mcaa.scenes.disc import ColorDisc, Disc
from torch_mcaa.scenes.mandelbrot import Mandelbrot
from torch_mcaa.scenes.polygon import Polygon
from torch_mcaa.scenes.smooth import Blob, Highlights, Quadratic, Ramp
from torch_mcaa.scenes.straight import Checkerboard, Hairlines, HalfPlane, Stripe
from torch_mcaa.scenes.waves import Sinusoid, ZonePlate


def gallery(size: tuple[int, int]) -> dict[str, Scene]:
    """Every built-in scene by name, placed for a picture of (height, width) pixels.

    Centres and angles are off the pixel grid and off the axes, so that no picture is easy by accident. Values
    lie in [0, 1] but for `highlights`. Raises McaaError unless both sides are whole numbers above 0.
    """
    if len(size) != 2 or not all(isinstance(side, int) and side > 0 for side in size):
        raise McaaError(f"size must be (height, width), whole numbers above 0, got {size}: give those")
    height, width = size
    side = min(height, width)
    x, y = 0.5 * width + 0.13, 0.5 * height - 0.21

    def offset(angle: float) -> float:
        return x * math.cos(angle) + y * math.sin(angle)

    def outline(*polar: tuple[float, float]) -> Polygon:
        return Polygon(tuple((x + r * side * math.cos(a), y + r * side * math.sin(a)) for r, a in polar))

    star = [(0.42 if i % 2 == 0 else 0.17, 0.3 + math.pi * i / 5) for i in range(10)]
    disc = Disc(x, y, 0.37 * side)
    return {
        "half-plane": HalfPlane(0.4, offset(0.4)),
        "stripe": Stripe(1.1, offset(1.1), 0.3 * side),
        "disc": disc,
        "polygon": outline((0.45, 0.2), (0.4, 1.5), (0.35, 2.6), (0.44, 4.1), (0.3, 5.2)),
        "star": outline(*star),
        "checkerboard": Checkerboard(side / 6.3, (0.37, 0.61)),
        "fine-checkerboard": Checkerboard(2.3, (0.37, 0.61)),
        "sinusoid": Sinusoid(0.23, 0.11, 0.7),
        "zone-plate": ZonePlate(2 * math.pi / side, x, y),
        "ramp": Ramp(0.6 / width, 0.4 / height),
        "quadratic": Quadratic(x, y, 1.2 / width**2, 0.6 / (width * height), 1.0 / height**2, 0.2),
        "blob": Blob(x, y, 0.2 * side),
        "highlights": _highlights(height, width),
        "hairline": Stripe(0.3, offset(0.3), 0.1),
        "hairlines": Hairlines(1.9, _spread(offset(1.9), side), 0.1),
        "color-disc": ColorDisc(disc, (0.95, 0.45, 0.1), (0.05, 0.2, 0.5)),
        "mandelbrot": Mandelbrot(x, y, 0.38 * side),
    }


def _spread(centre: float, side: int) -> tuple[float, ...]:
    """Offsets either side of a centre, with gaps that grow by a third from 0.4 px."""
    offsets, distance, gap = [centre], 0.4, 0.4
    while distance < 0.45 * side:
        offsets += [centre - distance, centre + distance]
        gap *= 4 / 3
        distance += gap
    return tuple(offsets)


def _highlights(height: int, width: int) -> Highlights:
    """24 blobs of std 1/7 px and height 50, 500 or 5000 on 0.05, placed by the plastic number."""
    first, second = 0.7548776662466927, 0.5698402909980532
    places = ((width * ((0.5 + i * first) % 1), height * ((0.5 + i * second) % 1)) for i in range(24))
    return Highlights(tuple(Blob(x, y, 1 / 7, 50.0 * 10 ** (i % 3)) for i, (x, y) in enumerate(places)), 0.05)
