"""Functions that jump where a parameter says, with their pictures in closed form, on 12 x 12 pixels: what `gradients.py` measures."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

import torch_mcaa as mcaa
from torch_mcaa.filters import Filter
from torch_mcaa.grid import Screen
from torch_mcaa.integrand import Function
from torch_mcaa.scenes import Checkerboard, Disc, HalfPlane, Polygon

SIZE = (12, 12)
STEP = 1e-4
"""Of the central difference: its error is of the order of 1e-8."""
GAUSSIAN = mcaa.Gaussian(0.5, radius=4.0)

Point = tuple[float, float]
Make = Callable[[Tensor], Function]
Picture = Callable[[float], Tensor]
"""The parameter to (C, H, W), in closed form."""


@dataclass(frozen=True)
class Case:
    """A function with one parameter.

    Attributes:
        asked: the standard deviation of its derivative image that was asked for, in per cent.
        inner: its values depend on the parameter too, not only its edges.
    """

    name: str
    make: Make
    picture: Picture
    theta: float
    asked: float = math.nan
    inner: bool = False
    filter: Filter = GAUSSIAN

    def derivative(self) -> Tensor:
        """(C, H, W): the true derivative image."""
        return (self.picture(self.theta + STEP) - self.picture(self.theta - STEP)) / (2 * STEP)


def centres() -> tuple[Tensor, Tensor]:
    """(1, W) and (H, 1)."""
    x, y = Screen.of(SIZE).centres()
    return x[None, :], y[:, None]


def _half_plane(angle: float, offset: float) -> Tensor:
    return HalfPlane(angle, offset).exact(*centres(), GAUSSIAN)[None]


def _position(theta: Tensor) -> Function:
    return lambda x, y: (x * math.cos(0.4) + y * math.sin(0.4) > theta).to(x.dtype)


def _power(theta: Tensor) -> Function:
    step = _position(theta)
    return lambda x, y: (0.2 + 0.7 * step(x, y)) ** 4


def _rotation(theta: Tensor) -> Function:
    return lambda x, y: ((x - 5.3) * torch.cos(theta) + (y - 6.4) * torch.sin(theta) >= 0).to(x.dtype)


def _disc(theta: Tensor) -> Function:
    return lambda x, y: (torch.hypot(x - 6.1, y - 5.8) < theta).to(x.dtype)


def _disc_picture(theta: float) -> Tensor:
    return Disc(6.1, 5.8, theta).exact(*centres(), GAUSSIAN)[None]


def _ring(width: float) -> Make:
    return lambda theta: lambda x, y: ((torch.hypot(x - 6.1, y - 5.8) - theta).abs() < width / 2).to(x.dtype)


def _board(theta: Tensor) -> Function:
    """theta: squares a pixel."""
    return lambda x, y: 1 - torch.remainder(torch.floor((x - 0.37) * theta) + torch.floor((y - 0.61) * theta), 2)


def _board_picture(theta: float) -> Tensor:
    return Checkerboard(2 / theta, (0.37, 0.61)).exact(*centres(), GAUSSIAN)[None]


def _nested(theta: Tensor) -> Function:
    """Two conditions in a turned frame, and a colour that depends on the parameter too."""
    cosine, sine = math.cos(0.4), math.sin(0.4)

    def f(x: Tensor, y: Tensor) -> Tensor:
        u, v = x * cosine + y * sine, y * cosine - x * sine
        inner = torch.where(v > 2.3 - 0.5 * theta, 0.9 + 0.8 * theta, 0.3)
        return torch.where(u > 7.1 + theta, inner, 0.1 * torch.ones_like(x))

    return f


def _nested_picture(theta: float) -> Tensor:
    (x, y), cosine, sine = centres(), math.cos(0.4), math.sin(0.4)
    first = torch.special.ndtr((x * cosine + y * sine - 7.1 - theta) / GAUSSIAN.std)
    second = torch.special.ndtr((y * cosine - x * sine - 2.3 + 0.5 * theta) / GAUSSIAN.std)
    return (0.1 + first * (0.3 + (0.6 + 0.8 * theta) * second - 0.1))[None]


COLOURS = (0.1, 0.9, 0.4, 0.7, 0.2)


def _two(theta: float) -> tuple[Point, ...]:
    return ((3.1 + theta, 3.4), (8.7, 7.6))


def _five(theta: float) -> tuple[Point, ...]:
    return ((3.1 + theta, 3.4), (8.7, 2.6 + theta), (6.2, 6.5), (2.4, 9.1 - theta), (9.3, 8.8))


def _voronoi(sites: Callable[..., tuple[Point, ...]]) -> Make:
    """The colour of the nearest site."""

    def make(theta: Tensor) -> Function:
        placed = sites(theta)

        def f(x: Tensor, y: Tensor) -> Tensor:
            nearest = torch.stack([(x - px) ** 2 + (y - py) ** 2 for px, py in placed]).argmin(0)
            return torch.tensor(COLOURS, dtype=x.dtype)[nearest]

        return f

    return make


def _voronoi_picture(sites: Callable[[float], tuple[Point, ...]]) -> Picture:
    def picture(theta: float) -> Tensor:
        placed, total = sites(theta), torch.zeros(SIZE, dtype=torch.float64)
        for k, (ax, ay) in enumerate(placed):
            others = [(bx, by) for j, (bx, by) in enumerate(placed) if j != k]
            planes = [(bx - ax, by - ay, (bx * bx + by * by - ax * ax - ay * ay) / 2) for bx, by in others]
            total += COLOURS[k] * _within(planes).exact(*centres(), GAUSSIAN)
        return total[None]

    return picture


def _within(planes: Sequence[tuple[float, float, float]]) -> Polygon:
    """The convex polygon where nx x + ny y <= level for all planes (nx, ny, level), cut off far outside the screen."""
    corners = [(-60.0, -60.0), (60.0, -60.0), (60.0, 60.0), (-60.0, 60.0)]
    for nx, ny, level in planes:
        kept = []
        for (ax, ay), (bx, by) in zip(corners, corners[1:] + corners[:1], strict=True):
            a, b = nx * ax + ny * ay - level, nx * bx + ny * by - level
            if a <= 0:
                kept.append((ax, ay))
            if (a < 0) != (b < 0):
                kept.append((ax + a / (a - b) * (bx - ax), ay + a / (a - b) * (by - ay)))
        corners = kept
    return Polygon(tuple(corners))


_OUTLINE = ((2.2, 3.1), (9.4, 2.3), (10.1, 7.7), (5.2, 10.3), (1.9, 8.1))


def _planes(theta: float) -> list[tuple[float, float, float]]:
    """A pentagon's sides, of which two move outwards."""
    found = []
    for k, ((ax, ay), (bx, by)) in enumerate(zip(_OUTLINE, _OUTLINE[1:] + _OUTLINE[:1], strict=True)):
        length = math.hypot(bx - ax, by - ay)
        nx, ny = (by - ay) / length, (ax - bx) / length
        found.append((nx, ny, nx * ax + ny * ay + (theta if k == 1 else 0.5 * theta if k == 3 else 0)))
    return found


def _sides(theta: Tensor, x: Tensor, y: Tensor) -> list[Tensor]:
    return [level - nx * x - ny * y for nx, ny, level in _planes(theta)]  # pyright: ignore[reportArgumentType]


def _polygon_product(theta: Tensor) -> Function:
    return lambda x, y: torch.stack([side > 0 for side in _sides(theta, x, y)]).all(0)


def _polygon_least(theta: Tensor) -> Function:
    return lambda x, y: torch.stack(_sides(theta, x, y)).amin(0) > 0


_TEXELS = torch.rand(3, 4, 4, dtype=torch.float64, generator=torch.Generator().manual_seed(3))


def _matrix(theta: Tensor) -> Tensor:
    """From the screen to texels: scaled and shifted by the parameter."""
    cosine, sine = math.cos(0.3), math.sin(0.3)
    constant = torch.tensor([[0.45 * cosine, 0.4 * sine, -1.1], [-0.4 * sine, 0.4 * cosine, 0.6], [0, 0, 1]], dtype=torch.float64)
    return constant + theta * torch.tensor([[0.2, 0, 1], [0, 0, 0.5], [0, 0, 0]], dtype=torch.float64)


def _texture(theta: Tensor) -> Function:
    return mcaa.Texture(_TEXELS, "nearest", "zeros", transform=_matrix(theta))


def _texture_picture(theta: float) -> Tensor:
    inverse, total = torch.linalg.inv(_matrix(torch.tensor(theta, dtype=torch.float64))), torch.zeros(3, *SIZE, dtype=torch.float64)
    for i in range(4):
        for j in range(4):
            corners = (
                inverse @ torch.tensor([u, v, 1.0], dtype=torch.float64)
                for u, v in ((j, i), (j + 1, i), (j + 1, i + 1), (j, i + 1))
            )
            covered = Polygon(tuple((float(c[0]), float(c[1])) for c in corners)).exact(*centres(), GAUSSIAN)
            total += _TEXELS[:, i, j, None, None] * covered
    return total


def _through_filter(filter: Filter, angle: float) -> Picture:
    """A half-plane's picture is the filter's integral over lines, here to second order in the offset: only its derivative is right."""

    def picture(theta: float) -> Tensor:
        x, y = centres()
        reach = 1.5 * max(filter.radius)
        along = (torch.arange(40000, dtype=torch.float64) + 0.5) / 40000 * 2 * reach - reach
        cosine, sine = math.cos(angle), math.sin(angle)
        distance = 7.3 - (x * cosine + y * sine).flatten()
        line = torch.stack(
            [filter(d * cosine - along * sine, d * sine + along * cosine).sum() * (2 * reach / 40000) for d in distance]
        )
        return (7.3 - theta) * line.view(1, *SIZE)

    return picture


def filtered(filter: Filter, angle: float) -> Case:
    """A half-plane at 7.3 px under any filter."""
    cosine, sine = math.cos(angle), math.sin(angle)

    def make(theta: Tensor) -> Function:
        return lambda x, y: (x * cosine + y * sine > theta).to(x.dtype)

    return Case(f"half-plane at {angle:.2g}, {filter!r}", make, _through_filter(filter, angle), 7.3, filter=filter)


TABLE = (
    Case("half-plane position", _position, lambda t: _half_plane(0.4, t), 7.3, 2.1),
    Case("rotation", _rotation, lambda t: _half_plane(t, 5.3 * math.cos(t) + 6.4 * math.sin(t)), 0.4, 1.7),
    Case("disc radius", _disc, _disc_picture, 4.0, 4.6),
    Case("checkerboard frequency", _board, _board_picture, 0.25, 9.8),
    Case("nested where", _nested, _nested_picture, 0.1, 0.9, inner=True),
    Case("(0.2 + 0.7 H)^4", _power, lambda t: 0.2**4 + (0.9**4 - 0.2**4) * _half_plane(0.4, t), 7.3, 2.1),
    Case("Voronoi argmin", _voronoi(_two), _voronoi_picture(_two), 0.2, 1.8),
)
MORE = (
    Case("checkerboard of 2.2 px squares", _board, _board_picture, 0.45),
    Case("5-site Voronoi", _voronoi(_five), _voronoi_picture(_five), 0.2),
    Case("polygon, all sides > 0", _polygon_product, lambda t: _within(_planes(t)).exact(*centres(), GAUSSIAN)[None], 0.1),
    Case("polygon, least side > 0", _polygon_least, lambda t: _within(_planes(t)).exact(*centres(), GAUSSIAN)[None], 0.1),
    Case("nearest texture, 3 channels", _texture, _texture_picture, 0.1),
    Case("disc of 0.6 px", _disc, _disc_picture, 0.6),
)
THIN = (
    Case("ring of 0.1 px", _ring(0.1), lambda t: _disc_picture(t + 0.05) - _disc_picture(t - 0.05), 3.5),
    Case("disc of 0.15 px", _disc, _disc_picture, 0.15),
)
FILTERED = tuple(
    filtered(filter, angle)
    for filter in (mcaa.Box(), mcaa.Tent(), mcaa.Mitchell(), mcaa.Lanczos(3))
    for angle in (0.0, 0.4, math.pi / 4)
)
