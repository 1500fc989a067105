"""The tail index: what it finds in laws whose index is known. Fixed seeds; bounds are six standard deviations of the counts."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from torch_mcaa.estimators.paper.tail import pareto_k

PIXELS = 2000


def uniform(n: int, seed: int = 5) -> Tensor:
    return torch.rand(1, n, PIXELS, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def heavy(terms: Tensor) -> float:
    return float((pareto_k(terms) > 0.5).double().mean())


@pytest.mark.parametrize("n", [256, 1024])
@pytest.mark.parametrize("k", [0.25, 0.75, 1.0])
def test_median_of_a_pareto_law(k: float, n: int) -> None:
    """The median over 2,000 pixels, half a standard deviation of one estimate off at most: the smaller of two estimates is low."""
    found = pareto_k(uniform(n) ** -k)
    found = found[~found.isnan()]
    size = min(n // 5, int(3 * math.sqrt(n)))
    assert abs(float(found.median()) - k) < 0.75 * 1.4 * max(k, 0.5) / math.sqrt(size)


def test_power_and_false_alarms() -> None:
    """The figures of the docstring, at 2,000 pixels known to 0.011 (one standard deviation at one half)."""
    for n, power in ((64, 0.51), (256, 0.79), (1024, 0.91)):
        assert abs(heavy(uniform(n) ** -0.75) - power) < 0.07
        assert heavy(uniform(n) ** -0.25) < 0.03


def normals(n: int) -> Tensor:
    return torch.randn(2, n, PIXELS, dtype=torch.float64, generator=torch.Generator().manual_seed(6)) / 2


@pytest.mark.parametrize("n", [64, 256])
def test_edges_and_smooth_functions_have_moments(n: int) -> None:
    x, y = normals(n)
    for f in (
        (x > 0.6).double(),
        1e-3 + 1e3 * (x > 0.9),
        0.5 + 0.1 * x + 3 * (x > 0.8),
        torch.exp(-((x - 0.5) ** 2 + y**2) / 2),
        torch.ones_like(x),
        1e4 + 1e-3 * x,
        torch.zeros_like(x),
    ):
        assert heavy(f[None]) < 0.01
    assert heavy((x**2)[None]) < 0.1  # the square of a normal variable, which 64 points can hardly tell from a power


def test_says_nothing_of_few_terms() -> None:
    assert pareto_k(uniform(16) ** -1).isnan().all()
    mostly_zero = uniform(256) ** -1 * (uniform(256, 7) < 0.1)
    assert pareto_k(mostly_zero).isnan().double().mean() > 0.99


def test_channels_are_told_apart() -> None:
    terms = torch.cat([torch.ones(1, 256, PIXELS, dtype=torch.float64), uniform(256) ** -1.0])
    found = pareto_k(terms)
    assert found.shape == (2, PIXELS) and found[0].isnan().all() and float((found[1] > 0.5).double().mean()) > 0.9


def test_scale_does_not_matter() -> None:
    terms = uniform(256) ** -0.75
    torch.testing.assert_close(pareto_k(terms * 2.0**40), pareto_k(terms), rtol=1e-9, atol=1e-9, equal_nan=True)
