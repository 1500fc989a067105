"""What a function is found to depend on."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

import torch_mcaa as mcaa
from torch_mcaa.errors import McaaError, McaaWarning
from torch_mcaa.integrand import Integrand
from torch_mcaa.replay.dependencies import Dependencies, check_reached, dependencies

X, Y = torch.rand(2, 256, generator=torch.Generator().manual_seed(0))


def found(f: Callable[[Tensor, Tensor], Any]) -> Dependencies:
    return dependencies(Integrand(f), X, Y)


def learned(*shape: int) -> Tensor:
    return torch.ones(shape, requires_grad=True)


class Doubled(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor) -> Tensor:
        return 2 * x

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> Tensor:
        return 2 * grads[0]


def same(tensors: tuple[Tensor, ...], expected: set[Tensor]) -> bool:
    return len(tensors) == len(expected) and {id(t) for t in tensors} == {id(t) for t in expected}


def test_closures_lists_and_modules() -> None:
    a, b, c, plain = learned(), learned(3), learned(), torch.ones(())
    net = torch.nn.Linear(2, 1)
    nested = {"b": [b]}

    def f(x: Tensor, y: Tensor) -> tuple[Tensor, ...]:
        out = net(torch.stack([x, y], -1))[..., 0]
        return torch.stack([a * x, out]).sum(0) + plain, torch.where(x < c, nested["b"][0][1] * y, 0)

    assert same(found(f).tensors, {a, b, c, net.weight, net.bias})
    assert found(f).smooth


def test_a_tensor_that_decides_only() -> None:
    radius = learned()
    assert same(found(lambda x, y: (x < radius).float()).tensors, {radius})
    assert not found(lambda x, y: (x < radius).float()).smooth


def test_what_was_computed_outside_is_an_input_itself() -> None:
    weight = learned()
    scaled = 3 * weight
    assert same(found(lambda x, y: scaled * x).tensors, {scaled})
    # and where the value is that tensor
    assert same(found(lambda x, y: scaled.expand(x.shape)).tensors, {scaled})


def test_custom_operations() -> None:
    weight = learned()
    scaled = 3 * weight
    assert same(found(lambda x, y: x * Doubled.apply(weight)).tensors, {weight})
    assert same(found(lambda x, y: x * Doubled.apply(scaled)).tensors, {scaled})


def test_operations_that_cannot_be_seen() -> None:
    """As in scripted code: a leaf is found in the graph, and what was computed from one outside cannot be."""
    weight = learned()
    scaled = 3 * weight

    def unseen(x: Tensor, tensor: Tensor) -> Tensor:
        with torch._C.DisableTorchFunction():
            return x * tensor

    assert same(found(lambda x, y: unseen(x, weight)).tensors, {weight})
    with pytest.raises(McaaError, match=r"MulBackward0.*custom operation or scripted code.*1 \* tensor"):
        found(lambda x, y: unseen(x, scaled))
    assert same(found(lambda x, y: unseen(x, 1 * scaled)).tensors, {scaled})


def test_what_f_makes_itself_is_none() -> None:
    def f(x: Tensor, y: Tensor) -> Tensor:
        own = torch.ones((), requires_grad=True)
        return x * own

    assert found(f).tensors == () and found(f).own == 1


@pytest.mark.parametrize(("turn", "name"), [(float, "__float__"), (Tensor.item, "item"), (Tensor.tolist, "tolist")])
@pytest.mark.filterwarnings("ignore:Converting a tensor:UserWarning")
def test_numbers(turn: Callable[[Tensor], float], name: str) -> None:
    weight = learned()
    assert found(lambda x, y: x * turn(weight)).severed == {name}
    with pytest.warns(McaaWarning, match=f"into a number by {name}"):
        mcaa.Supersampler((4, 4), discontinuities=False)(lambda x, y: x * turn(weight))


def test_in_place_operations_are_told() -> None:
    weight = learned(256)
    with pytest.raises(McaaError, match="in-place"):
        found(lambda x, y: weight.add_(x))


def test_hooks_outside_hear_nothing() -> None:
    def refuse(tensor: Tensor) -> Tensor:
        raise AssertionError

    weight = learned()
    with torch.autograd.graph.saved_tensors_hooks(refuse, refuse):
        found(lambda x, y: torch.exp(weight * x))


def test_tensors_that_come_later_are_refused() -> None:
    a, b = learned(), learned(2)
    known = Dependencies((a,), True, 0)
    check_reached([a * X], known)
    with pytest.raises(McaaError, match=r"of shape \(2,\)"):
        check_reached([a * X + b[0]], known)
    scaled = 3 * b
    check_reached([scaled[0] * X], Dependencies((scaled,), True, 0))


def test_nothing_is_missed_in_a_branch() -> None:
    """A tensor that is used in a corner of the screen alone, where no probe lies."""
    a, b = learned(), learned()
    layer = mcaa.Supersampler((400, 400), spp=1, discontinuities=False)

    def f(x: Tensor, y: Tensor) -> Tensor:
        return a * x + (b * y if bool((x + y < 0.5).any()) else 0)

    with pytest.raises(McaaError, match="not used them at the first ones"):
        layer(f).sum().backward()
