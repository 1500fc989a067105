"""Ramps that next to no sample meets are said, with their place; what samples meet, and what no parameter moves, is not."""

from __future__ import annotations

import math
import pickle
import re
import warnings
from collections.abc import Callable

import pytest
import torch
import torch.nn.functional as F
from heard import said
from torch import Tensor

import torch_mcaa as mcaa

SIZE = 32, 32
RADIUS = torch.tensor(10.3, requires_grad=True)
SHADE = torch.tensor(0.7, requires_grad=True)
Ramp = Callable[[Tensor], Tensor]


def _smoothstep(u: Tensor) -> Tensor:
    t = (u + 0.5).clamp(0, 1)
    return t * t * (3 - 2 * t)


RAMPS: dict[str, Ramp] = {
    "clamp": lambda u: torch.clamp(u, 0, 1),
    "minimum of maximum": lambda u: torch.minimum(torch.relu(u), torch.ones_like(u)),
    "hardtanh": F.hardtanh,
    "relus": lambda u: torch.relu(u) - torch.relu(u - 1),
    "smoothstep": _smoothstep,
    "sigmoid": torch.sigmoid,
    "tanh": torch.tanh,
    "erf": torch.erf,
    "softmax": lambda u: torch.softmax(torch.stack([u, torch.zeros_like(u)]), 0)[0],
}


def disc(ramp: Ramp, steepness: float) -> Callable[[Tensor, Tensor], Tensor]:
    return lambda x, y: SHADE * ramp(steepness * (RADIUS - torch.hypot(x - 16, y - 16)))


@pytest.mark.parametrize("steepness", [1e5, 1e6, 1e9, 1e13])
@pytest.mark.parametrize("ramp", RAMPS.values(), ids=RAMPS)
def test_a_ramp_that_no_sample_meets_is_said_with_its_place(ramp: Ramp, steepness: float) -> None:
    (message,) = said(disc(ramp, steepness))
    place = re.search(r"at column ([\d.]+), row ([\d.]+) .* not seen to decide", message)
    assert place is not None
    assert math.hypot(float(place[1]) - 16, float(place[2]) - 16) == pytest.approx(10.3, abs=2e-3)


@pytest.mark.parametrize(("steepness", "spp", "many"), [(30, 16, 0), (300, 16, 1), (100, 64, 0), (3000, 64, 1), (3000, 512, 0)])
def test_what_next_to_no_sample_meets_hangs_on_their_number(steepness: float, spp: int, many: int) -> None:
    """A gradient is exactly 0 in 7 calls of 12 with a ramp of 1/300 px and 16 samples a pixel, on a circle of 19 px."""
    radius = torch.tensor(3.0, requires_grad=True)
    for seed in range(3):
        f = lambda x, y: ((radius - torch.hypot(x - 8, y - 8)) * steepness).clamp(0, 1)  # noqa: E731
        messages = said(f, (16, 16), spp=spp, seed=seed)
        assert len(messages) == many and all("within 1/" in message for message in messages)


@pytest.mark.parametrize("spp", [1, 4, 8])
def test_few_samples_and_an_f_of_which_nothing_can_be_told(spp: int) -> None:
    """One that is random, one that is flat, and one that decides everywhere: no ramp, and no pieces to halve."""
    for f in (lambda x, y: SHADE * torch.rand_like(x), lambda x, y: SHADE + 0 * x, lambda x, y: SHADE * (1e4 * x).floor()):
        assert not any("f changes by" in message for message in said(f, (8, 8), spp=spp))


def test_ramps_beside_stronger_texture_and_in_another_channel_are_said() -> None:
    """Texture that changes by three times as much in a pixel, or by ten times, in the other channel."""
    ramp = disc(torch.sigmoid, 1e6)

    def textured(x: Tensor, y: Tensor) -> Tensor:
        return ramp(x, y) + 3 * torch.sin(0.8 * x) * torch.cos(0.9 * y)

    def other(x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        return 10 * torch.sin(0.8 * x) * torch.cos(0.9 * y), ramp(x, y)

    for f in (textured, other):
        (message,) = said(f)
        assert "f changes by 0.7 within" in message


@pytest.mark.parametrize("steepness", [1e5, 1e13])
@pytest.mark.parametrize("ramp", RAMPS.values(), ids=RAMPS)
def test_the_report_has_it_too(ramp: Ramp, steepness: float) -> None:
    """Beside other decisions; as a ramp, or, where float64 has hardly a number inside it, as a jump."""

    def beside(x: Tensor, y: Tensor) -> Tensor:
        return (x > 3).float() + disc(ramp, steepness)(x, y)

    report = mcaa.check_discontinuities(beside, SIZE)
    assert not report.ok and len(report.decisions) == 1
    places = report.ramps if steepness == 1e5 else report.jumps
    assert len(places) > 20
    for place in places:
        assert math.hypot(place.x - 16, place.y - 16) == pytest.approx(10.3, abs=2e-3)
    assert places[0].size == pytest.approx(2 * 0.7 if ramp in (torch.tanh, F.hardtanh, torch.erf) else 0.7, rel=0.05)
    assert ("ramps within 1/256 px" in str(report)) == (steepness == 1e5)
    assert "no other jump" not in str(report)


def test_the_report_is_well_of_what_samples_meet() -> None:
    for f in (
        *(disc(ramp, 40.0) for ramp in RAMPS.values()),
        lambda x, y: (x - RADIUS).abs().sqrt(),
        lambda x, y: SHADE * (x < RADIUS),
    ):
        report = mcaa.check_discontinuities(f, SIZE)
        assert report.ok and report.ramps == () and "no other jump" in str(report)


@pytest.mark.parametrize("size", [(1, 1), (2, 3), (1, 50), (256, 256)])
def test_pictures_of_any_size(size: tuple[int, int]) -> None:
    assert len(said(lambda x, y: torch.tanh(1e6 * (x - 0.05 * RADIUS)), size)) == 1


def test_without_the_ramp_the_gradient_is_there_and_nothing_is_said() -> None:
    layer = mcaa.Supersampler(SIZE, estimator=mcaa.Shared())

    def decided(x: Tensor, y: Tensor) -> Tensor:
        return SHADE * (torch.hypot(x - 16, y - 16) < RADIUS)

    assert said(decided) == []
    (found,) = torch.autograd.grad(layer(decided).sum(), RADIUS)
    assert float(found) == pytest.approx(0.7 * 2 * math.pi * 10.3, rel=0.02)


@pytest.mark.parametrize("seed", range(8))
def test_nothing_is_said_of_what_samples_meet_or_nothing_moves(seed: int) -> None:
    torch.manual_seed(seed)
    network = torch.nn.Sequential(
        torch.nn.Linear(2, 32), torch.nn.ReLU(), torch.nn.Linear(32, 32), torch.nn.Tanh(), torch.nn.Linear(32, 1)
    )
    image = torch.rand(1, 8, 8, requires_grad=True)
    for f in (
        *(disc(ramp, 40.0) for ramp in RAMPS.values()),
        lambda x, y: SHADE * torch.clamp(1e6 * (x - 10.123), 0, 1) + RADIUS * y,
        lambda x, y: SHADE * torch.sigmoid(1e9 * (torch.hypot(x - 16, y - 16) - 10.3)),
        lambda x, y: torch.sin(RADIUS * x) * torch.cos(RADIUS * y),
        lambda x, y: (x - RADIUS).abs().sqrt(),
        lambda x, y: torch.exp(-(((torch.hypot(x - 16, y - 16) - RADIUS) / 0.02) ** 2)),
        lambda x, y: torch.ones_like(x) / 3 + 1e-9 * x * RADIUS,
        lambda x, y: (torch.hypot(x - 16, y - 16) < RADIUS).float() * SHADE,
        mcaa.from_points(network),
        mcaa.Texture(image, "bilinear", "repeat", transform=torch.tensor([[0.1, 0.02, 0], [0, 0.1, 0], [0, 0, 1.0]])),
    ):
        assert said(f, seed=seed) == []


def test_a_ramp_beside_edges_and_one_that_grows_steep_are_said() -> None:
    def beside(x: Tensor, y: Tensor) -> Tensor:
        return (torch.hypot(x - 16, y - 16) < RADIUS).float() + 0.1 * torch.sigmoid(1e6 * (x - RADIUS - SHADE))

    (message,) = said(beside)
    assert "column 11.000" in message
    steepness = 1.0
    layer = mcaa.Supersampler(SIZE, estimator=mcaa.Shared())
    for call in range(1, 9):
        layer = pickle.loads(pickle.dumps(layer))
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            layer(lambda x, y: torch.sigmoid(steepness * (x - RADIUS)))  # noqa: B023
        assert len(caught) == (call in (4, 8))
        steepness = 1e6 if call >= 2 else 1.0


def test_hidden_code_is_named_as_such_and_plain_differentiation_is_let_be() -> None:
    def hidden(x: Tensor, y: Tensor) -> Tensor:
        return torch.from_numpy((x.detach().numpy() > 10.3).astype("float32")) * SHADE

    messages = said(hidden)
    assert messages and all("the trace cannot see" in m or "out of PyTorch" in m for m in messages)
    assert said(disc(torch.sigmoid, 1e6), discontinuities=False) == []
