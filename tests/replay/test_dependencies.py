"""What a function is found to depend on."""

from __future__ import annotations

import math
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
    known = Dependencies((a,), (a,), True, 0)
    check_reached([a * X], known)
    with pytest.raises(McaaError, match=r"of shape \(2,\)"):
        check_reached([a * X + b[0]], known)
    scaled = 3 * b
    check_reached([scaled[0] * X], Dependencies((scaled,), (scaled,), True, 0))


def test_nothing_is_missed_in_a_branch() -> None:
    """A tensor that is used in a corner of the screen alone, where no probe lies."""
    a, b = learned(), learned()
    layer = mcaa.Supersampler((400, 400), spp=1, discontinuities=False)

    def f(x: Tensor, y: Tensor) -> Tensor:
        return a * x + (b * y if bool((x + y < 0.5).any()) else 0)

    with pytest.raises(McaaError, match="not used them at the first ones"):
        layer(f).sum().backward()


class Cached(torch.nn.Module):
    """Uses a parameter and what it has computed from it before."""

    def __init__(self) -> None:
        super().__init__()
        self.weight = torch.nn.Parameter(torch.tensor([2.0, 3.0]))
        self.cached = self.weight.exp()

    def forward(self, x: Tensor, y: Tensor) -> Tensor:
        return torch.where(x < self.weight[1], self.weight[0] * x + self.cached[0], self.cached[1])


def of_both(p: Tensor, q: Tensor) -> Callable[[Tensor, Tensor], Tensor]:
    return lambda x, y: q.flatten()[0] * x + torch.where(y < 3.7 + p[0], p[1], q.flatten()[1] * p[0])


MADE: dict[str, Callable[[Tensor], Callable[[Tensor, Tensor], Tensor]]] = {
    "view": lambda p: of_both(p, p.view(1, 2)),
    "stack": lambda p: of_both(p, torch.stack([p[0], p[1]])),
    "square": lambda p: of_both(p, p**2),
    "both parts": lambda p: of_both(torch.stack(p.unbind()), p.exp()),
    "three": lambda p: of_both(q := p * 1, (q * 1).exp() + p.detach()),
}


@pytest.mark.parametrize("name", MADE)
@pytest.mark.parametrize("discontinuities", ["auto", False])
def test_a_tensor_and_one_computed_from_it_count_once(name: str, discontinuities: Any) -> None:
    """Where plain autograd is right: in the pixels that no edge reaches."""
    y, x = torch.meshgrid(torch.arange(12) + 0.5, torch.arange(6) + 0.5, indexing="ij")
    given = torch.zeros(12, 6)
    given[:2], given[10:] = 1.0, -2.0
    p, q = (torch.tensor([2.0, 3.0], requires_grad=True) for _ in range(2))
    (MADE[name](p)(x, y) * given).sum().backward()
    layer = mcaa.Supersampler((12, 6), discontinuities=discontinuities)
    for _ in range(2):
        # a graph that is kept has not been used up
        (layer(MADE[name](q))[0] * given).sum().backward()
    assert p.grad is not None and q.grad is not None
    # linear in x, so that the lattice errs by rounding
    torch.testing.assert_close(q.grad, 2 * p.grad, rtol=1e-5, atol=1e-4)


def test_a_module_and_what_it_has_kept() -> None:
    module = Cached()
    module.cached.sum().backward(retain_graph=True)
    assert module.weight.grad is not None
    module.weight.grad = None
    picture = mcaa.Supersampler((6, 6))(module)
    (x,) = torch.autograd.grad(picture[0, :, 0].sum(), module.weight)
    # 6 pixels at x = 1/2, with an edge 2.5 px away that no sample of theirs meets
    expected = torch.tensor([6 * 0.5 + 6 * math.exp(2.0), 0.0])
    torch.testing.assert_close(x, expected, rtol=1e-5, atol=1e-4)


def test_what_was_computed_outside_and_cannot_be_seen_beside_what_it_was_computed_from() -> None:
    weight = learned()
    scaled = 3 * weight
    with pytest.raises(McaaError, match="computed outside it"):
        found(lambda x, y: scaled * weight * x + torch.func.grad(lambda s: s**2)(scaled))


def test_a_parameter_made_in_inference_mode_is_refused() -> None:
    with torch.inference_mode():
        radius = torch.nn.Parameter(torch.tensor(5.0))
    with pytest.raises(McaaError, match="inference_mode"):
        mcaa.Supersampler((8, 8))(lambda x, y: (torch.hypot(x - 4, y - 4) < radius).float())
