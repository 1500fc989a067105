"""For a texture the layer is a filter, and its samples' limit too: `kornia.filters.filter2d` with the exactly integrated kernel, in value and in
gradient.
"""

from __future__ import annotations

import math
from typing import Any

import pytest
import texture_truth
import torch
from kornia_truth import PROFILES, filtered
from torch import Tensor

import torch_mcaa as mcaa
from torch_mcaa.filters import Filter
from torch_mcaa.texture import Interpolation

FILTERS: dict[str, Filter] = {"box": mcaa.Box(), "tent": mcaa.Tent(), "gaussian": mcaa.Gaussian(0.5)}
# strides 1, 2 and 4, and ratios 8/5 by 8/3 and 3/4 by 4/5
SIZES = ((24, 24), (12, 12), (6, 6), (15, 9), (32, 30))
ALPHA = 1e-5

every_filter = pytest.mark.parametrize("name", list(FILTERS))
every_interpolation = pytest.mark.parametrize("interpolation", ["nearest", "bilinear"])


def image(*shape: int, seed: int = 0) -> Tensor:
    return torch.rand(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def quantile(count: int) -> float:
    """What the largest of so many standard normal deviates exceeds in modulus with probability ALPHA (Šidák)."""
    each = -math.expm1(math.log1p(-ALPHA) / count)
    return float(torch.special.ndtri(torch.tensor(1 - each / 2, dtype=torch.float64)))


def layer(name: str, size: tuple[int, int], **arguments: Any) -> mcaa.Supersampler:
    return mcaa.Supersampler(size, filter=FILTERS[name], **{"estimator": mcaa.Shared(), **arguments}).double()


@every_interpolation
@every_filter
@pytest.mark.parametrize("size", SIZES)
def test_the_truth_by_filter2d_is_the_one_by_matrices(size: tuple[int, int], name: str, interpolation: str) -> None:
    texture = image(2, 24, 24)
    expected = texture_truth.pixel_values(texture, size, PROFILES[name], interpolation, "border")
    torch.testing.assert_close(filtered(texture, size, PROFILES[name], interpolation), expected, rtol=0, atol=1e-13)


@every_interpolation
@every_filter
@pytest.mark.parametrize("size", SIZES)
def test_the_layer_by_default(size: tuple[int, int], name: str, interpolation: Interpolation) -> None:
    """Values and gradients of it, of `render` and of `resize`, to rounding."""
    texels, grad = image(2, 24, 24).requires_grad_(), image(2, *size, seed=1) - 0.5
    expected = filtered(texels, size, PROFILES[name], interpolation)
    (slope,) = torch.autograd.grad((expected * grad).sum(), texels)
    default = mcaa.Supersampler(size, filter=FILTERS[name]).double()
    pictures = [default(mcaa.Texture(texels, interpolation)), mcaa.resize(texels, size, interpolation, filter=FILTERS[name])]
    if interpolation == "bilinear":
        pictures.append(default(texels[None])[0])
    for picture in pictures:
        torch.testing.assert_close(picture, expected, rtol=0, atol=1e-13)
        (found,) = torch.autograd.grad((picture * grad).sum(), texels)
        torch.testing.assert_close(found, slope, rtol=0, atol=1e-13)
    single = mcaa.render(mcaa.Texture(texels.detach().float(), interpolation), size, filter=FILTERS[name], progress=False)
    assert (
        float((single.image - filtered(texels.detach().float().double(), size, PROFILES[name], interpolation)).abs().max()) < 6e-8
    )


@every_interpolation
@every_filter
@pytest.mark.parametrize("size", SIZES)
def test_values_within_their_standard_error(size: tuple[int, int], name: str, interpolation: Interpolation) -> None:
    texture = mcaa.Texture(image(2, 24, 24), interpolation)
    picture = layer(name, size, spp=64)(texture)
    rendered = mcaa.render(
        texture, size, filter=FILTERS[name], estimator=mcaa.Shared(), spp=64, dtype=torch.float64, progress=False
    )
    assert torch.equal(picture, rendered.image)
    z = (picture - filtered(texture.image, size, PROFILES[name], interpolation)) / rendered.stderr
    assert float(z.abs().max()) < quantile(z.numel())


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("name", ["tent", "gaussian"])
def test_many_samples_where_the_integrand_is_continuous(name: str, size: tuple[int, int]) -> None:
    """4,001 a pixel: the kinks of two tents leave some n^-1.5 to n^-2."""
    texture = mcaa.Texture(image(1, 24, 24), "bilinear")
    picture = layer(name, size, spp=4001)(texture)
    assert float((picture - filtered(texture.image, size, PROFILES[name], "bilinear")).abs().max()) < 1e-5


@pytest.mark.parametrize(
    ("name", "interpolation"), [("box", "nearest"), ("tent", "nearest"), ("gaussian", "nearest"), ("box", "bilinear")]
)
def test_many_samples_where_it_jumps(name: str, interpolation: Interpolation) -> None:
    """16 lattices of 16,001 a pixel: steps leave 1/n to each, of random sign. Root mean square over the pixels."""
    texture = mcaa.Texture(image(1, 12, 12), interpolation)
    many = layer(name, (4, 5), spp=16001)
    picture = torch.stack([many(texture) for _ in range(16)]).mean(0)
    error = picture - filtered(texture.image, (4, 5), PROFILES[name], interpolation)
    assert float(error.square().mean().sqrt()) < 1e-5


@every_interpolation
@every_filter
@pytest.mark.parametrize("size", [(12, 12), (6, 6), (3, 3), (5, 9)])
def test_gradients_with_respect_to_the_texture(size: tuple[int, int], name: str, interpolation: Interpolation) -> None:
    """Over 16 calls. Their spread tells the error of their mean, of Student's t with 15 degrees, whose quantile at 1e-5 of 144 is 9.5."""
    texels, grad = image(1, 12, 12).requires_grad_(), image(1, *size, seed=1) - 0.5
    (expected,) = torch.autograd.grad((filtered(texels, size, PROFILES[name], interpolation) * grad).sum(), texels)
    many = layer(name, size, spp=64)
    found = torch.stack(
        [torch.autograd.grad((many(mcaa.Texture(texels, interpolation)) * grad).sum(), texels)[0] for _ in range(16)]
    )
    # 1e-12 for texels that no pixel sees: 0 up to rounding
    assert float(((found.mean(0) - expected).abs() / (found.std(0) / 4 + 1e-12)).max()) < 9.5
    assert float((found.mean(0) - expected).abs().max()) < 5e-3


@pytest.mark.parametrize("name", ["tent", "gaussian"])
def test_gradients_of_many_samples(name: str) -> None:
    texels, grad = image(1, 12, 12).requires_grad_(), image(1, 5, 9, seed=1) - 0.5
    (expected,) = torch.autograd.grad((filtered(texels, (5, 9), PROFILES[name], "bilinear") * grad).sum(), texels)
    (found,) = torch.autograd.grad((layer(name, (5, 9), spp=4001)(mcaa.Texture(texels)) * grad).sum(), texels)
    assert float((found - expected).abs().max()) < 1e-5
