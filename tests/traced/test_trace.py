"""The trace of decisions: signatures, the first decision that differs, and margins of every layout of points and lanes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import pytest
import torch
from torch import Tensor

from torch_mcaa.errors import McaaError
from torch_mcaa.grid import Screen
from torch_mcaa.traced.asked import Asked
from torch_mcaa.traced.program import Program, probe
from torch_mcaa.traced.trace import Traced, Watch
from torch_mcaa.traced.visitors import Causes, Margins, Signatures

SCREEN = Screen.of((12, 12))
CPU = torch.device("cpu")
Function = Callable[[Tensor, Tensor], Any]


def program_of(f: Function) -> Program:
    return probe(f, SCREEN, torch.float64, CPU).all_moving()


def row(*values: float) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


def signatures(f: Function, x: Tensor, y: Tensor) -> Tensor:
    seen = Signatures(CPU)
    Traced(f, program_of(f), seen)(x, y)
    return seen.signatures(len(x))


def causes(f: Function, before: Sequence[float], after: Sequence[float]) -> Causes:
    """At y = 1."""
    seen = Causes((2, len(before)), 0, False, CPU)
    x = row(*before, *after)
    Traced(f, program_of(f), seen)(x, torch.ones_like(x))
    return seen


def cells(x: Tensor, y: Tensor) -> Tensor:
    return torch.floor(x) + 2 * torch.floor(y)


def test_signatures_are_equal_in_a_cell_and_different_between_cells() -> None:
    index = torch.arange(64)
    x, y = (index % 8).to(torch.float64) / 2 + 0.2, (index // 8).to(torch.float64) / 2 + 0.1
    found = signatures(cells, x, y)
    cell = x.floor() * 100 + y.floor()
    assert torch.equal(found[:, None] == found, cell[:, None] == cell)


def test_signatures_are_those_of_any_other_block() -> None:
    x, y = torch.rand(1000, dtype=torch.float64, generator=torch.Generator().manual_seed(1)) * 9, torch.full((1000,), 2.5).double()
    whole = signatures(cells, x, y)
    assert torch.equal(torch.cat([signatures(cells, a, b) for a, b in zip(x.split(77), y.split(77), strict=True)]), whole)


def test_opposite_changes_do_not_cancel() -> None:
    """The sum of two floors is the same where one grows and the other falls: the signature is not."""
    first, second = signatures(lambda x, y: torch.floor(x) + torch.floor(-x), row(0.5, 1.5), row(0, 0)).tolist()
    assert first != second


def test_the_first_decision_that_differs_is_the_cause() -> None:
    def f(x: Tensor, y: Tensor) -> Tensor:
        inner = torch.where(x > 2, 1.0, 0.0)
        return torch.where(inner > 0.5, torch.floor(x / 4), torch.sign(x - 7))

    found = causes(f, [1.9, 3.9, 6.9, 5.0], [2.1, 4.1, 7.1, 5.1])
    # inner > 0.5 changes with x > 2, and later
    assert found.cause.tolist() == [0, 2, 3, -1]
    assert torch.allclose(found.margin[:, :3], torch.stack([row(-0.1, -0.025, -0.1), row(0.1, 0.025, 0.1)]))


def test_a_decision_with_a_margin_is_the_cause_before_one_without() -> None:
    def f(x: Tensor, y: Tensor) -> Tensor:
        value = torch.sqrt(3 - x)
        return torch.where(value.isnan(), 0.0, 1.0) + torch.where(x < 3, value.nan_to_num(), 2.0) + (x < 3.5)

    found = causes(f, [2.9, 3.1], [3.1, 3.6])
    assert [site.name for site in program_of(f).sites] == ["isnan", "lt", "nan_to_num", "lt"]
    assert found.cause.tolist() == [1, 3]
    assert torch.allclose(found.margin, torch.stack([row(-0.1, -0.4), row(0.1, 0.1)]))
    alone = causes(lambda x, y: torch.sqrt(3 - x).isnan().double(), [2.9, 3.1], [3.1, 3.6])
    assert alone.cause.tolist() == [0, -1] and bool((alone.margin == 0).all())


LAYOUTS: dict[str, Function] = {
    "points": lambda x, y: torch.stack([(x - 3 > 0).double(), (x - 5 > 0).double()]).sum(0),
    "(points, lanes)": lambda x, y: (x[:, None] - row(3, 5) > 0).sum(1),
    "(lanes, points)": lambda x, y: (x - row(3, 5)[:, None] > 0).sum(0),
    "(1, points, 1, lanes)": lambda x, y: (x[None, :, None, None] - row(3, 5) > 0).sum((0, 2, 3)),
    "argmin (points, choices)": lambda x, y: (x[:, None] - row(1, 5)).square().argmin(1),
    "argmin (choices, points)": lambda x, y: (x - row(1, 5)[:, None]).square().argmin(0),
    "argmin (lanes, points, choices)": lambda x, y: (x[:, None] - row(1, 5, 0, 6).view(2, 1, 2)).square().argmin(2).sum(0),
    "argmin (choices, lanes, points)": lambda x, y: (x - row(1, 0, 5, 6).view(2, 2, 1)).square().argmin(0).sum(0),
    "sort (points, choices)": lambda x, y: (x[:, None] - row(1, 5)).square().sort(1).indices[:, 0],
    "topk (choices, points)": lambda x, y: (x - row(1, 5)[:, None]).square().topk(1, 0, largest=False).indices[0],
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_margins_of_every_layout_cross_zero_at_the_change(layout: str) -> None:
    """All change at x = 3: linear margins, or differences of squares, which are linear too."""
    f = LAYOUTS[layout]
    found = causes(f, [2.9, 2.99], [3.2, 3.01])
    assert bool((found.cause >= 0).all())
    root = row(2.9, 2.99) + found.margin[0] / (found.margin[0] - found.margin[1]) * row(0.3, 0.02)
    assert torch.allclose(root, row(3, 3))
    seen = Margins(found.cause, found.branch, False)
    Traced(f, program_of(f), seen)(row(2.9, 2.99), row(1, 1))
    assert torch.equal(seen.total, found.margin[0])


def test_neighbours_in_rows_are_compared_within_rows() -> None:
    seen = Causes((2, 3), 1, False, CPU)
    x = row(0.6, 1.3, 1.6, 4.2, 4.3, 5.1)
    Traced(cells, program_of(cells), seen)(x, torch.ones_like(x))
    assert seen.cause.tolist() == [0, -1, -1, 0]
    assert torch.allclose(seen.margin[:, [0, 3]], torch.stack([row(-0.4, 0.3), row(0.3, 0.1)]))


def test_margins_have_a_graph_through_no_grad_and_detached_results() -> None:
    edge = torch.tensor(3.0, dtype=torch.float64, requires_grad=True)

    def f(x: Tensor, y: Tensor) -> Tensor:
        with torch.no_grad():
            inside = x * x > edge * edge
        return inside.double().detach()

    seen = Margins(torch.tensor([0]), torch.tensor([[0, 0, 1]]), True)
    Traced(f, program_of(f), seen)(row(3.0), row(0.0))
    # x * x was made under no_grad; what is left is the comparison's operand
    assert not seen.total.requires_grad

    def g(x: Tensor, y: Tensor) -> Tensor:
        margin = x - edge
        with torch.no_grad():
            return (margin > 0).double()

    seen = Margins(torch.tensor([0]), torch.tensor([[0, 0, 1]]), True)
    Traced(g, program_of(g), seen)(row(3.0), row(0.0))
    assert torch.autograd.grad(seen.total.sum(), edge)[0] == -1


def test_the_trace_changes_no_value_and_ends_with_the_call() -> None:
    x, y = row(*torch.linspace(0, 9, 50).tolist()), row(*torch.linspace(3, 5, 50).tolist())
    met = []
    with Watch(lambda number, decision, func: met.append(func.__name__)):
        traced = cells(x, y)
    assert torch.equal(traced, cells(x, y)) and met == ["floor", "floor"]


@pytest.mark.parametrize("later", [False, True])
def test_other_decisions_in_another_call_are_an_error_with_the_line(later: bool) -> None:
    """Python control flow on values: the probe met one branch, or the other."""

    def f(x: Tensor, y: Tensor) -> Tensor:
        if bool((x < 0).any()) != later:
            return torch.floor(x)
        return x

    asked = Asked(f, SCREEN, program_of(f), torch.float64, CPU, None)
    with pytest.raises(McaaError, match=r"other decisions than before.*torch\.where"):
        asked.signatures(row(-1.0, 2.0), row(1.0, 1.0))


@pytest.mark.filterwarnings("ignore")
def test_compiled_code_is_seen_through() -> None:
    compiled = torch.compile(lambda x: x > 3, backend="eager")
    compiled(row(1.0))
    found = causes(lambda x, y: compiled(x).double(), [2.9], [3.1])
    assert found.cause.tolist() == [0] and torch.allclose(found.margin[:, 0], row(-0.1, 0.1))


@pytest.mark.parametrize("lanes", [3, 40])
def test_signatures_of_few_and_of_many_lanes(lanes: int) -> None:
    """One of many comparisons differs at a time."""
    steps = torch.arange(lanes, dtype=torch.float64)
    x = torch.arange(-1, lanes, dtype=torch.float64) + 0.5
    found = signatures(lambda x, y: (x[:, None] > steps).sum(1), x, 0 * x)
    assert len(torch.unique(found)) == lanes + 1
    repeated = signatures(lambda x, y: (x[:, None] > steps).sum(1), x + 0.3, 0 * x)
    assert torch.equal(found, repeated)
