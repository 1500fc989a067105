"""`render` as a user types it: right things, wrong things, and everything that a `Rendering` promises."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import math
import random
import re
import sys
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from scipy.special import sici
from torch import Tensor

import torch_mcaa as mcaa
from torch_mcaa import progress as progress_module
from torch_mcaa.arguments import task_of
from torch_mcaa.errors import McaaError, McaaWarning
from torch_mcaa.estimators.parts import MODELS
from torch_mcaa.filters import Filter, SeparableFilter
from torch_mcaa.grid import Cell, Screen

SIZE = (9, 11)
FILTERS: list[Filter] = [
    mcaa.Box(),
    mcaa.Box(2.5),
    mcaa.Tent(),
    mcaa.Gaussian(0.5),
    mcaa.Gaussian(1.1),
    mcaa.Mitchell(),
    mcaa.CatmullRom(),
    mcaa.Lanczos(3),
    mcaa.BlackmanHarris(),
    mcaa.Tabulated([0.0, 1.0, 3.0, 1.0, 0.0]),
    mcaa.Tabulated([[0.0, 1.0, 0.0], [1.0, 4.0, 2.0], [0.0, 1.0, 0.0]], radius=1.5),
]
SIGNED = (mcaa.Mitchell, mcaa.Lanczos)
ADAPTIVE = [mcaa.Auto(), mcaa.JumpCorrected()]
"""Those whose values decide where others are asked for, in all channels at once."""
SHARED = [*ADAPTIVE, mcaa.Shared(), mcaa.Shared(mcaa.Sobol()), mcaa.Shared(replicates=2)]
ESTIMATORS = [*SHARED, mcaa.Shared(mcaa.Jittered()), mcaa.Importance(), mcaa.Importance(mcaa.MultiJittered())]


def constant(x: Tensor, y: Tensor) -> Tensor:
    return torch.full_like(x, 0.7)


def disc(x: Tensor, y: Tensor) -> Tensor:
    return torch.hypot(x - 5.2, y - 4.3) < 3.1


def wild(x: Tensor, y: Tensor) -> Tensor:
    return torch.sin(3 * x) + (x > 3) * y


# --- what comes back


@pytest.mark.parametrize("estimator", ESTIMATORS, ids=repr)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_shapes_and_dtypes(estimator: mcaa.Auto, dtype: torch.dtype) -> None:
    picture = mcaa.render(lambda x, y: (x, y, x > 4), SIZE, estimator=estimator, dtype=dtype)
    assert picture.image.shape == picture.stderr.shape == (3, *SIZE)
    assert picture.image.dtype == picture.stderr.dtype == dtype
    assert picture.spp.shape == picture.invalid.shape == picture.model.shape == SIZE
    assert picture.spp.dtype == picture.invalid.dtype == torch.int32
    assert picture.model.dtype == torch.uint8
    assert int(picture.model.max()) < len(picture.models)
    assert picture.models == (MODELS if estimator in ADAPTIVE else (repr(estimator),))
    assert picture.stopped == "spp"
    assert 0 < picture.seconds < 60
    assert picture.evaluations >= int(picture.spp.sum())
    assert all(tensor.device.type == "cpu" for tensor in (picture.image, picture.stderr, picture.spp))
    with pytest.raises(dataclasses.FrozenInstanceError):
        picture.stopped = "seconds"  # type: ignore[misc]


def test_defaults_are_those_documented() -> None:
    plain = mcaa.render(disc, SIZE)
    spelled = mcaa.render(
        disc,
        SIZE,
        filter=mcaa.Gaussian(0.5),
        estimator=mcaa.Auto(),
        spp=16,
        tolerance=None,
        seconds=None,
        extent=(0, 11, 0, 9),
        boundary="extend",
        nonfinite="raise",
        seed=0,
        dtype=torch.float32,
        device="cpu",
        compile=False,
        progress=False,
    )
    assert torch.equal(plain.image, spelled.image)
    assert torch.equal(plain.stderr, spelled.stderr)


# importance sampling has it where all its weights are 1: for w >= 0, and without a border to divide by; lines need a product of profiles
KEEPING_CONSTANTS = [
    (filter, estimator, boundary)
    for filter, estimator, boundary in itertools.product(FILTERS, ESTIMATORS, ("extend", "renormalize"))
    if (not isinstance(estimator, mcaa.Importance) or (boundary == "extend" and not isinstance(filter, SIGNED)))
    and (not isinstance(estimator, mcaa.JumpCorrected) or isinstance(filter, SeparableFilter))
]


@pytest.mark.parametrize(("filter", "estimator", "boundary"), KEEPING_CONSTANTS, ids=repr)
def test_constants_are_exact(filter: Filter, estimator: mcaa.Auto, boundary: str) -> None:
    """To 24 eps, the rounding of a few hundred terms."""
    few = max(4, estimator.fewest)
    for spp in (few, 16):
        picture = mcaa.render(constant, SIZE, filter=filter, estimator=estimator, boundary=boundary, spp=spp)  # type: ignore[arg-type]
        assert float((picture.image - 0.7).abs().max()) <= 24 * torch.finfo(torch.float32).eps
        assert bool((picture.stderr > 0).all())
    double = mcaa.render(
        lambda x, y: torch.full_like(x, 0.7, dtype=torch.float64),
        SIZE,
        filter=filter,
        estimator=estimator,
        boundary=boundary,  # type: ignore[arg-type]
        spp=few,
        dtype=torch.float64,
    )
    assert float((double.image - 0.7).abs().max()) <= 24 * torch.finfo(torch.float64).eps


def share_on_screen(filter: SeparableFilter, size: tuple[int, int]) -> Tensor:
    """(H, W) float64: the integral of w over the screen, by differences of the CDF."""

    def along(n: int) -> Tensor:
        centre = torch.arange(n, dtype=torch.float64) + 0.5
        return filter.profile_cdf(n - centre) - filter.profile_cdf(-centre)

    return along(size[0])[:, None] * along(size[1])


@pytest.mark.parametrize("filter", [w for w in FILTERS if isinstance(w, SeparableFilter)], ids=repr)
@pytest.mark.parametrize("estimator", [*SHARED, mcaa.Importance()], ids=repr)
def test_zero_boundary_against_the_closed_form(filter: SeparableFilter, estimator: mcaa.Auto) -> None:
    """The mean over 16 seeds of a constant's picture, within 5.5 standard errors of that mean in every pixel.

    A pixel whose points all fell on the screen 16 times has no spread: 1e-2 allows for the share that they missed. For a mean of 16, t
    of 15 degrees passes 5.5 with probability 6e-5; the seeds are fixed.
    """
    exact = 0.7 * share_on_screen(filter, SIZE)
    seeds = 16
    pictures = torch.stack(
        [mcaa.render(constant, SIZE, filter=filter, estimator=estimator, boundary="zero", seed=s).image[0] for s in range(seeds)]
    ).double()
    error = (pictures.mean(0) - exact).abs()
    spread = pictures.std(0) / math.sqrt(seeds)
    assert float((error / (5.5 * spread + 1e-2)).max()) < 1
    # the border is where it should be: a pixel at it has lost a share, one inside has not
    assert float((pictures.mean(0) - exact).abs().max()) < 0.15


@pytest.mark.parametrize("boundary", ["zero", "renormalize"])
@pytest.mark.parametrize("extent", [None, (3.0, -2.0, 1.0, 7.0)])
@pytest.mark.parametrize("estimator", ESTIMATORS, ids=repr)
def test_f_is_not_asked_beyond_a_closed_boundary(
    boundary: str, extent: tuple[float, float, float, float] | None, estimator: mcaa.Auto
) -> None:
    x0, x1, y0, y1 = extent or (0.0, 11.0, 0.0, 9.0)

    def f(x: Tensor, y: Tensor) -> Tensor:
        assert min(x0, x1) <= float(x.min()) <= float(x.max()) <= max(x0, x1)
        assert min(y0, y1) <= float(y.min()) <= float(y.max()) <= max(y0, y1)
        return x * y

    mcaa.render(f, SIZE, filter=mcaa.Gaussian(1.1), estimator=estimator, boundary=boundary, extent=extent)  # type: ignore[arg-type]


@pytest.mark.parametrize("estimator", [*ADAPTIVE, mcaa.Shared()], ids=repr)
def test_boundaries_agree_inside(estimator: mcaa.Auto) -> None:
    """Pixels whose filter does not reach the border do not know of it.

    But for how many evaluations were left for them: then they agree to half the standard error, which is mostly for what no sample met.
    """
    inside = (0, slice(3, -3), slice(3, -3))
    pictures = [
        mcaa.render(disc, (13, 15), filter=mcaa.Tent(2.0), estimator=estimator, boundary=b)  # type: ignore[arg-type]
        for b in ("extend", "zero", "renormalize")
    ]
    for other in pictures[1:]:
        allowed = pictures[0].stderr[inside] / 2 if estimator in ADAPTIVE else 1e-6
        assert bool(((pictures[0].image - other.image)[inside].abs() <= allowed).all())


def test_sinc_needs_a_closed_screen() -> None:
    for boundary in ("extend", "renormalize"):
        with pytest.raises(McaaError, match=r"Sinc\(\).*boundary='zero'.*Lanczos\(3\)"):
            mcaa.render(constant, SIZE, filter=mcaa.Sinc(), boundary=boundary)  # type: ignore[arg-type]
    with pytest.raises(McaaError, match="sinc"):
        mcaa.render(constant, SIZE, filter=mcaa.Sinc(), boundary="zero", estimator=mcaa.Importance())
    with pytest.raises(McaaError, match=r"Shared\(Lattice\(\)\)"):
        mcaa.render(constant, SIZE, filter=mcaa.Sinc(), boundary="zero", estimator=mcaa.Shared(mcaa.Sobol()))


def test_sinc_over_the_screen_against_the_sine_integral() -> None:
    """A constant's pixel: products of (Si(pi (n - c)) + Si(pi c)) / pi. In units of the standard error, rms over the pixels at most 2."""

    def along(n: int) -> np.ndarray:
        centre = np.arange(n) + 0.5
        return (sici(math.pi * (n - centre))[0] + sici(math.pi * centre)[0]) / math.pi

    height, width = 12, 17
    exact = torch.from_numpy(0.7 * along(height)[:, None] * along(width))
    picture = mcaa.render(constant, (height, width), filter=mcaa.Sinc(), boundary="zero", spp=64)
    error = picture.image[0].double() - exact
    assert float(((error / picture.stderr[0]) ** 2).mean()) < 4
    assert float(error.abs().max()) < 0.02
    assert float(error[2:-2, 2:-2].abs().max()) < 2e-3


# --- coordinates


@pytest.mark.parametrize("estimator", [*ADAPTIVE, mcaa.Shared(), mcaa.Shared(mcaa.Sobol()), mcaa.Importance()], ids=repr)
@pytest.mark.parametrize("scale", [0.25, -2.0])
def test_extent_is_a_change_of_coordinates(estimator: mcaa.Auto, scale: float) -> None:
    """Powers of two change no bit."""
    plain = mcaa.render(wild, SIZE, estimator=estimator)
    scaled = mcaa.render(lambda x, y: wild(x / scale, y / scale), SIZE, estimator=estimator, extent=(0, 11 * scale, 0, 9 * scale))
    assert torch.equal(plain.image, scaled.image)
    assert torch.equal(plain.stderr, scaled.stderr)


def test_extent_places_f() -> None:
    """A linear f is reproduced at the pixels' centres: y down, x right, backwards where the extent runs backwards."""
    extent = (3.0, -1.0, 10.0, 12.0)
    picture = mcaa.render(lambda x, y: (x, y), SIZE, extent=extent, spp=64)
    cx, cy = Screen.of(SIZE, extent).centres()
    assert float((picture.image[0] - cx).abs().max()) < 2e-2 * 4 / 11
    assert float((picture.image[1] - cy[:, None]).abs().max()) < 2e-2 * 2 / 9


@pytest.mark.parametrize("estimator", [*ADAPTIVE, mcaa.Shared(), mcaa.Shared(mcaa.Sobol()), mcaa.Importance()], ids=repr)
def test_a_texture_covers_the_screen_once(estimator: mcaa.Auto) -> None:
    """Four by four pixels to a texel, and a filter of a pixel: every pixel is its texel."""
    image = torch.rand(3, 3, 2, generator=torch.Generator().manual_seed(1))
    texture = mcaa.Texture(image, "nearest")
    picture = mcaa.render(texture, (12, 8), filter=mcaa.Box(), estimator=estimator)
    expected = image.repeat_interleave(4, 1).repeat_interleave(4, 2)
    assert float((picture.image - expected).abs().max()) < 1e-6
    # rendering bound the texture to no screen
    assert texture.size is None
    again = mcaa.render(texture, (6, 4), filter=mcaa.Box(), estimator=estimator)
    assert float((again.image - image.repeat_interleave(2, 1).repeat_interleave(2, 2)).abs().max()) < 1e-6


@pytest.mark.parametrize("estimator", ESTIMATORS, ids=repr)
def test_channels_are_independent_of_each_other(estimator: mcaa.Auto) -> None:
    """Bit for bit, but where values choose the points: there a channel alone is another picture of the same truth.

    6.1 is the quantile of 1e-5 for the 3960 values.
    """
    functions = [wild, disc, lambda x, y: x * y]
    together = mcaa.render(lambda x, y: tuple(f(x, y) for f in functions), (40, 33), estimator=estimator)
    for channel, f in enumerate(functions):
        alone = mcaa.render(f, (40, 33), estimator=estimator)
        if estimator in ADAPTIVE:
            apart = (together.image[channel] - alone.image[0]).abs()
            assert bool((apart < 6.1 * torch.hypot(together.stderr[channel], alone.stderr[0])).all())
        else:
            assert torch.equal(together.image[channel], alone.image[0])
            assert torch.equal(together.stderr[channel], alone.stderr[0])


@pytest.mark.parametrize("estimator", ESTIMATORS, ids=repr)
def test_seeds(estimator: mcaa.Auto) -> None:
    pictures = [mcaa.render(wild, SIZE, estimator=estimator, seed=seed).image for seed in (0, 1, 2**32, 2**64 - 1)]
    for one, other in itertools.combinations(pictures, 2):
        assert float((one != other).float().mean()) > 0.5
    assert torch.equal(pictures[3], mcaa.render(wild, SIZE, estimator=estimator, seed=2**64 - 1).image)


# --- the caps


@pytest.mark.parametrize("estimator", ESTIMATORS, ids=repr)
@pytest.mark.parametrize("tolerance", [None, 1e-9])
@pytest.mark.parametrize("size", [(1, 1), (1, 7), (7, 1), (5, 3)])
def test_spp_is_a_hard_cap(estimator: mcaa.Auto, tolerance: float | None, size: tuple[int, int]) -> None:
    least = estimator.fewest
    for spp in [n for n in (*range(1, 18), 64) if n >= least]:
        picture = mcaa.render(wild, size, estimator=estimator, spp=spp, tolerance=tolerance)
        mean = float(picture.spp.double().mean())
        assert mean <= spp
        # a pattern has not every number of points, a lattice leaves one for its audit
        assert mean >= min(spp, max(1, spp * 0.6 - 1))
        assert picture.stopped == "spp"
        assert bool((picture.stderr > 0).all())
        assert bool(picture.image.isfinite().all())


@pytest.mark.parametrize("height", range(1, 10))
@pytest.mark.parametrize("estimator", [mcaa.Auto(), mcaa.Shared()], ids=repr)
def test_spp_is_a_hard_cap_however_the_strips_fall(estimator: mcaa.Auto, height: int) -> None:
    """A lattice's points are not spread evenly over the rows of its strip: a picture of few rows can catch more than its share."""
    for seed, (spp, tolerance) in itertools.product(range(6), ((1, None), (2, None), (1, 1e-9), (5, 1e-9))):
        picture = mcaa.render(wild, (height, 2), estimator=estimator, spp=spp, tolerance=tolerance, seed=seed)
        assert float(picture.spp.double().mean()) <= spp


@pytest.mark.parametrize("estimator", [*ADAPTIVE, mcaa.Shared(), mcaa.Shared(mcaa.Sobol()), mcaa.Importance()], ids=repr)
def test_spp_is_a_hard_cap_over_many_cells(estimator: mcaa.Auto) -> None:
    for spp, tolerance in itertools.product((estimator.fewest, max(5, estimator.fewest), 9), (None, 1e-9)):
        picture = mcaa.render(wild, (33, 97), estimator=estimator, spp=spp, tolerance=tolerance)
        assert 0.6 * spp - 1 <= float(picture.spp.double().mean()) <= spp


@pytest.mark.parametrize("boundary", ["extend", "zero"])
@pytest.mark.parametrize("estimator", SHARED, ids=repr)
def test_spp_counts_the_points_in_each_pixel(estimator: mcaa.Auto, boundary: str) -> None:
    seen: list[Tensor] = []

    def f(x: Tensor, y: Tensor) -> Tensor:
        seen.append(torch.stack([x, y]))
        return x

    height, width = 23, 19
    picture = mcaa.render(f, (height, width), estimator=estimator, boundary=boundary, dtype=torch.float64)  # type: ignore[arg-type]
    x, y = torch.cat(seen, 1).unique(dim=1)
    on = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    if boundary == "zero":
        # what lies beyond the screen is asked at its first and last places, and counts for nothing
        on &= (x > 0) & (y > 0) & (x < width * (1 - 2.0**-49)) & (y < height * (1 - 2.0**-49))
    pixel = y[on].long() * width + x[on].long()
    counted = torch.bincount(pixel, minlength=height * width).reshape(height, width).int()
    if estimator in ADAPTIVE:
        # 64 places are asked twice, to see whether f is random
        assert bool((picture.spp >= counted).all()) and int((picture.spp - counted).sum()) <= 64
    else:
        assert torch.equal(picture.spp, counted)


@pytest.mark.parametrize("value", [0.0, 1e-40, 3.3, 10.0, -200.0, 255.0, 65504.0, 1e15])
@pytest.mark.parametrize("estimator", [mcaa.Auto(), mcaa.JumpCorrected(), mcaa.Shared()], ids=repr)
def test_constants_of_any_size(value: float, estimator: mcaa.Auto) -> None:
    """In sizes that have a pilot; alone, beside a channel that changes, and with a change that float32 rounds to steps or nothing."""
    for f in (
        lambda x, y: torch.full_like(x, value),
        lambda x, y: (torch.full_like(x, value), x),
        lambda x, y: value + 1e-7 * value * x,
    ):
        for size, spp in (((30, 40), 16), ((64, 64), 64), ((1, 500), 8)):
            picture = mcaa.render(f, size, estimator=estimator, spp=spp)
            # a sum of some 60 numbers that are known to 1.4e-45
            assert float((picture.image[0] - value).abs().max()) <= max(1e-4 * abs(value), 9e-44)
            assert bool(picture.stderr.isfinite().all())


def test_values_beyond_what_can_be_squared_are_said() -> None:
    with pytest.warns(McaaWarning, match=r"squares are beyond torch.float32.*float64"):
        picture = mcaa.render(lambda x, y: 1e30 * torch.sin(x), (16, 16))
    assert bool(picture.image.isfinite().all()) and bool(picture.stderr.isinf().all())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert bool(mcaa.render(lambda x, y: 1e30 * torch.sin(x), (16, 16), dtype=torch.float64).stderr.isfinite().all())


@pytest.mark.parametrize("value", [0.0, 0.7, -3e4])
@pytest.mark.parametrize("estimator", ESTIMATORS, ids=repr)
def test_standard_error_is_never_zero_by_ignorance(estimator: mcaa.Auto, value: float) -> None:
    least = estimator.fewest
    for spp, boundary in itertools.product((1, 2, 4, 16, 64), ("extend", "zero", "renormalize")):
        if spp < least:
            continue
        picture = mcaa.render(lambda x, y: torch.full_like(x, value), SIZE, estimator=estimator, spp=spp, boundary=boundary)  # type: ignore[arg-type]
        assert bool((picture.stderr > 0).all())
        assert bool(picture.image.isfinite().all())


NARROW = [mcaa.Box(), mcaa.Box(0.6), mcaa.Box(0.1), mcaa.Gaussian(0.1), mcaa.Gaussian(0.02), mcaa.Tent(0.2)]


@pytest.mark.parametrize("filter", NARROW, ids=repr)
@pytest.mark.parametrize("estimator", ESTIMATORS, ids=repr)
def test_a_filter_that_few_points_meet(filter: Filter, estimator: mcaa.Auto) -> None:
    """A pixel whose filter met no point has no value, which must not pass for one: NaN comes with +inf, or not at all."""
    least = estimator.fewest
    for spp in [n for n in (1, 2, 3, 4, 8, 33) if n >= least]:
        try:
            picture = mcaa.render(constant, SIZE, filter=filter, estimator=estimator, spp=spp)
        except McaaError as refusal:
            assert re.search("spp|filter", str(refusal))  # noqa: PT017 - refusing with the reason is as good
            continue
        empty = picture.image.isnan()
        assert bool((picture.stderr[empty] == torch.inf).all())
        assert bool((picture.stderr > 0).all())
        assert float((picture.image[~empty] - 0.7).abs().max() if not bool(empty.all()) else 0.0) < 1e-5


def test_the_default_leaves_no_pixel_empty() -> None:
    """A box of a pixel holds a point of every pattern that has one in each pixel; so must the default at one evaluation."""
    for spp, estimator in itertools.product((1, 2, 3), (mcaa.Auto(), mcaa.Shared(), mcaa.Shared(mcaa.Sobol()), mcaa.Importance())):
        for filter in (mcaa.Box(), mcaa.Tent(), mcaa.Gaussian(0.35)):
            picture = mcaa.render(constant, SIZE, filter=filter, estimator=estimator, spp=spp)
            assert bool(picture.image.isfinite().all())


# --- what ends the work


@pytest.mark.parametrize("estimator", [*ADAPTIVE, mcaa.Shared(), mcaa.Shared(mcaa.Sobol()), mcaa.Importance()], ids=repr)
def test_tolerance_ends_easy_scenes_early(estimator: mcaa.Auto) -> None:
    def ramp(x: Tensor, y: Tensor) -> Tensor:
        return 0.01 * x + 0.02 * y

    picture = mcaa.render(ramp, (40, 50), estimator=estimator, tolerance=5e-3, spp=512)
    assert picture.stopped == "tolerance"
    # what no sample met is no part of a tolerance
    assert float((picture.stderr.square() - picture.unseen.square()).clamp_min(0).sqrt().max()) <= 5e-3
    assert float(picture.spp.double().mean()) < 256


@pytest.mark.parametrize("estimator", [*ADAPTIVE, mcaa.Shared(), mcaa.Shared(mcaa.Sobol()), mcaa.Importance()], ids=repr)
def test_a_tolerance_out_of_reach_ends_at_the_cap(estimator: mcaa.Auto) -> None:
    picture = mcaa.render(wild, (20, 20), estimator=estimator, tolerance=1e-7, spp=24)
    assert picture.stopped == "spp"
    assert float(picture.stderr.max()) > 1e-7
    assert 18 <= float(picture.spp.double().mean()) <= 24


@pytest.mark.parametrize(("estimator", "times"), [(mcaa.Auto(), 1.2), (mcaa.Shared(), 2.0)], ids=repr)
def test_tolerance_spends_where_it_is_needed(estimator: mcaa.Auto, times: float) -> None:
    """An edge in the left half: its cells get more evaluations than those of the flat half, and meet the tolerance.

    A straight edge that is located needs few more.
    """

    def f(x: Tensor, y: Tensor) -> Tensor:
        return (x + 0.31 * y < 40).float()

    picture = mcaa.render(f, (64, 192), estimator=estimator, tolerance=2e-2, spp=64)
    assert picture.stopped == "tolerance"
    assert float(picture.stderr.max()) <= 2e-2
    assert float(picture.spp[:, :64].double().mean()) > times * float(picture.spp[:, 128:].double().mean())


def test_rounds_are_merged_by_their_numbers_of_evaluations() -> None:
    """Rounds of 4 and then of about as much again as there was, until the cap: weights n^1.5, whatever the values."""
    picture = mcaa.render(wild, SIZE, estimator=mcaa.Importance(), tolerance=1e-9, spp=64, seed=3, dtype=torch.float64)
    task = task_of(wild, Screen.of(SIZE), mcaa.Gaussian(0.5), "extend", "raise", 3, torch.float64, None)
    sizes = (4, 5, 13, 24, 18)
    rounds = [mcaa.Importance().round(task, n, k).estimate(Cell(0, 0, *SIZE)) for k, n in enumerate(sizes)]
    weights = [n**1.5 / sum(m**1.5 for m in sizes) for n in sizes]
    value = torch.stack([w * r.value for w, r in zip(weights, rounds)]).sum(0)
    variance = torch.stack([w**2 * r.variance for w, r in zip(weights, rounds)]).sum(0)
    torch.testing.assert_close(picture.image, value, rtol=1e-13, atol=1e-13)
    torch.testing.assert_close(picture.stderr**2, variance, rtol=1e-13, atol=0)
    assert bool((picture.spp == 64).all())


def test_relative_tolerance() -> None:
    def f(x: Tensor, y: Tensor) -> Tensor:
        return 1000 + 10 * torch.sin(x) * torch.cos(y)

    relative = mcaa.render(f, (20, 20), tolerance=mcaa.Tolerance(relative=1e-3), spp=256)
    assert relative.stopped == "tolerance"
    assert bool((relative.stderr <= 1e-3 * relative.image.abs() * (1 + 1e-6)).all())
    either = mcaa.render(f, (20, 20), tolerance=mcaa.Tolerance(absolute=1.0, relative=1e-9), spp=256)
    assert torch.equal(either.image, mcaa.render(f, (20, 20), tolerance=1.0, spp=256).image)


def test_seconds_ends_near_the_time_and_says_what_is_missing() -> None:
    """16 cells and an f that sleeps: no more than one cell is begun after the time."""
    calls: list[float] = []

    def f(x: Tensor, y: Tensor) -> Tensor:
        calls.append(time.perf_counter())
        time.sleep(0.02)
        return x

    mcaa.render(f, (32, 32), seconds=100.0, spp=4, estimator=mcaa.Importance())
    in_a_cell = len(calls)
    calls.clear()
    start = time.perf_counter()
    with pytest.warns(McaaWarning, match="of 16384 pixels had a sample"):
        picture = mcaa.render(f, (128, 128), seconds=0.15, spp=64, estimator=mcaa.Importance())
    assert picture.stopped == "seconds"
    assert sum(call > start + 0.15 for call in calls) <= in_a_cell
    assert picture.seconds >= 0.15
    empty = picture.image.isnan()
    assert bool(empty.any())
    assert not bool(empty.all())
    assert bool((picture.stderr[empty] == torch.inf).all())
    assert bool(picture.stderr[~empty].isfinite().all())
    assert torch.equal(picture.spp == 0, empty[0])


def test_no_time_for_a_single_cell() -> None:
    with pytest.warns(McaaWarning, match="the time was up"):
        picture = mcaa.render(lambda x, y: (x, y), SIZE, seconds=1e-9)
    assert picture.stopped == "seconds"
    assert bool(picture.image.isnan().all())
    assert bool((picture.stderr == torch.inf).all())
    assert int(picture.spp.sum()) == 0
    assert picture.evaluations == 0


@pytest.mark.parametrize("estimator", [mcaa.Auto(), mcaa.JumpCorrected()], ids=repr)
@pytest.mark.parametrize("options", [{"spp": 16}, {"spp": 4096}, {"spp": 256, "tolerance": 1e-6}], ids=repr)
def test_every_pixel_has_a_value_before_any_takes_long(estimator: mcaa.Estimator, options: dict[str, Any]) -> None:
    """What comes after the first look, of a tenth of a second, takes 0.3 s a call."""
    calls = 0

    def f(x: Tensor, y: Tensor) -> Tensor:
        nonlocal calls
        calls += len(x)
        if calls > 1.5 * 5 * 256 * 256:
            time.sleep(0.3)
        return (torch.hypot(x - 128, y - 128) < 90).to(x)

    picture = mcaa.render(f, (256, 256), estimator=estimator, seconds=2.0, **options)
    assert picture.stopped == "seconds" and picture.image.isfinite().all() and (picture.spp > 0).all()
    # the area of a disc by its pixels
    assert abs(float(picture.image.mean()) - math.pi * 90**2 / 256**2) < 2e-3


@pytest.mark.parametrize("seconds", [1e6, math.inf])
def test_time_to_spare(seconds: float) -> None:
    picture = mcaa.render(wild, SIZE, seconds=seconds, spp=20)
    assert picture.stopped == "spp"
    assert 18 <= float(picture.spp.double().mean()) <= 20


@pytest.mark.parametrize("k", [0, 1, 5])
def test_ctrl_c_returns_what_is_done(k: int) -> None:
    calls: list[int] = []

    def f(x: Tensor, y: Tensor) -> Tensor:
        if len(calls) == k:
            raise KeyboardInterrupt
        calls.append(1)
        return x

    with pytest.warns(McaaWarning, match="interrupted") as caught:
        picture = mcaa.render(f, (70, 140), estimator=mcaa.Importance(), spp=4)
    assert caught[0].filename == __file__
    assert picture.stopped == "interrupted"
    empty = picture.image.isnan()
    assert bool((picture.stderr[empty] == torch.inf).all())
    assert bool((picture.stderr[~empty] < torch.inf).all())
    assert bool(empty.all()) == (k == 0)
    # 6 cells of one call each
    assert bool(empty.any())


def test_ctrl_c_in_a_later_round_keeps_the_rounds_before() -> None:
    calls: list[int] = []

    def f(x: Tensor, y: Tensor) -> Tensor:
        calls.append(1)
        if len(calls) > 2:
            raise KeyboardInterrupt
        return wild(x, y)

    with pytest.warns(McaaWarning, match="interrupted"):
        picture = mcaa.render(f, SIZE, estimator=mcaa.Importance(), spp=64, tolerance=1e-9)
    assert picture.stopped == "interrupted"
    assert bool(picture.image.isfinite().all())
    assert 0 < float(picture.spp.double().mean()) < 64


# --- progress


@pytest.mark.parametrize(
    "options",
    [{}, {"tolerance": 1e-7, "spp": 40}, {"tolerance": 0.2}, {"seconds": 1e4, "spp": 20}],
    ids=["one round", "to the cap", "to the tolerance", "in time"],
)
@pytest.mark.parametrize("estimator", [mcaa.Auto(), mcaa.JumpCorrected(), mcaa.Shared(), mcaa.Importance()], ids=repr)
def test_progress_rises_to_one(options: dict[str, Any], estimator: mcaa.Auto) -> None:
    told: list[float] = []
    mcaa.render(wild, (100, 80), estimator=estimator, progress=told.append, **options)
    assert told == sorted(told)
    assert all(0 < fraction <= 1 for fraction in told)
    assert told[-1] == 1.0
    if not options:
        assert len(set(told)) == len(told)


def test_progress_may_raise() -> None:
    class Enough(Exception):
        pass

    def stop(fraction: float) -> None:
        raise Enough

    with pytest.raises(Enough):
        mcaa.render(constant, SIZE, progress=stop)


@pytest.mark.parametrize("progress", [None, True, False])
@pytest.mark.parametrize("terminal", [True, False])
@pytest.mark.parametrize("patience", [-1.0, 1e6])
def test_progress_bar(
    progress: bool | None, terminal: bool, patience: float, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """On a terminal, once the work takes long; never on the standard output, and a pipe gets no drawings."""
    monkeypatch.setattr(progress_module, "_PATIENCE", patience)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: terminal, raising=False)
    monkeypatch.setenv("TERM", "xterm")
    mcaa.render(constant, (80, 80), progress=progress)
    out, err = capsys.readouterr()
    assert out == ""
    assert ("rendering" in err) == (terminal and progress is not False and patience < 0)
    assert terminal or not err.strip()
    assert terminal or progress or err == ""


# --- the methods of a Rendering


def test_interval() -> None:
    picture = mcaa.render(wild, SIZE)
    for level, z in ((0.95, 1.959963984540054), (0.6826894921370859, 1.0), (0.999, 3.290526731491895)):
        low, high = picture.interval(level)
        torch.testing.assert_close(low, picture.image - z * picture.stderr)
        torch.testing.assert_close(high, picture.image + z * picture.stderr)
    assert torch.equal(picture.interval()[0], picture.interval(0.95)[0])
    for level in (0, 1, -0.5, 1.5, 95, math.nan, "0.95", None):
        with pytest.raises(McaaError, match="level must lie between 0 and 1"):
            picture.interval(level)


def test_numpy() -> None:
    picture = mcaa.render(lambda x, y: (x, y, x), SIZE)
    array = picture.numpy()
    assert array.shape == (*SIZE, 3)
    assert array.dtype == np.float32
    assert np.array_equal(array[..., 1], picture.image[1].numpy())


def test_npz_round_trip(tmp_path: Path) -> None:
    picture = mcaa.render(lambda x, y: (x, y), SIZE, dtype=torch.float64)
    picture.save(tmp_path / "picture.npz")
    with np.load(tmp_path / "picture.npz") as saved:
        assert set(saved) == {"image", "stderr", "spp", "invalid", "model"}
        assert np.array_equal(saved["image"], picture.numpy())
        assert np.array_equal(saved["stderr"], picture.stderr.permute(1, 2, 0).numpy())
        for name in ("spp", "invalid", "model"):
            assert np.array_equal(saved[name], getattr(picture, name).numpy())
            assert saved[name].dtype == getattr(picture, name).numpy().dtype


def test_save_writes_over_unless_told_not_to(tmp_path: Path) -> None:
    one, other = mcaa.render(constant, SIZE), mcaa.render(disc, SIZE)
    path = tmp_path / "picture.png"
    one.save(path)
    other.save(path)
    kept = path.read_bytes()
    with pytest.raises(McaaError, match="exists"):
        one.save(path, force=False)
    assert path.read_bytes() == kept
    with pytest.raises(McaaError, match="unknown extension"):
        one.save(tmp_path / "picture.jpg")
    with pytest.raises(McaaError, match="No such file"):
        one.save(tmp_path / "nowhere" / "picture.png")
    assert [file.name for file in tmp_path.iterdir()] == ["picture.png"]


@pytest.mark.parametrize("channels", [1, 3, 4])
def test_picture_in_a_notebook(channels: int, tmp_path: Path) -> None:
    picture = mcaa.render(lambda x, y: (x / 11,) * channels, SIZE)
    png = picture._repr_png_()
    assert png is not None
    (tmp_path / "cell.png").write_bytes(png)
    with Image.open(tmp_path / "cell.png") as shown:
        assert shown.size == (11, 9)
        assert len(shown.getbands()) == channels
    assert mcaa.render(lambda x, y: (x, y), SIZE)._repr_png_() is None


# --- nothing else changes


def test_no_global_state() -> None:
    def state() -> tuple[Any, ...]:
        kind, keys, *rest = np.random.get_state()  # noqa: NPY002 - that it stays as it is
        return (
            torch.get_rng_state().tolist(),
            (kind, keys.tolist(), *rest),
            random.getstate(),
            torch.get_default_dtype(),
            torch.get_default_device(),
            torch.get_num_threads(),
            torch.get_num_interop_threads(),
            torch.is_grad_enabled(),
            torch.are_deterministic_algorithms_enabled(),
            torch.get_float32_matmul_precision(),
            list(warnings.filters),
        )

    before = state()
    for estimator in ESTIMATORS:
        mcaa.render(wild, SIZE, estimator=estimator)
    mcaa.render(wild, SIZE, tolerance=1e-3)
    with pytest.raises(McaaError):
        mcaa.render(lambda x, y: None, SIZE)
    assert state() == before


@pytest.mark.parametrize("estimator", ESTIMATORS, ids=repr)
def test_a_user_s_default_dtype_changes_no_bit(estimator: mcaa.Auto) -> None:
    plain = mcaa.render(wild, SIZE, estimator=estimator)
    before = torch.get_default_dtype()
    torch.set_default_dtype(torch.float64)
    try:
        other = mcaa.render(wild, SIZE, estimator=estimator)
    finally:
        torch.set_default_dtype(before)
    assert torch.equal(plain.image, other.image)
    assert torch.equal(plain.stderr, other.stderr)


@pytest.mark.parametrize("estimator", ESTIMATORS, ids=repr)
def test_parameters_of_f_leak_no_graph(estimator: mcaa.Auto) -> None:
    weight = torch.tensor([0.3, 0.2], requires_grad=True)

    def f(x: Tensor, y: Tensor) -> Tensor:
        return x * weight[0] + y * weight[1]

    for options in ({}, {"tolerance": 1e-6}):
        picture = mcaa.render(f, SIZE, estimator=estimator, **options)  # type: ignore[arg-type]
        assert not picture.image.requires_grad
        assert not picture.stderr.requires_grad
        assert picture.image.grad_fn is None
    assert weight.grad is None


@pytest.mark.parametrize("estimator", ESTIMATORS, ids=repr)
def test_f_may_differentiate(estimator: mcaa.Auto) -> None:
    """A slope by autograd inside f, as for the normals of a distance field."""

    def slope(x: Tensor, y: Tensor) -> Tensor:
        with torch.enable_grad():
            x = x.requires_grad_()
            (gradient,) = torch.autograd.grad((x * x * y).sum(), x)
        return gradient

    picture = mcaa.render(slope, SIZE, estimator=estimator)
    assert torch.equal(picture.image, mcaa.render(lambda x, y: 2 * x * y, SIZE, estimator=estimator).image)
    assert not picture.image.requires_grad


def test_inside_inference_mode_and_with_a_module() -> None:
    network = torch.nn.Sequential(torch.nn.Linear(2, 4), torch.nn.Tanh(), torch.nn.Linear(4, 3))
    f = mcaa.from_points(network)
    plain = mcaa.render(f, SIZE)
    assert plain.image.shape == (3, *SIZE)
    with torch.inference_mode():
        assert torch.equal(mcaa.render(f, SIZE, tolerance=None).image, plain.image)


# --- wrong things

BAD: list[tuple[dict[str, Any], str]] = [
    ({"size": (0, 5)}, "at least one pixel.*height 0"),
    ({"size": (5, -1)}, "at least one pixel.*width -1"),
    ({"size": (2.5, 3)}, r"two integers.*\(2\.5, 3\)"),
    ({"size": 5}, "two integers.*got 5"),
    ({"size": "512x512"}, "two integers.*'512x512'"),
    ({"spp": 0}, "spp must be an integer of at least 1, got 0"),
    ({"spp": -1}, "spp .*got -1"),
    ({"spp": 2.5}, r"spp .*got 2\.5"),
    ({"spp": True}, "spp .*got True"),
    ({"spp": "16"}, "spp .*got '16'"),
    ({"tolerance": 0}, "tolerance must be above 0, got 0"),
    ({"tolerance": -1e-3}, r"tolerance .*got -0\.001"),
    ({"tolerance": math.nan}, "tolerance .*got nan"),
    ({"tolerance": math.inf}, "tolerance .*got inf"),
    ({"tolerance": "1e-3"}, "tolerance .*got '1e-3'"),
    ({"tolerance": True}, "tolerance .*got True"),
    ({"seconds": 0}, "seconds must be above 0, got 0"),
    ({"seconds": -1.0}, r"seconds .*got -1\.0"),
    ({"seconds": math.nan}, "seconds .*got nan"),
    ({"seconds": "2"}, "seconds .*got '2'"),
    ({"extent": (0, 1, 2)}, r"four numbers.*\(0, 1, 2\)"),
    ({"extent": (0, 0, 1, 2)}, "x0 != x1"),
    ({"extent": (0, math.inf, 1, 2)}, "finite"),
    ({"boundary": "wrap"}, "'extend', 'zero' or 'renormalize', got 'wrap'"),
    ({"boundary": None}, "boundary .*got None"),
    ({"nonfinite": "warn"}, "'raise', 'ignore' or 'propagate', got 'warn'"),
    ({"seed": -1}, "seed .*got -1"),
    ({"seed": 2**64}, "seed .*got 18446744073709551616"),
    ({"seed": 1.5}, r"seed .*got 1\.5"),
    ({"seed": True}, "seed .*got True"),
    ({"seed": None}, "seed .*got None"),
    ({"dtype": int}, "dtype .*float32 or torch.float64, got <class 'int'>"),
    ({"dtype": torch.int32}, "dtype .*got torch.int32"),
    ({"dtype": torch.float16}, "dtype .*got torch.float16"),
    ({"dtype": torch.bfloat16}, "dtype .*got torch.bfloat16"),
    ({"dtype": "float32"}, "dtype .*got float32"),
    ({"device": "nonsense"}, "device 'nonsense' cannot be used"),
    ({"device": "meta"}, "device 'meta' cannot be used"),
    ({"device": 1.5}, r"device 1\.5 cannot be used"),
    ({"filter": "box"}, r"filter such as .*Box\(\), got 'box'"),
    ({"filter": mcaa.Box}, "filter such as"),
    ({"estimator": "auto"}, r"estimator such as Auto\(\).*got 'auto'"),
    ({"estimator": mcaa.Auto}, "estimator such as"),
    ({"compile": "on"}, "compile must be 'auto', True or False, got 'on'"),
    ({"progress": "yes"}, "progress must be .*got 'yes'"),
    ({"f": None}, "f must be a function of two tensors x, y, got NoneType"),
    ({"f": 0.5}, "f must be a function .*got float"),
    ({"f": torch.zeros(3, 4, 4)}, r"got Tensor; wrap an image in Texture\(image\)"),
    ({"f": np.zeros((4, 4, 3))}, r"got ndarray; wrap an image in Texture\(image\)"),
    ({"f": mcaa.Texture}, "f "),
]


@pytest.mark.parametrize(("wrong", "said"), BAD, ids=[f"{next(iter(w))}={str(next(iter(w.values())))[:20]}" for w, _ in BAD])
def test_bad_arguments(wrong: dict[str, Any], said: str) -> None:
    arguments: dict[str, Any] = {"f": constant, "size": SIZE, **wrong}
    with pytest.raises(McaaError, match=said) as caught:
        mcaa.render(arguments.pop("f"), arguments.pop("size"), **arguments)
    assert "\n" not in str(caught.value)


@pytest.mark.skipif(torch.cuda.is_available(), reason="a CUDA device is there")
def test_a_device_that_is_not_there() -> None:
    with pytest.raises(McaaError, match="device 'cuda' cannot be used: .*pass device='cpu'"):
        mcaa.render(constant, SIZE, device="cuda")


@pytest.mark.parametrize("wrong", [{"absolute": -1.0}, {"relative": -1.0}, {"relative": math.nan}, {"absolute": 0.0}, {}], ids=repr)
def test_bad_tolerances(wrong: dict[str, float]) -> None:
    with pytest.raises(McaaError, match="tolerance"):
        mcaa.Tolerance(**wrong)


@pytest.mark.parametrize("replicates", [2, 3, 5])
@pytest.mark.parametrize("spp", [3, 5, 7, 16])
@pytest.mark.parametrize("options", [{}, {"tolerance": 1e-9}, {"seconds": 1e4}], ids=repr)
def test_replicates_work_or_are_refused_before_the_work(replicates: int, spp: int, options: dict[str, Any]) -> None:
    """R replicates need R evaluations a pixel in all, whatever the rounds make of them."""
    calls: list[int] = []

    def f(x: Tensor, y: Tensor) -> Tensor:
        calls.append(1)
        return wild(x, y)

    estimator = mcaa.Shared(replicates=replicates)
    if spp < replicates:
        with pytest.raises(McaaError, match=f"replicates={replicates}\\) needs at least {replicates} evaluations"):
            mcaa.render(f, SIZE, estimator=estimator, spp=spp, **options)
        assert not calls
    else:
        picture = mcaa.render(f, SIZE, estimator=estimator, spp=spp, **options)
        assert picture.stopped == "spp"
        assert float(picture.spp.double().mean()) <= spp


def test_what_an_object_with_other_methods_means() -> None:
    """Only a texture is bound to the screen: an f of the user's may have an attribute of any name."""

    class Lamp:
        on = True

        def __call__(self, x: Tensor, y: Tensor) -> Tensor:
            return x

    assert mcaa.render(Lamp(), SIZE).image.shape == (1, *SIZE)


def test_a_picture_that_does_not_fit_is_refused() -> None:
    with pytest.raises(McaaError, match="300000 x 300000 pixels in 1 channel does not fit"):
        mcaa.render(constant, (300_000, 300_000))
    with pytest.raises(McaaError, match="does not fit into memory"):
        mcaa.render(constant, (10**9, 10**9))


def test_numbers_of_numpy_are_numbers() -> None:
    picture = mcaa.render(constant, SIZE, spp=np.int64(16), tolerance=np.float32(0.5), seconds=np.float64(100))  # type: ignore[arg-type]
    assert picture.stopped == "tolerance"


@pytest.mark.parametrize(("estimator", "width"), [(mcaa.Auto(), 0.3), (mcaa.Shared(), 0.8)], ids=["auto", "shared"])
def test_a_round_without_a_point_does_not_spoil_the_next(estimator: mcaa.Auto, width: float) -> None:
    """f is finite on a tenth of the plane: in some pixels none of the first points meets it, and one of the later ones in all."""

    def f(x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        return torch.where(((7.3 * x) % 1 < 0.3) & ((5.1 * y) % 1 < 0.3), 0.7, torch.nan)

    arguments = {"filter": mcaa.Box(width), "estimator": estimator, "nonfinite": "ignore"}
    once = mcaa.render(f, SIZE, spp=4, **arguments).image.isnan()  # type: ignore[arg-type]
    picture = mcaa.render(f, SIZE, spp=256, tolerance=1e-9, **arguments)  # type: ignore[arg-type]
    assert bool(once.any())
    assert bool(picture.image.isfinite().all())
    assert bool(picture.stderr.isfinite().all())
    assert float((picture.image - 0.7).abs().max()) < 1e-5


def test_time_that_does_not_last_is_said() -> None:
    """Of an f that takes long a call not even a first look comes to an end, and what has no value is counted in a warning."""

    def slow(x: Tensor, y: Tensor) -> Tensor:
        time.sleep(0.01)
        return (torch.hypot(x - 8, y - 8) < 5).to(x.dtype)

    with pytest.warns(mcaa.McaaWarning, match="the time was up before") as met:
        picture = mcaa.render(slow, (512, 512), seconds=0.05)
    empty = int(picture.image.isnan().sum())
    assert picture.stopped == "seconds" and 0 < empty < 512 * 512
    assert f"before {empty} of 262144 pixels" in str(met[0].message)
    # without the clock a cell takes 263 calls
    assert picture.seconds < 1.5


def test_a_cell_of_jumps_ends_with_the_clock() -> None:
    """Each call takes 50 ms: the whole takes 56."""
    calls = 0

    def slow(x: Tensor, y: Tensor) -> Tensor:
        nonlocal calls
        calls += 1
        time.sleep(0.05)
        return (torch.hypot(x - 40, y - 40) < 30).to(x.dtype)

    picture = mcaa.render(slow, (80, 80), seconds=1.0)
    assert picture.stopped == "seconds" and calls < 45 and bool(picture.image.isfinite().all())


@pytest.mark.parametrize("scale", [1e-30, 1e-22, 1e20, 1e30])
def test_values_whose_squares_float32_does_not_hold(scale: float) -> None:
    """The standard error is then too large, never 0 or NaN; where it is +inf, that is said."""
    with pytest.warns(McaaWarning, match="squares are beyond") if scale == 1e30 else contextlib.nullcontext():
        picture = mcaa.render(lambda x, y: scale * (torch.hypot(x - 8, y - 8) < 5), (32, 32))
    assert bool((picture.stderr > 0).all())
    assert float((picture.image / scale).sum()) == pytest.approx(25 * math.pi, rel=1e-3)


def test_pictures_are_equal_if_they_are_one() -> None:
    picture = mcaa.render(lambda x, y: x, (4, 4))
    assert picture == picture and picture != mcaa.render(lambda x, y: x, (4, 4))
    with pytest.raises(mcaa.McaaError, match="written to a path, got None"):
        picture.save(None)  # type: ignore[arg-type]


@pytest.mark.parametrize("filter", [mcaa.Gaussian(0.5), mcaa.Gaussian(2.0), mcaa.Lanczos(3)], ids=repr)
@pytest.mark.parametrize("estimator", [mcaa.Shared(), mcaa.Auto()], ids=repr)
def test_what_a_closed_screen_cuts_off_is_known(filter: SeparableFilter, estimator: mcaa.Auto) -> None:
    """boundary="zero": a constant comes out as the integral of w over the screen, exactly."""
    centre = torch.arange(24, dtype=torch.float64) + 0.5
    share = filter.profile_cdf(24 - centre) - filter.profile_cdf(-centre)
    arguments = {"filter": filter, "estimator": estimator, "boundary": "zero"}
    for spp in (16, 64):
        found = mcaa.render(lambda x, y: torch.full_like(x, 0.7), (24, 24), spp=spp, dtype=torch.float64, **arguments)  # type: ignore[arg-type]
        assert float((found.image[0] - 0.7 * share * share[:, None]).abs().max()) < 1e-12
        assert float(found.stderr.max()) < 1e-3
