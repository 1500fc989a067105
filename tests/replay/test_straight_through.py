"""Slopes of f that its values do not have."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch
from heard import said
from torch import Tensor

import torch_mcaa as mcaa

EDGE = torch.tensor(6.2, requires_grad=True)
Scene = Callable[[Tensor, Tensor], Tensor]


class _Straight(torch.autograd.Function):
    """A step with the slope of its argument."""

    @staticmethod
    def forward(ctx: Any, v: Tensor) -> Tensor:
        return (v > 0).to(v)

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> Tensor:  # pyright: ignore[reportIncompatibleMethodOverride]
        return grad


def _detached(v: Tensor) -> Tensor:
    soft = torch.sigmoid(v)
    return ((v > 0).to(v) - soft).detach() + soft


SURROGATES: dict[str, Scene] = {
    "a function of autograd": lambda x, y: _Straight.apply(x - EDGE),
    "of units that are larger than pixels": lambda x, y: _Straight.apply((x - EDGE) / 16),
    "a detached difference": lambda x, y: _detached(x - EDGE),
    "rounding": lambda x, y: 0.1 * (x - EDGE + ((x - EDGE).round() - (x - EDGE)).detach()),
    "beside a channel that is not one": lambda x, y: torch.stack([torch.sin(y) * (x > EDGE), _Straight.apply(x - EDGE)]),
}
OWN: dict[str, Scene] = {
    "a step": lambda x, y: (x > EDGE).to(x),
    "slopes on either side": lambda x, y: torch.where(x > EDGE, torch.sin(y), EDGE * 0.1 * x),
    "a sigmoid that saturates": lambda x, y: torch.sigmoid(5 * (x - EDGE)) * (y > EDGE),
    "a slope that is left out": lambda x, y: torch.sin(x.detach()) * EDGE * (y < EDGE),
    "half precision": lambda x, y: torch.sin((x * y / 30).half()).to(x) * (x < EDGE),
    "next to no slope": lambda x, y: (x < EDGE) + 1e-6 * y,
    "stairs": lambda x, y: (x - EDGE).floor() + 0.001 * y,
}


def told(f: Scene) -> bool:
    return any("straight-through" in message for message in said(f, (16, 16), spp=4))


@pytest.mark.parametrize("name", SURROGATES)
def test_a_slope_beside_an_edge_is_told(name: str) -> None:
    assert told(SURROGATES[name])


@pytest.mark.parametrize("name", OWN)
def test_slopes_of_values_are_not(name: str) -> None:
    assert not told(OWN[name])


def test_nothing_is_asked_beyond_a_closed_screen() -> None:
    asked: list[Tensor] = []

    def f(x: Tensor, y: Tensor) -> Tensor:
        asked.append(x.detach())
        return _Straight.apply(x - EDGE)

    with pytest.warns(mcaa.McaaWarning, match="straight-through"):
        mcaa.Supersampler((16, 16), spp=4, estimator=mcaa.Shared(), boundary="zero")(f)
    assert 0 <= float(torch.cat(asked).min()) <= float(torch.cat(asked).max()) <= 16
