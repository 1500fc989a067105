"""`check_discontinuities`: every jump that no decision explains, and none where there is none."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

import torch_mcaa as mcaa
from torch_mcaa import scenes

RADIUS = torch.tensor(20.0, requires_grad=True)
Function = Callable[[Tensor, Tensor], Any]


def _numpy(x: Tensor, y: Tensor) -> Tensor:
    inside = np.hypot(x.numpy() - 30, y.numpy() - 30) < RADIUS.item()
    return torch.from_numpy(inside.astype(np.float32))


def _unseen(x: Tensor, y: Tensor) -> Tensor:
    with torch._C.DisableTorchFunction():
        return torch.where(x * x + y * y < 900, 1.0, 0.0)


def _faint_on_a_ramp(x: Tensor, y: Tensor) -> Tensor:
    return 0.1 * x + torch.from_numpy((x.numpy() > 20.3) * 0.02)


def _fainter_than_texture(x: Tensor, y: Tensor) -> Tensor:
    return torch.sin(0.8 * x) * torch.cos(0.9 * y) + torch.from_numpy((x.numpy() > 20.3) * 0.1)


def _in_a_quiet_channel(x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    return 10 * torch.sin(0.8 * x) * torch.cos(0.9 * y), torch.from_numpy((x.numpy() > 20.3) * 0.02)


@pytest.mark.parametrize("f", [_numpy, _unseen, _faint_on_a_ramp, _fainter_than_texture, _in_a_quiet_channel])
def test_a_hidden_jump_is_found_where_it_is(f: Function) -> None:
    report = mcaa.check_discontinuities(f, (64, 64))
    assert not report.ok and len(report.jumps) > 20
    for jump in report.jumps:
        if f is _numpy:
            assert abs(np.hypot(jump.x - 30, jump.y - 30) - 20) < 1e-3 and jump.size == 1
        elif f is _unseen:
            assert abs(np.hypot(jump.x, jump.y) - 30) < 1e-3
        else:
            assert abs(jump.col - 20.3) < 1e-3
            assert jump.size == pytest.approx(0.1 if f is _fainter_than_texture else 0.02, rel=1e-3)
    text = str(report)
    assert "no decision explains" in text and "level_set" in text and f"column {report.jumps[0].col:.3f}" in text


def test_declared_jumps_are_explained() -> None:
    def f(x: Tensor, y: Tensor) -> Tensor:
        mcaa.level_set(RADIUS - torch.hypot(x - 30, y - 30))
        return _numpy(x.detach(), y.detach())

    report = mcaa.check_discontinuities(f, (64, 64))
    assert report.ok and report.decisions[0][1] == "level_set" and report.decisions[0][2] > 100


@pytest.mark.parametrize("name", scenes.gallery((48, 40)))
def test_no_false_alarm_on_the_gallery(name: str) -> None:
    scene = scenes.gallery((48, 40))[name]
    report = mcaa.check_discontinuities(scene, (48, 40))
    assert report.jumps == () and not report.random
    assert report.ok, str(report)


def test_no_false_alarm_on_steep_or_rounded_functions() -> None:
    torch.manual_seed(9)  # a network whose steepest bend is just above what it is rounded by
    network = torch.nn.Sequential(torch.nn.Linear(2, 16), torch.nn.ReLU(), torch.nn.Linear(16, 1))
    for f in (
        lambda x, y: torch.sigmoid((x - 20) * 300),
        lambda x, y: torch.sin(x * 3) * torch.cos(y * 2),
        lambda x, y: torch.ones_like(x).float() / 3 + x.float() * 1e-9,
        mcaa.from_points(network),
        lambda x, y: network(torch.stack([x, y], -1))[:, 0],
        mcaa.Texture(torch.rand(3, 16, 16), "bilinear", "repeat"),
    ):
        report = mcaa.check_discontinuities(f, (32, 32))
        assert report.ok, str(report)


def test_decisions_are_counted_by_line() -> None:
    def f(x: Tensor, y: Tensor) -> Tensor:
        left = x < 10.5
        return left.float() + (y < -50).float()

    report = mcaa.check_discontinuities(f, (64, 64))
    (first, lt, count), (second, also, none) = report.decisions
    assert lt == also == "lt" and none == 0 and count == 64
    assert int(second.rsplit(":")[-1]) == int(first.rsplit(":")[-1]) + 1 and __file__ in first
    assert f"{first}  lt: 64" in str(report) and f"{second}  lt: none" in str(report)


def test_random_functions_are_called_so() -> None:
    report = mcaa.check_discontinuities(lambda x, y: torch.rand_like(x), (16, 16))
    assert report.random and not report.ok and "random" in str(report)


def test_problems_are_reported() -> None:
    report = mcaa.check_discontinuities(lambda x, y: (x < RADIUS.item()).float(), (16, 16))
    assert not report.ok and report.jumps == () and "its gradient is lost" in str(report)


def test_what_is_no_function_is_refused() -> None:
    with pytest.raises(mcaa.McaaError, match="must be a function"):
        mcaa.check_discontinuities(3, (16, 16))  # pyright: ignore[reportArgumentType]
    with pytest.raises(mcaa.McaaError, match="size"):
        mcaa.check_discontinuities(lambda x, y: x, (0, 16))
    with pytest.raises(mcaa.McaaError, match="f must return a tensor.*got NoneType"):
        mcaa.check_discontinuities(lambda x, y: None, (16, 16))
    with pytest.raises(mcaa.McaaError, match="seed must be an integer"):
        mcaa.check_discontinuities(lambda x, y: x, (16, 16), seed="1")  # pyright: ignore[reportArgumentType]
    with pytest.raises(mcaa.McaaError, match="inside a transform"):
        torch.vmap(lambda p: mcaa.check_discontinuities(lambda x, y: x * p, (16, 16)))(torch.ones(2))
