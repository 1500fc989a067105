"""f changes between the forward and the backward pass: its variables are held, and other changes are refused."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest
import torch
from torch import Tensor

import torch_mcaa as mcaa
from torch_mcaa.errors import McaaError
from torch_mcaa.replay.bound import bound

SIZE = 16, 16
LAYER = mcaa.Supersampler(SIZE, estimator=mcaa.Shared(), redraw=False)
GRAD = torch.rand(1, *SIZE, generator=torch.Generator().manual_seed(3))
IMAGE = GRAD[:, :8, :8]
SHARE, CALLS = 1.0, 0


def _scaled(distance: Tensor, radius: Tensor) -> Tensor:
    return (distance < SHARE * radius).float()


def _counted(x: Tensor, y: Tensor) -> Tensor:
    global CALLS
    CALLS += 1
    return x


class _Disc:
    """An object whose attributes may change."""

    def __init__(self, radius: Tensor, share: float) -> None:
        self.radius, self.share = radius, share

    def __call__(self, x: Tensor, y: Tensor) -> Tensor:
        return (torch.hypot(x - 8.2, y - 8) < self.share * self.radius).float()


def _closure(radius: Tensor) -> Iterator[Tensor]:
    for k in range(3):
        yield LAYER(lambda x, y: (torch.hypot(x - 8.2, y - 8) < radius * (k + 1) / 3).float())  # noqa: B023


def _inner(radius: Tensor) -> Iterator[Tensor]:
    """The loop's variable is read by a function in f's closure."""

    def step(distance: Tensor) -> Tensor:
        return (distance < radius * (k + 1) / 3).float()

    for k in range(3):  # noqa: B007
        yield LAYER(lambda x, y: step(torch.hypot(x - 8.2, y - 8)))


def _global(radius: Tensor) -> Iterator[Tensor]:
    global SHARE
    for k in range(3):
        SHARE = (k + 1) / 3
        yield LAYER(lambda x, y: _scaled(torch.hypot(x - 8.2, y - 8), radius))


@pytest.mark.parametrize("pictures", [_closure, _inner, _global])
def test_a_loop_goes_on_before_the_backward_pass(pictures: Callable[[Tensor], Iterator[Tensor]]) -> None:
    late, at_once = (torch.tensor(5.0, requires_grad=True) for _ in range(2))
    torch.stack([(GRAD * picture).sum() for picture in pictures(late)]).sum().backward()
    for picture in pictures(at_once):
        (GRAD * picture).sum().backward()
    torch.testing.assert_close(late.grad, at_once.grad, rtol=1e-5, atol=0)


def test_what_else_changes_is_refused() -> None:
    radius, colour = torch.tensor(5.0, requires_grad=True), torch.tensor(1.0)
    disc = _Disc(radius, 1.0)
    held = [1.0]

    def attribute() -> None:
        disc.share = 1.001

    def data() -> None:
        radius.data = radius.data + 0.003

    def element() -> None:
        held[0] = 0.5

    def buffer() -> None:
        colour.mul_(2)

    def f(x: Tensor, y: Tensor) -> Tensor:
        return disc(x, y) * held[0] * colour

    for change in (attribute, data, element, buffer):
        picture = LAYER(f)
        change()
        with pytest.raises(McaaError, match="changed between the forward and the backward pass"):
            picture.sum().backward()
        LAYER(f).sum().backward()


@pytest.mark.parametrize("what", ["std", "extent", "transform"])
def test_parameters_of_the_layer_count_too(what: str) -> None:
    start = {"std": torch.tensor(0.5), "extent": torch.tensor([0.0, 8.0, 0.0, 8.0]), "transform": torch.eye(3)}[what]
    parameter = start.requires_grad_()
    arguments: dict[str, Any] = {}
    if what != "transform":
        arguments = {"filter": mcaa.Gaussian(parameter)} if what == "std" else {"extent": parameter}
    f = mcaa.Texture(IMAGE, transform=parameter) if what == "transform" else torch.hypot
    picture = mcaa.Supersampler((8, 8), estimator=mcaa.Shared(), **arguments)(f)
    parameter.data = parameter.data * 1.01
    with pytest.raises(McaaError, match="a parameter of the filter, the extent or the transform changed"):
        picture.sum().backward()


def test_a_function_that_is_random_or_changes_what_it_reads_is_said_and_not_compared() -> None:
    weight = torch.tensor(2.0, requires_grad=True)

    def grows(x: Tensor, y: Tensor) -> Tensor:
        weight.data.add_(0.001)
        return (x < weight) * weight

    for f in (lambda x, y: weight * (x + torch.rand_like(x)), grows):
        with pytest.warns(mcaa.McaaWarning, match="is random, or changes something that it reads"):
            picture = LAYER(f)
        weight.grad = None
        picture.sum().backward()
        assert weight.grad is not None


def test_decisions_inside_vmap_are_compared() -> None:
    place = torch.tensor(3.0, requires_grad=True)
    picture = LAYER(lambda x, y: torch.vmap(lambda a: torch.where(a > place, 1.0, 0.0))(x))
    place.data = place.data + 0.003
    with pytest.raises(McaaError, match="changed between the forward and the backward pass"):
        picture.sum().backward()


def test_functions_that_set_what_they_read_are_as_they_were() -> None:
    count = 0

    def counting(x: Tensor, y: Tensor) -> Tensor:
        nonlocal count
        count += 1
        return x

    def calls(x: Tensor, y: Tensor) -> Tensor:
        return counting(x, y)

    def itself(x: Tensor, y: Tensor, deep: int = 2) -> Tensor:
        return itself(x, y, deep - 1) if deep else x + y

    def inner(x: Tensor, y: Tensor) -> Tensor:
        total = x

        def add() -> None:
            nonlocal total
            total = total + y

        add()
        return total

    assert bound(counting) is counting and bound(_counted) is _counted
    assert bound(calls) is calls
    for f in (itself, inner):
        twin = bound(f)
        assert twin is not f and float(twin(torch.tensor(1.0), torch.tensor(2.0))) == 3
    disc = _Disc(torch.tensor(1.0), 1.0)
    assert bound(disc) is disc and bound(torch.hypot) is torch.hypot
    decorated = torch.no_grad()(counting)
    assert bound(decorated) is decorated
