"""Where the default errs more than the plain lattice: `python benchmarks/fallback.py [--seeds 3] [--spp 8 16 32 64] [--only stripes]`.

Random families of 96 x 96 pixels under the Gaussian of 0.5 px, float64: the root mean square error of `Auto()` over that of `Shared(Lattice())`
with as many evaluations, over all scenes of a family, the worst first. What both err beside a lattice of 1024 a pixel with other points; an error
of less than a millionth of the range of values counts as that. A family where `Auto` is far better is better still than the table can say.
"""

from __future__ import annotations

import argparse
import math
import zlib
from collections.abc import Callable
from functools import cache

import numpy as np
import skimage.data
import torch
from jumps import CASES
from jumps import SIZE as DRAWN
from torch import Tensor

import torch_mcaa as mcaa
from torch_mcaa import scenes
from torch_mcaa.integrand import Function

SIZE, TRUTH = 96, 1024
FILTER = mcaa.Gaussian(0.5)
SMALL = 1e-6
Draw = Callable[[torch.Generator], Function]
PHOTOGRAPHS = ("camera", "astronaut", "coffee", "coins", "brick", "grass", "gravel", "page", "text", "retina")


def _between(g: torch.Generator, low: float, high: float) -> float:
    return low + (high - low) * float(torch.rand((), generator=g, dtype=torch.float64))


def _log(g: torch.Generator, low: float, high: float) -> float:
    return low * (high / low) ** _between(g, 0, 1)


def _tones(g: torch.Generator, count: int, low: float, high: float) -> Function:
    """A sum of tones of `low` to `high` cycles a pixel."""
    tones = []
    for _ in range(count):
        frequency, turn = _log(g, low, high), _between(g, 0, 2 * math.pi)
        tones.append((2 * math.pi * frequency * math.cos(turn), 2 * math.pi * frequency * math.sin(turn), _between(g, 0, 6.3)))
    return lambda x, y: sum((torch.cos(u * x + v * y + p) for u, v, p in tones), torch.zeros_like(x)) / count / 2


def _line(g: torch.Generator) -> Function:
    """The distance from a line through the middle."""
    t = _between(g, 0, 2 * math.pi)
    c, s = math.cos(t), math.sin(t)
    offset = SIZE / 2 * (c + s) + _between(g, -12, 12)
    return lambda x, y: x * c + y * s - offset


def _curve(g: torch.Generator) -> Function:
    """The distance from an ellipse."""
    cx, cy, a, b = (_between(g, *span) for span in ((40, 56), (40, 56), (15, 40), (15, 40)))
    return lambda x, y: torch.hypot((x - cx) / a, (y - cy) / b) * min(a, b) - min(a, b)


def _meeting(g: torch.Generator, low: Function, high: Function, level: float, edge: Function) -> Function:
    return lambda x, y: torch.where(edge(x, y) >= 0, high(x, y) + level, low(x, y))


def _patterns(count: int, low: float, high: float, level: float, edge: Callable[[torch.Generator], Function] = _line) -> Draw:
    return lambda g: _meeting(g, _tones(g, count, low, high), _tones(g, count, low, high), level, edge(g))


def _coloured(g: torch.Generator) -> Function:
    """Three channels of tones that meet at one line."""
    edge = _line(g)
    channels = [_meeting(g, _tones(g, 1, 0.03, 0.4), _tones(g, 1, 0.03, 0.4), _between(g, -1, 1), edge) for _ in range(3)]
    return lambda x, y: tuple(channel(x, y) for channel in channels)


def _noise(g: torch.Generator, texels: float) -> mcaa.Texture:
    """Bilinear noise of `texels` a pixel."""
    image = torch.rand(1, 64, 64, generator=g, dtype=torch.float64)
    return mcaa.Texture(image, wrap="repeat", transform=[[texels, 0.1 * texels, 0], [-0.1 * texels, texels, 0], [0, 0, 1]])


def _textured(g: torch.Generator, texels: float) -> Function:
    first, second = _noise(g, texels), _noise(g, texels)
    return _meeting(g, lambda x, y: first(x, y)[0], lambda x, y: second(x, y)[0], 0.5, _line(g))


@cache
def _photograph(name: str) -> Tensor:
    pixels = np.atleast_3d(getattr(skimage.data, name)())
    return torch.from_numpy(np.moveaxis(pixels, -1, 0) / 255.0).contiguous()


def _natural(interpolation: str, magnified: float) -> Draw:
    """A photograph turned by any angle, each texel `magnified` px wide."""

    def draw(g: torch.Generator) -> Function:
        image = _photograph(PHOTOGRAPHS[int(_between(g, 0, len(PHOTOGRAPHS)))])
        t, scale = _between(g, -0.5, 0.5), 1 / magnified
        c, s = scale * math.cos(t), scale * math.sin(t)
        u, v = (_between(g, 0, size) for size in (image.shape[2], image.shape[1]))
        return mcaa.Texture(image, interpolation, "mirror", transform=[[c, -s, u], [s, c, v], [0, 0, 1]])  # type: ignore[arg-type]

    return draw


def _stripes(period: float) -> Draw:
    def draw(g: torch.Generator) -> Function:
        distance, share = _line(g), _between(g, 0.2, 0.8)
        return lambda x, y: ((distance(x, y) / period) % 1 < share).to(x.dtype)

    return draw


def _dots(count: int, low: float, high: float) -> Draw:
    def draw(g: torch.Generator) -> Function:
        dots = [(_between(g, 0, SIZE), _between(g, 0, SIZE), _log(g, low, high)) for _ in range(count)]
        return lambda x, y: torch.stack([torch.hypot(x - a, y - b) < r for a, b, r in dots]).any(0).to(x.dtype)

    return draw


def _hairlines(g: torch.Generator) -> Function:
    """Hairlines of nearly one direction."""
    t, lines = _between(g, 0, 2 * math.pi), []
    for _ in range(4):
        turn = t + _between(g, -0.05, 0.05)
        c, s = math.cos(turn), math.sin(turn)
        lines.append((c, s, SIZE / 2 * (c + s) + _between(g, -15, 15), _log(g, 0.03, 0.3)))
    return lambda x, y: torch.stack([(x * c + y * s - o).abs() < w / 2 for c, s, o, w in lines]).any(0).to(x.dtype)


def _hash(x: Tensor, y: Tensor) -> Tensor:
    """White noise: another number at every place."""
    return torch.remainder(torch.sin(x * 12.9898 + y * 78.233) * 43758.5453, 1)


def _noisy(g: torch.Generator) -> Function:
    edge, amount = _line(g), _log(g, 0.02, 0.5)
    return lambda x, y: (edge(x, y) >= 0).to(x.dtype) + amount * _hash(x, y)


def _half_noisy(g: torch.Generator) -> Function:
    edge, other = _line(g), _line(g)
    return lambda x, y: torch.where(edge(x, y) >= 0, _hash(x, y), (other(x, y) >= 0).to(x.dtype))


def _posterised(low: float, high: float) -> Draw:
    """A smooth picture in a few levels."""

    def draw(g: torch.Generator) -> Function:
        smooth, levels = _tones(g, 4, low, high), int(_between(g, 4, 12))
        return lambda x, y: torch.floor(smooth(x, y) * levels) / levels

    return draw


def _stepped(g: torch.Generator) -> Function:
    """A gradient with steps."""
    distance, width, step = _line(g), _log(g, 3, 30), _between(g, 0.1, 1)
    return lambda x, y: (1 - step) * distance(x, y) / width + step * torch.floor(distance(x, y) / width)


def _mandelbrot(scale: float) -> Draw:
    places = ((-0.75, 0.1), (-0.1011, 0.9563), (-1.25066, 0.02012), (-0.748, 0.1), (0.275, 0.0))

    def draw(g: torch.Generator) -> Function:
        real, imag = places[int(_between(g, 0, len(places)))]
        return scenes.Mandelbrot(SIZE / 2, SIZE / 2, scale, real, imag, 60)

    return draw


def _fbm(octaves: int, sharp: bool) -> Draw:
    """Sums of bilinear noise, each octave twice as fine and half as high; `sharp`: where it is above its mean."""

    def draw(g: torch.Generator) -> Function:
        layers = [(_noise(g, 2.0**k / 24), 2.0**-k) for k in range(octaves)]

        def f(x: Tensor, y: Tensor) -> Tensor:
            total = sum((a * (n(x, y)[0] - 0.5) for n, a in layers), torch.zeros_like(x))
            return (total > 0).to(x.dtype) if sharp else total

        return f

    return draw


def _voronoi(count: int) -> Draw:
    def draw(g: torch.Generator) -> Function:
        sites = [(_between(g, 0, SIZE), _between(g, 0, SIZE)) for _ in range(count)]
        colours = torch.rand(3, count, generator=g, dtype=torch.float64)

        def f(x: Tensor, y: Tensor) -> Tensor:
            return colours.to(x.dtype)[:, torch.stack([(x - a) ** 2 + (y - b) ** 2 for a, b in sites]).argmin(0)]

        return f

    return draw


def _floor(g: torch.Generator) -> Function:
    """A checkerboard in perspective."""
    horizon, t, size = _between(g, -20, 30), _between(g, 0, 1.5), _log(g, 40, 160)

    def f(x: Tensor, y: Tensor) -> Tensor:
        depth = size / (y - horizon).clamp_min(0.1)
        u, v = (x - SIZE / 2) * depth / 40, 2 * depth
        u, v = u * math.cos(t) - v * math.sin(t), u * math.sin(t) + v * math.cos(t)
        return torch.where(y > horizon, torch.remainder(torch.floor(u) + torch.floor(v), 2), 0.5)

    return f


def _shaded(g: torch.Generator) -> Function:
    """A shaded ball before a textured ground."""
    cx, cy, radius = _between(g, 30, 66), _between(g, 30, 66), _between(g, 15, 30)
    ground = _noise(g, _log(g, 0.1, 1))

    def f(x: Tensor, y: Tensor) -> Tensor:
        u, v = (x - cx) / radius, (y - cy) / radius
        inside = u * u + v * v < 1
        height = (1 - u * u - v * v).clamp_min(0).sqrt()
        return torch.where(inside, (0.5 * u + 0.3 * v + 0.8 * height).clamp_min(0), 0.6 * ground(x, y)[0])

    return f


def _drawn(case: str) -> Draw:
    """The middle of the scenes of jumps.py."""
    moved = (DRAWN - SIZE) / 2

    def draw(g: torch.Generator) -> Function:
        scene = CASES[case](g)
        return lambda x, y: scene(x + moved, y + moved)

    return draw


FAMILIES: dict[str, Draw] = {
    **{case: _drawn(case) for case in CASES if case not in ("discs of 20 to 100 px", "pentagons", "rectangles along the axes")},
    "tones of 0.02-0.1 c/px at a line": _patterns(1, 0.02, 0.1, 0),
    "tones of 0.02-0.1 c/px, a step": _patterns(1, 0.02, 0.1, 1),
    "tones of 0.1-0.6 c/px at a line": _patterns(1, 0.1, 0.6, 0),
    "tones of 0.1-0.6 c/px, a step": _patterns(1, 0.1, 0.6, 1),
    "sums of tones at a line": _patterns(4, 0.02, 0.4, 0.3),
    "sums of tones at an ellipse": _patterns(4, 0.02, 0.4, 0.3, _curve),
    "tones in colour at a line": _coloured,
    "bilinear noise of 8 px at a line": lambda g: _textured(g, 1 / 8),
    "bilinear noise of 2 px at a line": lambda g: _textured(g, 1 / 2),
    **{f"{kind} photographs x {m:g}": _natural(kind, m) for kind in ("bilinear", "nearest") for m in (0.5, 1, 2, 3.5, 6)},
    **{f"stripes every {p:g} px": _stripes(p) for p in (0.5, 1, 1.5, 2, 3, 5, 8)},
    "40 dots of 0.2-1 px": _dots(40, 0.2, 1),
    "40 dots of 1-4 px": _dots(40, 1, 4),
    "300 dots of 0.5-2 px": _dots(300, 0.5, 2),
    "four hairlines nearly parallel": _hairlines,
    "noise over an edge": _noisy,
    "noise beside an edge": _half_noisy,
    "posterised, slow": _posterised(0.005, 0.03),
    "posterised, fast": _posterised(0.03, 0.2),
    "gradients with steps": _stepped,
    "Mandelbrot, 30 px a unit": _mandelbrot(30),
    "Mandelbrot, 3000 px a unit": _mandelbrot(3000),
    "fbm of 4 octaves": _fbm(4, False),
    "fbm of 7 octaves": _fbm(7, False),
    "fbm of 4 octaves, two tones": _fbm(4, True),
    "fbm of 7 octaves, two tones": _fbm(7, True),
    "Voronoi of 12": _voronoi(12),
    "Voronoi of 200": _voronoi(200),
    "checkerboards in perspective": _floor,
    "balls before textures": _shaded,
    "tones of 0.1-1 c/px": lambda g: _tones(g, 3, 0.1, 1),
}


def picture(f: Function, estimator: mcaa.estimators.Estimator, spp: int, seed: int) -> mcaa.Rendering:
    return mcaa.render(f, (SIZE, SIZE), filter=FILTER, estimator=estimator, spp=spp, seed=seed, dtype=torch.float64)


def _range(f: Function) -> float:
    """Of f's values."""
    x, y = torch.rand(2, 1 << 14, generator=torch.Generator().manual_seed(1), dtype=torch.float64) * SIZE
    values = f(x, y)
    values = torch.stack(values) if isinstance(values, (tuple, list)) else values
    return float(values.max() - values.min())


def errors(family: str, spp: list[int], seeds: int) -> list[tuple[float, float]]:
    """For each number of evaluations the mean square errors of `Shared()` and `Auto()`, in squared ranges of values."""
    squares = torch.zeros(len(spp), 2, dtype=torch.float64)
    for seed in range(seeds):
        f = FAMILIES[family](torch.Generator().manual_seed(zlib.crc32(family.encode()) + seed))
        truth = picture(f, mcaa.Shared(), TRUTH, seed + 1000).image
        span = _range(f)
        for row, count in zip(squares, spp, strict=True):
            for k, estimator in enumerate((mcaa.Shared(), mcaa.Auto())):
                row[k] += ((picture(f, estimator, count, seed).image - truth) / span).square().mean() / seeds
    return [(float(a), float(b)) for a, b in squares]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--spp", type=int, nargs="+", default=[8, 16, 32, 64])
    parser.add_argument("--only", default="", help="families whose names contain this")
    arguments = parser.parse_args()
    rows = []
    for family in FAMILIES:
        if arguments.only in family:
            pairs = [tuple(max(math.sqrt(e), SMALL) for e in pair) for pair in errors(family, arguments.spp, arguments.seeds)]
            rows.append((max(b / a for a, b in pairs), family, pairs))
    print(f"| family | {' | '.join(f'at {n}: plain, ratio' for n in arguments.spp)} |\n|{'---|' * (1 + len(arguments.spp))}")
    for _, family, pairs in sorted(rows, reverse=True):
        print(f"| {family} | {' | '.join(f'{a:.1e}, {b / a:.2f}' for a, b in pairs)} |")


if __name__ == "__main__":
    main()
