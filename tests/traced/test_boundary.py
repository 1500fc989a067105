"""The boundary term: 0 in value; in gradient what the samples lack, against closed forms and under every filter."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest
import torch
from gradients import Score, edges, main, score
from jumping import FILTERED, MORE, SIZE, TABLE, THIN, Case
from terms import boundary_term
from torch import Tensor

import torch_mcaa as mcaa
from torch_mcaa.grid import Cell, Screen
from torch_mcaa.traced.boundary import elements, splat, surrogate
from torch_mcaa.traced.once import zero_with_gradient

SCREEN = Screen.of(SIZE)
CELL = Cell(0, 0, *SIZE)
FILTER = mcaa.Gaussian(0.5)
SEEDS = 24
ACCURATE = 1e-3
"""Of the true derivative image: brackets of 2^-10 px, where the seeds' spread is less."""


def named(case: Case) -> str:
    return case.name


def scored(case: Case, seeds: int = SEEDS) -> Score:
    return score(case, seeds)


@pytest.mark.parametrize("case", TABLE, ids=named)
def test_the_bias_is_chance_and_the_deviation_no_more_than_asked(case: Case) -> None:
    """Lattice shifts are independent from seed to seed. The mean square over pixels of a mean's error over its variance is 1.

    Few pixels matter and they are correlated: 2.2 of the root is over 4.5 standard deviations for one degree of freedom's normal tail at
    1e-5, and more for several. The deviation, from 24 seeds, may come out a third too large.
    """
    s = scored(case)
    assert s.bias < 4.42 * s.chance + 100 * ACCURATE
    assert s.deviation < 1.33 * case.asked
    assert s.plain > 30
    assert s.evaluations < 16


@pytest.mark.parametrize("case", [*MORE, *FILTERED], ids=named)
def test_the_bias_is_chance(case: Case) -> None:
    s = scored(case)
    assert s.bias < 4.42 * s.chance + 100 * ACCURATE
    assert s.plain == pytest.approx(100)


@pytest.mark.parametrize("case", THIN, ids=named)
def test_thin_pieces_are_right_on_average(case: Case) -> None:
    """The sum of the derivative image, over 150 seeds; 4.42 standard errors, which are heavy-tailed but bounded by 1 / chord."""
    truth = float(case.derivative().sum())
    sums = torch.stack([edges(case, seed, 3)[0].sum() for seed in range(150)])
    error = float(sums.std()) / math.sqrt(150)
    assert abs(float(sums.mean()) - truth) < 4.42 * error
    assert error < 0.15 * abs(truth)


def disc(radius: Tensor, x: Tensor, y: Tensor) -> Tensor:
    return (torch.hypot(x - 6.1, y - 5.8) < radius).to(x.dtype)


def parameter(value: float = 4.0, dtype: torch.dtype = torch.float64) -> Tensor:
    return torch.tensor(value, dtype=dtype, requires_grad=True)


def test_the_value_is_zero_bit_for_bit_and_adds_nothing() -> None:
    radius = parameter()
    term = boundary_term(lambda x, y: (disc(radius, x, y), 7 - disc(radius, x, y)), SCREEN, FILTER, 1)
    assert term.shape == (2, *SIZE) and bool((term == 0).all())
    picture = torch.rand(2, *SIZE, dtype=torch.float64) - 0.5
    assert torch.equal(picture + term, picture)
    first, second = (torch.autograd.grad(term[c].sum(), radius, retain_graph=True)[0] for c in (0, 1))
    assert float(first) > 20 and float(second) == pytest.approx(-float(first))


def test_the_surrogate_has_the_gradient_of_the_dense_term() -> None:
    radius = parameter()
    loss = torch.cos(torch.arange(144, dtype=torch.float64)).view(1, *SIZE)

    def f(x: Tensor, y: Tensor) -> Tensor:
        return disc(radius, x, y)

    (dense,) = torch.autograd.grad((boundary_term(f, SCREEN, FILTER, 5, dtype=torch.float64) * loss).sum(), radius)
    met = elements(f, SCREEN, CELL, FILTER, 5, dtype=torch.float64)
    rows, cols, weights = splat(met, SCREEN, FILTER)
    coefficient = (loss[0][rows, cols] * weights).sum(1) * met.jump[0] * met.weight
    value = surrogate(f, SCREEN, met, coefficient)
    assert float(value.detach()) == 0
    (sparse,) = torch.autograd.grad(value, radius)
    assert float(sparse) == pytest.approx(float(dense), rel=1e-12)


def test_second_derivatives_are_refused() -> None:
    radius = parameter()

    def gradient() -> Tensor:
        term = boundary_term(lambda x, y: disc(radius * radius / 4, x, y), SCREEN, FILTER, 1, dtype=torch.float64)
        return torch.autograd.grad(term.square().sum() + term.sum(), radius, create_graph=True)[0]

    with pytest.raises(mcaa.McaaError, match="second derivative"):
        torch.autograd.grad(gradient(), radius)
    with pytest.raises(mcaa.McaaError, match="second derivative"):
        gradient().backward()


def test_zero_with_gradient() -> None:
    x = torch.tensor([1.0, -2.0], requires_grad=True)
    zero = zero_with_gradient(3 * x)
    assert zero.tolist() == [0.0, 0.0]
    assert torch.autograd.grad(zero.sum(), x)[0].tolist() == [3.0, 3.0]


def test_jumps_of_fixed_things_have_no_gradient_and_cost_no_error() -> None:
    colour = parameter(0.7)
    term = boundary_term(lambda x, y: torch.where(x > 5.5, colour, 0.1), SCREEN, FILTER, 1, dtype=torch.float64)
    slope = torch.autograd.grad(term.sum(), colour, allow_unused=True)[0] if term.requires_grad else None
    assert slope is None or float(slope) == 0


def board(x: Tensor, y: Tensor) -> Tensor:
    return torch.remainder(torch.floor(x / 1.7) + torch.floor(y / 1.9), 2)


def test_edges_that_do_not_move_cost_nothing() -> None:
    """A disc cut out of a checkerboard: evaluations are those of the disc alone, and its jumps those to the board."""
    radius, places = parameter(), {}
    for name, ground in (("plain", lambda x, y: torch.zeros_like(x)), ("board", board)):
        count = [0]

        def tally(col: Tensor, row: Tensor, count: list[int] = count) -> None:
            count[0] += len(col)

        def f(x: Tensor, y: Tensor, ground=ground) -> Tensor:
            return torch.where(torch.hypot(x - 6.1, y - 5.8) < radius, 2.0, ground(x, y))

        met = elements(f, SCREEN, CELL, FILTER, 5, dtype=torch.float64, tally=tally)
        places[name] = met.col, met.jump.abs(), count[0]
    assert torch.equal(places["plain"][0], places["board"][0]) and places["plain"][2] == places["board"][2]
    assert set(places["plain"][1].flatten().tolist()) == {2.0} and set(places["board"][1].flatten().tolist()) == {1.0, 2.0}
    none = elements(board, SCREEN, CELL, FILTER, 5, tally=lambda col, row: pytest.fail("f was asked"))
    assert len(none) == 0 and none.jump.shape == (1, 0)


def test_a_moving_edge_on_a_fixed_one_is_the_moving_one() -> None:
    """Two channels with one edge: f decides on the fixed one first."""
    edge = parameter(5.3)
    term = boundary_term(lambda x, y: (x > 5.3, x > edge), SCREEN, FILTER, 2, dtype=torch.float64)
    assert float(torch.autograd.grad(term[1].sum(), edge)[0]) == pytest.approx(-12, rel=1e-2)


def test_an_outline_by_crossing_numbers() -> None:
    """Decisions that jump nowhere, rows of the vertices, in segments with true edges: those are not left out with them.

    The gradient of a polygon's area is the shoelace formula's. 3 lines a pixel on edges of 8 px and more: 2 % at their ends.
    """
    vertices = torch.tensor([[3.0, 4], [20, 5], [17, 19], [6, 16]], dtype=torch.float64, requires_grad=True)

    def f(x: Tensor, y: Tensor) -> Tensor:
        (ax, ay), (bx, by) = vertices.T[:, None], vertices.roll(-1, 0).T[:, None]
        row, crossing = y[:, None], ax + (y[:, None] - ay) / (by - ay) * (bx - ax)
        return (((ay <= row) != (by <= row)) & (x[:, None] < crossing)).sum(1) % 2

    after = vertices.roll(-1, 0)
    (truth,) = torch.autograd.grad(0.5 * (vertices[:, 0] * after[:, 1] - after[:, 0] * vertices[:, 1]).sum(), vertices)
    for seed in range(3):
        term = boundary_term(f, Screen.of((24, 24)), FILTER, seed, dtype=torch.float64)
        (found,) = torch.autograd.grad(term.sum(), vertices)
        assert float((found - truth).abs().max()) < 0.05 * float(truth.abs().max())


def test_edges_of_different_tensors_on_one_another_are_said() -> None:
    """Colour fringes that start at nothing: which of three equal edges has which jump cannot be told. A step later it can."""
    shifts = [parameter(value) for value in (0.0, 0.0, 0.0)]

    def f(x: Tensor, y: Tensor) -> list[Tensor]:
        return [disc(torch.tensor(4.0), x - shift, y) for shift in shifts]

    met = elements(f, SCREEN, CELL, FILTER, 2, dtype=torch.float64, inputs=shifts)
    assert len(met.problems) == 1 and "pixel apart" in met.problems[0] and met.problems[0].count(__file__) == 2
    with torch.no_grad():
        for k, shift in enumerate(shifts):
            shift += 0.01 * k
    assert elements(f, SCREEN, CELL, FILTER, 2, dtype=torch.float64, inputs=shifts).problems == ()


def by_numbers(x: Tensor, y: Tensor, shift: Tensor) -> list[Tensor]:
    return [disc(torch.tensor(4.0), x - number, y) for number in shift]


def by_lanes(x: Tensor, y: Tensor, shift: Tensor) -> Tensor:
    return disc(torch.tensor(4.0), x - shift[:, None], y)


@pytest.mark.parametrize("f", [by_numbers, by_lanes])
def test_edges_of_numbers_of_one_tensor_on_one_another_are_said(f: Callable[..., Any]) -> None:
    """The same with the shifts in one tensor, and by one comparison."""
    for start, said in (([0.0, 0, 0], True), ([0.0, 0.01, 0.02], False)):
        shift = torch.tensor(start, dtype=torch.float64, requires_grad=True)
        met = elements(lambda x, y, s=shift: f(x, y, s), SCREEN, CELL, FILTER, 2, dtype=torch.float64, inputs=[shift])
        assert bool(met.problems) == said
        if said:
            assert __file__ in met.problems[0] and "other numbers move it" in met.problems[0]


def test_edges_that_belong_together_are_not_said() -> None:
    """One margin twice; a decision that follows from another; corners, where edges of different tensors cross."""
    radius, height = parameter(), parameter(1.0)

    def f(x: Tensor, y: Tensor) -> Tensor:
        inside = disc(radius, x, y)
        again = torch.hypot(x - 6.1, y - 5.8) < radius
        return torch.where(again, height, 0.0) * inside + ((inside * height > 0.5) & (x > 6 * height))

    assert elements(f, SCREEN, CELL, FILTER, 2, dtype=torch.float64, inputs=[radius, height]).problems == ()


def test_decisions_that_always_come_together_are_not_said() -> None:
    """Two ways to ask for one edge, two lanes of a sort, and sides of a polygon that meet in corners, all by numbers of one tensor."""
    numbers = torch.tensor([6.1, 5.8, 3.3, 0.4], dtype=torch.float64, requires_grad=True)

    def f(x: Tensor, y: Tensor) -> list[Tensor]:
        radius = torch.hypot(x - numbers[0], y - numbers[1])
        first = (radius < numbers[2]).double() + ((x - numbers[0]) ** 2 + (y - numbers[1]) ** 2 < numbers[2] ** 2)
        ordered = torch.stack([radius, 0.5 * (x + y), numbers[3] * x + y]).argsort(0).double()
        sides = torch.stack([x - numbers[2], y - numbers[2], 9.3 - x, numbers[0] + 3 - y])
        return [first, ordered[0] + 2 * ordered[1], (sides > 0).all(0).double()]

    assert elements(f, SCREEN, CELL, FILTER, 2, dtype=torch.float64, inputs=[numbers]).problems == ()


def test_a_moving_decision_that_jumps_at_a_fixed_edge_has_no_part() -> None:
    height = parameter(1.0)
    met = elements(lambda x, y: torch.where(x > 5.3, height, 0.0) > 0.5, SCREEN, CELL, FILTER, 2, dtype=torch.float64)
    assert len(met) == 0 and met.problems == ()


def test_all_parameters_of_a_module_in_float32() -> None:
    """A layer in float32 refuses float64 places, so it is asked in float32: one edge, a line through its weights."""

    class Half(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.linear = torch.nn.Linear(2, 1)
            with torch.no_grad():
                self.linear.weight.copy_(torch.tensor([[0.8, 0.6]]))
                self.linear.bias.fill_(-8.0)

        def forward(self, x: Tensor, y: Tensor) -> Tensor:
            return (self.linear(torch.stack([x, y], -1))[:, 0] > 0).float()

    module = Half()
    term = boundary_term(module, SCREEN, FILTER, 2)
    assert bool((term == 0).all())
    term.sum().backward()
    # the picture's sum is the area beyond the line, which is 15 px long; the bias moves it by one px a unit
    bias, weight = module.linear.bias.grad, module.linear.weight.grad
    assert bias is not None and weight is not None
    assert float(bias) == pytest.approx(15, rel=0.01)
    # moved on the line by its own place there: the mean column and row of the chord
    assert float(weight[0, 0] * 0.8 + weight[0, 1] * 0.6) == pytest.approx(8 * float(bias), rel=1e-3)


def test_an_extent_scales_the_gradient() -> None:
    """The same disc in units of 1/100 px, with y up: the derivative by its radius in those is 100 times that in pixels."""
    radius, small = parameter(), parameter(0.04)
    pixels = boundary_term(lambda x, y: disc(radius, x, y), SCREEN, FILTER, 3, dtype=torch.float64)
    screen = Screen.of(SIZE, (0.0, 0.12, 0.12, 0.0))
    scaled = boundary_term(
        lambda x, y: (torch.hypot(x - 0.061, 0.12 - y - 0.058) < small).double(), screen, FILTER, 3, dtype=torch.float64
    )
    one, other = torch.autograd.grad(pixels.sum(), radius)[0], torch.autograd.grad(scaled.sum(), small)[0]
    assert float(other) == pytest.approx(100 * float(one), rel=1e-6)


@pytest.mark.filterwarnings("ignore")
def test_margins_that_cannot_be_followed_are_said_with_their_line() -> None:
    radius = parameter()
    met = elements(lambda x, y: disc(radius, x.detach(), y.detach()), SCREEN, CELL, FILTER, 0)
    assert len(met) == 0 and len(met.problems) == 1
    assert __file__ in met.problems[0] and "no derivative by x and y" in met.problems[0]

    def behind(x: Tensor, y: Tensor) -> Tensor:
        hidden = torch.from_numpy((x.detach().numpy() > 5.2) * 1.0) + 1e-3 * x
        return (hidden > radius / 8).double()

    met = elements(behind, SCREEN, CELL, FILTER, 0)
    assert len(met) == 0 and "jumps there, before any decision" in met.problems[0]


WITHOUT_RULE: dict[str, Callable[[Tensor], Tensor]] = {
    "isnan": lambda d: torch.sqrt(d).isnan(),
    "isfinite": lambda d: torch.log(d).isfinite(),
    "isneginf": lambda d: torch.log(torch.relu(d)).isneginf(),
    "nan_to_num": lambda d: torch.nan_to_num(torch.sqrt(d) * 0 + 1),
    "ne": lambda d: (lambda root: root != root)(torch.sqrt(d)),
    "any": lambda d: torch.relu(d)[:, None].any(1),
    "count_nonzero": lambda d: torch.count_nonzero(torch.relu(d)[:, None], 1),
    "logical_and": lambda d: torch.logical_and(torch.relu(d), torch.ones_like(d)),
    "isin": lambda d: torch.isin(torch.relu(d), torch.zeros(1, dtype=d.dtype)),
    "frexp": lambda d: torch.frexp(torch.relu(d) + 1 + (d > 9))[0] * (torch.frexp(1 + d / 4)[1] > 0),
    "__setitem__": lambda d: _assigned(d),
}


def _assigned(d: Tensor) -> Tensor:
    out = torch.zeros_like(d, dtype=torch.bool)
    out[:] = torch.relu(d)
    return out


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", WITHOUT_RULE)
def test_operations_that_decide_and_have_no_margin_are_said_with_their_line(name: str) -> None:
    """Beside a texture, of which bisection by values would see more than of the jump."""
    radius = parameter()
    met = elements(
        lambda x, y: WITHOUT_RULE[name](torch.hypot(x - 5, y - 5) - radius) + 50 * torch.sin(7 * x) * torch.sin(5 * y),
        *(SCREEN, CELL, FILTER, 0),
    )
    assert any(__file__ in problem and f": {name} decides by something" in problem for problem in met.problems)


def test_no_state_is_changed() -> None:
    radius = parameter()
    before = torch.get_rng_state(), torch.is_grad_enabled(), torch.get_default_dtype()
    with torch.no_grad():
        term = boundary_term(lambda x, y: disc(radius, x, y), SCREEN, FILTER, 1)
    assert term.requires_grad and torch.is_grad_enabled()
    assert torch.equal(before[0], torch.get_rng_state()) and before[2] == torch.get_default_dtype()
    assert radius.grad is None


def test_a_filter_that_reaches_everywhere_wants_a_closed_screen() -> None:
    radius = parameter()
    term = boundary_term(lambda x, y: disc(radius, x, y), SCREEN, mcaa.Sinc(), 1, closed=True)
    assert float(torch.autograd.grad(term.sum(), radius)[0]) == pytest.approx(2 * math.pi * 4, rel=0.1)


def test_the_benchmark_prints_its_rows(capsys: pytest.CaptureFixture[str]) -> None:
    main(["--seeds", "2", "--cases", "disc radius"])
    head, rule, row = capsys.readouterr().out.splitlines()
    assert head.count("|") == rule.count("|") == row.count("|") and row.startswith("| disc radius | 100 %")
