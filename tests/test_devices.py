"""What another device gives: the pictures and gradients that the CPU gives, but for rounding. Where there is none, one is pretended."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import nullcontext

import pytest
import torch
from pretended import pretended
from torch import Tensor

import torch_mcaa as mcaa
from torch_mcaa.integrand import BLOCK

CUDA = [pytest.mark.gpu, pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")]
SIZE = (50, 60)


@pytest.fixture(params=[pytest.param("cuda", marks=CUDA), "pretended"])
def device(request: pytest.FixtureRequest) -> Iterator[str]:
    with pretended() if request.param == "pretended" else nullcontext(request.param) as name:
        yield name


# autocast, which a layer asks about, knows real devices alone
real = pytest.mark.parametrize("device", [pytest.param("cuda", marks=CUDA)], indirect=True)


def disc(x: Tensor, y: Tensor) -> Tensor:
    return torch.hypot(x - 40.3, y - 30.8) < 20


def three(x: Tensor, y: Tensor) -> tuple[Tensor, ...]:
    return torch.sin(0.3 * x), 30 * (torch.hypot(x - 40.3, y - 30.8) < 20), torch.cos(0.1 * y * x)


DENSITY = mcaa.Mixture([mcaa.FilterDensity(mcaa.Gaussian(0.5)), mcaa.Normal(1.0)])
ESTIMATORS = [
    mcaa.Auto(),
    mcaa.JumpCorrected(),
    mcaa.Shared(),
    mcaa.Shared(replicates=2),
    mcaa.Shared(mcaa.Sobol()),
    mcaa.Importance(),
    mcaa.Importance(density=DENSITY),
    mcaa.Importance(allocation=mcaa.Neyman()),
    mcaa.Crude(biased_ok=True),
    mcaa.Stratified((2, 2)),
    mcaa.AdaptiveImportance(),
    mcaa.ControlVariate(),
]


def both(
    device: str, f: Callable[..., object], size: tuple[int, int] = SIZE, **arguments: object
) -> tuple[mcaa.Rendering, mcaa.Rendering]:
    """In float64, where the two devices' functions differ by some 1e-16 of what they return."""
    return tuple(
        mcaa.render(f, size, device=place, **{"dtype": torch.float64, **arguments})  # pyright: ignore[reportArgumentType]
        for place in ("cpu", device)
    )


def agree(cpu: mcaa.Rendering, cuda: mcaa.Rendering, tolerance: float = 1e-9) -> None:
    assert cuda.image.device.type == cuda.stderr.device.type != "cpu"
    scale = float(cpu.image.abs().max())
    torch.testing.assert_close(cuda.image.cpu(), cpu.image, rtol=0, atol=tolerance * scale)
    torch.testing.assert_close(cuda.stderr.cpu(), cpu.stderr, rtol=1e-6, atol=tolerance * scale)
    assert torch.equal(cuda.spp.cpu(), cpu.spp) and torch.equal(cuda.model.cpu(), cpu.model)


@pytest.mark.parametrize("f", [disc, three])
@pytest.mark.parametrize("estimator", ESTIMATORS, ids=repr)
def test_estimators(device: str, estimator: mcaa.Estimator, f: Callable[..., object]) -> None:
    agree(*both(device, f, estimator=estimator))


def test_ordered_strata(device: str) -> None:
    """Which rectangle is cut next hangs on last bits: the pictures differ by less than their standard errors say."""
    cpu, cuda = both(device, three, estimator=mcaa.OrderedStrata())
    difference = (cuda.image.cpu() - cpu.image).square() / (cuda.stderr.cpu().square() + cpu.stderr.square())
    assert float(difference.mean()) < 1


@pytest.mark.parametrize(
    ("filter", "boundary"), [(mcaa.Box(), "extend"), (mcaa.Mitchell(1 / 3, 1 / 3), "zero"), (mcaa.Lanczos(3), "renormalize")]
)
def test_filters_and_boundaries(device: str, filter: mcaa.Filter, boundary: str) -> None:
    agree(*both(device, three, filter=filter, boundary=boundary))


def test_several_cells(device: str) -> None:
    """What no sample met is told by the range of values in a cell, and a GPU's are larger: the disc's is seen farther away."""
    cpu, cuda = both(device, three, size=(300, 2100), estimator=mcaa.Shared(), spp=4)
    torch.testing.assert_close(cuda.image.cpu(), cpu.image, rtol=0, atol=1e-8)
    assert bool((cuda.unseen.cpu() >= cpu.unseen - 1e-9).all())
    torch.testing.assert_close(cuda.stderr.cpu()[::2].mean((1, 2)), cpu.stderr[::2].mean((1, 2)), rtol=0.01, atol=0)


def test_points_of_a_call(device: str) -> None:
    """A network keeps hundreds of numbers for each point: a call gets fewer points than are weighed together."""
    seen: list[int] = []

    def counted(x: Tensor, y: Tensor) -> Tensor:
        seen.append(x.numel())
        return x

    picture = mcaa.render(counted, (500, 600), estimator=mcaa.Shared(), device=device)
    assert sum(seen) == picture.evaluations and BLOCK < max(seen) <= 16 * BLOCK < picture.evaluations


def test_tolerance(device: str) -> None:
    cpu, cuda = both(device, three, size=(100, 120), tolerance=1.0, spp=64)
    assert cpu.stopped == cuda.stopped == "tolerance"
    agree(cpu, cuda)


def test_not_finite(device: str) -> None:
    def hole(x: Tensor, y: Tensor) -> Tensor:
        return torch.where(x * x + y * y < 100, torch.nan, x)

    with pytest.raises(mcaa.McaaError, match="f returned nan at x = "):
        mcaa.render(hole, SIZE, device=device)
    for estimator in (mcaa.Shared(), mcaa.Auto(), mcaa.Importance()):
        cpu, cuda = both(device, hole, nonfinite="ignore", estimator=estimator)
        assert int(cuda.invalid.sum()) > 0 and torch.equal(cuda.invalid.cpu(), cpu.invalid)


@pytest.mark.parametrize("interpolation", ["nearest", "bicubic"])
def test_textures(device: str, interpolation: str) -> None:
    image = torch.rand(3, 40, 50, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    cpu = mcaa.render(mcaa.Texture(image, interpolation=interpolation), SIZE, dtype=torch.float64)  # pyright: ignore[reportArgumentType]
    cuda = mcaa.render(mcaa.Texture(image.to(device), interpolation=interpolation), SIZE, dtype=torch.float64, device=device)  # pyright: ignore[reportArgumentType]
    agree(cpu, cuda)


@pytest.mark.gpu
@CUDA[1]
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # the compiler's own
def test_compiled() -> None:
    eager, compiled = (mcaa.render(three, (300, 2100), estimator=mcaa.Shared(), compile=c, device="cuda") for c in (False, True))
    torch.testing.assert_close(compiled.image, eager.image, rtol=0, atol=30 * 1e-5)
    torch.testing.assert_close(compiled.stderr, eager.stderr, rtol=1e-2, atol=30 * 1e-5)


@pytest.mark.parametrize("estimator", [*ESTIMATORS, mcaa.OrderedStrata()], ids=repr)
def test_same_bits_again(device: str, estimator: mcaa.Estimator) -> None:
    """Threads of a GPU add in whatever order they come, unless told otherwise; float64 shows it."""
    size = (300, 700) if isinstance(estimator, (mcaa.Auto, mcaa.JumpCorrected)) else SIZE
    first, second = (mcaa.render(three, size, estimator=estimator, device=device, dtype=torch.float64) for _ in range(2))
    assert torch.equal(first.image, second.image) and torch.equal(first.stderr, second.stderr)


def test_save(device: str, tmp_path: object) -> None:
    mcaa.render(disc, SIZE, device=device).save(f"{tmp_path}/disc.png")


@real
@pytest.mark.parametrize("estimator", [mcaa.Auto(), mcaa.Shared()], ids=repr)
def test_gradients_of_a_layer(device: str, estimator: mcaa.Estimator) -> None:
    found = []
    for place in ("cpu", device):
        radius = torch.tensor(20.0, dtype=torch.float64, device=place, requires_grad=True)
        layer = mcaa.Supersampler(SIZE, estimator=estimator).to(place, torch.float64)
        picture = layer(lambda x, y, r=radius: torch.where(torch.hypot(x - 40.3, y - 30.8) < r, 0.1 * r, torch.sin(0.1 * x)))
        picture.square().sum().backward()
        assert radius.grad is not None and picture.device.type == place
        found.append((picture.detach().cpu(), radius.grad.cpu()))
    torch.testing.assert_close(found[1][0], found[0][0], rtol=0, atol=1e-8)
    torch.testing.assert_close(found[1][1], found[0][1], rtol=1e-6, atol=0)


@real
@pytest.mark.parametrize("estimator", [mcaa.Auto(), mcaa.Shared()], ids=repr)
def test_same_gradients_again(device: str, estimator: mcaa.Estimator) -> None:
    found = []
    for _ in range(3):
        radius = torch.tensor(20.0, dtype=torch.float64, device=device, requires_grad=True)
        layer = mcaa.Supersampler((300, 400), estimator=estimator).to(device, torch.float64)
        layer(
            lambda x, y, r=radius: torch.where(torch.hypot(x - 40.3, y - 30.8) < r, 0.1 * r, torch.sin(0.1 * x))
        ).square().sum().backward()
        found.append(radius.grad)
    assert torch.equal(found[0], found[1]) and torch.equal(found[0], found[2])


@real
def test_layer_of_textures_and_warps(device: str) -> None:
    textures = torch.rand(2, 3, 40, 50, generator=torch.Generator().manual_seed(1))
    matrix = torch.tensor([[0.6, 0.1, 2.0], [0.0, 0.7, 1.0], [0.001, 0.0, 1.0]]).expand(2, 3, 3)
    for warp in (
        lambda t, m: mcaa.Supersampler((20, 25)).to(t.device)(t),
        lambda t, m: mcaa.warp_perspective(t, m, (30, 30)),
        lambda t, m: mcaa.warp_affine(t, m[:, :2], (30, 30)),
        lambda t, m: mcaa.resize(t, (13, 17)),
    ):
        grads, values = [], []
        for place in ("cpu", device):
            placed = textures.clone().to(place).requires_grad_()
            warped = warp(placed, matrix.to(place))
            warped.square().sum().backward()
            values.append(warped.detach().cpu())
            grads.append(placed.grad.cpu())
        torch.testing.assert_close(values[1], values[0], rtol=0, atol=1e-3)
        torch.testing.assert_close(grads[1], grads[0], rtol=0, atol=1e-2 * float(grads[0].abs().max()))


def test_audit_of_discontinuities(device: str) -> None:
    radius = torch.tensor(20.0, device=device, requires_grad=True)
    report = mcaa.check_discontinuities(lambda x, y: (torch.hypot(x - 40.3, y - 30.8) < radius).float(), SIZE, device=device)
    assert "test_devices.py" in str(report)


def test_a_texture_elsewhere_is_told(device: str) -> None:
    with pytest.raises(mcaa.McaaError, match="f raised|was asked on"):
        mcaa.render(mcaa.Texture(torch.rand(1, 8, 8)), SIZE, device=device)
