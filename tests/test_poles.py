"""Where shared samples meet what grows without bound: +inf there, and nowhere else."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import pytest
import torch
from torch import Tensor

import torch_mcaa as mcaa
from torch_mcaa import scenes

Function = Callable[[Tensor, Tensor], Tensor]


def pole(power: float, x0: float = 8.23, y0: float = 8.31) -> Function:
    return lambda x, y: torch.hypot(x - x0, y - y0).clamp_min(1e-30) ** -power


def without(f: Function, size: int, seed: int, estimator: object, spp: int) -> tuple[int, mcaa.Rendering]:
    """How many pixels have no standard error; a warning says so if there are any."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        picture = mcaa.render(f, (size, size), estimator=estimator, spp=spp, seed=seed)  # type: ignore[arg-type]
    count = int(picture.stderr.isinf().any(0).sum())
    assert [f"in {count} pixels" in str(each.message) for each in caught] == [True] * (count > 0)
    return count, picture


@pytest.mark.parametrize("spp", [16, 64])
@pytest.mark.parametrize(
    "estimator",
    [mcaa.Auto(), mcaa.JumpCorrected(), mcaa.Shared(), mcaa.Shared(mcaa.Sobol()), mcaa.Shared(replicates=2)],
    ids=repr,
)
def test_no_second_moment(estimator: mcaa.Shared, spp: int) -> None:
    """r^-1.5 has k = 3/4: found in every one of 6 seeds, in all pixels whose filter reaches it and in none four pixels off."""
    for seed in range(6):
        count, picture = without(pole(1.5), 17, seed, estimator, spp)
        assert count > 0
        lost = picture.stderr[0].isinf()
        assert lost[8, 8] and bool(picture.image.isfinite().all())
        assert not lost[:4].any() and not lost[:, 13:].any()


def test_in_large_pictures_and_the_right_channel() -> None:
    heavy = pole(1.5, 100.3, 41.7)
    with pytest.warns(mcaa.McaaWarning, match="no second moment"):
        picture = mcaa.render(lambda x, y: (x, heavy(x, y)), (200, 300))
    assert picture.stderr[0].isfinite().all() and picture.stderr[1, 41, 100].isinf()
    assert int(picture.stderr.isinf().sum()) < 50


BOUNDED: dict[str, Function] = {
    "r^-0.5, which has a second moment": pole(0.5),
    "logarithm": lambda x, y: -torch.hypot(x - 8.23, y - 8.31).clamp_min(1e-30).log(),
    "edge of 10^6 : 1": lambda x, y: torch.where(x + 0.3 * y > 9, 1e6, 1.0).to(x),
    "dot of 10^6": lambda x, y: 1 + 1e6 * (torch.hypot(x - 7.3, y - 8.1) < 0.3).to(x),
    "thin bright line": lambda x, y: 1e6 * ((x + 0.3 * y - 9).abs() < 0.02).to(x) + torch.sin(x),
    "exponential": lambda x, y: torch.exp(x + y - 34),
    "narrow bump": scenes.Blob(8.2, 8.7, 0.05, 1000.0),
    "cone": lambda x, y: 1e4 * (1 - torch.hypot(x - 8.2, y - 8.7) / 0.15).clamp_min(0),
    "texels of a heavy tail": lambda x, y: (
        torch.frac((x * 0.7).floor() * 0.618 + (y * 0.7).floor() * 0.755).clamp_min(1e-3) ** -1.5
    ),
    "constant": lambda x, y: torch.full_like(x, 3),
    "zero": lambda x, y: torch.zeros_like(x),
}


@pytest.mark.parametrize("name", list(BOUNDED))
@pytest.mark.parametrize("spp", [16, 64])
@pytest.mark.parametrize("estimator", [mcaa.Auto(), mcaa.JumpCorrected(), mcaa.Shared()], ids=repr)
def test_no_false_alarms(estimator: mcaa.Shared, name: str, spp: int) -> None:
    for seed in range(4):
        assert without(BOUNDED[name], 17, seed, estimator, spp)[0] == 0


@pytest.mark.parametrize("estimator", [mcaa.Auto(), mcaa.JumpCorrected(), mcaa.Shared()], ids=repr)
def test_no_false_alarms_on_the_gallery(estimator: mcaa.Shared) -> None:
    for size in (16, 70):
        for scene in scenes.gallery((size, size)).values():
            assert without(scene, size, 3, estimator, 16)[0] == 0, scene  # type: ignore[arg-type]


@pytest.mark.parametrize("estimator", [mcaa.Auto(), mcaa.JumpCorrected(), mcaa.Shared()], ids=repr)
def test_equal_bits_with_a_pole(estimator: mcaa.Shared) -> None:
    threads, pictures = torch.get_num_threads(), []
    try:
        for count in (1, 3):
            torch.set_num_threads(count)
            pictures.append(without(pole(1.5, 90.2, 61.3), 130, 1, estimator, 16)[1])
    finally:
        torch.set_num_threads(threads)
    assert torch.equal(pictures[0].stderr, pictures[1].stderr) and pictures[0].evaluations == pictures[1].evaluations
