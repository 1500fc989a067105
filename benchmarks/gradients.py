"""Gradients through edges: `python benchmarks/gradients.py [--seeds 200]` prints bias and standard deviation of derivative images.

12 x 12 pixels, 64 evaluations of f a pixel in all: those that the scan for edges leaves are samples of a lattice, whose derivative automatic
differentiation gives. The truth is a central difference of closed forms in float64. Columns in per cent of the root mean square
of the true derivative image: what plain automatic differentiation misses; the bias of ours, with its Monte Carlo error; its standard deviation.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

import torch_mcaa as mcaa
from torch_mcaa.edges.boundary import LINES, Elements, elements, margins, splat
from torch_mcaa.edges.program import probe
from torch_mcaa.filters import Filter
from torch_mcaa.grid import Cell, Screen
from torch_mcaa.integrand import Function
from torch_mcaa.scenes import Checkerboard, Disc, HalfPlane, Polygon

SIZE = (12, 12)
EVALUATIONS = 64
_STEP = 1e-4

Make = Callable[[Tensor], Function]
Picture = Callable[[float, Filter], Tensor]
"""(parameter, filter) -> (C, H, W), in closed form."""


@dataclass(frozen=True)
class Case:
    """A function with one parameter, its picture in closed form, and the standard deviation of findings 6 in per cent."""

    name: str
    make: Make
    picture: Picture
    theta: float
    asked: float


def _centres() -> tuple[Tensor, Tensor]:
    x, y = Screen.of(SIZE).centres()
    return x[None, :], y[:, None]


def _half_plane(angle: float, offset: float, filter: Filter) -> Tensor:
    return HalfPlane(angle, offset).exact(*_centres(), filter)


def _site(theta: Tensor | float) -> tuple[tuple[Tensor | float, Tensor | float], ...]:
    return ((3.1 + theta, 3.4), (8.7, 2.6 + theta), (6.2, 6.5), (2.4, 9.1 - theta), (9.3, 8.8))


COLOURS = (0.1, 0.9, 0.4, 0.7, 0.2)


def voronoi(sites: tuple[tuple[Tensor | float, Tensor | float], ...], colours: tuple[float, ...]) -> Function:
    """The colour of the nearest site."""

    def f(x: Tensor, y: Tensor) -> Tensor:
        distance = torch.stack([(x - px) ** 2 + (y - py) ** 2 for px, py in sites])
        return torch.tensor(colours, dtype=x.dtype)[distance.argmin(0)]

    return f


def _cell_of(sites: tuple[tuple[float, float], ...], index: int) -> Polygon:
    """The Voronoi cell of a site, cut off far outside the screen."""
    far, (ax, ay) = 60.0, sites[index]
    corners = [(-far, -far), (far, -far), (far, far), (-far, far)]
    for other, (bx, by) in enumerate(sites):
        if other != index:
            nx, ny = bx - ax, by - ay
            corners = _clipped(corners, nx, ny, nx * (ax + bx) / 2 + ny * (ay + by) / 2)
    return Polygon(tuple(corners))


def _clipped(corners: list[tuple[float, float]], nx: float, ny: float, level: float) -> list[tuple[float, float]]:
    """The part of a convex polygon where nx x + ny y <= level."""
    kept = []
    for (ax, ay), (bx, by) in zip(corners, corners[1:] + corners[:1], strict=True):
        a, b = nx * ax + ny * ay - level, nx * bx + ny * by - level
        if a <= 0:
            kept.append((ax, ay))
        if (a < 0) != (b < 0):
            kept.append((ax + a / (a - b) * (bx - ax), ay + a / (a - b) * (by - ay)))
    return kept


def _voronoi_picture(sites: tuple[tuple[float, float], ...], filter: Filter) -> Tensor:
    return sum(
        (colour * _cell_of(sites, k).exact(*_centres(), filter) for k, colour in enumerate(COLOURS[: len(sites)])), torch.zeros(())
    )[None]


def _two(theta: Tensor | float) -> tuple[tuple[Tensor | float, Tensor | float], ...]:
    return ((3.1 + theta, 3.4), (8.7, 7.6))


def _nested(theta: Tensor) -> Function:
    """Two conditions in a turned frame, and a colour that depends on the parameter too."""
    cosine, sine = math.cos(0.4), math.sin(0.4)

    def f(x: Tensor, y: Tensor) -> Tensor:
        u, v = x * cosine + y * sine, y * cosine - x * sine
        inner = torch.where(v > 2.3 - 0.5 * theta, 0.9 + 0.8 * theta, 0.3)
        return torch.where(u > 7.1 + theta, inner, 0.1 * torch.ones_like(x))

    return f


def _nested_picture(theta: float, filter: Filter) -> Tensor:
    x, y = _centres()
    cosine, sine = math.cos(0.4), math.sin(0.4)
    assert isinstance(filter, mcaa.Gaussian)
    first = torch.special.ndtr((x * cosine + y * sine - 7.1 - theta) / filter.std)
    second = torch.special.ndtr((y * cosine - x * sine - 2.3 + 0.5 * theta) / filter.std)
    return (0.1 + first * (0.3 + (0.6 + 0.8 * theta) * second - 0.1))[None]


def _turned(theta: Tensor, power: bool = False) -> Function:
    def f(x: Tensor, y: Tensor) -> Tensor:
        cover = (x * math.cos(0.4) + y * math.sin(0.4) > theta).to(x.dtype)
        return (0.2 + 0.7 * cover) ** 4 if power else cover

    return f


def _rotation(theta: Tensor) -> Function:
    return lambda x, y: (((x - 5.3) * torch.cos(theta) + (y - 6.4) * torch.sin(theta)) >= 0).to(x.dtype)


def _board(theta: Tensor) -> Function:
    """theta: squares a pixel."""
    return lambda x, y: 1 - torch.remainder(torch.floor((x - 0.37) * theta) + torch.floor((y - 0.61) * theta), 2)


CASES = (
    Case("half-plane position", _turned, lambda t, w: _half_plane(0.4, t, w)[None], 7.3, 2.1),
    Case(
        "rotation",
        _rotation,
        lambda t, w: _half_plane(t, 5.3 * math.cos(t) + 6.4 * math.sin(t), w)[None],
        0.4,
        1.7,
    ),
    Case(
        "disc radius",
        lambda t: lambda x, y: (torch.hypot(x - 6.1, y - 5.8) < t).to(x.dtype),
        lambda t, w: Disc(6.1, 5.8, t).exact(*_centres(), w)[None],
        4.0,
        4.6,
    ),
    Case("checkerboard frequency", _board, lambda t, w: Checkerboard(2 / t, (0.37, 0.61)).exact(*_centres(), w)[None], 0.45, 9.8),
    Case("nested where", _nested, _nested_picture, 0.1, 0.9),
    Case(
        "(0.2 + 0.7 H)^4",
        lambda t: _turned(t, power=True),
        lambda t, w: (0.2**4 + (0.9**4 - 0.2**4) * _half_plane(0.4, t, w))[None],
        7.3,
        2.1,
    ),
    Case("Voronoi argmin", lambda t: voronoi(_two(t), COLOURS[:2]), lambda t, w: _voronoi_picture(_two(t), w), 0.2, 1.8),
    Case("5-site Voronoi", lambda t: voronoi(_site(t), COLOURS), lambda t, w: _voronoi_picture(_site(t), w), 0.2, math.nan),
)


def derivative(case: Case, filter: Filter) -> Tensor:
    """(C, H, W): the true derivative image."""
    return (case.picture(case.theta + _STEP, filter) - case.picture(case.theta - _STEP, filter)) / (2 * _STEP)


def interior(case: Case, filter: Filter, seed: int, spp: int) -> Tensor:
    """(C, H, W): the derivative of the samples, by automatic differentiation."""

    def tangent(x: Tensor, y: Tensor) -> Tensor:
        # a parameter of each point's own
        theta = torch.full_like(x, case.theta).requires_grad_()
        with torch.enable_grad():
            value = case.make(theta)(x, y)
            channels = value if isinstance(value, tuple) else (value,)
            found = [
                torch.autograd.grad(c.sum(), theta, allow_unused=True, retain_graph=True)[0] if c.requires_grad else None
                for c in channels
            ]
        return torch.stack([torch.zeros_like(x) if slope is None else slope for slope in found])

    return mcaa.render(tangent, SIZE, filter=filter, estimator=mcaa.Shared(), spp=spp, seed=seed, dtype=torch.float64).image


def edges(case: Case, filter: Filter, seed: int, lines: int) -> tuple[Tensor, float]:
    """(C, H, W): the boundary term's derivative; and the evaluations a pixel that it took."""
    theta = torch.tensor(case.theta, dtype=torch.float64, requires_grad=True)
    f, screen, spent = case.make(theta), Screen.of(SIZE), [0]

    def tally(col: Tensor, row: Tensor) -> None:
        spent[0] += int(((col >= 0) & (col < SIZE[1]) & (row >= 0) & (row < SIZE[0])).sum())

    program = probe(f, screen, torch.float64, torch.device("cpu"))
    cell = Cell(0, 0, *SIZE)
    met = elements(f, screen, cell, filter, seed, lines, program=program, dtype=torch.float64, tally=tally)
    # the margins are asked for once more
    tally(met.col, met.row)
    return boundary_image(f, screen, met, filter, theta), spent[0] / (SIZE[0] * SIZE[1])


def boundary_image(f: Function, screen: Screen, met: Elements, filter: Filter, theta: Tensor) -> Tensor:
    """(C, H, W): the derivative of the boundary term by a scalar."""
    picture = torch.zeros(len(met.jump), screen.height * screen.width, dtype=torch.float64)
    if len(met):
        # the derivative of a gradient by what it is linear in gives every margin's own
        unit = torch.ones(len(met), dtype=torch.float64, requires_grad=True)
        (total,) = torch.autograd.grad((unit * margins(f, screen, met)).sum(), theta, create_graph=True)
        (slope,) = torch.autograd.grad(total, unit)
        rows, cols, weights = splat(met, screen, filter)
        amount = met.jump[:, :, None] * ((slope * met.weight)[:, None] * weights)
        picture.index_add_(1, (rows * screen.width + cols).flatten(), amount.flatten(1))
    return picture.view(-1, screen.height, screen.width)


@dataclass(frozen=True)
class Score:
    """In per cent of the true derivative image: plain differentiation's error, ours, what of it chance explains, standard deviation."""

    plain: float
    bias: float
    chance: float
    deviation: float
    evaluations: float


def score(case: Case, filter: Filter, seeds: int, lines: int = LINES) -> Score:
    truth = derivative(case, filter)
    scale = float(truth.square().mean().sqrt()) / 100
    images, plain, spent = [], [], 0.0
    for seed in range(seeds):
        edge, evaluations = edges(case, filter, seed, lines)
        inner = interior(case, filter, seed, max(1, round(EVALUATIONS - evaluations)))
        images.append(inner + edge)
        plain.append(inner)
        spent += evaluations / seeds
    spread = torch.stack(images).var(0).mean().sqrt()
    return Score(
        float((torch.stack(plain).mean(0) - truth).square().mean().sqrt()) / scale,
        float((torch.stack(images).mean(0) - truth).square().mean().sqrt()) / scale,
        float(spread) / math.sqrt(seeds) / scale,
        float(spread) / scale,
        spent,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--lines", type=int, default=LINES)
    parser.add_argument("--cases", default="")
    arguments = parser.parse_args()
    print(
        "| derivative | plain AD misses | bias (chance) | standard deviation | asked | evaluations of the scan a pixel |\n|"
        + "---|" * 6
    )
    for case in CASES:
        if arguments.cases in case.name:
            s = score(case, mcaa.Gaussian(0.5, radius=4.0), arguments.seeds, arguments.lines)
            print(
                f"| {case.name} | {s.plain:.0f} % | {s.bias:.2f} % ({s.chance:.2f} %) | {s.deviation:.2f} % | {case.asked:g} % "
                f"| {s.evaluations:.1f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
