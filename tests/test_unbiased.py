"""Unbiased, and covered by their intervals: every estimator on every scene with a closed form.

A scene is laid out again and again on one screen, 16 x 16 pixels each, so that one rendering has hundreds of independent pictures of it: pixels draw
points of their own. Filters reach less than three pixels, and the three rows and columns at a tile's border are left out.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable

import pytest
import torch
from torch import Tensor

import torch_mcaa as mcaa
from torch_mcaa import scenes

TILE, MARGIN = 16, 3
FILTERS = [mcaa.Gaussian(0.5), mcaa.Box()]
ESTIMATORS = [
    mcaa.Importance(mcaa.Independent()),
    mcaa.Importance(mcaa.Jittered()),
    mcaa.Importance(mcaa.MultiJittered()),
    mcaa.Importance(mcaa.Sobol()),
    mcaa.Importance(mcaa.Lattice()),
    mcaa.Importance(density=mcaa.Mixture([mcaa.FilterDensity(mcaa.Gaussian(0.5)), mcaa.Normal(1.0)])),
    mcaa.Crude(),
    mcaa.Stratified((3, 2)),
    mcaa.Stratified((2, 1), weights="balance"),
    mcaa.Stratified((2, 1), density=mcaa.Normal(0.4), weights="paper"),
    mcaa.Stratified((2, 2), counts="optimal"),
    mcaa.AdaptiveImportance(),
    mcaa.AdaptiveImportance(density=mcaa.Mixture),
    mcaa.ControlVariate(),
    mcaa.OrderedStrata(),
    mcaa.Importance(allocation=mcaa.EqualVariance()),
    mcaa.Importance(allocation=mcaa.Neyman(), combine="discard_pilot"),
]


def closed_forms(filter: mcaa.Gaussian) -> dict[str, scenes.Scene]:
    found = {}
    for name, scene in scenes.gallery((TILE, TILE)).items():
        try:
            scene.exact(torch.zeros(1), torch.zeros(1), filter)
        except mcaa.McaaError:
            continue
        found[name] = scene
    return found


def tiled(chosen: list[scenes.Scene]) -> Callable[[Tensor, Tensor], tuple[Tensor, ...]]:
    """All the scenes at once, a channel or more each."""

    def f(x: Tensor, y: Tensor) -> tuple[Tensor, ...]:
        values = [scene(x.remainder(TILE), y.remainder(TILE)) for scene in chosen]
        return tuple(v.to(torch.float64) for value in values for v in (value if isinstance(value, tuple) else (value,)))

    return f


def truths(chosen: list[scenes.Scene], filter: mcaa.Gaussian) -> Tensor:
    centre = torch.arange(MARGIN, TILE - MARGIN, dtype=torch.float64) + 0.5
    exact = [scene.exact(centre[None], centre[:, None], filter) for scene in chosen]
    return torch.cat([e if e.dim() == 3 else e[None] for e in exact])


def pictures(plane: Tensor, tiles: int) -> Tensor:
    """(C, tiles 16, tiles 16) to (tiles^2, C, 10, 10)."""
    cut = plane.unflatten(2, (tiles, TILE)).unflatten(1, (tiles, TILE)).permute(1, 3, 0, 2, 4).flatten(0, 1)
    return cut[..., MARGIN:-MARGIN, MARGIN:-MARGIN]


def usable(chosen: mcaa.Importance, filter: mcaa.Gaussian) -> bool:
    if isinstance(filter, mcaa.Box):
        return "Normal" not in repr(chosen) and "Gaussian" not in repr(chosen)
    return not isinstance(chosen, mcaa.Crude)


CASES = [(chosen, filter) for chosen in ESTIMATORS for filter in FILTERS if usable(chosen, filter)]  # type: ignore[arg-type]


def rendered(chosen: mcaa.Importance, filter: mcaa.Gaussian, spp: int, tiles: int) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Errors and standard errors (tiles^2, C, 10, 10), the predicted variance and the range of f about each pixel (C, 10, 10)."""
    chosen_scenes = list(closed_forms(filter).values())
    f = tiled(chosen_scenes)
    with warnings.catch_warnings():
        # the highlights are hardly sampled at all; their +inf is right
        warnings.simplefilter("ignore", mcaa.McaaWarning)
        picture = mcaa.render(f, (TILE * tiles,) * 2, filter=filter, estimator=chosen, spp=spp, dtype=torch.float64, seed=20)
    assert picture.bias == () and picture.predicted_variance is not None
    places = (torch.arange(TILE * 8, dtype=torch.float64) + 0.5) / 8
    values = torch.stack(f(places[None].expand(TILE * 8, -1), places[:, None].expand(-1, TILE * 8)))
    reach = 8 * (2 * math.ceil(max(filter.radius)) + 1)
    pool = torch.nn.functional.max_pool2d
    high, low = (sign * pool(sign * values, reach, 8, reach // 2 - 4) for sign in (1, -1))
    span = (high - low)[:, MARGIN:-MARGIN, MARGIN:-MARGIN]
    errors = pictures(picture.image, tiles) - truths(chosen_scenes, filter)
    return errors, pictures(picture.stderr, tiles), pictures(picture.predicted_variance, tiles).mean(0), span


def sidak(tests: int, alpha: float = 1e-5) -> float:
    one = -math.expm1(math.log1p(-alpha) / tests)
    return math.sqrt(2) * float(torch.erfinv(torch.tensor(1 - one, dtype=torch.float64)))


@pytest.mark.parametrize(("chosen", "filter"), CASES, ids=repr)
def test_unbiased(chosen: mcaa.Importance, filter: mcaa.Gaussian) -> None:
    """|z| of the mean of 144 pictures at 32 evaluations, in every pixel below the quantile for alpha = 1e-5 over all of them (Sidak), and for the sum
    of each scene's picture below 4.42, which is 1e-5 for one.

    Pixels count where the variance of one evaluation is at least 0.4 % of the square of f's range about them, as for 0.004 <= phi <= 0.996: then
    4,608 evaluations met both sides 18 times or more. Student's t of 143 degrees widens the quantile by 9 %, that of the sum by 6 %.
    """
    tiles, spp = 12, 32
    errors, _, variance, span = rendered(chosen, filter, spp, tiles)
    spread = errors.std(0)
    told = (variance * spp >= 0.004 * span.square()) & (spread > 1e-9)
    assert int(told.sum()) > 300
    z = errors.mean(0) / (spread / tiles)
    assert float(z[told].abs().max()) < 1.09 * sidak(int(told.sum()))
    sums = torch.where(told, errors, 0).sum((2, 3))
    z = (sums.mean(0) / (sums.std(0) / tiles))[told.any(2).any(1)]
    assert float(z.abs().max()) < 1.06 * 4.42


@pytest.mark.parametrize(("chosen", "filter"), CASES, ids=repr)
def test_covered(chosen: mcaa.Importance, filter: mcaa.Gaussian) -> None:
    """At 64 evaluations the 95 % interval holds the true value of at least 0.93 of a scene's pixels with n phi (1 - phi) >= 5.

    For values that are not 0 or 1: with an n-fold variance of at least 5 squared ranges. 49 pictures of 10 x 10 pixels; the bound is on the mean
    over a scene's pixels, less three of its standard deviations as if the pixels of a picture were one where few count. Two-stage allocations are
    left out: each pixel has its own number there.
    """
    if "allocation" in repr(chosen):
        pytest.skip("each pixel has its own number of evaluations")
    tiles, spp = 7, 64
    errors, stderr, variance, span = rendered(chosen, filter, spp, tiles)
    told = (spp * (variance * spp) >= 5 * span.square()) & (errors.std(0) > 1e-9)
    covered = (errors.abs() <= 1.959964 * stderr).to(torch.float64)
    channel = 0
    for name, scene in closed_forms(filter).items():
        value = scene(torch.zeros(1), torch.zeros(1))
        for _ in range(len(value) if isinstance(value, tuple) else 1):
            here = told[channel]
            if here.any():
                each = covered[:, channel][:, here].mean(1)
                assert float(each.mean()) + 3 * float(each.std()) / tiles >= 0.93, name
            channel += 1
