"""Derivatives moved onto the filter, against closed forms and against differences of pictures of many samples."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch
from torch import Tensor

import torch_mcaa as mcaa
from torch_mcaa import scenes
from torch_mcaa.errors import McaaError
from torch_mcaa.filters import Filter
from torch_mcaa.grid import Screen
from torch_mcaa.replay.moved import Moved, is_continuous

SIZE = 8, 9
GRAD = torch.randn(1, *SIZE, dtype=torch.float64, generator=torch.Generator().manual_seed(4))


def centres() -> tuple[Tensor, Tensor]:
    row, col = torch.meshgrid(torch.arange(SIZE[0]) + 0.5, torch.arange(SIZE[1]) + 0.5, indexing="ij")
    return col.double(), row.double()


def test_the_std_of_a_gaussian_over_a_wave() -> None:
    """exp(-s^2 k^2 / 2) times the wave: of a smooth f the lattice has no error, and that the cut at 5 std moves counts some 1e-4."""
    std = torch.nn.Parameter(torch.tensor(0.55, dtype=torch.float64))
    layer = mcaa.Supersampler(SIZE, filter=mcaa.Gaussian(std), estimator=mcaa.Shared(), spp=32).double()
    kx, ky = 0.9, 0.4
    (layer(lambda x, y: torch.cos(kx * x + ky * y)) * GRAD).sum().backward()
    x, y = centres()
    k2, s = kx * kx + ky * ky, 0.55
    expected = (GRAD[0] * torch.cos(kx * x + ky * y)).sum() * math.exp(-s * s * k2 / 2) * -s * k2
    assert std.grad is not None
    torch.testing.assert_close(float(std.grad), float(expected), rtol=3e-4, atol=1e-5)


def test_the_std_of_a_gaussian_over_an_edge() -> None:
    """Central differences of the closed form. The spread over 12 calls tells the error of their mean (7.3 of it: 1e-5 of Student's t)."""
    std = torch.nn.Parameter(torch.tensor(0.6, dtype=torch.float64))
    layer = mcaa.Supersampler(SIZE, filter=mcaa.Gaussian(std), spp=64).double()
    plane = scenes.HalfPlane(0.4, 5.3)
    found = torch.stack([torch.autograd.grad((layer(plane) * GRAD).sum(), std)[0] for _ in range(12)])
    ahead, behind = ((plane.exact(*centres(), mcaa.Gaussian(s)) * GRAD[0]).sum() for s in (0.6001, 0.5999))
    expected = float(ahead - behind) / 2e-4
    assert abs(float(found.mean()) - expected) < 7.3 * float(found.std()) / 12**0.5 + 1e-5
    assert float(found.std()) < 0.05


@pytest.mark.parametrize("boundary", ["zero", "renormalize"])
def test_the_std_where_the_screen_ends(boundary: Any) -> None:
    """The exact derivative of the value that the same points give, by central differences."""
    std = torch.nn.Parameter(torch.tensor(0.6, dtype=torch.float64))
    layer = mcaa.Supersampler(
        SIZE, filter=mcaa.Gaussian(std), estimator=mcaa.Shared(), spp=8, boundary=boundary, redraw=False, decorrelate=False
    ).double()

    def loss() -> Tensor:
        return (layer(lambda x, y: 1 + torch.cos(x + y * y / 9)) * GRAD).sum()

    (found,) = torch.autograd.grad(loss(), std)
    with torch.no_grad():
        std += 1e-5
        ahead = loss()
        std -= 2e-5
        behind = loss()
    # the support moves with std, where w is 4e-6 of its height
    torch.testing.assert_close(float(found), float(ahead - behind) / 2e-5, rtol=1e-4, atol=1e-4)


def test_an_extent() -> None:
    """Of a wave in f's coordinates: a chain rule through the frequencies in pixels."""
    extent = torch.tensor([0.4, 8.0, -3.0, 2.5], dtype=torch.float64, requires_grad=True)

    def exact(e: Tensor) -> Tensor:
        x, y = centres()
        fx, fy = (e[1] - e[0]) / SIZE[1], (e[3] - e[2]) / SIZE[0]
        wave = torch.cos(0.8 * (e[0] + fx * x) + 1.1 * (e[2] + fy * y))
        return (wave * torch.exp(-0.125 * ((0.8 * fx) ** 2 + (1.1 * fy) ** 2)) * GRAD[0]).sum()

    layer = mcaa.Supersampler(SIZE, extent=extent, estimator=mcaa.Shared(), spp=32).double()
    picture = layer(lambda x, y: torch.cos(0.8 * x + 1.1 * y))
    (found,) = torch.autograd.grad((picture * GRAD).sum(), extent)
    (expected,) = torch.autograd.grad(exact(extent), extent)
    torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-4)


def test_an_extent_over_an_edge() -> None:
    """x1 of the extent moves an edge that f knows nothing of."""
    extent = torch.tensor([0.0, 18.0, 0.0, 8.0], dtype=torch.float64, requires_grad=True)
    layer = mcaa.Supersampler(SIZE, extent=extent, spp=64).double()
    found = torch.stack([torch.autograd.grad((layer(lambda x, y: (x < 9.3).to(x)) * GRAD).sum(), extent)[0] for _ in range(12)])

    def exact(x1: float) -> float:
        edge = 9.3 * SIZE[1] / x1
        return float((torch.special.ndtr((edge - centres()[0]) / 0.5) * GRAD[0]).sum())

    expected = (exact(18.001) - exact(17.999)) / 2e-3
    error = found[:, 1].std() / 12**0.5
    assert abs(float(found[:, 1].mean()) - expected) < 7.3 * float(error) + 1e-6
    assert float(found[:, 1].std()) < 0.02


def test_places_and_areas() -> None:
    """Back where they came from, and the logarithm of the area is that of the map's Jacobian, up to one number for all places."""
    screen = Screen.of(SIZE, (2.0, 7.0, 9.0, -3.0))
    matrix = torch.tensor([[1.7, 0.3, 2.0], [-0.2, 1.9, 1.0], [0.05, 0.03, 1.0]], dtype=torch.float64)
    col, row = torch.rand(2, 50, dtype=torch.float64, generator=torch.Generator().manual_seed(2)) * 8
    for extent in (None, torch.tensor(screen.extent, dtype=torch.float64)):
        for transform in (None, matrix):
            moved = Moved(screen, extent, transform)
            u, v = (t.requires_grad_() for t in moved.held(col, row))
            back = moved.pulled(u, v)
            torch.testing.assert_close(torch.stack(back[:2]).detach(), torch.stack([col, row]), rtol=0, atol=1e-9)
            (a, b), (c, d) = (torch.autograd.grad(t.sum(), (u, v), retain_graph=True, materialize_grads=True) for t in back[:2])
            off = back[2] - (a * d - b * c).abs().log()
            assert float(off.detach().max() - off.detach().min()) < 1e-9


@pytest.mark.parametrize("interpolation", ["nearest", "bilinear"])
@pytest.mark.parametrize("filter", [mcaa.Gaussian(0.5), mcaa.Tent(), mcaa.Mitchell()], ids=repr)
def test_a_transform(filter: Filter, interpolation: Any) -> None:
    """Shift, scale, shear and tilt of a texture: differences of pictures of 1,001 samples, of the same points on both sides.

    Each entry by what moves the texture by some 0.1 px either way, whose curvature is worth 2 %. The spreads over 8 gradients and over 4
    differences tell the error: 12 of it is 1e-5 of Student's t with 7 degrees.
    """
    texels = torch.rand(1, 16, 18, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    matrix = torch.tensor([[1.7, 0.3, 2.0], [-0.2, 1.9, 1.0], [0.01, 0.005, 1.0]], dtype=torch.float64, requires_grad=True)
    scale = torch.tensor([[0.1, 0.1, 1.0], [0.1, 0.1, 1.0], [0.002, 0.002, 0.1]], dtype=torch.float64)

    def picture(m: Tensor, spp: int, seed: int) -> Tensor:
        layer = mcaa.Supersampler(SIZE, filter=filter, estimator=mcaa.Shared(), spp=spp, seed=seed).double()
        return layer(mcaa.Texture(texels, interpolation, "repeat", transform=m))

    found = torch.stack([torch.autograd.grad((picture(matrix, 64, s) * GRAD).sum(), matrix)[0] for s in range(8)]) * scale
    for i, j in ((0, 0), (1, 2), (2, 1)):
        step = torch.zeros(3, 3, dtype=torch.float64)
        step[i, j] = 0.1 * scale[i, j]
        with torch.no_grad():
            sides = torch.stack(
                [((picture(matrix + step, 1001, s) - picture(matrix - step, 1001, s)) * GRAD).sum() / 0.2 for s in range(4)]
            )
        error = math.hypot(float(found[:, i, j].std()) / 8**0.5, float(sides.std()) / 2)
        assert float((found[:, i, j].mean() - sides.mean()).abs()) < 12 * error + 0.02 * float(sides.mean().abs())
        assert float(found[:, i, j].std()) < 0.1


def test_a_box_leaves_the_transform_to_the_texture() -> None:
    """It ends in a step, so the texture is differentiated: of a ramp, exactly."""
    ramp = (0.1 * torch.arange(40, dtype=torch.float64)).expand(1, 40, 40)
    matrix = torch.tensor([[1.0, 0.0, 9.0], [0.0, 1.0, 9.0], [0.0, 0.0, 1.0]], dtype=torch.float64, requires_grad=True)
    layer = mcaa.Supersampler(SIZE, filter=mcaa.Box(), estimator=mcaa.Shared(), discontinuities=False).double()
    (found,) = torch.autograd.grad(layer(mcaa.Texture(ramp, transform=matrix)).sum(), matrix)
    assert abs(float(found[0, 2]) - 0.1 * SIZE[0] * SIZE[1]) < 1e-9


def test_which_filters_are_continuous() -> None:
    assert all(map(is_continuous, (mcaa.Gaussian(), mcaa.Tent(), mcaa.Mitchell(), mcaa.Lanczos(3), mcaa.BlackmanHarris())))
    assert not any(map(is_continuous, (mcaa.Box(), mcaa.Gaussian(0.5, 0.7))))


def test_what_is_refused() -> None:
    extent = torch.tensor([0.0, 8.0, 0.0, 8.0], requires_grad=True)

    def f(x: Tensor, y: Tensor) -> Tensor:
        return x

    with pytest.raises(McaaError, match=r"boundary='extend', got 'zero'"):
        mcaa.Supersampler(SIZE, extent=extent, boundary="zero")(f)
    with pytest.raises(McaaError, match="goes to 0 at its sides"):
        mcaa.Supersampler(SIZE, extent=extent, filter=mcaa.Box())(f)
    tilt = torch.tensor([[1.0, 0, 0], [0, 1, 0], [0, -0.2, 1]], requires_grad=True)
    with pytest.raises(McaaError, match="horizon lies on the screen"):
        mcaa.Supersampler(SIZE)(mcaa.Texture(torch.rand(1, 8, 8), transform=tilt))
    for std in (torch.ones(2), torch.tensor(1)):
        with pytest.raises(McaaError, match="std must be one number"):
            mcaa.Gaussian(std)
    learned = torch.nn.Parameter(torch.tensor(0.5))
    filter = mcaa.Gaussian(learned)
    assert filter == mcaa.Gaussian(0.5) and hash(filter) == hash(mcaa.Gaussian(0.5))
    with torch.no_grad():
        learned.fill_(-1)
    with pytest.raises(McaaError, match="std must be a number"):
        mcaa.Supersampler(SIZE, filter=filter)
