"""The adjoint against the splat it belongs to: <picture(f), g> = sum_p f(p) A(p) for any pixels g, to rounding (64-bit sums of some 10^4 terms)."""

from __future__ import annotations

from typing import Literal

import pytest
import torch
from torch import Tensor

import torch_mcaa as mcaa
from torch_mcaa.errors import McaaError
from torch_mcaa.estimators import Task
from torch_mcaa.filters import Filter
from torch_mcaa.grid import Screen
from torch_mcaa.integrand import Integrand
from torch_mcaa.replay.adjoint import Adjoint, at_places, norm, reach_of
from torch_mcaa.replay.samples import Samples, strip_of

Boundary = Literal["extend", "zero", "renormalize"]
SIZE = 9, 11
GRID = 1 + torch.rand(5, 7, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
FILTERS: tuple[Filter, ...] = (
    mcaa.Box(),
    mcaa.Box(2.5),
    mcaa.Tent(),
    mcaa.Gaussian(0.5),
    mcaa.Mitchell(),
    mcaa.Lanczos(3),
    mcaa.Tabulated(GRID, 1.7),
)


def wavy(x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    return torch.sin(2 * x + 0.3 * y * y), torch.cos(x * y)


def task_of(filter: Filter, boundary: Boundary) -> Task:
    return Task(Screen.of(SIZE), Integrand(wavy, torch.float64), filter, boundary, 3, torch.float64, torch.device("cpu"))


def noise(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("spp", [1, 5, 16, 64])
@pytest.mark.parametrize("boundary", ["extend", "zero", "renormalize"])
@pytest.mark.parametrize("filter", FILTERS, ids=repr)
def test_is_the_transpose_of_the_splat(filter: Filter, boundary: Boundary, spp: int) -> None:
    task = task_of(filter, boundary)
    grad = noise(2, *SIZE)
    rendered = mcaa.render(
        wavy, SIZE, filter=filter, estimator=mcaa.Shared(), spp=spp, boundary=boundary, seed=3, dtype=torch.float64, progress=False
    )
    strip = strip_of(task, spp)
    samples = Samples(task, strip, reach_of(filter))
    adjoint = Adjoint(filter, strip, task.dtype, task.device)
    divisor = norm(task, strip)
    padded = samples.padded(grad if divisor is None else grad / divisor)
    total = 0.0
    for strips, planes in samples.blocks():
        col, row, inside = samples.places(strips, planes)
        weight = adjoint(samples.band(padded, strips), planes)
        values = torch.stack(wavy(*torch.broadcast_tensors(col, row)))
        total += float((weight * values * (1 if inside is None else inside)).sum())
    torch.testing.assert_close(total, float((rendered.image * grad).sum()), rtol=1e-11, atol=1e-11)


def test_blocks_hold_every_sample_once() -> None:
    task = task_of(mcaa.Gaussian(0.5), "extend")
    strip = strip_of(task, 64)
    samples = Samples(task, strip, 2)
    met = torch.zeros(samples.strips, strip.count)
    for strips, planes in samples.blocks():
        met[strips, planes] += 1
    assert bool((met == 1).all())


@pytest.mark.parametrize("along", [(1, 0), (0, 1)])
@pytest.mark.parametrize("filter", [mcaa.Gaussian(0.6), mcaa.Mitchell(), mcaa.Tabulated(GRID, 1.7)], ids=repr)
def test_slopes_are_those_of_the_weights(filter: Filter, along: tuple[int, int]) -> None:
    """Central differences of step 1e-6 of A at the samples' places, whose error is some 1e-9; kinks of a table lie where no sample does."""
    task = task_of(filter, "extend")
    strip = strip_of(task, 5)
    samples = Samples(task, strip, reach_of(filter))
    grad = noise(1, *SIZE)
    slope = Adjoint(filter, strip, task.dtype, task.device, along)
    (block,) = samples.blocks()
    found = slope(samples.band(samples.padded(grad), block[0]), block[1])
    col, row = (t.flatten() for t in torch.broadcast_tensors(*samples.places(*block)[:2]))
    totals = torch.stack([filter(col - 5.5, row - i - 0.5).sum() for i in range(SIZE[0])])
    h = 1e-6
    ahead, behind = (at_places(filter, grad / totals[:, None], col + s * along[0] * h, row + s * along[1] * h)[0] for s in (1, -1))
    torch.testing.assert_close(found.flatten(), (ahead - behind) / (2 * h), rtol=1e-5, atol=1e-7)


def test_at_places_far_from_the_screen() -> None:
    far = torch.tensor([-1e9, 1e9, -3.6, 14.6], dtype=torch.float64)
    assert not at_places(mcaa.Gaussian(0.5), noise(1, *SIZE), far, far).any()
    inside = at_places(mcaa.Box(), noise(1, *SIZE), torch.tensor([2.3]).double(), torch.tensor([4.9]).double())
    assert float(inside) == float(noise(1, *SIZE)[0, 4, 2])


def test_what_cannot_be_weighed() -> None:
    with pytest.raises(McaaError, match="finite radius"):
        reach_of(mcaa.Sinc())
    task = task_of(mcaa.Gaussian(0.001), "extend")
    with pytest.raises(McaaError, match="raise spp"):
        Adjoint(task.filter, strip_of(task, 5), task.dtype, task.device)
