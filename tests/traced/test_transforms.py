"""f may use vmap, grad and jvp inside: the same picture, gradient and silence as without them."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.utils.checkpoint import checkpoint

import torch_mcaa as mcaa
from torch_mcaa.grid import Screen
from torch_mcaa.traced.program import probe

SITES = torch.tensor([[3.0, 4.0], [12.0, 5.0], [7.0, 12.0], [13.0, 13.0]])
CIRCLES = torch.tensor([[4.0, 4.0], [11.0, 5.0], [8.0, 12.0]])
Function = Callable[[Tensor, Tensor], Any]


def _by_point(function: Callable[[Tensor, Tensor], Any]) -> Function:
    """A function of single points, mapped over all."""
    return lambda x, y: torch.vmap(function)(x.reshape(-1), y.reshape(-1)).reshape(x.shape)


def _points(p: Tensor) -> tuple[Function, Function]:
    return (
        _by_point(lambda a, b: torch.where(torch.hypot(a - 8, b - 8) < p, 1.0, 0.0)),
        lambda x, y: torch.where(torch.hypot(x - 8, y - 8) < p, 1.0, 0.0),
    )


def _sites(p: Tensor) -> tuple[Function, Function]:
    def distances(x: Tensor, y: Tensor) -> Tensor:
        return torch.stack([torch.hypot(x - a * p / 5, y - b) for a, b in SITES])

    return (
        lambda x, y: torch.vmap(lambda s: torch.hypot(x - s[0] * p / 5, y - s[1]))(SITES).argmin(0),
        lambda x, y: distances(x, y).argmin(0),
    )


def _nearest(p: Tensor) -> tuple[Function, Function]:
    def nearest(a: Tensor, b: Tensor) -> Tensor:
        # no dim: the index among all, of four in two rows
        return torch.hypot(a - SITES[:, 0] * p / 5, b - SITES[:, 1]).view(2, 2).argmin().float()

    return _by_point(nearest), _sites(p)[1]


def _nested(p: Tensor) -> tuple[Function, Function]:
    def disc(s: Tensor, a: Tensor, b: Tensor) -> Tensor:
        return (torch.hypot(a - s[0], b - s[1]) < p / 2) * s[0]

    def mapped(x: Tensor, y: Tensor) -> Tensor:
        return torch.vmap(lambda s: _by_point(lambda a, b: disc(s, a, b))(x, y))(CIRCLES).sum(0)

    return mapped, lambda x, y: torch.stack([disc(s, x, y) for s in CIRCLES]).sum(0)


def _box(x: Tensor, y: Tensor, p: Tensor) -> Tensor:
    """A distance that decides on its way."""
    across, down = (x - 8).abs() - p, (y - 8).abs() - 0.7 * p
    return torch.where(across > down, across, down)


def _normal(p: Tensor) -> tuple[Function, Function]:
    """Shaded by the slope of what decides."""

    def slope(x: Tensor, y: Tensor) -> Tensor:
        across, down = (x - 8).abs() - p, (y - 8).abs() - 0.7 * p
        return torch.where(across > down, torch.sign(x - 8), 0)

    return (
        lambda x, y: torch.where(_box(x, y, p) < 0, 0.5 + 0.3 * torch.func.grad(lambda x: _box(x, y, p).sum())(x), 0),
        lambda x, y: torch.where(_box(x, y, p) < 0, 0.5 + 0.3 * slope(x, y), 0),
    )


def _normals(p: Tensor) -> tuple[Function, Function]:
    """Point by point, the value with its slope."""

    def shaded(a: Tensor, b: Tensor) -> Tensor:
        slope, value = torch.func.grad_and_value(_box)(a, b, p)
        return torch.where(value < 0, 0.5 + 0.3 * slope, 0)

    return _by_point(shaded), _normal(p)[1]


def _autograd(p: Tensor) -> tuple[Function, Function]:
    def shaded(x: Tensor, y: Tensor) -> Tensor:
        with torch.enable_grad():
            x = x if x.requires_grad else x.clone().requires_grad_()
            value = _box(x, y, p)
            (slope,) = torch.autograd.grad(value.sum(), x, create_graph=True)
        return torch.where(value < 0, 0.5 + 0.3 * slope, 0)

    return shaded, _normal(p)[1]


def _jvp(p: Tensor) -> tuple[Function, Function]:
    def moved(x: Tensor, y: Tensor) -> Tensor:
        return torch.func.jvp(lambda x: torch.where(x < p, p * x, y), (x,), (torch.ones_like(x),))[1]

    return moved, lambda x, y: torch.where(x < p, p, 0)


def _mapped_parameter(p: Tensor) -> tuple[Function, Function]:
    """No operation is given the tensor itself that the gradient is for."""
    return (
        lambda x, y: torch.vmap(lambda p: (x < p).float())(p.reshape(1))[0],
        lambda x, y: (x < p).float(),
    )


@pytest.mark.parametrize("case", [_points, _sites, _nearest, _nested, _normal, _normals, _autograd, _jvp, _mapped_parameter])
@pytest.mark.parametrize("estimator", [mcaa.Auto(), mcaa.Shared()], ids=["Auto", "Shared"])
def test_pictures_and_gradients_are_those_of_plain_code(
    case: Callable[[Tensor], tuple[Function, Function]], estimator: mcaa.Estimator
) -> None:
    found = []
    for k in range(2):
        p = torch.tensor(5.3, requires_grad=True)
        layer = mcaa.Supersampler((16, 16), estimator=estimator)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            # PyTorch scripts its own derivatives at the first jvp, and deprecates that
            warnings.simplefilter("ignore", FutureWarning)
            picture = layer(case(p)[k])
            found.append((picture.detach(), *torch.autograd.grad((picture * torch.linspace(0, 1, 16)).sum(), p)))
    torch.testing.assert_close(found[0], found[1], rtol=1e-4, atol=1e-4)
    assert found[1][1].abs() > 1


def test_chunks_of_points_are_refused_by_name() -> None:
    p = torch.tensor(5.3, requires_grad=True)

    def chunked(x: Tensor, y: Tensor) -> Tensor:
        return torch.vmap(lambda a: (a < p).float(), chunk_size=64)(x.reshape(-1)).reshape(x.shape)

    with pytest.raises(mcaa.McaaError, match="chunk_size"):
        mcaa.Supersampler((8, 8))(chunked).sum().backward()


def test_a_checkpoint_around_a_slope_is_refused_by_name() -> None:
    p = torch.tensor(5.3, requires_grad=True)
    layer, (f, _) = mcaa.Supersampler((8, 8)), _normal(p)
    with pytest.raises(mcaa.McaaError, match="saved tensor hooks"):
        checkpoint(lambda: layer(f), use_reentrant=False)


def _slope(ramp: Callable[[Tensor], Tensor]) -> Callable[[Function], Function]:
    """The derivative by x of a ramp of a function."""
    return lambda h: lambda x, y: torch.vmap(torch.func.grad(lambda a, b: ramp(h(a, b))))(x, y)


def _pushed(h: Function) -> Function:
    return lambda x, y: torch.func.jvp(lambda a: torch.relu(h(a, y)), (x,), (torch.ones_like(x),))[1]


def _by_autograd(h: Function) -> Function:
    def f(x: Tensor, y: Tensor) -> Tensor:
        with torch.enable_grad():
            x = x.clone().requires_grad_()
            return torch.autograd.grad(torch.relu(h(x, y)).sum(), x, create_graph=True)[0]

    return f


SLOPES: dict[str, Callable[[Function], Function]] = {
    "relu": _slope(torch.relu),
    "abs": _slope(lambda h: (h + h.abs()) / 2),
    "maximum": _slope(lambda h: torch.maximum(h, torch.zeros_like(h))),
    "min of two": _slope(lambda h: -torch.min(-h, torch.zeros_like(h))),
    "max along an axis": _slope(lambda h: torch.stack([h, 0 * h]).max(0).values),
    "amin of two": _slope(lambda h: -torch.stack([-h, 0 * h]).amin(0)),
    "clamp": _slope(lambda h: h.clamp(0, 99)),
    "clamp by name": _slope(lambda h: torch.clamp(h, min=0.0)),
    "clamp_min": _slope(lambda h: h.clamp_min(0)),
    "clamp_max": _slope(lambda h: -torch.clamp_max(-h, 0)),
    "hardtanh": _slope(lambda h: torch.nn.functional.hardtanh(h, 0.0, 99.0)),
    "jvp": _pushed,
    "autograd.grad": _by_autograd,
}


def test_what_is_mapped_alone_decides_no_more_than_it_did() -> None:
    """Without a derivative a bend is none of its decisions."""
    p = torch.tensor(5.3, requires_grad=True)
    for inner, names in ((lambda h: h, []), (torch.func.grad, ["relu"])):
        f = _by_point(lambda a, b, inner=inner: inner(lambda c: torch.relu(c - p))(a) + b)
        assert [site.name for site in probe(f, Screen.of((8, 8)), torch.float32, torch.device("cpu")).sites] == names


@pytest.mark.parametrize("name", SLOPES)
@pytest.mark.filterwarnings("ignore:`torch.jit.script`:DeprecationWarning")
def test_slopes_that_f_takes_jump_where_it_bends(name: str) -> None:
    """As where the comparison is written out, on the same lines."""
    loss = torch.linspace(0.2, 1, 100).view(1, 10, 10)
    found = []
    for make in (SLOPES[name], lambda h: lambda x, y: torch.where(h(x, y) > 0, 0.9, 0.0)):
        p = torch.tensor(5.3, requires_grad=True)
        layer = mcaa.Supersampler((10, 10), estimator=mcaa.Shared(), spp=16)
        (layer(make(lambda x, y, p=p: 0.9 * x + 0.3 * y - p)) * loss).sum().backward()
        assert p.grad is not None
        found.append(float(p.grad))
    assert found[0] == pytest.approx(found[1], rel=1e-5) and abs(found[1]) > 1
