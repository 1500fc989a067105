"""What f may return, how few evaluations there may be, and how small a screen, for every estimator."""

from __future__ import annotations

import math

import pytest
import torch
from every_estimator import ADAPTIVE, ALL, BY_DENSITY, CHANCE, ENOUGH, PAIRS, PER_PIXEL, rms
from torch import Tensor

import torch_mcaa as mcaa
from torch_mcaa.errors import McaaError
from torch_mcaa.integrand import Function


def hole(value: float) -> Function:
    """0.7, but for a spot of 0.4 x 0.4 px in pixel (4, 4), where f is not finite."""
    return lambda x, y: torch.where((x > 4.3) & (x < 4.7) & (y > 4.3) & (y < 4.7), value, 0.7 * torch.ones_like(x))


BAD = [math.nan, math.inf, -math.inf]


@pytest.mark.parametrize("bad", BAD)
@pytest.mark.parametrize("chosen", ALL, ids=repr)
def test_15_nan_and_inf_are_refused_with_their_place(chosen: mcaa.Importance, bad: float) -> None:
    """Naive: NaN pixels wherever a filter met the spot, and no word of why."""
    with pytest.raises(McaaError, match=rf"f returned {bad} at x = 4\.[3-7]\d*, y = 4\.[3-7]\d* .*nonfinite='ignore'"):
        mcaa.render(hole(bad), (12, 12), estimator=chosen, spp=ENOUGH)


@pytest.mark.parametrize("bad", BAD)
@pytest.mark.parametrize("chosen", ALL, ids=repr)
def test_15_nan_and_inf_are_left_out(chosen: mcaa.Importance, bad: float) -> None:
    """nonfinite="ignore": 0.7 everywhere, within what the weights vary, the samples counted, and `bias` says so.

    Naive: counted as 0, up to 0.12 too dark about the spot, which has 12 % of its pixel's filter; or NaN. Where weights are all of one
    modulus 0.7 comes out exactly (to 100 roundings); else the standard error must cover it, at 1e-5 for each of 144 pixels, 5.4, and the
    t of 16 terms: 8.
    """
    picture = mcaa.render(hole(bad), (12, 12), estimator=chosen, spp=ENOUGH, nonfinite="ignore")
    assert int(picture.invalid.sum()) > 0
    assert bool(picture.image.isfinite().all()) and bool(picture.stderr.isfinite().all())
    assert float(picture.stderr.min()) > 0
    assert any("not finite" in line for line in picture.bias)
    error = (picture.image - 0.7).abs()
    if chosen in BY_DENSITY or chosen is PAIRS or isinstance(chosen, mcaa.AdaptiveImportance):
        assert float((error / picture.stderr).max()) < 8
    else:
        assert float(error.max()) < 100 * torch.finfo(torch.float32).eps


@pytest.mark.parametrize("bad", [math.nan, math.inf])
@pytest.mark.parametrize("chosen", ALL, ids=repr)
def test_15_nan_and_inf_propagate_no_further_than_the_filter(chosen: mcaa.Importance, bad: float) -> None:
    """nonfinite="propagate": NaN with +inf beside it where a sample was bad, and nothing beyond the filter's 2.5 px.

    Naive: through sums over the picture, or over neighbours' variances, NaN spreads.
    """
    picture = mcaa.render(hole(bad), (12, 12), estimator=chosen, spp=ENOUGH, nonfinite="propagate", seed=1)
    lost = picture.image[0].isnan()
    assert bool(lost[4, 4]) and not bool(picture.image.isinf().any())
    far = torch.ones_like(lost)
    far[2:7, 2:7] = False
    if isinstance(chosen, (mcaa.Auto, mcaa.JumpCorrected, mcaa.Shared)):
        far[1:8, 1:8] = False
    assert not bool(lost[far].any())
    assert bool((picture.stderr[0].isinf() == lost).all()) and not bool(picture.stderr.isnan().any())


def test_15_a_function_that_is_nowhere_finite() -> None:
    """Every estimator, "ignore": no value at all, so NaN with +inf, never a 0 that looks like black. Naive: 0 / 0, or 0."""
    for chosen in ALL:
        picture = mcaa.render(lambda x, y: torch.full_like(x, math.nan), (3, 3), estimator=chosen, spp=ENOUGH, nonfinite="ignore")
        assert bool(picture.image.isnan().all()), chosen
        assert bool((picture.stderr == math.inf).all()), chosen


def disc(x: Tensor, y: Tensor) -> Tensor:
    return (torch.hypot(x - 2.2, y - 2.4) < 1.5).to(x.dtype)


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (9, 1), (2, 1)])
@pytest.mark.parametrize("chosen", ALL, ids=repr)
def test_one_pixel_wide_screens(chosen: mcaa.Importance, size: tuple[int, int]) -> None:
    """No neighbours to pool with: finite values in [0, 1] but for the weights, and a finite positive standard error."""
    picture = mcaa.render(disc, size, estimator=chosen, spp=ENOUGH)
    assert tuple(picture.image.shape) == (1, *size)
    assert bool(picture.image.isfinite().all())
    assert bool(picture.stderr.isfinite().all()) and float(picture.stderr.min()) > 0
    assert float(picture.image.min()) > -0.5 and float(picture.image.max()) < 1.5


@pytest.mark.parametrize("chosen", ALL, ids=repr)
def test_f_may_return_any_real_dtype(chosen: mcaa.Importance) -> None:
    """0 and 1 are exact in each of them: the same picture, bit for bit."""
    first = mcaa.render(disc, (5, 5), estimator=chosen, spp=ENOUGH)
    for dtype in (torch.float16, torch.bfloat16, torch.float64, torch.int32, torch.uint8, torch.bool):
        other = mcaa.render(lambda x, y, dtype=dtype: disc(x, y).to(dtype), (5, 5), estimator=chosen, spp=ENOUGH)
        assert torch.equal(first.image, other.image) and torch.equal(first.stderr, other.stderr)
        assert other.image.dtype == torch.float32


@pytest.mark.parametrize("chosen", ALL, ids=repr)
def test_pictures_in_double(chosen: mcaa.Importance) -> None:
    """float64 all through: the float32 picture to its rounding, but for the points that rounding moves over the edge (one in 48)."""
    double = mcaa.render(disc, (5, 5), estimator=chosen, spp=ENOUGH, dtype=torch.float64)
    assert double.image.dtype == double.stderr.dtype == torch.float64
    single = mcaa.render(disc, (5, 5), estimator=chosen, spp=ENOUGH)
    assert float((double.image - single.image).abs().max()) < 0.05
    assert rms(double.stderr) == pytest.approx(rms(single.stderr), rel=0.2)


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float16, torch.int32, "float32", None])
def test_dtypes_of_pictures_that_are_refused(dtype: object) -> None:
    """Naive: a picture in bfloat16 has 8 bits, and a standard error below its own rounding."""
    with pytest.raises(
        McaaError, match=r"dtype must be torch.float32 or torch.float64, got .*; f itself may return any real dtype"
    ):
        mcaa.render(disc, (2, 2), dtype=dtype)  # type: ignore[arg-type]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("chosen", ALL, ids=repr)
def test_pixels_that_see_only_zeros(chosen: mcaa.Importance, dtype: torch.dtype) -> None:
    """A variance of 0 by ignorance: a feature of an area of 1 / n may have been missed, so neither 0 nor NaN.

    Naive: standard error 0, or 0 / 0. Not more than 1 either, the largest that is possible for values of 0 or 1.
    """
    picture = mcaa.render(lambda x, y: torch.zeros_like(x), (5, 5), estimator=chosen, spp=ENOUGH, dtype=dtype)
    assert float(picture.image.abs().max()) == 0
    assert float(picture.stderr.min()) > 0 and float(picture.stderr.max()) < 1


def fewest(chosen: mcaa.Importance) -> tuple[int, int]:
    """What `render` needs, and the floor it names: with an allocation a pilot at the estimator's floor and then two points, for a variance."""
    if chosen in PER_PIXEL and chosen.allocation != mcaa.Uniform():
        return chosen.fewest + max(2, chosen.fewest), max(2, chosen.fewest)
    return chosen.fewest, chosen.fewest


@pytest.mark.parametrize(
    "chosen",
    [
        *ALL,
        mcaa.Stratified((4, 4), weights="filter"),
        mcaa.Stratified((3, 3), weights="filter", counts="optimal"),
        mcaa.OrderedStrata(3),
    ],
    ids=repr,
)
def test_budgets_below_the_floor(chosen: mcaa.Importance) -> None:
    """Every spp below the floor is refused with the floor; from there on every spp to 20 more works.

    At the floor a standard error may be +inf, of one point, but is no NaN and not 0. Naive: strata without a point, 0 / 0, or points that nobody
    asked for.
    """
    least, named = fewest(chosen)
    for spp in range(1, least):
        with pytest.raises(McaaError, match=rf"at least {named}\b.*got spp = {spp}"):
            mcaa.render(disc, (3, 3), estimator=chosen, spp=spp)
    for spp in range(least, least + 20, 3):
        picture = mcaa.render(disc, (3, 3), estimator=chosen, spp=spp)
        # a round cannot be below its floor, and a cut lattice may hold one point more
        assert int(picture.spp.sum()) <= 9 * spp
        assert not bool(picture.stderr.isnan().any()) and float(picture.stderr.min()) > 0
        assert bool((picture.image.isfinite() | picture.stderr.isinf()).all())


@pytest.mark.parametrize("chosen", ALL, ids=repr)
def test_several_channels_do_not_mix(chosen: mcaa.Importance) -> None:
    """A channel of 10^6, one of 0 and one of a disc: the third is the picture of the disc alone, but where values choose the points.

    Naive: one tail index, one mask or one scale for all channels.
    """

    def f(x: Tensor, y: Tensor) -> tuple[Tensor, ...]:
        return torch.full_like(x, 1e6), torch.zeros_like(x), disc(x, y)

    together, alone = (mcaa.render(g, (5, 5), estimator=chosen, spp=ENOUGH) for g in (f, disc))
    assert bool(together.stderr.isfinite().all()) and float(together.stderr.min()) > 0
    if chosen in ADAPTIVE or any(name in repr(chosen) for name in ("Adaptive", "Ordered", "allocation", "optimal")):
        difference = (together.image[2] - alone.image[0]).abs() / torch.hypot(together.stderr[2], alone.stderr[0])
        # two pictures with points of their own: 25 pixels at 1e-5, 5.1, widened for the few terms
        assert float(difference.max()) < 1.5 * CHANCE
    else:
        torch.testing.assert_close(together.image[2], alone.image[0], rtol=0, atol=1e-6)
        torch.testing.assert_close(together.stderr[2], alone.stderr[0], rtol=1e-4, atol=1e-7)
