"""kornia's conventions: where our filter is so narrow that it reads a point, kornia's values come out; where it is not, nothing aliases."""

from __future__ import annotations

import math
import warnings
from typing import Any

import pytest
import torch
from kornia.geometry import transform as kornia_transform
from torch import Tensor

import torch_mcaa as mcaa
from torch_mcaa.errors import McaaError, McaaWarning

SIZE = 40, 44
# it reads within 5e-4 px of a place, where a slope of 2 a pixel makes 1e-3
POINT: dict[str, Any] = {"filter": mcaa.Gaussian(1e-4), "estimator": mcaa.Importance()}
FILL = torch.tensor([0.1, 0.5, 0.9], dtype=torch.float64)


def pictures(*shape: int) -> Tensor:
    return torch.rand(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(0))


def homographies() -> Tensor:
    first = [[2.3, 0.3, -8.0], [-0.2, 2.6, -4.0], [0.002, 0.003, 1.0]]
    second = [[2.3, 0.3, 1.0], [-0.2, 2.6, -4.0], [0.002, 0.003, 1.0]]
    return torch.tensor([first, second], dtype=torch.float64)


@pytest.mark.parametrize("align_corners", [True, False])
@pytest.mark.parametrize("padding_mode", ["zeros", "border", "reflection", "fill"])
@pytest.mark.parametrize("mode", ["bilinear", "nearest"])
def test_perspective(mode: Any, padding_mode: Any, align_corners: bool) -> None:
    src, M = pictures(2, 3, 20, 24), homographies()
    theirs = kornia_transform.warp_perspective(src, M, SIZE, mode, padding_mode, align_corners, FILL)
    ours = mcaa.warp_perspective(src, M, SIZE, mode, padding_mode, align_corners, FILL, **POINT)
    assert ours.shape == theirs.shape and ours.dtype == theirs.dtype
    off = (ours - theirs).abs()
    # a centre within 5e-4 px of a texel's edge, as one in a thousand is, may have either
    assert float((off > 1e-3).double().mean()) <= (4e-3 if mode == "nearest" else 0)


@pytest.mark.parametrize("sign", [1.0, -3.0])
def test_a_homography_times_a_number_is_the_same(sign: float) -> None:
    src, M = pictures(1, 1, 20, 24), homographies()[:1]
    first, second = (mcaa.warp_perspective(src, m, SIZE) for m in (M, sign * M))
    torch.testing.assert_close(first, second, rtol=0, atol=1e-9)


def test_affine() -> None:
    src, M = pictures(2, 3, 20, 24), homographies()[:, :2]
    theirs = kornia_transform.warp_affine(src, M, SIZE)
    torch.testing.assert_close(mcaa.warp_affine(src, M, SIZE, **POINT), theirs, rtol=0, atol=1e-3)
    shared = mcaa.warp_affine(src, M[:1], SIZE, seed=3)
    torch.testing.assert_close(shared, mcaa.warp_affine(src, M[:1].expand(2, -1, -1), SIZE, seed=3), rtol=0, atol=1e-12)


@pytest.mark.parametrize(("interpolation", "align_corners"), [("bilinear", None), ("bilinear", True), ("nearest-exact", None)])
def test_resize(interpolation: Any, align_corners: bool | None) -> None:
    src = pictures(2, 3, 20, 24)
    theirs = kornia_transform.resize(src, (44, 64), interpolation, align_corners)
    off = (mcaa.resize(src, (44, 64), interpolation, align_corners, **POINT) - theirs).abs()
    assert float((off > 1e-3).double().mean()) <= (4e-3 if interpolation == "nearest-exact" else 0)


@pytest.mark.parametrize("interpolation", ["nearest", "bilinear", "bicubic"])
def test_one_texel_is_the_same_everywhere(interpolation: Any) -> None:
    src = torch.rand(1, 2, 1, 1, generator=torch.Generator().manual_seed(1))
    torch.testing.assert_close(mcaa.resize(src, (4, 6), interpolation, align_corners=True), src.expand(1, 2, 4, 6))


def test_area_is_the_mean_over_each_pixel() -> None:
    src = pictures(2, 3, 20, 24)
    torch.testing.assert_close(mcaa.resize(src, (5, 6), "area"), kornia_transform.resize(src, (5, 6), "area"), rtol=0, atol=1e-13)
    ours, theirs = mcaa.resize(src, (7, 11), "area"), mcaa.resize(src, (7, 11), "area", estimator=mcaa.Shared(), spp=257)
    # steps of 1 against 257 samples
    torch.testing.assert_close(ours, theirs, rtol=0, atol=0.02)


@pytest.mark.parametrize("side", ["short", "long", "vert", "horz"])
@pytest.mark.parametrize("shape", [(20, 31), (31, 20), (3, 20, 31), (2, 2, 3, 20, 31)])
def test_shapes(shape: tuple[int, ...], side: Any) -> None:
    src = pictures(*shape)
    ours = mcaa.resize(src, 13, side=side, spp=1)
    assert ours.shape == kornia_transform.resize(src, 13, side=side).shape
    assert mcaa.resize(src.half(), 13, side=side, spp=1).dtype == torch.half


def test_no_aliasing_under_minification() -> None:
    """A tone of 0.46 cycles a texel, of which 8 make a pixel, is gone in a right picture: kornia's keeps two thirds of its amplitude.

    Of a Gaussian of 0.5 px nothing of 3.7 cycles a pixel is left (1e-29); what the lattice makes of it is its error.
    """
    x = torch.arange(256, dtype=torch.float64)
    tone = torch.cos(2 * math.pi * 0.46 * x).expand(256, 256)[None, None]
    shrink = torch.tensor([[[0.125, 0.0, 0.0], [0.0, 0.125, 0.0]]], dtype=torch.float64)
    inner = (..., slice(4, -4), slice(4, -4))
    theirs = kornia_transform.warp_affine(tone, shrink, (32, 32))[inner]
    ours = mcaa.warp_affine(tone, shrink, (32, 32))[inner]
    sampled = mcaa.warp_affine(tone, shrink, (32, 32), estimator=mcaa.Shared(), spp=64)[inner]
    assert float(theirs.square().mean().sqrt()) > 0.4
    assert float(sampled.square().mean().sqrt()) < 0.02
    # what the cut at 5 std leaves
    assert float(ours.abs().max()) < 1e-6


def test_what_moves_and_scales_is_exact() -> None:
    """A shift by whole pixels, a mirror and a scale of 1/2, against pictures made of the same texels; whatever the seed."""
    src = pictures(2, 3, 20, 24)
    plain = mcaa.resize(src, (20, 24))
    shifted = mcaa.warp_affine(src, torch.tensor([[[1.0, 0.0, 3.0], [0.0, 1.0, -2.0]]]), (20, 24), padding_mode="border")
    torch.testing.assert_close(shifted[..., :18, 3:], plain[..., 2:, :21], rtol=0, atol=1e-13)
    mirrored = mcaa.warp_affine(src, torch.tensor([[[-1.0, 0.0, 23.0], [0.0, 1.0, 0.0]]]), (20, 24), padding_mode="border", seed=5)
    torch.testing.assert_close(mirrored, plain.flip(-1), rtol=0, atol=1e-13)
    halved = mcaa.warp_affine(src, torch.tensor([[[0.5, 0.0, -0.25], [0.0, 0.5, -0.25]]]), (10, 12), padding_mode="border")
    torch.testing.assert_close(halved, mcaa.resize(src, (10, 12)), rtol=0, atol=1e-13)


@pytest.mark.parametrize("padding_mode", ["zeros", "border", "reflection", "fill"])
@pytest.mark.parametrize("align_corners", [True, False])
def test_gradients_of_what_moves_and_scales(align_corners: bool, padding_mode: Any) -> None:
    src, M = pictures(1, 1, 4, 5).requires_grad_(), torch.tensor([[[0.7, 0.0, 0.3], [0.0, -1.2, 4.1]]], dtype=torch.float64)
    assert torch.autograd.gradcheck(
        lambda s: mcaa.warp_affine(s, M, (4, 5), "bicubic", padding_mode, align_corners, FILL[:1]), [src]
    )


def test_gradients() -> None:
    """Of a shift by s of a linear ramp: the value falls by the slope, and the picture's own gradient sums to 1 a pixel of the result."""
    ramp = (0.1 * torch.arange(40, dtype=torch.float64)).expand(40, 40)[None, None].clone().requires_grad_()
    shift = torch.tensor([[[1.0, 0.0, 0.3], [0.0, 1.0, 0.0]]], dtype=torch.float64, requires_grad=True)
    mcaa.warp_affine(ramp, shift, (40, 40))[0, 0, 18, 20].backward()
    assert ramp.grad is not None and shift.grad is not None
    torch.testing.assert_close(float(ramp.grad.sum()), 1.0, rtol=0, atol=1e-9)
    # x' = x + 0.3 has its source at x - 0.3; M[0, 0] moves it by the source's x = 19.7, M[0, 1] by its y = 18
    expected = -0.1 * torch.tensor([[19.7, 18.0, 1.0], [0.0, 0.0, 0.0]], dtype=torch.float64)
    torch.testing.assert_close(shift.grad[0], expected, rtol=1e-3, atol=1e-3)


def test_a_horizon_is_told() -> None:
    tilted = torch.tensor([[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.05, 1.0]]])
    src = pictures(1, 1, 20, 24).float()
    mcaa.warp_perspective(src, tilted, (15, 20))
    with pytest.warns(McaaWarning, match=r"horizon of M\[0\]"):
        mcaa.warp_perspective(src, tilted, (30, 20))
    with pytest.warns(McaaWarning, match="horizon"), pytest.raises(McaaError, match="horizon"):
        mcaa.warp_perspective(src, tilted.requires_grad_(), (30, 20))


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"src": torch.zeros(3, 8, 8)}, "src must be"),
        ({"src": torch.zeros(1, 3, 8, 8, dtype=torch.uint8)}, "src must be"),
        ({"M": torch.eye(3)}, "M must be"),
        ({"src": torch.zeros(1, 3, 8, 8).to_sparse()}, "src must be.*layout torch.sparse_coo"),
        ({"src": torch.zeros(1, 3, 8, 8, device="meta")}, "src must be.*on meta, where there are no values"),
        ({"M": torch.eye(3)[None].to_sparse()}, "M must be a dense tensor"),
        ({"align_corners": "yes"}, "align_corners must be True or False, got 'yes'"),
        ({"align_corners": torch.ones(2)}, "align_corners must be True or False"),
        ({"M": torch.eye(3)[None] * 1j}, "M must be real"),
        ({"mode": ["bilinear"]}, "mode must be one of"),
        ({"M": torch.eye(3)[None].expand(3, -1, -1)}, "2 pictures and M 3 maps"),
        ({"M": torch.zeros(1, 3, 3)}, "invertible"),
        ({"M": torch.full((1, 3, 3), torch.nan)}, "finite"),
        ({"dsize": (0, 4)}, "at least one pixel"),
        ({"mode": "cubic"}, "mode must be"),
        ({"padding_mode": "wrap"}, "padding_mode must be"),
    ],
)
def test_bad_input(arguments: dict[str, Any], said: str) -> None:
    given = {"src": torch.zeros(2, 3, 8, 8), "M": torch.eye(3)[None], "dsize": (4, 4), **arguments}
    with pytest.raises(McaaError, match=said):
        mcaa.warp_perspective(**given)


def test_bad_input_of_resize() -> None:
    for given, said in (
        ({"input": torch.zeros(8)}, "input must be"),
        ({"side": "left"}, "side must be"),
        ({"size": 2.5}, "size must be an integer or two integers"),
        ({"align_corners": "yes"}, "align_corners must be True, False or None"),
        ({"antialias": torch.ones(2)}, "antialias True or False"),
        ({"interpolation": "linear"}, "interpolation must be"),
    ):
        with pytest.raises(McaaError, match=said):
            mcaa.resize(**{"input": torch.zeros(3, 8, 8), "size": 4, **given})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "fill", [0.3, [0.1, 0.2, 0.3], torch.rand(2), torch.rand(5, 3, 1, 1), torch.rand(2, 1, 3, 1, 1), torch.rand(3) * 1j]
)
def test_what_is_no_colour_to_fill_with_is_refused(fill: object) -> None:
    with pytest.raises(mcaa.McaaError, match="fill_value must be a tensor"):
        mcaa.warp_perspective(torch.rand(1, 3, 8, 9), torch.eye(3)[None], (4, 4), padding_mode="fill", fill_value=fill)  # pyright: ignore[reportArgumentType]


def test_a_size_that_is_none_is_told_before_the_colour() -> None:
    with pytest.raises(mcaa.McaaError, match="size must be two integers"):
        mcaa.warp_perspective(torch.rand(1, 3, 8, 9), torch.eye(3)[None], 5, padding_mode="fill", fill_value=torch.rand(3))  # pyright: ignore[reportArgumentType]


def test_a_users_compilation_does_not_look_inside() -> None:
    src, eye = torch.rand(1, 2, 8, 9), torch.eye(3)[None]
    warped = torch.compile(lambda t: mcaa.warp_perspective(t, eye, (5, 6)) + 1, backend="eager")
    resized = torch.compile(lambda t: mcaa.resize(t, (5, 6)) + 1, backend="eager")
    assert torch.equal(warped(src), mcaa.warp_perspective(src, eye, (5, 6)) + 1)
    assert torch.equal(resized(src), mcaa.resize(src, (5, 6)) + 1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warped(src + 1)
