"""Textures whose rows and columns are the screen's: exact, without a sample."""

from __future__ import annotations

import copy
import gc
import itertools
import math
import subprocess
import sys
import weakref
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import texture_truth
import torch
from kornia_truth import PROFILES
from torch import Tensor
from torch.utils.checkpoint import checkpoint

import torch_mcaa as mcaa
from torch_mcaa.arguments import task_of
from torch_mcaa.errors import McaaError, McaaWarning
from torch_mcaa.estimators.parts import EXACT
from torch_mcaa.estimators.texel_weights import Axis
from torch_mcaa.estimators.texels import Texels
from torch_mcaa.filters import Filter, SeparableFilter
from torch_mcaa.filters.gauss import legendre
from torch_mcaa.filters.moments import moment
from torch_mcaa.filters.quadrature import FEW, panels
from torch_mcaa.grid import Screen
from torch_mcaa.texture import Interpolation, Wrap

F64 = torch.float64
WRAPS: tuple[Wrap, ...] = ("zeros", "border", "repeat", "mirror")
INTERPOLATIONS: tuple[Interpolation, ...] = ("nearest", "bilinear", "bicubic")
KNOWN: dict[str, Filter] = {"box": mcaa.Box(), "tent": mcaa.Tent(), "gaussian": mcaa.Gaussian(0.5)}
SAMPLES = torch.tensor([0.3, -0.2, 1.0, 2.0, 0.5])
FILTERS: list[SeparableFilter] = [
    mcaa.Box(),
    mcaa.Box(1.7),
    mcaa.Tent(),
    mcaa.Tent(0.3),
    mcaa.Gaussian(0.5),
    mcaa.Gaussian(2.0),
    mcaa.Gaussian(0.5, 0.6),
    mcaa.Gaussian(0.01, 2.0),
    mcaa.Mitchell(),
    mcaa.CatmullRom(),
    mcaa.Lanczos(3),
    mcaa.BlackmanHarris(),
    mcaa.Tabulated(SAMPLES, 1.3),  # type: ignore[list-item]
]
TURNED = torch.tensor([[2.0, 0.3, 0.0], [-0.3, 2.0, 0.0], [0.0, 0.0, 1.0]])
# scaled by 0.72 and mirrored at -0.32 in y, shifted
MIRRORED = torch.tensor([[1.37, 0.0, -0.4], [0.0, -0.61, 2.3], [0.0, 0.0, 1.9]], dtype=F64)

every_filter = pytest.mark.parametrize("filter", FILTERS, ids=repr)
every_boundary = pytest.mark.parametrize("boundary", ["extend", "zero", "renormalize"])


def image(*shape: int, seed: int = 0) -> Tensor:
    return torch.rand(*shape, dtype=F64, generator=torch.Generator().manual_seed(seed))


def rendered(texture: Any, size: tuple[int, int], **arguments: Any) -> mcaa.Rendering:
    picture = mcaa.render(texture, size, progress=False, **{"dtype": F64, **arguments})
    assert bool((picture.model == EXACT).all())
    return picture


@pytest.mark.parametrize("size", [(24, 24), (12, 12), (6, 6), (15, 9), (32, 30), (70, 5), (1, 1)])
@pytest.mark.parametrize("name", list(KNOWN))
@pytest.mark.parametrize("interpolation", ["nearest", "bilinear"])
def test_closed_forms(interpolation: Interpolation, name: str, size: tuple[int, int]) -> None:
    """To rounding, of the truth's second differences too; float32 within 2 standard errors, which bound it."""
    for wrap, dtype in itertools.product(WRAPS, (torch.float32, F64)):
        texture = mcaa.Texture(image(2, 24, 24).to(dtype), interpolation, wrap)
        picture = rendered(texture, size, filter=KNOWN[name], dtype=dtype)
        error = (picture.image - texture_truth.pixel_values(texture.image, size, PROFILES[name], interpolation, wrap)).abs()
        assert float(error.max()) < (1e-13 if dtype == F64 else 6e-8)
        assert dtype == F64 or float((error / picture.stderr).max()) < 2
        assert float(picture.stderr.min()) > 0 and float(picture.stderr.max()) < (1e-13 if dtype == F64 else 1e-7)


def by_quadrature(
    texture: mcaa.Texture,
    texels: int,
    axis: tuple[float, float],
    filter: SeparableFilter,
    boundary: str,
    places: tuple[int, float, float],
) -> Tensor:
    """(pixels, texels): what the texels of one axis weigh, by 12 nodes on pieces cut wherever anything may have a kink, 80 of them at least.

    axis: texels a unit of the screen's coordinates, and where they begin; places: pixels, their size and where they begin.
    """
    (pixels, size, start), radius, rows = places, filter.half_width, []
    kinks = [radius * torch.linspace(-1, 1, 81, dtype=F64), 0.1 * radius * torch.linspace(-1, 1, 81, dtype=F64)]
    kinks += [torch.arange(-8, 9, dtype=F64), torch.tensor(getattr(filter, "sign_changes", ()), dtype=F64)]
    knots = (torch.arange(-120, 121, dtype=F64) / 2 - axis[0] * start - axis[1]) / (axis[0] * size)
    # a texel of 1 in each channel, read through its middle
    each = mcaa.Texture(torch.eye(texels, dtype=F64)[:, None], texture.interpolation, texture.wrap)
    for pixel in range(pixels):
        low, high = (-radius, radius) if boundary == "extend" else (max(-radius, -pixel - 0.5), min(radius, pixels - pixel - 0.5))
        d, weight = legendre(torch.cat([*kinks, knots - pixel - 0.5]).clamp(low, high).unique(), 12)
        weight = weight * filter.profile(d)
        x = axis[0] * (start + size * (pixel + 0.5 + d)) + axis[1]
        row = torch.stack(each(x, torch.full_like(x, 0.5))) @ weight
        rows.append(row / weight.sum() if boundary == "renormalize" else row)
    return torch.stack(rows)


@every_boundary
@every_filter
def test_quadrature(filter: SeparableFilter, boundary: str) -> None:
    size, screens = (3, 4), ({}, {"extent": (3.3, -2.1, 0.2, 4.7)})
    texels = image(1, 5, 4)
    for wrap, interpolation, arguments in itertools.product(WRAPS, INTERPOLATIONS, screens):
        texture = mcaa.Texture(texels, interpolation, wrap, transform=None if arguments else MIRRORED)
        screen = Screen.of(size, arguments.get("extent"))
        assert texture.axes is not None
        along = zip(size[::-1], screen.pixel_size, screen.extent[::2], strict=True)
        across, down = (
            by_quadrature(texture, count, axis, filter, boundary, places)
            for count, axis, places in zip((4, 5), texture.axes, along, strict=True)
        )
        picture = rendered(texture, size, filter=filter, boundary=boundary, **arguments)
        error = (picture.image - down @ texels @ across.T).abs()
        # three Gaussians of 50 panels, the table with its jumps at the ends: a place is known to 1e-15 at best
        assert float(error.max()) < 1e-14
        assert float((error / picture.stderr).max()) < 2


@every_filter
def test_panels(filter: SeparableFilter) -> None:
    """Few pieces, on which the rule gives the moments of the profile; `moment` has 16 nodes on hundreds."""
    ends = panels(filter)
    assert len(ends) < 20 and float(ends[0]) == -filter.half_width and float(ends[-1]) == filter.half_width
    d, weight = legendre(ends, FEW)
    mass = weight * filter.profile(d)
    for power in range(4):
        expected = moment(filter, power, 0)
        assert abs(float((mass * d**power).sum()) - expected) < 1e-14 * filter.half_width**power


class _Bump(SeparableFilter):
    """One of a user's own: off centre, of infinite smoothness, a hundred times narrower than its support."""

    half_width = 4.0
    absolute_profile_integral = 1.0

    def profile(self, d: Tensor) -> Tensor:
        return torch.exp(-0.5 * ((d - 0.3) / 0.04) ** 2) / (0.04 * math.sqrt(2 * math.pi))

    def profile_cdf(self, d: Tensor) -> Tensor:
        return torch.special.ndtr((d - 0.3) / 0.04)

    def profile_sample(self, u: Tensor) -> tuple[Tensor, Tensor]:
        return 0.3 + 0.04 * torch.special.ndtri(u), torch.ones_like(u)


def test_a_filter_of_ones_own() -> None:
    """Shifted by 0.3 px, as a Gaussian between shifted texels."""
    texels = image(1, 8, 9)
    shifted = torch.tensor([[1, 0, 0.3], [0, 1, 0.3], [0, 0, 1]], dtype=F64)
    own = rendered(mcaa.Texture(texels), (8, 9), filter=_Bump()).image
    other = rendered(mcaa.Texture(texels, transform=shifted), (8, 9), filter=mcaa.Gaussian(0.04, 2.0)).image
    torch.testing.assert_close(own, other, rtol=0, atol=1e-13)


@pytest.mark.parametrize("scale", [100.0, 0.01])
@pytest.mark.parametrize("interpolation", ["nearest", "bilinear"])
def test_far_smaller_and_far_larger(interpolation: Interpolation, scale: float) -> None:
    size = (3, 4)
    texels = image(1, int(size[0] * scale), int(size[1] * scale)) if scale > 1 else image(1, 2, 3)
    size = size if scale > 1 else (200, 300)
    picture = rendered(mcaa.Texture(texels, interpolation), size)
    expected = texture_truth.pixel_values(texels, size, PROFILES["gaussian"], interpolation, "border")
    # the truth's differences lose two digits to a hundred texels a pixel
    torch.testing.assert_close(picture.image, expected, rtol=0, atol=1e-12)


def test_a_million_texels_a_pixel() -> None:
    """What ends is constant beyond its border; of what does not there are too many, and it is sampled."""
    for wrap, expected in (("zeros", 0.0), ("border", 0.25)):
        texture = mcaa.Texture(torch.full((1, 3, 3), 0.25), "bicubic", wrap, transform=torch.diag(torch.tensor([1e6, 1e6, 1.0])))  # type: ignore[arg-type]
        picture = rendered(texture, (8, 8))
        torch.testing.assert_close(picture.image[0, 2:, 2:], torch.full((6, 6), expected, dtype=F64), rtol=0, atol=1e-13)
    coarse, far = torch.diag(torch.tensor([1e6, 1e6, 1.0])), torch.tensor([[1.0, 0, 1e14], [0, 1, 0], [0, 0, 1]], dtype=F64)
    for transform in (coarse, far):
        texture = mcaa.Texture(image(1, 3, 3), wrap="repeat", transform=transform)
        assert int(mcaa.render(texture, (8, 8), progress=False).spp.min()) > 0


@every_boundary
def test_the_gradient_is_the_transposed_map(boundary: Any) -> None:
    """<W t, g> = <t, W^T g>, through whole cells and their borders, and by central differences."""
    for wrap, interpolation in itertools.product(WRAPS, INTERPOLATIONS):
        texels, size = image(2, 37, 21).requires_grad_(), (300, 261)
        layer = mcaa.Supersampler(size, filter=mcaa.Lanczos(3), boundary=boundary).double()
        grad = image(2, *size, seed=1) - 0.5
        picture = layer(mcaa.Texture(texels, interpolation, wrap))
        (found,) = torch.autograd.grad((picture * grad).sum(), texels)
        other = image(2, 37, 21, seed=2)
        expected = (layer(mcaa.Texture(other, interpolation, wrap)) * grad).sum()
        assert abs(float((found * other).sum() - expected)) < 1e-10
        small = mcaa.Supersampler((2, 3), boundary=boundary).double()
        few = image(1, 3, 4).requires_grad_()
        assert torch.autograd.gradcheck(lambda t, small=small, i=interpolation, w=wrap: small(mcaa.Texture(t, i, w)), [few])


def test_a_batch() -> None:
    textures = image(2, 3, 8, 9).requires_grad_()
    layer = mcaa.Supersampler((5, 6))
    assert torch.equal(layer(textures)[1], rendered(mcaa.Texture(textures[1].detach()), (5, 6)).image)
    assert torch.autograd.gradcheck(layer, [textures])
    # another call, other points: none
    assert torch.equal(layer(textures), layer(textures)) and layer(textures.half()).dtype == torch.half
    picture = layer(textures)
    (first,) = torch.autograd.grad(picture.square().sum(), textures, create_graph=True)
    with pytest.raises(McaaError, match="second derivatives"):
        torch.autograd.grad(first.sum(), textures)


def test_checkpoints_autocast_and_copies() -> None:
    textures, layer = torch.rand(2, 3, 8, 9, generator=torch.Generator().manual_seed(0)).requires_grad_(), mcaa.Supersampler((5, 6))

    def gradient(make: Callable[[Tensor], Tensor]) -> Tensor:
        return torch.autograd.grad(make(textures).square().sum(), textures)[0]

    expected = gradient(layer)
    assert torch.equal(gradient(lambda t: checkpoint(layer, t, call=0, use_reentrant=False)), expected)  # type: ignore[arg-type]
    assert torch.equal(gradient(copy.deepcopy(layer)), expected)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        assert torch.equal(gradient(layer), expected)


def test_what_moves_has_the_gradient_of_samples() -> None:
    """The values are exact all the same."""
    texels, std = image(1, 24, 24).requires_grad_(), torch.tensor(0.5, dtype=F64, requires_grad=True)
    transform = torch.diag(torch.tensor([2.0, 2.0, 1.0], dtype=F64)).requires_grad_()
    layer = mcaa.Supersampler((12, 12), filter=mcaa.Gaussian(std)).double()
    picture = layer(mcaa.Texture(texels, transform=transform))
    expected = texture_truth.pixel_values(texels.detach(), (12, 12), PROFILES["gaussian"], "bilinear", "border")
    torch.testing.assert_close(picture, expected, rtol=0, atol=1e-13, check_stride=False)
    picture.square().sum().backward()
    assert all(t.grad is not None and float(t.grad.abs().sum()) > 0 for t in (texels, std, transform))
    with torch.no_grad():
        step = torch.tensor(1e-4, dtype=F64)
        ahead, behind = (
            mcaa.Supersampler((12, 12), filter=mcaa.Gaussian(std.detach() + s, 2.5)).double()(
                mcaa.Texture(texels, transform=transform)
            )
            for s in (step, -step)
        )
    slope = (ahead.square().sum() - behind.square().sum()) / (2 * step)
    torch.testing.assert_close(std.grad, slope, rtol=0.02, atol=0)


def test_what_a_rendering_says() -> None:
    texture = mcaa.Texture(image(1, 9, 9))
    for arguments in ({}, {"tolerance": 1e-3}, {"seconds": 60.0}, {"tolerance": 1e-30}, {"spp": 1}):
        picture = rendered(texture, (70, 90), **arguments)
        assert picture.evaluations == 0 and not bool(picture.spp.any()) and not bool(picture.invalid.any())
        assert picture.models[int(picture.model[0, 0])] == "texels, exactly"
        assert picture.stopped == ("tolerance" if arguments.get("tolerance") == 1e-3 else "spp")
        assert picture.bias == () and not bool(picture.unseen.any())
        assert float(picture.stderr.min()) > 0
        assert torch.equal(picture.image, rendered(texture, (70, 90)).image)
    black = rendered(mcaa.Texture(torch.zeros(1, 3, 3)), (4, 4), dtype=torch.float32)
    assert float(black.stderr.min()) > 0 and not bool(black.image.any())


@pytest.mark.parametrize("wrap", ["border", "repeat", "mirror"])
def test_constants_come_out_exactly(wrap: Wrap) -> None:
    for interpolation, filter in itertools.product(INTERPOLATIONS, FILTERS):
        texture = mcaa.Texture(torch.full((1, 5, 7), 0.7), interpolation, wrap)
        assert bool((rendered(texture, (6, 11), filter=filter, dtype=torch.float32).image == 0.7).all())


def test_what_is_sampled_as_before() -> None:
    texels = torch.rand(1, 20, 20, generator=torch.Generator().manual_seed(0))
    with_hole = texels.clone()
    with_hole[0, 3, 4] = torch.nan
    box = mcaa.Tabulated(torch.ones(3, 3), 0.5)
    for texture, arguments in (
        (mcaa.Texture(texels, transform=TURNED), {}),
        (mcaa.Texture(texels, transform=-torch.eye(3)), {}),
        (mcaa.Texture(texels), {"filter": box}),
        (mcaa.Texture(texels), {"filter": mcaa.Sinc(), "boundary": "zero"}),
        (mcaa.Texture(texels), {"estimator": mcaa.Shared()}),
        (mcaa.Texture(with_hole), {"nonfinite": "ignore"}),
        (mcaa.Texture(with_hole), {"nonfinite": "propagate"}),
        (lambda x, y: mcaa.Texture(texels)(x, y), {}),
    ):
        picture = mcaa.render(texture, (20, 20), progress=False, **arguments)  # type: ignore[arg-type]
        assert picture.evaluations > 0 and not bool((picture.model == EXACT).any()), arguments
    with pytest.raises(McaaError, match="f returned nan at x = "):
        mcaa.render(mcaa.Texture(with_hole), (20, 20), progress=False)


def test_a_large_finite_texel() -> None:
    """The sum of the texels overflows, the picture does not."""
    texels = torch.full((1, 4, 4), 3e38)
    with pytest.warns(McaaWarning, match="squares are beyond torch.float32"):
        assert bool((rendered(mcaa.Texture(texels), (4, 4), dtype=torch.float32).image == 3e38).all())


@every_boundary
def test_cells_by_themselves(boundary: Any) -> None:
    """In another order, each by a new round."""
    size, texture = (300, 530), mcaa.Texture(image(2, 90, 77).float(), "bicubic", "mirror")
    picture = rendered(texture, size, boundary=boundary, dtype=torch.float32)
    task = task_of(texture, Screen.of(size), mcaa.Gaussian(0.5), boundary, "raise", 0, torch.float32, None)
    for cell in reversed(list(task.screen.cells(*mcaa.Auto().cell(task, 16, False)))):
        estimate = mcaa.Auto().round(task, 16, 0).estimate(cell)
        assert torch.equal(estimate.value, picture.image[(slice(None), *cell.window)])
        assert torch.equal(estimate.variance.sqrt(), picture.stderr[(slice(None), *cell.window)])


PROGRAM = """
import hashlib, sys, torch, torch_mcaa as mcaa
torch.set_num_threads(int(sys.argv[1]))
digest = hashlib.sha256()
for dtype in (torch.float32, torch.float64):
    texels = torch.rand(3, 700, 411, generator=torch.Generator().manual_seed(0)).to(dtype).requires_grad_()
    for interpolation, filter in (("nearest", mcaa.Gaussian(0.5)), ("bicubic", mcaa.Lanczos(3))):
        picture = mcaa.Supersampler((301, 287), filter=filter).to(dtype)(mcaa.Texture(texels, interpolation))
        (grad,) = torch.autograd.grad(picture.square().sum(), texels)
        for plane in (picture, grad):
            digest.update(plane.detach().contiguous().numpy().tobytes())
print(digest.hexdigest())
"""


def test_threads_do_not_change_a_bit() -> None:
    digests = set()
    for threads in (1, 2, 3, 8):
        run = subprocess.run([sys.executable, "-c", PROGRAM, str(threads)], capture_output=True, text=True, check=True)
        digests.add(run.stdout.strip())
    assert len(digests) == 1


def test_memory_does_not_grow_with_the_texture() -> None:
    """Columns are taken some at a time: of 2,000 x 3,000 texels for 4 x 4 pixels no float64 copy is made."""
    texels = torch.rand(1, 2000, 3000, generator=torch.Generator().manual_seed(0))
    task = task_of(mcaa.Texture(texels), Screen.of((4, 4)), mcaa.Box(), "extend", "raise", 0, torch.float32, None)
    map_ = Texels.of(task)
    assert map_ is not None
    with torch.autograd.profiler.profile(profile_memory=True) as profile:
        map_.values(next(iter(task.screen.cells(4, 4))))
    events: Any = profile.function_events
    assert 0 < max(event.cpu_memory_usage for event in events) <= 1.1 * 8 * 2**20
    expected = texels.double().view(4, 500, 4, 750).mean((1, 3))
    nearest = mcaa.render(mcaa.Texture(texels, "nearest"), (4, 4), filter=mcaa.Box(), dtype=F64, progress=False)
    np.testing.assert_allclose(nearest.image[0].numpy(), expected.numpy(), rtol=0, atol=1e-14)


def test_a_texture_is_looked_at_once_a_picture_and_let_go(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Axis] = []
    fits = Axis.fits

    def counted(self: Axis, filter: SeparableFilter) -> bool:
        asked.append(self)
        return fits(self, filter)

    monkeypatch.setattr(Axis, "fits", counted)
    texels = torch.rand(1, 20, 20, generator=torch.Generator().manual_seed(0))
    texture = weakref.ref(texels)
    gc.disable()
    try:
        mcaa.render(mcaa.Texture(texels), (8, 8), progress=False)
        del texels
        assert len(asked) == 2 and texture() is None
    finally:
        gc.enable()
