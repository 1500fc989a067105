"""One scene for each kind of picture, its closed form under the Gaussian of 0.5 px, and the same scene for compilers that do not know PyTorch."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

import torch_mcaa as mcaa
from torch_mcaa import scenes
from torch_mcaa.patterns import Lattice

# the closed forms are those of a Gaussian that nothing cuts off
UNCUT = mcaa.Gaussian(0.5, radius=4.0)
SIZE = 512
Field = Callable[[Tensor, Tensor], Tensor]


@dataclass(frozen=True)
class Case:
    """A scene of 0 to 1 on size x size pixels.

    Attributes:
        scene: f(x, y), in PyTorch.
        truth: (H, W) float64.
        busy: (H, W) bool, the pixels that are not flat, over which errors are taken.
        kernel: the name of the same f in `kernels.py`, and the numbers it takes.
        distance: the signed distance to the edge in pixels, for methods that know it; None where there is none.
    """

    name: str
    scene: Field
    truth: Tensor
    busy: Tensor
    kernel: str
    numbers: np.ndarray
    distance: Field | None = None

    @property
    def size(self) -> int:
        return len(self.truth)

    def some_pixels(self, count: int, seed: int) -> Tensor:
        """At most `count` of those that are not flat, at random."""
        pixels = self.busy.flatten().nonzero()[:, 0]
        return pixels[torch.randperm(len(pixels), generator=torch.Generator().manual_seed(seed))[:count]]


@dataclass(frozen=True)
class Grain:
    """Squares of `side` px of random grey between 0.35 and 0.65, repeated after 256 of them: noise finer than samples of 16 a pixel."""

    side: float = 0.1373
    seed: int = 5

    def table(self) -> Tensor:
        return 0.35 + 0.3 * torch.rand(256, 256, generator=torch.Generator().manual_seed(self.seed), dtype=torch.float64)

    def field(self) -> Field:
        table = self.table().float().flatten()

        def f(x: Tensor, y: Tensor) -> Tensor:
            column, row = (torch.floor(t * (1 / self.side)).to(torch.int32) & 255 for t in (x, y))
            return table.index_select(0, (row * 256 + column).flatten()).view(x.shape).to(x.dtype)

        return f

    def exact(self, size: int) -> Tensor:
        """A A^T products: the weight of every square along x, and along y."""
        edges = torch.arange(-64, int(size / self.side) + 64, dtype=torch.float64)
        centres = torch.arange(size, dtype=torch.float64)[:, None] + 0.5
        cdf = torch.special.ndtr((edges * self.side - centres) / UNCUT.std)
        weights = torch.zeros(size, 256, dtype=torch.float64).index_add_(1, edges[:-1].long() % 256, cdf.diff(dim=1))
        return weights @ self.table() @ weights.T


@dataclass(frozen=True)
class _Mean:
    """Of two tones."""

    first: scenes.Sinusoid
    second: scenes.Sinusoid

    def __call__(self, x: Tensor, y: Tensor) -> Tensor:
        return 0.5 * (self.first(x, y) + self.second(x, y))

    def exact(self, cx: Tensor, cy: Tensor, filter: object) -> Tensor:
        return 0.5 * (self.first.exact(cx, cy, UNCUT) + self.second.exact(cx, cy, UNCUT))


def _case(
    name: str, scene: scenes.Scene | _Mean, size: int, kernel: str, numbers: list[float], distance: Field | None = None
) -> Case:
    centre = torch.arange(size, dtype=torch.float64) + 0.5
    truth = scene.exact(centre[None, :].expand(size, -1), centre[:, None].expand(-1, size), UNCUT)
    busy = (truth > 1e-3) & (truth < 1 - 1e-3) if distance else torch.ones_like(truth, dtype=torch.bool)
    return Case(name, scene, truth, busy, kernel, np.array(numbers, np.float32), distance)  # pyright: ignore[reportArgumentType]


def edges(size: int = SIZE) -> Case:
    angle, width = 0.73, 0.37 * size
    offset = size / 2 * (math.cos(angle) + math.sin(angle)) + 0.21

    def distance(x: Tensor, y: Tensor) -> Tensor:
        return width / 2 - (x * math.cos(angle) + y * math.sin(angle) - offset).abs()

    scene = scenes.Stripe(angle, offset, width)
    return _case("edges", scene, size, "stripe", [math.cos(angle), math.sin(angle), offset, width / 2], distance)


def curves(size: int = SIZE) -> Case:
    x, y, radius = size / 2 + 0.3, size / 2 - 0.9, 0.39 * size
    return _case("curves", scenes.Disc(x, y, radius), size, "disc", [x, y, radius], lambda a, b: radius - torch.hypot(a - x, b - y))


def polygons(size: int = SIZE) -> Case:
    """A pentagon, convex, so that its distance is the least of those to its sides."""
    turns = [0.31 + 2 * math.pi * k / 5 for k in range(5)]
    corners = [(size / 2 + 0.41 * size * math.cos(t), size / 2 + 0.41 * size * math.sin(t)) for t in turns]
    sides = [(x, y, u, v) for (x, y), (u, v) in zip(corners, corners[1:] + corners[:1], strict=True)]

    def distance(x: Tensor, y: Tensor) -> Tensor:
        to = [((u - a) * (y - b) - (v - b) * (x - a)) / math.hypot(u - a, v - b) for a, b, u, v in sides]
        return torch.stack(to).amin(0)

    return _case("polygons", scenes.Polygon(tuple(corners)), size, "polygon", [n for side in sides for n in side], distance)


def smooth(size: int = SIZE) -> Case:
    """Tones of up to half a cycle a pixel, in the corners."""
    k = 0.5 * math.pi / (size / math.sqrt(2))
    return _case("smooth", scenes.ZonePlate(k, size / 2, size / 2), size, "zone_plate", [k, size / 2, size / 2])


def noise(size: int = SIZE) -> Case:
    grain = Grain()
    truth = grain.exact(size)
    numbers = np.concatenate([[1 / grain.side], grain.table().flatten().numpy()]).astype(np.float32)
    return Case("noise", grain.field(), truth, torch.ones_like(truth, dtype=torch.bool), "grain", numbers)


def resonance(size: int = SIZE) -> Case:
    """The tone that the lattice of 16 a pixel is blind to, and the one that the 4 x 4 grid is."""
    dual = np.linalg.inv(Lattice().strip(16, 0, True, (0.0, 0.0)).basis).T[0]
    tones = scenes.Sinusoid(float(dual[0]), float(dual[1]), 0.4), scenes.Sinusoid(4.0, 0.0, 1.1)
    numbers = [n for t in tones for n in (2 * math.pi * t.u, 2 * math.pi * t.v, t.phase)]
    return _case("resonance", _Mean(*tones), size, "two_tones", numbers)


CASES: dict[str, Callable[[int], Case]] = {made.__name__: made for made in (edges, curves, polygons, smooth, noise, resonance)}
