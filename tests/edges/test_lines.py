"""Samples on lines: what is asked, where, and what their weighted mean is."""

from __future__ import annotations

import math

import pytest
import torch
from on_lines import Ask, sampled, scatter, weighed
from torch import Tensor

import torch_mcaa as mcaa
from torch_mcaa.edges.correction import Window
from torch_mcaa.edges.lines import scattered
from torch_mcaa.filters import SeparableFilter

ROUNDING = 1e-13
"""Sums of a few hundred float64 products of size 1."""


def two_channels(x: Tensor, y: Tensor) -> Tensor:
    return torch.stack([(3 * x - 2 * y).sin(), x * y])


@pytest.mark.parametrize("filter", [mcaa.Gaussian(0.5), mcaa.Tent(), mcaa.Lanczos(3), mcaa.Box()], ids=str)
def test_weighed_is_the_sum_over_all_samples(filter: SeparableFilter) -> None:
    """Σ w f / Σ w about each centre, over samples placed by hand, in a window that begins at negative pixels."""
    row, col, size = -5, -7, 11
    samples = sampled(two_channels, 5, size, size, row, col)
    reach = Window.halo_of(filter)
    rows, cols = torch.tensor([-1, 1, 0]), torch.tensor([-2, -3, -1])
    found = weighed(scatter(samples), filter, rows, cols, reach)
    x = (torch.arange(col, col + size)[:, None] + samples.x).expand(size, size, -1)
    y = (torch.arange(row, row + size)[:, None, None] + samples.y).expand(size, size, -1)
    for k, (i, j) in enumerate(zip(rows.tolist(), cols.tolist(), strict=True)):
        w = filter(x - j - 0.5, y - i - 0.5)
        expected = (two_channels(x, y) * w).sum((1, 2, 3)) / w.sum()
        assert torch.allclose(found[:, k], expected, rtol=ROUNDING, atol=100 * ROUNDING)


def test_weighed_of_a_constant_is_the_constant() -> None:
    samples = sampled(lambda x, y: torch.full_like(x, 3.0), 7)
    found = weighed(scatter(samples), mcaa.Gaussian(0.5), torch.tensor([5, 6]), torch.tensor([5, 4]), 3)
    assert float((found - 3).abs().max()) < 10 * ROUNDING


def test_weighed_sums_float32_samples_in_float64() -> None:
    samples = sampled(lambda x, y: torch.full_like(x, 0.1, dtype=torch.float32), 5)
    found = weighed(scatter(samples), mcaa.Gaussian(0.5), torch.tensor([5]), torch.tensor([5]), 3)
    assert found.dtype == torch.float64
    assert float((found - float(torch.tensor(0.1, dtype=torch.float32))).abs()) < ROUNDING


def test_scattered_asks_where_it_is_told_and_nowhere_else() -> None:
    """n places in each pixel of `asked`, in coordinates of the screen."""
    row, col = 40, -3
    asked = torch.zeros(4, 6, dtype=torch.bool)
    asked[0, 5] = asked[3, 0] = asked[2, 2] = True
    x, y = torch.tensor([0.1, 0.5, 0.9], dtype=torch.float64), torch.tensor([0.7, 0.2, 0.4], dtype=torch.float64)
    ask = Ask(two_channels)
    samples = scattered(ask, x, y, row, col, asked, 7)
    assert ask.count == 9 and len(ask.places) == 1
    met = set(zip(*(place.tolist() for place in ask.places[0]), strict=True))
    told = {(col + q + float(u), row + r + float(v)) for r, q in asked.nonzero().tolist() for u, v in zip(x, y, strict=True)}
    assert met == told
    assert samples.values.shape == (2, 3, 3)
    assert torch.equal(samples.slot >= 0, asked)
    for r, q in asked.nonzero().tolist():
        assert torch.equal(samples.values[:, samples.slot[r, q]], two_channels(x + (col + q), y + (row + r)))
    assert (samples.row, samples.col, samples.number, samples.count) == (row, col, 7, 3)


def test_scattered_asks_nothing_when_no_pixel_is_wanted() -> None:
    x = torch.tensor([0.1, 0.5, 0.9], dtype=torch.float64)
    ask = Ask(two_channels)
    samples = scattered(ask, x, x.flip(0), 0, 0, torch.zeros(3, 4, dtype=torch.bool), 0)
    assert ask.count == 0
    assert samples.values.shape == (2, 0, 3) and bool((samples.slot == -1).all())


@pytest.mark.parametrize("lines", [3, 5, 9, 21])
def test_a_lattice_has_as_many_lines_along_either_axis_as_points(lines: int) -> None:
    """The offsets along each axis are all the fractions k / n of a pixel, moved by the shift."""
    samples = sampled(lambda x, y: x, lines)
    for place, shift in ((samples.x, 0.3217), (samples.y, 0.7113)):
        fractions = torch.sort(torch.remainder(place - shift, 1) * lines).values.round().long() % lines
        assert sorted(fractions.tolist()) == list(range(lines))
        assert math.isclose(float(torch.diff(torch.sort(place).values).max()) * lines, 1, rel_tol=1e-9)
