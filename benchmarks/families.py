"""Families of random scenes with closed-form pixel values, and the error of an estimator over them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import torch
from torch import Tensor

import torch_mcaa as mcaa
from torch_mcaa import scenes
from torch_mcaa.filters import Filter

SIZE, SMALL = 24, 8
# the closed forms are those of a Gaussian that nothing cuts off; 8 std of it are the same in float64
FILTER = mcaa.Gaussian(0.5, radius=4.0)
Draw = Callable[[torch.Generator], scenes.Scene]


def _uniform(generator: torch.Generator, low: float, high: float) -> float:
    return low + (high - low) * float(torch.rand((), generator=generator, dtype=torch.float64))


def _edge(angle: Callable[[torch.Generator], float]) -> Draw:
    def draw(generator: torch.Generator) -> scenes.Scene:
        t = angle(generator)
        through = SIZE / 2 * (math.cos(t) + math.sin(t)) + _uniform(generator, -0.5, 0.5)
        return scenes.HalfPlane(t, through)

    return draw


def _quarter(generator: torch.Generator) -> float:
    return math.pi / 2 * math.floor(_uniform(generator, 0, 4))


def _line(generator: torch.Generator) -> scenes.Scene:
    t = _uniform(generator, 0, 2 * math.pi)
    return scenes.Stripe(t, SIZE / 2 * (math.cos(t) + math.sin(t)) + _uniform(generator, -0.5, 0.5), 0.1)


def _disc(generator: torch.Generator) -> scenes.Scene:
    x, y = (SIZE / 2 + _uniform(generator, -0.5, 0.5) for _ in range(2))
    return scenes.Disc(x, y, _uniform(generator, 3, 9))


def _tone(low: float, high: float) -> Draw:
    def draw(generator: torch.Generator) -> scenes.Scene:
        frequency, t = _uniform(generator, low, high), _uniform(generator, 0, 2 * math.pi)
        return scenes.Sinusoid(frequency * math.cos(t), frequency * math.sin(t), _uniform(generator, 0, 2 * math.pi))

    return draw


FAMILIES: dict[str, Draw] = {
    "random edges": _edge(lambda g: _uniform(g, 0, 2 * math.pi)),
    "axis edges": _edge(_quarter),
    "near-axis edges": _edge(lambda g: _quarter(g) + _uniform(g, -0.05, 0.05)),
    "diagonal edges": _edge(lambda g: _quarter(g) + math.pi / 4),
    "0.1 px lines": _line,
    "discs": _disc,
    "tones < 1 c/px": _tone(0, 1),
    "tones 1-3 c/px": _tone(1, 3),
    "tones 3-8 c/px": _tone(3, 8),
}


@dataclass(frozen=True)
class Score:
    """Over the pixels that are not flat: RMSE, reported standard error (root mean square) over it, coverage of the 95 % interval."""

    rmse: float
    ratio: float
    coverage: float
    bias: float

    @classmethod
    def of(cls, error: Tensor, stderr: Tensor) -> Score:
        rmse = float(error.square().mean().sqrt())
        return cls(
            rmse,
            float(stderr.square().mean().sqrt()) / rmse,
            float((error.abs() <= 1.959964 * stderr).to(torch.float64).mean()),
            float(error.mean()),
        )


Method = Callable[[scenes.Scene, int], tuple[Tensor, Tensor]]


def estimator(chosen: object, spp: int, dtype: torch.dtype = torch.float64, filter: Filter = FILTER) -> Method:
    """A method: (scene, seed) -> (values, standard errors) (H, W)."""

    def method(scene: scenes.Scene, seed: int) -> tuple[Tensor, Tensor]:
        picture = mcaa.render(scene, (SIZE, SIZE), filter=filter, estimator=chosen, spp=spp, seed=seed, dtype=dtype)  # type: ignore[arg-type]
        return picture.image[0], picture.stderr[0]

    return method


def grid_and_blur(k: int, std: float = 0.5, reach: int = 4) -> Method:
    """What people do by hand: a k x k grid in every pixel, a Gaussian blur, every k-th value."""

    def method(scene: scenes.Scene, seed: int) -> tuple[Tensor, Tensor]:
        places = (torch.arange((SIZE + 2 * reach) * k, dtype=torch.float64) + 0.5) / k - reach
        values = scene(places[None, :].expand(len(places), -1), places[:, None].expand(-1, len(places)))
        assert isinstance(values, Tensor)
        d = (torch.arange((2 * reach + 1) * k, dtype=torch.float64) + 0.5) / k - reach - 0.5
        weight = torch.exp(-0.5 * (d / std) ** 2)
        weight = weight / weight.sum()
        along = values.to(torch.float64).unfold(1, len(d), k) @ weight
        picture = along.T.unfold(1, len(d), k) @ weight
        return picture.T, torch.full_like(picture, torch.nan)

    return method


def _flat_pixels(truth: Tensor) -> Tensor:
    """Where a scene of 0 and 1 is one of them within the filter, or as good as."""
    return (truth < 1e-3) | (truth > 1 - 1e-3)


def score(family: str, method: Method, seeds: int, truth_filter: Filter | None = None, first_seed: int = 0) -> Score:
    """Run a method over `seeds` random scenes of a family, a new seed for each."""
    generator = torch.Generator().manual_seed(20260101 + first_seed)
    centre = torch.arange(SIZE, dtype=torch.float64) + 0.5
    errors, reported = [], []
    for seed in range(first_seed, first_seed + seeds):
        scene = FAMILIES[family](generator)
        truth = scene.exact(centre[None, :], centre[:, None], FILTER if truth_filter is None else truth_filter)
        value, stderr = method(scene, seed)
        flat = torch.zeros_like(truth, dtype=torch.bool) if family.startswith("tones") else _flat_pixels(truth)
        errors.append((value.to(torch.float64) - truth)[~flat])
        reported.append(stderr.to(torch.float64)[~flat])
    return Score.of(torch.cat(errors), torch.cat(reported))


def _middle(generator: torch.Generator) -> tuple[float, float]:
    return SMALL / 2 + _uniform(generator, -0.5, 0.5), SMALL / 2 + _uniform(generator, -0.5, 0.5)


def _half_plane(generator: torch.Generator) -> scenes.Scene:
    (x, y), t = _middle(generator), _uniform(generator, 0, 2 * math.pi)
    return scenes.HalfPlane(t, x * math.cos(t) + y * math.sin(t))


def _arc(generator: torch.Generator) -> scenes.Scene:
    (x, y), t, r = _middle(generator), _uniform(generator, 0, 2 * math.pi), _uniform(generator, 2, 9)
    return scenes.Disc(x - r * math.cos(t), y - r * math.sin(t), r)


def _stripe(generator: torch.Generator) -> scenes.Scene:
    (x, y), t = _middle(generator), _uniform(generator, 0, 2 * math.pi)
    return scenes.Stripe(t, x * math.cos(t) + y * math.sin(t), _uniform(generator, 0.1, 0.5))


def _quadratic(generator: torch.Generator) -> scenes.Scene:
    return scenes.Quadratic(*_middle(generator), *(_uniform(generator, -0.05, 0.05) for _ in range(3)))


def _blob(generator: torch.Generator) -> scenes.Scene:
    return scenes.Blob(*_middle(generator), _uniform(generator, 1, 3))


def _slow(generator: torch.Generator) -> scenes.Scene:
    frequency, t = _uniform(generator, 0, 0.5), _uniform(generator, 0, 2 * math.pi)
    return scenes.Sinusoid(frequency * math.cos(t), frequency * math.sin(t), _uniform(generator, 0, 2 * math.pi))


GROUPS: dict[str, tuple[Draw, ...]] = {"EDGE": (_half_plane, _arc, _stripe), "SMOOTH": (_quadratic, _blob, _slow)}
"""Of scenes for pictures of SMALL x SMALL pixels, whose edges pass through the middle."""


@dataclass(frozen=True)
class Case:
    """A scene, its closed form (SMALL, SMALL), and the pixels that count."""

    scene: scenes.Scene
    truth: Tensor
    counted: Tensor


@cache
def cases(draw: Draw, filter: Filter, pixels: int) -> list[Case]:
    """Random scenes until a third of `pixels` count, and no fewer than one for 128 of them."""
    generator = torch.Generator().manual_seed(20260102)
    centre = torch.arange(SMALL, dtype=torch.float64) + 0.5
    made: list[Case] = []
    while sum(int(case.counted.sum()) for case in made) < pixels / 3 or len(made) < pixels / 128:
        scene = draw(generator)
        truth = scene.exact(centre, centre[:, None], filter)
        counted = ~_flat_pixels(truth) if draw in GROUPS["EDGE"] else torch.ones_like(truth, dtype=torch.bool)
        made.append(Case(scene, truth, counted))
    return made
