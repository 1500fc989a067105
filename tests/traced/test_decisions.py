"""Every operation that decides, in every spelling: the edge it makes has the gradient of the plain comparison."""

from __future__ import annotations

import math

import pytest
import torch
from steps import SPELLINGS
from terms import boundary_term
from torch import Tensor

import torch_mcaa as mcaa
from torch_mcaa import scenes
from torch_mcaa.grid import Screen
from torch_mcaa.traced.decisions import in_place, name_of
from torch_mcaa.traced.ruling import rule_of

SCREEN = Screen.of((12, 12))
FILTER = mcaa.Gaussian(0.5)
RADIUS = 4.0


def gradient(spelling: str, seed: int = 0) -> tuple[Tensor, Tensor]:
    """The boundary term of a step across a circle, and the gradient of a smooth loss by its radius."""
    radius = torch.tensor(RADIUS, dtype=torch.float64, requires_grad=True)

    def f(x: Tensor, y: Tensor) -> Tensor:
        return SPELLINGS[spelling](torch.hypot(x - 6.1, y - 5.8) - radius)

    term = boundary_term(f, SCREEN, FILTER, seed, 4, dtype=torch.float64)
    loss = torch.cos(torch.arange(144, dtype=torch.float64)).view(1, 12, 12) * 0.3 + 1
    return term, torch.autograd.grad((term * loss).sum(), radius)[0]


@pytest.fixture(scope="module")
def expected() -> float:
    return float(gradient("h < 0")[1])


@pytest.mark.parametrize("spelling", SPELLINGS)
def test_every_spelling_has_the_gradient_of_the_comparison(spelling: str, expected: float) -> None:
    """The last brackets are 2^-10 px wide, and the margin's derivative, or the step's height, may change by as much of a radius' part."""
    term, found = gradient(spelling)
    assert bool((term == 0).all())
    assert float(found) == pytest.approx(expected, rel=3e-4)


def test_the_comparison_has_the_right_gradient(expected: float) -> None:
    """The loss's gradient by the radius, a central difference of the disc's closed form."""
    x, y = SCREEN.centres()

    def picture(radius: float) -> Tensor:
        return scenes.Disc(6.1, 5.8, radius).exact(x, y[:, None], mcaa.Gaussian(0.5))

    loss = torch.cos(torch.arange(144, dtype=torch.float64)).view(12, 12) * 0.3 + 1
    slope = float((loss * (picture(RADIUS + 1e-4) - picture(RADIUS - 1e-4))).sum()) / 2e-4
    # the shift of the lines is one of few: the standard deviation of the sum is 3e-4
    assert expected == pytest.approx(slope, rel=1.5e-3)


@pytest.mark.parametrize(
    ("function", "name"),
    [
        (torch.lt, "lt"),
        (torch.Tensor.lt, "lt"),
        (torch.Tensor.lt_, "lt"),
        (torch.Tensor.__lt__, "lt"),
        (torch.ops.aten.lt.Scalar, "lt"),
        (torch.Tensor.__floordiv__, "floordiv"),
        (torch.Tensor.__imod__, "mod"),
        (torch.special.round, "round"),
    ],
)
def test_names(function: object, name: str) -> None:
    assert name_of(function) == name and rule_of(function) is not None


def test_what_decides_nothing() -> None:
    for function in (
        torch.relu,
        torch.clamp,
        torch.maximum,
        torch.abs,
        torch.where,
        torch.exp,
        torch.Tensor.item,
        torch.Tensor.__bool__,
    ):
        assert rule_of(function) is None
    assert in_place(torch.Tensor.add_) and in_place(torch.Tensor.__iadd__) and in_place(torch.Tensor.__setitem__)
    assert not in_place(torch.Tensor.add) and not in_place(torch.Tensor.__lt__)


def test_level_set_outside_a_trace_is_a_comparison_and_refuses_integers() -> None:
    assert mcaa.level_set(torch.tensor([-1.0, 0.0, 1.0])).tolist() == [False, False, True]
    for wrong in (torch.tensor([1, 2]), 3.0):
        with pytest.raises(mcaa.McaaError, match="floating point"):
            mcaa.level_set(wrong)  # pyright: ignore[reportArgumentType]


def test_the_branch_cut_of_an_angle_turns_with_it() -> None:
    """f = atan2, continuous but for the cut; the picture's mean slope by the cut's shift is that of its height 2 π, ∫ w over the half line."""
    shift = torch.tensor(5.3, dtype=torch.float64, requires_grad=True)
    term = boundary_term(lambda x, y: torch.atan2(y - shift, x - 6.2), SCREEN, mcaa.Box(), 3, 3, dtype=torch.float64)
    picture = torch.stack([torch.autograd.grad(term[0, 5, k], shift, retain_graph=True)[0] for k in range(12)])
    # the cut runs along row 5 from the left to x = 6.2; y grows through it from -π to π, and it moves with the shift
    truth = torch.tensor([-2 * math.pi] * 6 + [-2 * math.pi * 0.2] + [0.0] * 5, dtype=torch.float64)
    # only where lines meet the cut's end is there an error: one line of three in a pixel
    assert torch.allclose(picture[[0, 1, 2, 3, 4, 5, 8, 9, 10, 11]], truth[[0, 1, 2, 3, 4, 5, 8, 9, 10, 11]], rtol=1e-3, atol=1e-3)
    assert abs(float(picture[6] - truth[6])) < 2 * math.pi / 3
