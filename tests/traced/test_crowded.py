"""Changes that crowd within a pixel or two: each counts by the probability with which it was met, whatever is beside it."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable

import pytest
import torch
from torch import Tensor

import torch_mcaa as mcaa

Field = Callable[[Tensor], Callable[[Tensor, Tensor], Tensor]]


def stripes(period: float) -> Field:
    """Of a share of the period; the repetition stays where it is."""
    return lambda share: lambda x, y: (torch.remainder((0.92 * x + 0.39 * y) / period, 1.0) < share).to(x.dtype)


def dots(pitch: float) -> Field:
    def field(share: Tensor) -> Callable[[Tensor, Tensor], Tensor]:
        def f(x: Tensor, y: Tensor) -> Tensor:
            u, v = (0.8 * x + 0.6 * y) / pitch, (0.8 * y - 0.6 * x) / pitch
            return (torch.maximum((u - u.floor() - 0.5).abs(), (v - v.floor() - 0.5).abs()) < 0.5 * share.sqrt()).to(x.dtype)

        return f

    return field


def gradients(field: Field, seeds: int) -> Tensor:
    """Of the sum over the inner 24 x 24 of 32 x 32 pixels, by the share of the plane that is 1."""
    found = []
    for seed in range(seeds):
        share = torch.tensor(0.4, requires_grad=True)
        picture = mcaa.Supersampler((32, 32), estimator=mcaa.Shared(), seed=seed)(field(share))
        picture[0, 4:28, 4:28].sum().backward()
        assert share.grad is not None
        found.append(share.grad)
    return torch.stack(found)


@pytest.mark.parametrize(
    "field",
    [*(stripes(period) for period in (0.3, 0.8, 1.0, 1.3, 1.6, 2.0)), dots(0.9), dots(1.7)],
    ids=["stripes 0.3", "0.8", "1.0", "1.3", "1.6", "2.0", "dots 0.9", "1.7"],
)
def test_the_gradient_is_that_of_the_share(field: Field) -> None:
    """576 for a picture that is the share itself; what the window cuts of a period is less than 1 %. 4.42 standard errors, of 20 seeds."""
    found = gradients(field, 20)
    error = float(found.std()) / math.sqrt(20)
    assert abs(float(found.mean()) - 576) < 4.42 * error + 6
    assert error < 0.04 * 576


def test_a_close_look_takes_single_pieces_for_what_they_are() -> None:
    """A hairline is met now and then and stands for those that were missed: its blocks are no crowd, whatever was met of it."""
    place = torch.tensor(16.3, requires_grad=True)

    def f(x: Tensor, y: Tensor) -> Tensor:
        return ((0.96 * x + 0.28 * y - place).abs() < 0.1).to(x.dtype) * x

    found = []
    for seed in range(40):
        place.grad = None
        mcaa.Supersampler((32, 32), estimator=mcaa.Shared(), seed=seed)(f)[0, 4:28].sum().backward()
        assert place.grad is not None
        found.append(place.grad)
    all_of_them = torch.stack(found)
    # 0.2 px wide, x / 0.96 along it: 24 rows
    truth, error = 24 * 0.2 / 0.96**2, float(all_of_them.std()) / math.sqrt(40)
    assert abs(float(all_of_them.mean()) - truth) < 4.42 * error


@pytest.mark.parametrize("size", [(1, 1), (1, 2), (2, 1), (3, 3)])
@pytest.mark.parametrize("boundary", ["extend", "zero"])
def test_screens_of_few_pixels(size: tuple[int, int], boundary: str) -> None:
    for seed in range(4):
        share = torch.tensor(0.4, requires_grad=True)
        layer = mcaa.Supersampler(size, spp=30, boundary=boundary, seed=seed, estimator=mcaa.Shared())  # pyright: ignore[reportArgumentType]
        picture = layer(stripes(0.13)(share)).sum()
        with warnings.catch_warnings():
            # none where no line met an edge
            warnings.filterwarnings("ignore", "no gradient reaches")
            picture.backward()
        assert share.grad is not None and share.grad.isfinite()


def test_noise_falls_with_the_samples_where_many_changes_are_near() -> None:
    """A checkerboard of 2.5 px cells, by its angle and frequency: -48 and 37 (finite differences). At 256 samples it was known to 47 and 21, where
    segments that may be followed were no more than at 64."""
    weight = torch.rand(16, 16, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    found = []
    for seed in range(6):
        p = torch.tensor([0.3, 1 / 2.5], requires_grad=True)

        def checkerboard(x: Tensor, y: Tensor, p: Tensor = p) -> Tensor:
            u, v = (torch.cos(p[0]) * x + torch.sin(p[0]) * y) * p[1], (torch.cos(p[0]) * y - torch.sin(p[0]) * x) * p[1]
            return (u.floor() + v.floor()) % 2

        picture = mcaa.Supersampler((16, 16), spp=256, seed=seed, estimator=mcaa.Shared())(checkerboard)
        found.append(torch.autograd.grad((picture * weight).sum(), p)[0])
    off = torch.stack(found) - torch.tensor([37.1, -48.0])
    assert float(off[:, 0].square().mean().sqrt()) < 3 and float(off[:, 1].square().mean().sqrt()) < 9


def hashed(cell: Tensor) -> Tensor:
    """In [0, 1), and another one where a last digit is."""
    return torch.frac(torch.sin(cell * 12.9898) * 43758.5453).abs()


def test_what_rounding_makes_another_of_is_differentiated_as_it_is_drawn() -> None:
    """Discs of hashed radii in squares of 3.4 px: 2 pi r^2 of each, by a factor of all radii. In float64 they have other radii.

    Of 910 close looks two are off, which is no crowd: the chance is that of lines that lie evenly.
    """
    factor, pitch = torch.tensor(1.0, requires_grad=True), 3.4
    i, j = torch.meshgrid(torch.arange(1.0, 5.0), torch.arange(1.0, 5.0), indexing="ij")
    radius = (0.2 + 0.2 * hashed(i + 7 * j)) * pitch

    def f(x: Tensor, y: Tensor) -> Tensor:
        u, v = x / pitch, y / pitch
        i, j = u.floor(), v.floor()
        inside = (i >= 1) & (i <= 4) & (j >= 1) & (j <= 4)
        r = 0.2 + 0.2 * hashed(i + 7 * j)
        return ((torch.hypot(u - i - 0.5, v - j - 0.5) < factor * r) & inside).to(x.dtype)

    truth = 2 * math.pi * float(radius.square().sum())
    for seed in range(3):
        picture = mcaa.Supersampler((20, 20), spp=256, seed=seed, estimator=mcaa.Shared())(f)
        (found,) = torch.autograd.grad(picture.sum(), factor)
        assert float(found) == pytest.approx(truth, rel=0.02)
