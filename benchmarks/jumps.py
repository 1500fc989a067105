"""What locating jumps is worth: `python benchmarks/jumps.py [--seeds 8] [--spp 16]` prints the table of the README.

Random scenes of 256 x 256 pixels with closed-form pixel values under the Gaussian of 0.5 px, over the pixels that are not flat. The reported
standard error is that without the floor for what no sample met, `Rendering.unseen`.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

import torch_mcaa as mcaa
from torch_mcaa import scenes
from torch_mcaa.estimators import Estimator

SIZE = 256
STD = 0.5
FILTER = mcaa.Gaussian(STD)
# the closed forms are those of a Gaussian that nothing cuts off
UNCUT = mcaa.Gaussian(STD, radius=8 * STD)


@dataclass(frozen=True)
class Ramps:
    """Two colour ramps, a + b . r, that meet at the line r . n = offset."""

    angle: float
    offset: float
    sides: tuple[tuple[float, float, float], tuple[float, float, float]]

    def __call__(self, x: Tensor, y: Tensor) -> Tensor:
        low, high = (a + bx * x + by * y for a, bx, by in self.sides)
        return torch.where(x * math.cos(self.angle) + y * math.sin(self.angle) >= self.offset, high, low)

    def exact(self, cx: Tensor, cy: Tensor) -> Tensor:
        """The mean of a linear function on one side of a line under a normal density is its mean there plus std times its slope."""
        n = math.cos(self.angle), math.sin(self.angle)
        z = (cx * n[0] + cy * n[1] - self.offset) / STD
        (a, ax, ay), (b, bx, by) = self.sides
        at_low, at_high = a + ax * cx + ay * cy, b + bx * cx + by * cy
        slope = (bx - ax) * n[0] + (by - ay) * n[1]
        density = torch.exp(-z * z / 2) / math.sqrt(2 * math.pi)
        return at_low + (at_high - at_low) * torch.special.ndtr(z) + STD * slope * density


@dataclass(frozen=True)
class Steep:
    """A continuous step of `width` px across a line."""

    angle: float
    offset: float
    width: float

    def __call__(self, x: Tensor, y: Tensor) -> Tensor:
        return ((x * math.cos(self.angle) + y * math.sin(self.angle) - self.offset) / self.width + 0.5).clamp(0, 1)

    def exact(self, cx: Tensor, cy: Tensor) -> Tensor:
        """The integral of the normal distribution function between the step's ends, over its width."""
        middle = cx * math.cos(self.angle) + cy * math.sin(self.angle) - self.offset

        def integral(t: Tensor) -> Tensor:
            z = t / STD
            return STD * (z * torch.special.ndtr(z) + torch.exp(-z * z / 2) / math.sqrt(2 * math.pi))

        return (integral(middle + self.width / 2) - integral(middle - self.width / 2)) / self.width


@dataclass(frozen=True)
class Stripes:
    """`count` stripes of `width` px along a line, `period` px apart."""

    angle: float
    offset: float
    width: float
    period: float
    count: int

    def __call__(self, x: Tensor, y: Tensor) -> Tensor:
        place = (x * math.cos(self.angle) + y * math.sin(self.angle) - self.offset) / self.period
        return ((place >= 0) & (place < self.count) & (place % 1 < self.width / self.period)).to(x.dtype)

    def exact(self, cx: Tensor, cy: Tensor) -> Tensor:
        middle = cx * math.cos(self.angle) + cy * math.sin(self.angle) - self.offset
        starts = self.period * torch.arange(self.count, dtype=torch.float64)
        return sum(
            (torch.special.ndtr((middle - a) / STD) - torch.special.ndtr((middle - a - self.width) / STD) for a in starts.tolist()),
            torch.zeros_like(middle),
        )


def _uniform(generator: torch.Generator, low: float, high: float) -> float:
    return low + (high - low) * float(torch.rand((), generator=generator, dtype=torch.float64))


def _line(generator: torch.Generator, *angles: float) -> tuple[float, float]:
    """An angle and the offset of a line through the middle of the picture."""
    t = angles[int(_uniform(generator, 0, len(angles)))] if angles else _uniform(generator, 0, 2 * math.pi)
    return t, SIZE / 2 * (math.cos(t) + math.sin(t)) + _uniform(generator, -20, 20)


def _polygon(generator: torch.Generator, corners: int) -> scenes.Scene:
    turns = sorted(_uniform(generator, 0, 2 * math.pi) for _ in range(corners))
    while max(b - a for a, b in zip(turns, [*turns[1:], turns[0] + 2 * math.pi], strict=True)) > 3:
        turns = sorted(_uniform(generator, 0, 2 * math.pi) for _ in range(corners))
    radii = [_uniform(generator, 60, 110) for _ in turns]
    return scenes.Polygon(
        tuple((SIZE / 2 + r * math.cos(t), SIZE / 2 + r * math.sin(t)) for r, t in zip(radii, turns, strict=True))
    )


def _square(generator: torch.Generator) -> scenes.Scene:
    x, y, wide, high = (_uniform(generator, *span) for span in ((30, 60), (30, 60), (60, 150), (60, 150)))
    return scenes.Polygon(((x, y), (x + wide, y), (x + wide, y + high), (x, y + high)))


def _disc(generator: torch.Generator, low: float, high: float) -> scenes.Scene:
    return scenes.Disc(SIZE / 2 + _uniform(generator, -9, 9), SIZE / 2 + _uniform(generator, -9, 9), _uniform(generator, low, high))


def _ramps(generator: torch.Generator, scale: float) -> Ramps:
    def side(times: float) -> tuple[float, float, float]:
        return (
            times * _uniform(generator, 0.2, 1),
            times * _uniform(generator, -1e-3, 1e-3),
            times * _uniform(generator, -1e-3, 1e-3),
        )

    return Ramps(*_line(generator), (side(1), side(scale)))


def _straight(generator: torch.Generator, width: float | None, *angles: float) -> scenes.Scene:
    angle, offset = _line(generator, *angles)
    return scenes.HalfPlane(angle, offset) if width is None else scenes.Stripe(angle, offset, width)


def _nearly(generator: torch.Generator, width: float) -> scenes.Scene:
    """A line that samples hit for long stretches, or nowhere: it is nearly along an axis, or has nearly a simple slope."""
    slope, turn = (0.0, 0.5, 1.0)[int(_uniform(generator, 0, 3))], AXIS[int(_uniform(generator, 0, 4))]
    return _straight(generator, width, turn + math.atan(slope) + _uniform(generator, -0.01, 0.01))


Drawn = Ramps | Steep | Stripes
Draw = Callable[[torch.Generator], scenes.Scene | Drawn]
AXIS = tuple(math.pi / 2 * k for k in range(4))
CASES: dict[str, Draw] = {
    "edges": lambda g: _straight(g, None),
    "edges along an axis": lambda g: _straight(g, None, *AXIS),
    "diagonal edges": lambda g: _straight(g, None, *(a + math.pi / 4 for a in AXIS)),
    "discs of 20 to 100 px": lambda g: _disc(g, 20, 100),
    "discs of 3 to 9 px": lambda g: _disc(g, 3, 9),
    "pentagons": lambda g: _polygon(g, 5),
    "rectangles along the axes": _square,
    "two ramps": lambda g: _ramps(g, 1.5),
    "two ramps, 30 : 1": lambda g: _ramps(g, 30),
    "0.1 px lines": lambda g: _straight(g, 0.1),
    "0.1 px lines along an axis": lambda g: _straight(g, 0.1, *AXIS),
    "0.05 px lines near slopes of 0, 1/2 and 1": lambda g: _nearly(g, 0.05),
    "checkerboards of 16 to 40 px": lambda g: scenes.Checkerboard(_uniform(g, 32, 80), (_uniform(g, 0, 9), _uniform(g, 0, 9))),
    "steps of 0.02 px": lambda g: Steep(*_line(g), 0.02),
    "steps of 0.1 px": lambda g: Steep(*_line(g), 0.1),
    "steps of 0.25 px": lambda g: Steep(*_line(g), 0.25),
    "steps of 1 px": lambda g: Steep(*_line(g), 1.0),
    "two 0.1 px lines 0.6 px apart": lambda g: Stripes(*_line(g), 0.1, 0.6, 2),
    "0.09 px stripes every 0.35 px": lambda g: Stripes(*_line(g), 0.0875, 0.35, 17),
    "0.6 px stripes every 1.5 px": lambda g: Stripes(*_line(g), 0.6, 1.5, 8),
}


@dataclass(frozen=True)
class Score:
    """Root mean square error, the largest one, evaluations a pixel, reported over true standard error, coverage of the 95 % interval."""

    rmse: float
    worst: float
    spp: float
    ratio: float
    coverage: float


def score(
    case: str, chosen: Estimator, spp: int, seeds: int, dtype: torch.dtype, tolerance: float | None = None, first: int = 0
) -> Score:
    """An estimator's score over `seeds` random scenes of a case, a new seed for each."""
    generator = torch.Generator().manual_seed(20261122 + first)
    centre = torch.arange(SIZE, dtype=torch.float64) + 0.5
    errors, reported, spent = [], [], []
    for seed in range(first, first + seeds):
        scene = CASES[case](generator)
        cx, cy = centre[None, :], centre[:, None]
        truth = scene.exact(cx, cy) if isinstance(scene, Drawn) else scene.exact(cx, cy, UNCUT)
        picture = mcaa.render(
            scene, (SIZE, SIZE), filter=FILTER, estimator=chosen, spp=spp, seed=seed, dtype=dtype, tolerance=tolerance
        )
        around = torch.nn.functional.max_pool2d(torch.stack([truth, -truth])[None], 3, 1, 1)[0].sum(0)
        busy = around > 1e-2 * (truth.max() - truth.min())
        errors.append((picture.image[0].to(torch.float64) - truth)[busy])
        seen = (picture.stderr[0].square() - picture.unseen[0].square()).clamp_min(0).sqrt()
        reported.append(seen.to(torch.float64)[busy])
        spent.append(float(picture.spp.to(torch.float64).mean()))
    error, stderr = torch.cat(errors), torch.cat(reported)
    rmse = float(error.square().mean().sqrt())
    return Score(
        rmse,
        float(error.abs().max()),
        sum(spent) / len(spent),
        float(stderr.square().mean().sqrt()) / rmse,
        float((error.abs() <= 1.959964 * stderr).to(torch.float64).mean()),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--spp", type=int, default=16)
    parser.add_argument("--tolerance", type=float, default=None)
    arguments = parser.parse_args()
    print(
        "| scene | `Shared(Lattice())` | `Auto()`, float32 | float64 | evaluations a pixel | reported / true, coverage |\n|"
        + "---|" * 6
    )
    for case in CASES:
        shared = score(case, mcaa.Shared(), arguments.spp, arguments.seeds, torch.float64)
        single, double = (
            score(case, mcaa.Auto(), arguments.spp, arguments.seeds, dtype, arguments.tolerance)
            for dtype in (torch.float32, torch.float64)
        )
        print(
            f"| {case} | {shared.rmse:.1e} | {single.rmse:.1e} | {double.rmse:.1e} (worst {double.worst:.0e}) | {double.spp:.1f} "
            f"| {double.ratio:.2f}, {double.coverage:.0%} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
