"""Pictures of the layer whose jumps are taken from f's decisions."""

from __future__ import annotations

import cmath
import math
import statistics
from collections.abc import Callable

import numpy as np
import pytest
import torch
from torch import Tensor

import torch_mcaa as mcaa
from torch_mcaa import scenes
from torch_mcaa.arguments import task_of
from torch_mcaa.estimators import Estimator
from torch_mcaa.filters import Filter
from torch_mcaa.grid import Screen
from torch_mcaa.replay.plan import followed

SIZE = 64, 64
STD = 0.5
UNCUT = mcaa.Gaussian(STD, radius=8 * STD)
ANGLE, OFFSET = 0.4, 41.3
TONES = (0.1, 0.05), (-0.05, 0.15)
"""Cycles a pixel on either side of the line."""


def patterned(x: Tensor, y: Tensor) -> Tensor:
    low, high = (0.5 * torch.cos(2 * math.pi * (u * x + v * y)) for u, v in TONES)
    return torch.where(x * math.cos(ANGLE) + y * math.sin(ANGLE) >= OFFSET, high + 1, low)


def exact() -> Tensor:
    """Of `patterned`: along the normal by Gauss and Legendre's rule on either side of the line, along the line in closed form."""
    c, s = math.cos(ANGLE), math.sin(ANGLE)
    nodes, weights = np.polynomial.legendre.leggauss(48)
    centre = torch.arange(SIZE[0], dtype=torch.float64) + 0.5
    d = centre[None, :] * c + centre[:, None] * s
    along = -centre[None, :] * s + centre[:, None] * c
    total = torch.zeros_like(d)
    for (u, v), level, side in zip(TONES, (0, 1), (-1, 1), strict=True):
        normal, tangent = 2 * math.pi * (u * c + v * s), 2 * math.pi * (-u * s + v * c)
        damped = cmath.exp(-((tangent * STD) ** 2) / 2).real
        near, far = torch.full_like(d, OFFSET), d + side * 8 * STD
        far = torch.where((far - near) * side > 0, far, near)
        near = torch.where((near - d).abs() > 8 * STD, torch.where((near - d) * side > 0, far, d - side * 8 * STD), near)
        for node, weight in zip(nodes.tolist(), weights.tolist(), strict=True):
            t = near + (far - near) * (node + 1) / 2
            density = torch.exp(-(((t - d) / STD) ** 2) / 2) / (STD * math.sqrt(2 * math.pi))
            value = level + 0.5 * damped * torch.cos(normal * t + tangent * along)
            total += weight / 2 * (far - near).abs() * density * value
    return total


def layer(chosen: Estimator | None = None, spp: int = 16, filter: Filter = UNCUT, **rest: object) -> mcaa.Supersampler:
    return mcaa.Supersampler(SIZE, filter=filter, estimator=chosen, spp=spp, redraw=False, **rest).double()  # type: ignore[arg-type]


def error(picture: Tensor, truth: Tensor, angle: float = ANGLE, offset: float = OFFSET) -> float:
    """Root mean square error in the pixels about a line."""
    centre = torch.arange(SIZE[0], dtype=torch.float64) + 0.5
    near = (centre[None, :] * math.cos(angle) + centre[:, None] * math.sin(angle) - offset).abs() < 2
    return float((picture[0] - truth)[near].square().mean().sqrt())


@pytest.mark.parametrize("chosen", [mcaa.Auto(), mcaa.JumpCorrected()], ids=repr)
def test_edges_between_patterns_are_located(chosen: Estimator) -> None:
    """Values alone do not tell such an edge from the patterns beside it."""
    truth = exact()
    alone = {"filter": UNCUT, "estimator": chosen, "spp": 16, "dtype": torch.float64, "progress": False}
    # from values it is found on part of the lines, and on which is chance
    values = [mcaa.render(patterned, SIZE, seed=seed, **alone).image for seed in range(4)]
    assert error(layer(chosen)(patterned), truth) < 2e-4 < 0.2 * statistics.median(error(value, truth) for value in values)
    assert error(layer(chosen, spp=64)(patterned), truth) < 3e-5


def test_straight_edges_are_exact() -> None:
    scene = scenes.HalfPlane(0.3, 33.3)
    centre = torch.arange(64, dtype=torch.float64) + 0.5
    assert error(layer()(scene), scene.exact(centre[None, :], centre[:, None], UNCUT), 0.3, 33.3) < 1e-10


def test_a_jump_too_small_to_stand_out() -> None:
    def f(x: Tensor, y: Tensor, jump: float = 1e-3) -> Tensor:
        return torch.sin(0.2 * x) + jump * (x + 0.3 * y > 40)

    smooth = layer()(lambda x, y: torch.sin(0.2 * x))
    slope = math.hypot(1, 0.3)
    centre = torch.arange(64, dtype=torch.float64) + 0.5
    step = torch.special.ndtr((centre[None, :] + 0.3 * centre[:, None] - 40) / (slope * STD))
    # of blocks that are sampled the lattice is another one: it errs by 3e-7 of the sine; samples alone err by 1e-5 of the step
    assert float((layer()(f)[0] - smooth[0] - 1e-3 * step).abs().max()) < 1e-6


def test_finite_differences_agree_with_the_gradient() -> None:
    weights = torch.randn(SIZE, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    place = torch.tensor([31.3, 32.1, 20.2], dtype=torch.float64)

    def loss(p: Tensor, spp: int = 16) -> Tensor:
        return (layer(mcaa.JumpCorrected(), spp)(lambda x, y: (torch.hypot(x - p[0], y - p[1]) < p[2]).to(x)) * weights).sum()

    steps = [1e-4 * torch.eye(3, dtype=torch.float64)[k] for k in range(3)]
    differences = torch.stack([(loss(place + step) - loss(place - step)) / 2e-4 for step in steps])
    finer = torch.stack([(loss(place + step / 10) - loss(place - step / 10)) / 2e-5 for step in steps])
    assert torch.allclose(differences, finer, rtol=1e-6)
    (gradient,) = torch.autograd.grad(loss(place.requires_grad_(), 64), place)
    assert torch.allclose(differences, gradient, rtol=5e-3)


def test_decisions_that_make_no_jump() -> None:
    """The borders of texels: where f is continuous it is sampled, at no other cost."""
    image = torch.rand(1, 48, 48, dtype=torch.float64, generator=torch.Generator().manual_seed(3))
    texture = mcaa.Texture(image, "bilinear", "repeat", transform=torch.diag(torch.tensor([0.7, 0.7, 1.0], dtype=torch.float64)))
    plain = mcaa.render(texture, SIZE, filter=UNCUT, spp=16, dtype=torch.float64, progress=False).image
    assert float((layer()(lambda x, y: texture(x, y)) - plain).abs().max()) < 0.02


def test_with_and_without_a_gradient_the_picture_is_the_same() -> None:
    radius = torch.tensor(20.0, dtype=torch.float64, requires_grad=True)

    def f(x: Tensor, y: Tensor) -> Tensor:
        return (torch.hypot(x - 32, y - 32) < radius).to(x)

    with torch.no_grad():
        plain = layer()(f)
    assert torch.equal(layer()(f), plain)


def test_what_the_trace_cannot_follow_is_found_from_values() -> None:
    def hidden(x: Tensor, y: Tensor) -> Tensor:
        return torch.from_numpy((x.numpy() * 0.9 + y.numpy() * 0.3 > 37).astype(np.float64)) + (y > 20)

    def rendered(f: Callable[[Tensor, Tensor], Tensor]) -> Tensor:
        return mcaa.render(f, SIZE, filter=UNCUT, spp=16, dtype=torch.float64, progress=False).image

    # with a gradient to be had it would warn of numpy
    with torch.no_grad():
        assert torch.equal(layer()(hidden), rendered(hidden))
    seen = scenes.Disc(30, 31, 12)
    assert torch.equal(layer(discontinuities=False)(seen), rendered(seen))
    assert not torch.equal(layer()(seen), rendered(seen))


def test_the_cap_holds_and_the_order_of_work_changes_no_bit() -> None:
    size, screen = (300, 270), Screen.of((300, 270))

    def f(x: Tensor, y: Tensor) -> Tensor:
        return torch.where(torch.remainder(torch.floor(x / 24) + torch.floor(y / 31), 2) > 0, torch.sin(0.3 * x), 0.01 * y)

    def task() -> object:
        made = task_of(f, screen, mcaa.Gaussian(0.5), "extend", "raise", 5, torch.float32, None)
        made.integrand.function = followed(made, f)
        assert made.followed is not None
        return made

    picture = mcaa.render(task().integrand.function, size, spp=11, seed=5, progress=False)  # type: ignore[attr-defined]
    assert picture.spp.double().mean() <= 11
    assert int((picture.model > 0).sum()) > 1000
    again, chosen = task(), mcaa.Auto()
    with torch.no_grad():
        for cell in reversed(list(screen.cells(*chosen.cell(again, 16, False)))):  # type: ignore[arg-type]
            estimate = chosen.round(again, 11, 0).estimate(cell)  # type: ignore[arg-type]
            assert torch.equal(estimate.value, picture.image[(slice(None), *cell.window)])
            assert torch.equal(estimate.points, picture.spp[cell.window])
