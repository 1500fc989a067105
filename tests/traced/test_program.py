"""What the probe says of f: its decisions with their lines, and what no trace will follow."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

import torch_mcaa as mcaa
from torch_mcaa.grid import Screen
from torch_mcaa.traced.program import probe

SCREEN = Screen.of((12, 12))
CPU = torch.device("cpu")
THETA = torch.tensor(3.0, requires_grad=True)
CONSTANT = torch.tensor(3.0)
STATE = torch.zeros(())
Function = Callable[[Tensor, Tensor], Any]


def problems(f: Function) -> tuple[str, ...]:
    return probe(f, SCREEN, torch.float32, CPU).problems


def disc(x: Tensor, y: Tensor) -> Tensor:
    return (torch.hypot(x, y) < THETA).float()


def test_a_decision_has_its_line() -> None:
    (site,) = probe(disc, SCREEN, torch.float32, CPU).sites
    line = inspect.getsourcelines(disc)[1] + 1
    assert site.where == f"{__file__}:{line}" and site.name == "lt" and site.axis == 0


def _numpy(x: Tensor, y: Tensor) -> Tensor:
    return torch.from_numpy(np.floor(x.numpy()))


def _array(x: Tensor, y: Tensor) -> Tensor:
    return torch.from_numpy(np.asarray(x) + 0)


def _item(x: Tensor, y: Tensor) -> Tensor:
    return (x < THETA.item()).float()


def _branch(x: Tensor, y: Tensor) -> Tensor:
    return torch.floor(x) if x.sum() > 0 else torch.ceil(x)


def _vmap(x: Tensor, y: Tensor) -> Tensor:
    return torch.vmap(lambda a: torch.where(a > 3, 1.0, 0.0))(x)


def _masked(x: Tensor, y: Tensor) -> Tensor:
    out, some = torch.zeros_like(x), x > 3
    out[some] = (y[some] > 2).float()
    return out


def _parameters(x: Tensor, y: Tensor) -> Tensor:
    return torch.where(THETA > 2, x, y)


def _state(x: Tensor, y: Tensor) -> Tensor:
    STATE.add_(1)
    return x * THETA


def _sorted_points(x: Tensor, y: Tensor) -> Tensor:
    return x.argsort().float()


@pytest.mark.parametrize(
    ("f", "said"),
    [
        (_numpy, "numpy takes values of the points out of PyTorch"),
        (_array, "takes values of the points out of PyTorch"),
        (_item, "item takes a parameter's value out of PyTorch, and its gradient is lost"),
        (_branch, "__bool__ lets Python's control flow depend on the points"),
        (_masked, "gt mixes points, or takes some of them only"),
        (_parameters, "gt decides on parameters alone"),
        (_state, "add_ changes a tensor in place that f did not make"),
        (_sorted_points, "argsort mixes points"),
    ],
)
def test_what_cannot_be_followed_is_named_with_its_line(f: Function, said: str) -> None:
    source, first = inspect.getsourcelines(f)
    found = [problem for problem in problems(f) if said in problem]
    assert len(found) == 1
    where = int(found[0].split(": ")[0].rsplit(":", 1)[1])
    assert found[0].startswith(__file__) and first <= where < first + len(source)


def test_code_that_torch_does_not_show_is_found_where_its_result_is_used() -> None:
    class Kernel(torch.autograd.Function):
        @staticmethod
        def forward(ctx, x):
            with torch._C.DisableTorchFunction():
                return (x > 3).float()

        @staticmethod
        def backward(ctx, *gradient):
            return gradient[0] * 0

    (problem,) = problems(lambda x, y: Kernel.apply(x) + y)
    assert "add takes a tensor from code that the trace cannot see" in problem
    (problem,) = problems(lambda x, y: Kernel.apply(x))
    assert "what f returns takes a tensor from code that the trace cannot see" in problem


def test_a_registered_kernel_is_named() -> None:
    kernel = torch.library.custom_op(
        "mcaa_tests::hidden", lambda x: (x > 3).float(), mutates_args=(), schema="(Tensor x) -> Tensor"
    )
    for call in (kernel, torch.ops.mcaa_tests.hidden):
        (problem,) = problems(lambda x, y, call=call: call(x.detach()) + y)
        assert "mcaa_tests" in problem and "is a kernel that the trace cannot see into" in problem
    assert problems(lambda x, y: torch.ops.aten.add.Tensor(x, y) + torch.ops.aten.mul(x, y)) == ()


def test_who_declares_a_jump_is_not_told_of_the_code_that_hides_it() -> None:
    def f(x: Tensor, y: Tensor) -> Tensor:
        mcaa.level_set(x - THETA)
        return torch.from_numpy((x.detach().numpy() > THETA.item()).astype(np.float32))

    assert problems(f) == ()


def test_who_declares_a_jump_that_does_not_move_is_told_what_is_lost() -> None:
    def f(x: Tensor, y: Tensor) -> Tensor:
        return mcaa.level_set(torch.from_numpy(x.detach().numpy() - THETA.item())) * y

    (problem,) = problems(f)
    assert "item takes a parameter's value out of PyTorch" in problem


def test_a_declaration_of_nothing_is_told() -> None:
    def f(x: Tensor, y: Tensor) -> Tensor:
        mcaa.level_set(torch.log(-(x - THETA).abs() - 1))
        return y

    (problem,) = problems(f)
    assert "level_set is given NaN everywhere" in problem


def _constants(x: Tensor, y: Tensor) -> Tensor:
    scale = 1.0 if bool(CONSTANT > 2) else 2.0
    return x * scale * CONSTANT.item() + torch.arange(3.0).sort().values.sum() / THETA


def _made(x: Tensor, y: Tensor) -> Tensor:
    """Of the points nothing but the type is in a constant that is made from them."""
    return (x > THETA) * torch.where(x.new_tensor(3.0) > 2, 1.0, 2.0) * (torch.ones_like(x[:1]) > 0.5)


def _sorted(x: Tensor, y: Tensor) -> Tensor:
    """Numbers in order are continuous wherever two of them change places, and poles and cuts of numbers are hardly met."""
    first = torch.sort(torch.stack([THETA, 2 / THETA])).values[0]
    return (x > first).float() * torch.stack([THETA, torch.atan2(THETA, 1 + THETA)]).max(0).values


def _own_state(x: Tensor, y: Tensor) -> Tensor:
    x -= 3
    out = torch.zeros_like(x)
    out += y
    out[x > 0] = THETA
    return out


def _turned(x: Tensor, y: Tensor) -> Any:
    """A texture that is made inside f looks at its transform."""
    return mcaa.Texture(torch.rand(1, 4, 4), "nearest", "repeat", transform=torch.eye(3) * THETA)(x, y)


def _network() -> Function:
    return mcaa.from_points(
        torch.nn.Sequential(torch.nn.Linear(2, 13), torch.nn.ReLU(), torch.nn.Linear(13, 17), torch.nn.Linear(17, 1))
    )


@pytest.mark.parametrize(
    "f", [disc, _vmap, _constants, _sorted, _own_state, _made, _turned, _network(), mcaa.Texture(torch.rand(3, 13, 17), "nearest")]
)
def test_nothing_is_said_of_what_is_in_order(f: Function) -> None:
    """13 and 17 are the probe's numbers of points: layers and textures of those sizes are not taken for points."""
    assert problems(f) == ()


def test_an_error_of_f_is_chained() -> None:
    with pytest.raises(mcaa.McaaError, match=r"f raised RuntimeError") as caught:
        problems(lambda x, y: x @ torch.ones(3, 3))
    assert isinstance(caught.value.__cause__, RuntimeError)


def test_functions_that_fold_their_points_are_probed_with_whole_rows() -> None:
    (site,) = probe(lambda x, y: (x.view(-1, 64) > THETA).view(-1).float() + 0 * (x > 100), SCREEN, torch.float32, CPU).sites[1:]
    assert site.axis == 0


def test_two_runs_that_differ_are_an_error() -> None:
    calls = []

    def f(x: Tensor, y: Tensor) -> Tensor:
        calls.append(1)
        return torch.floor(x) if len(calls) % 2 else x

    with pytest.raises(mcaa.McaaError, match="control flow depends on values"):
        problems(f)
