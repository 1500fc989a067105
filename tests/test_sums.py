"""Sums at places that may be equal: what `index_add_` and `scatter_add_` give on a CPU, to the bit, whichever way another device adds."""

from __future__ import annotations

from contextlib import nullcontext

import pytest
import torch
from pretended import pretended

from torch_mcaa.sums import add_at, add_rows


@pytest.fixture(params=["cpu", "pretended"])
def device(request: pytest.FixtureRequest):
    with pretended() if request.param == "pretended" else nullcontext("cpu") as name:
        yield name


@pytest.mark.parametrize("shape", [(), (3,), (2, 3)])
def test_add_at(device: str, shape: tuple[int, ...]) -> None:
    generator = torch.Generator().manual_seed(1)
    index = torch.randint(0, 7, (100,), generator=generator)
    values, total = torch.rand(*shape, 100, generator=generator), torch.rand(*shape, 7, generator=generator)
    told = total.clone()
    for k in range(100):
        told[..., index[k]] += values[..., k]
    placed = total.clone().to(device)
    given = add_at(placed, index.to(device), values.to(device))
    assert given is placed
    assert torch.equal(placed.cpu(), told)


def test_add_rows(device: str) -> None:
    generator = torch.Generator().manual_seed(2)
    index = torch.randint(0, 4, (20, 5), generator=generator)
    values, total = torch.rand(3, 20, 5, generator=generator), torch.rand(3, 4, 5, generator=generator)
    told = total.scatter_add(1, index.expand_as(values), values)
    assert torch.equal(add_rows(total.clone().to(device), index.to(device), values.to(device)).cpu(), told)
