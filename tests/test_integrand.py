"""The contract of f: what it may return, what is said when it returns something else, and what becomes of NaN and infinities."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

import torch_mcaa as mcaa
from torch_mcaa.errors import McaaError, McaaWarning
from torch_mcaa.integrand import BLOCK, Integrand

X = torch.linspace(0, 3, 256)
Y = X.flip(0) + 10
SIZE = (12, 14)

Returned = Callable[[Tensor, Tensor], Any]

ACCEPTED: dict[str, tuple[Returned, int]] = {
    "tensor": (lambda x, y: x + y, 1),
    "tuple": (lambda x, y: (x, y, x + y), 3),
    "tuple of one": (lambda x, y: (x,), 1),
    "list": (lambda x, y: [x, y], 2),
    "stacked": (lambda x, y: torch.stack([x, y, x * y, y]), 4),
    "bool": (lambda x, y: x > 1.5, 1),
    "int64": (lambda x, y: (x * 7).long(), 1),
    "uint8": (lambda x, y: (x * 7).to(torch.uint8), 1),
    "float16": (lambda x, y: x.half(), 1),
    "bfloat16": (lambda x, y: x.bfloat16(), 1),
    "float64": (lambda x, y: x.double() / 3, 1),
    "mixed": (lambda x, y: (x > 1, x.double(), y.half()), 3),
    "expanded": (lambda x, y: torch.ones(()).expand(x.shape), 1),
    "strided": (lambda x, y: torch.stack([x, y], -1)[..., 1], 1),
}


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("form", ACCEPTED)
def test_accepted_forms(form: str, dtype: torch.dtype) -> None:
    f, channels = ACCEPTED[form]
    values = Integrand(f, dtype)(X, Y)
    raw = f(X, Y)
    expected = [raw] if isinstance(raw, Tensor) and raw.shape == X.shape else list(raw)
    assert len(values) == len(expected) == channels
    for value, plain in zip(values, expected):
        assert value.dtype == dtype
        assert value.shape == X.shape
        assert torch.equal(value, plain.to(dtype))


def test_all_forms_of_one_function_are_one_picture() -> None:
    forms: list[Returned] = [
        lambda x, y: (x > 4, y),
        lambda x, y: [(x > 4).int(), y],
        lambda x, y: torch.stack([(x > 4).to(y), y]),
        lambda x, y: ((x > 4).half(), y.double()),
    ]
    pictures = [mcaa.render(f, SIZE, spp=5).image for f in forms]
    assert pictures[0].shape == (2, *SIZE)
    assert all(torch.equal(pictures[0], picture) for picture in pictures[1:])


def test_what_f_is_given() -> None:
    def f(x: Tensor, y: Tensor) -> Tensor:
        assert x.shape == y.shape
        assert x.dtype == y.dtype == torch.float32
        assert x.device.type == y.device.type == "cpu"
        assert x.is_contiguous()
        assert y.is_contiguous()
        assert not x.requires_grad
        assert x.data_ptr() != y.data_ptr()
        return x

    for estimator in (mcaa.Auto(), mcaa.JumpCorrected(), mcaa.Shared(), mcaa.Shared(mcaa.Jittered()), mcaa.Importance()):
        mcaa.render(f, SIZE, estimator=estimator)


@pytest.mark.parametrize(
    "estimator", [mcaa.Auto(), mcaa.JumpCorrected(), mcaa.Shared(), mcaa.Shared(mcaa.Sobol()), mcaa.Importance()], ids=repr
)
def test_f_may_change_its_arguments(estimator: mcaa.Auto) -> None:
    in_place = mcaa.render(lambda x, y: x.mul_(0.1).add_(y.sin_()), SIZE, estimator=estimator)
    plain = mcaa.render(lambda x, y: x * 0.1 + y.sin(), SIZE, estimator=estimator)
    assert torch.equal(in_place.image, plain.image)
    assert torch.equal(in_place.stderr, plain.stderr)


def test_few_points_are_filled_up_by_few() -> None:
    """Locating the edges of small discs takes many calls of a few points each."""
    centres = torch.randint(0, 32, (20, 2), generator=torch.Generator().manual_seed(6))

    def discs(x: Tensor, y: Tensor) -> Tensor:
        return (torch.hypot(x[:, None] - centres[:, 0], y[:, None] - centres[:, 1]).amin(1) < 1.8).to(x)

    picture = mcaa.render(discs, (32, 32), spp=64, seed=6)
    assert float(picture.spp.double().mean()) <= 64
    # the filter's reach alone is a third more
    assert picture.evaluations < 2.2 * 64 * 32 * 32


def test_every_evaluation_is_counted_and_blocks_are_small() -> None:
    seen: list[int] = []

    def f(x: Tensor, y: Tensor) -> Tensor:
        seen.append(x.numel())
        return x

    for estimator in (
        mcaa.Auto(),
        mcaa.JumpCorrected(),
        mcaa.Shared(),
        mcaa.Shared(mcaa.Sobol()),
        mcaa.Importance(),
        mcaa.Shared(replicates=2),
    ):
        seen.clear()
        picture = mcaa.render(f, (60, 60), estimator=estimator, spp=20)
        assert picture.evaluations == sum(seen)
        assert max(seen) <= BLOCK


REFUSED: dict[str, tuple[Returned, str]] = {
    "a python scalar": (lambda x, y: 0.5, r"shape \(256,\).*got float 0\.5.*full_like"),
    "none": (lambda x, y: None, "got NoneType"),
    "an array": (lambda x, y: x.numpy(), "got a numpy array"),
    "too many points": (lambda x, y: torch.cat([x, y]), r"got a tensor of shape \(512,\)"),
    "a scalar tensor": (lambda x, y: x.sum(), r"got a tensor of shape \(\)"),
    "channels last": (lambda x, y: torch.stack([x, y], -1), r"\(C, 256\).*got a tensor of shape \(256, 2\)"),
    "no channels": (lambda x, y: x.new_empty(0, *x.shape), r"got a tensor of shape \(0, 256\)"),
    "a dimension too many": (lambda x, y: x[None, None], r"got a tensor of shape \(1, 1, 256\)"),
    "an empty tuple": (lambda x, y: (), "got a tuple of 0"),
    "a tuple with a number": (lambda x, y: (x, 0.5), r"shape \(256,\), got float 0\.5"),
    "a tuple of points": (lambda x, y: tuple(x), r"shape \(256,\), got a tensor of shape \(\)"),
    "a nested tuple": (lambda x, y: ((x, y), x), "got a tuple of 2"),
    "complex": (lambda x, y: torch.complex(x, y), "complex64.*real part"),
    "sparse": (lambda x, y: x.to_sparse(), "torch.sparse_coo.*to_dense"),
    "another device": (lambda x, y: x.to("meta"), "asked on cpu.*on meta.*move what f uses to cpu"),
    "another device in a tuple": (lambda x, y: (x, y.to("meta")), "asked on cpu.*on meta"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_refused_forms(what: str) -> None:
    f, said = REFUSED[what]
    with pytest.raises(McaaError, match=said):
        Integrand(f)(X, Y)
    with pytest.raises(McaaError):
        mcaa.render(f, SIZE)


@pytest.mark.parametrize("estimator", [mcaa.Auto(), mcaa.JumpCorrected(), mcaa.Shared(), mcaa.Shared(mcaa.Sobol())], ids=repr)
def test_changing_number_of_channels(estimator: mcaa.Auto) -> None:
    calls: list[int] = []

    def f(x: Tensor, y: Tensor) -> tuple[Tensor, ...]:
        calls.append(1)
        return (x,) * min(len(calls), 2)

    with pytest.raises(McaaError, match="2 channels where it had returned 1"):
        mcaa.render(f, (70, 70), estimator=estimator, tolerance=1e-6)


def test_an_f_that_raises_is_chained_and_placed() -> None:
    def f(x: Tensor, y: Tensor) -> Tensor:
        if bool((x > 7).any()):
            raise RuntimeError("the network\nis not there")
        return x

    with pytest.raises(
        McaaError, match=r"RuntimeError: the network\nis not there; it was asked for .* x in \[.*\], y in \["
    ) as caught:
        mcaa.render(f, SIZE)
    assert type(caught.value.__cause__) is RuntimeError
    low, high = map(float, re.findall(r"x in \[(.*?), (.*?)\]", str(caught.value))[0])
    assert low < 7 < high


def test_an_f_that_raises_where_points_want_a_gradient_is_all_that_is_said() -> None:
    """PyTorch warns, once a process, of numbers that are made of such points: an f of one dtype alone raises in the other."""

    def f(x: Tensor, y: Tensor) -> Tensor:
        raise RuntimeError("no such dtype")

    always = torch.is_warn_always_enabled()
    torch.set_warn_always(True)
    try:
        with pytest.raises(McaaError, match=r"no such dtype.*x in \[0, 3\], y in \[0, 3\]"):
            Integrand(f)(X.clone().requires_grad_(), X)
    finally:
        torch.set_warn_always(always)


def test_an_f_of_one_argument() -> None:
    with pytest.raises(McaaError, match="TypeError.*takes 1 positional argument but 2"):
        mcaa.render(lambda p: p, SIZE)  # type: ignore[arg-type,misc]


def test_from_points() -> None:
    def network(points: Tensor) -> Tensor:
        assert points.ndim == 2
        assert points.shape[1] == 2
        return torch.stack([points[:, 0], points[:, 1], points.sum(1)], 1)

    x, y, total = mcaa.from_points(network)(X, Y)
    assert torch.equal(x, X)
    assert torch.equal(y, Y)
    assert torch.equal(total, X + Y)
    (flat,) = mcaa.from_points(lambda points: points[:, 0] * 2)(X, Y)
    assert torch.equal(flat, X * 2)
    picture = mcaa.render(mcaa.from_points(network), SIZE)
    assert torch.equal(picture.image, mcaa.render(lambda x, y: (x, y, x + y), SIZE).image)


@pytest.mark.parametrize(
    ("out", "said"),
    [
        (lambda points: points.mT, r"got a tensor of shape \(2, 256\)"),
        (lambda points: points[:-1], r"N = 256, got a tensor of shape \(255, 2\)"),
        (lambda points: points[None], r"got a tensor of shape \(1, 256, 2\)"),
        (lambda points: 0.0, "got float 0.0"),
        (lambda points: points.numpy(), "got a numpy array"),
    ],
)
def test_from_points_refuses(out: Callable[[Tensor], Any], said: str) -> None:
    with pytest.raises(McaaError, match=said):
        mcaa.from_points(out)(X, Y)
    with pytest.raises(McaaError, match="f raised McaaError: a function on points must return"):
        mcaa.render(mcaa.from_points(out), SIZE)


# --- NaN and infinities

ADAPTIVE = [mcaa.Auto(), mcaa.JumpCorrected()]
FIXED = [mcaa.Shared(), mcaa.Shared(mcaa.Sobol()), mcaa.Shared(replicates=2)]
"""Shared points that do not depend on f."""
SHARED = [*ADAPTIVE, *FIXED]
ESTIMATORS = [*SHARED, mcaa.Importance()]


def waves(x: Tensor, y: Tensor) -> Tensor:
    return torch.sin(0.9 * x) * torch.cos(0.7 * y)


def in_pixels(x: Tensor, y: Tensor) -> Tensor:
    """Rows 4 to 7, columns 6 to 8."""
    return (x >= 6) & (x < 9) & (y >= 4) & (y < 8)


def in_disc(x: Tensor, y: Tensor) -> Tensor:
    return (x - 6.3) ** 2 + (y - 5.2) ** 2 < 6


def with_holes(hole: Callable[[Tensor, Tensor], Tensor], value: float = torch.nan) -> Returned:
    return lambda x, y: torch.where(hole(x, y), value, waves(x, y))


class Recorder:
    """f, and where it was asked: float64 (N,) without repetitions."""

    def __init__(self, f: Returned) -> None:
        self.f, self.seen = f, []

    def __call__(self, x: Tensor, y: Tensor) -> Any:
        self.seen.append(torch.stack([x.double().flatten(), y.double().flatten()]))
        return self.f(x, y)

    @property
    def points(self) -> tuple[Tensor, Tensor]:
        x, y = torch.cat(self.seen, 1).unique(dim=1)
        return x, y


def count(x: Tensor, y: Tensor) -> Tensor:
    """(H, W): how many of the points lie in each pixel."""
    height, width = SIZE
    on = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    pixel = y[on].long() * width + x[on].long()
    return torch.bincount(pixel, minlength=height * width).reshape(SIZE).int()


def beyond_the_hole(filter: mcaa.Gaussian) -> Tensor:
    """(H, W) bool: the pixels whose filter does not reach `in_pixels`."""
    rows, cols = torch.arange(SIZE[0])[:, None] + 0.5, torch.arange(SIZE[1]) + 0.5
    reach = max(filter.radius)
    return (rows < 4 - reach) | (rows > 8 + reach) | (cols < 6 - reach) | (cols > 9 + reach)


def weights(filter: mcaa.Gaussian, x: Tensor, y: Tensor) -> Tensor:
    """(H, W, N): w at every point for every pixel."""
    rows, cols = torch.arange(SIZE[0]) + 0.5, torch.arange(SIZE[1]) + 0.5
    return filter(x - cols[:, None], (y - rows[:, None])[:, None])


@pytest.mark.parametrize("value", [torch.nan, torch.inf, -torch.inf])
@pytest.mark.parametrize("estimator", ESTIMATORS, ids=repr)
def test_raise_names_the_first_place(value: float, estimator: mcaa.Auto) -> None:
    f = Recorder(with_holes(in_pixels, value))
    with pytest.raises(
        McaaError, match=r"channel 0\); mend f, or what it reads; render alone passes over .*nonfinite='ignore' or 'propagate'"
    ) as caught:
        mcaa.render(f, SIZE, estimator=estimator)
    told, x, y = re.findall(r"returned (.*?) at x = (.*?), y = (.*?) \(", str(caught.value))[0]
    assert float(told) == value or (told == "nan" and value != value)
    last = f.seen[-1]
    first = int(in_pixels(*last).nonzero()[0])
    assert (float(x), float(y)) == pytest.approx(tuple(last[:, first].tolist()), rel=1e-8)
    # no block before it held one
    assert not any(bool(in_pixels(*block).any()) for block in f.seen[:-1])


def test_raise_names_the_channel_and_what_float32_cannot_hold() -> None:
    with pytest.raises(McaaError, match=r"returned inf .*channel 1"):
        mcaa.render(lambda x, y: (x, torch.full_like(x, 1e300, dtype=torch.float64)), SIZE)
    with pytest.warns(McaaWarning, match="squares are beyond torch.float64"):
        picture = mcaa.render(lambda x, y: torch.full_like(x, 1e300, dtype=torch.float64), SIZE, dtype=torch.float64)
    assert float((picture.image / 1e300 - 1).abs().max()) < 1e-14


def test_large_finite_values_do_not_raise() -> None:
    """Their sum overflows float32; they do not."""
    assert len(Integrand(lambda x, y: torch.full_like(x, 3e38))(X, Y)) == 1
    with pytest.warns(McaaWarning, match="squares are beyond torch.float32"):
        picture = mcaa.render(lambda x, y: torch.full_like(x, 1e38), SIZE, spp=2)
    assert float((picture.image / 1e38 - 1).abs().max()) < 1e-6
    assert int(picture.invalid.sum()) == 0


@pytest.mark.parametrize("filter", [mcaa.Gaussian(0.5), mcaa.Box(), mcaa.Lanczos(3)], ids=repr)
@pytest.mark.parametrize("estimator", SHARED, ids=repr)
@pytest.mark.parametrize("nonfinite", ["ignore", "propagate"])
def test_invalid_counts_whole_pixels(filter: mcaa.Gaussian, estimator: mcaa.Auto, nonfinite: str) -> None:
    """Where f is NaN on whole pixels, all their evaluations are invalid and no other."""
    picture = mcaa.render(with_holes(in_pixels), SIZE, filter=filter, estimator=estimator, nonfinite=nonfinite)  # type: ignore[arg-type]
    hole = torch.zeros(SIZE, dtype=torch.bool)
    hole[4:8, 6:9] = True
    assert picture.invalid.dtype == torch.int32
    assert torch.equal(picture.invalid, picture.spp * hole)
    assert int(picture.invalid.sum()) > 0


@pytest.mark.parametrize("estimator", SHARED, ids=repr)
def test_invalid_counts_parts_of_pixels(estimator: mcaa.Auto) -> None:
    f = Recorder(with_holes(in_disc, torch.inf))
    picture = mcaa.render(f, SIZE, estimator=estimator, nonfinite="ignore", dtype=torch.float64)
    x, y = f.points
    bad = in_disc(x, y)
    if estimator in ADAPTIVE:
        # 64 places of a cell are asked twice, to see whether f is random
        for told, seen in ((picture.spp, count(x, y)), (picture.invalid, count(x[bad], y[bad]))):
            assert bool((told >= seen).all()) and int((told - seen).sum()) <= 64
    else:
        assert torch.equal(picture.spp, count(x, y))
        assert torch.equal(picture.invalid, count(x[bad], y[bad]))


def test_invalid_of_importance_counts_its_own_points() -> None:
    f = Recorder(with_holes(in_disc))
    picture = mcaa.render(f, SIZE, estimator=mcaa.Importance(), nonfinite="ignore", dtype=torch.float64)
    # plane by plane, 16 points in each pixel
    x, y = torch.cat(f.seen, 1)[:, : 16 * SIZE[0] * SIZE[1]].reshape(2, 16, *SIZE)
    bad = in_disc(x, y)
    assert torch.equal(picture.invalid, bad.sum(0, dtype=torch.int32))
    # under its own density every weight is 1: the value is the mean of what is left
    left = torch.where(bad, 0, waves(x, y)).sum(0) / (~bad).sum(0)
    some = ~bad.all(0)
    assert float((picture.image[0] - left)[some].abs().max()) < 1e-14
    assert bool(picture.image[0][~some].isnan().all())


@pytest.mark.parametrize("filter", [mcaa.Gaussian(0.5), mcaa.Tent()], ids=repr)
@pytest.mark.parametrize("estimator", [mcaa.Shared(), mcaa.Shared(mcaa.Sobol())], ids=repr)
def test_ignored_samples_leave_the_weighted_mean_of_the_rest(filter: mcaa.Gaussian, estimator: mcaa.Shared) -> None:
    f = Recorder(with_holes(in_disc))
    picture = mcaa.render(f, SIZE, filter=filter, estimator=estimator, nonfinite="ignore", dtype=torch.float64)
    x, y = f.points
    # points off the lattice serve the standard error only: theirs are the offsets that no other column repeats
    _, place, times = (torch.frac(x + 8) * 2**30).round().unique(return_inverse=True, return_counts=True)
    kept = ~in_disc(x, y) & (times[place] > 3 if estimator == mcaa.Shared() else True)
    x, y = x[kept], y[kept]
    w = weights(filter, x, y)
    near = w.sum(-1) > 1e-2 * weights(filter, *f.points).sum(-1)
    mean = (w * waves(x, y)).sum(-1) / w.sum(-1)
    assert int((~near).sum()) < 20
    # the patterns' coordinates have 32 bits
    assert float((picture.image[0] - mean)[near].abs().max()) < 1e-7


@pytest.mark.parametrize("filter", [mcaa.Gaussian(0.5), mcaa.Box(), mcaa.Lanczos(3)], ids=repr)
@pytest.mark.parametrize("estimator", [*FIXED, mcaa.Importance()], ids=repr)
def test_ignore_changes_only_what_the_hole_reaches(filter: mcaa.Gaussian, estimator: mcaa.Shared) -> None:
    clean = mcaa.render(waves, SIZE, filter=filter, estimator=estimator)
    picture = mcaa.render(with_holes(in_pixels), SIZE, filter=filter, estimator=estimator, nonfinite="ignore")
    # |f| <= 1: rounding of a few dozen terms
    assert float((picture.image - clean.image)[0][beyond_the_hole(filter)].abs().max()) < 2e-6


@pytest.mark.parametrize("filter", [mcaa.Gaussian(0.5), mcaa.Box(), mcaa.Lanczos(3)], ids=repr)
@pytest.mark.parametrize("estimator", ADAPTIVE, ids=repr)
@pytest.mark.parametrize("nonfinite", ["ignore", "propagate"])
def test_a_hole_may_move_points_elsewhere_but_not_beyond_the_standard_errors(
    filter: mcaa.Gaussian, estimator: mcaa.Auto, nonfinite: str
) -> None:
    """Where values choose the points a hole changes them in the whole cell: pictures with and without agree as their errors say.

    Over 16 seeds, for which a root mean square of some ten independent pixels each is known to 10 %: 1.3 is three of that.
    """
    apart = beyond_the_hole(filter)
    differences, allowed = [], []
    for seed in range(16):
        clean = mcaa.render(waves, SIZE, filter=filter, estimator=estimator, seed=seed)
        picture = mcaa.render(with_holes(in_pixels), SIZE, filter=filter, estimator=estimator, nonfinite=nonfinite, seed=seed)  # type: ignore[arg-type]
        differences.append((picture.image - clean.image)[0][apart])
        allowed.append(torch.hypot(picture.stderr, clean.stderr)[0][apart])
    assert float(torch.stack(differences).square().mean().sqrt()) < 1.3 * float(torch.stack(allowed).square().mean().sqrt())


# weights of both signs are not normalised in importance sampling
KEEPING_CONSTANTS = [(w, e) for w in (mcaa.Gaussian(0.5), mcaa.Box()) for e in ESTIMATORS] + [(mcaa.Lanczos(3), e) for e in SHARED]


@pytest.mark.parametrize(("filter", "estimator"), KEEPING_CONSTANTS, ids=repr)
def test_ignore_keeps_constants(filter: mcaa.Gaussian, estimator: mcaa.Auto) -> None:
    """What is left of the weights is normalised, so 0.7 stays 0.7 where anything is left. For a w of both signs that may be little."""

    def f(x: Tensor, y: Tensor) -> Tensor:
        return torch.where(in_disc(x, y), torch.nan, 0.7)

    picture = mcaa.render(f, SIZE, filter=filter, estimator=estimator, nonfinite="ignore")
    has_value = picture.image.isfinite()
    assert float(has_value.float().mean()) > 0.8
    assert float((picture.image[has_value] - 0.7).abs().max()) < (1e-3 if isinstance(filter, mcaa.Lanczos) else 2e-6)


@pytest.mark.parametrize("filter", [mcaa.Gaussian(0.5), mcaa.Box(), mcaa.Lanczos(3)], ids=repr)
@pytest.mark.parametrize("estimator", SHARED, ids=repr)
def test_propagate_marks_what_the_hole_reaches_and_nothing_else(filter: mcaa.Gaussian, estimator: mcaa.Auto) -> None:
    """And, but for points that f chooses, changes nothing else."""
    clean = mcaa.render(waves, SIZE, filter=filter, estimator=estimator)
    f = Recorder(with_holes(in_pixels))
    picture = mcaa.render(f, SIZE, filter=filter, estimator=estimator, nonfinite="propagate")
    x, y, much = *f.points, 1e-4
    if estimator in ADAPTIVE:
        # bisection crowds where |w| may be anything, so what the hole has of |w| itself: that of the samples differs by half, at most
        at, much = (torch.arange(8 * 24, dtype=torch.float64) + 0.5) / 8 - 5, 2e-4
        x, y = (axis.flatten() for axis in torch.meshgrid(at, at, indexing="xy"))
    w = weights(filter, x, y).abs()
    share = (w * in_pixels(x, y)).sum(-1) / w.sum(-1)
    lost = picture.image[0].isnan()
    assert bool(lost[share > much].all())
    # |f| <= 1: a share below 1e-5 may pass for rounding
    assert estimator in ADAPTIVE or float((picture.image - clean.image)[0][~lost].abs().max()) < 2e-5
    assert not bool(lost[share == 0].any())


def test_propagate_of_importance_marks_the_pixels_whose_points_met_it() -> None:
    clean = mcaa.render(waves, SIZE, estimator=mcaa.Importance())
    picture = mcaa.render(with_holes(in_disc), SIZE, estimator=mcaa.Importance(), nonfinite="propagate")
    lost = picture.image[0].isnan()
    assert torch.equal(lost, picture.invalid > 0)
    assert torch.equal(picture.image[0][~lost], clean.image[0][~lost])


@pytest.mark.parametrize("filter", [mcaa.Gaussian(0.5), mcaa.Box(), mcaa.Lanczos(3)], ids=repr)
@pytest.mark.parametrize("estimator", ESTIMATORS, ids=repr)
@pytest.mark.parametrize("nonfinite", ["ignore", "propagate"])
def test_standard_error_is_infinite_where_there_is_no_value(filter: mcaa.Gaussian, estimator: mcaa.Auto, nonfinite: str) -> None:
    """And only there: the neighbours have one that is finite and above 0."""
    picture = mcaa.render(with_holes(in_pixels), SIZE, filter=filter, estimator=estimator, nonfinite=nonfinite)  # type: ignore[arg-type]
    lost = picture.image.isnan()
    assert bool((picture.stderr[lost] == torch.inf).all())
    assert bool(picture.stderr[~lost].isfinite().all())
    assert bool((picture.stderr > 0).all())


@pytest.mark.parametrize("estimator", ESTIMATORS, ids=repr)
@pytest.mark.parametrize("nonfinite", ["ignore", "propagate"])
def test_a_hole_does_not_shrink_the_standard_error_far_away(estimator: mcaa.Auto, nonfinite: str) -> None:
    """f from 0 to 100: a pixel at the far corner knows as much as it did without the hole, to the share that the hole has in the range.

    Where f chooses the points it may know less, as the evaluations go to the hole's edge: what no sample met is a hundredth of the range
    over the lines a pixel, and these are 15, or with jumps to be located no fewer than 3.
    """

    def ramp(x: Tensor, y: Tensor) -> Tensor:
        return 100 * (x + y) / 26

    def f(x: Tensor, y: Tensor) -> Tensor:
        return torch.where(in_pixels(x, y), torch.nan, ramp(x, y))

    clean = mcaa.render(ramp, SIZE, estimator=estimator)
    picture = mcaa.render(f, SIZE, estimator=estimator, nonfinite=nonfinite)  # type: ignore[arg-type]
    ratio = float(picture.stderr[0, -1, -1]) / float(clean.stderr[0, -1, -1])
    assert 0.9 < ratio < (1.1 * 15 / 3 if estimator in ADAPTIVE else 1.1)


@pytest.mark.parametrize("nonfinite", ["ignore", "propagate"])
@pytest.mark.parametrize("estimator", ESTIMATORS, ids=repr)
def test_nothing_finite_anywhere(nonfinite: str, estimator: mcaa.Auto) -> None:
    picture = mcaa.render(lambda x, y: x * torch.nan, SIZE, estimator=estimator, nonfinite=nonfinite)  # type: ignore[arg-type]
    assert bool(picture.image.isnan().all())
    assert bool((picture.stderr == torch.inf).all())
    assert torch.equal(picture.invalid, picture.spp)


@pytest.mark.parametrize("nonfinite", ["ignore", "propagate"])
@pytest.mark.parametrize("estimator", ESTIMATORS, ids=repr)
def test_without_nan_the_choice_changes_no_bit(nonfinite: str, estimator: mcaa.Auto) -> None:
    picture = mcaa.render(waves, SIZE, estimator=estimator, nonfinite=nonfinite)  # type: ignore[arg-type]
    clean = mcaa.render(waves, SIZE, estimator=estimator)
    for name in ("image", "stderr", "spp", "invalid"):
        assert torch.equal(getattr(picture, name), getattr(clean, name))


def test_one_bad_channel_spoils_the_sample_for_all() -> None:
    """A sample counts once, in every channel or in none."""

    def f(x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        return torch.where(in_pixels(x, y), 50.0, 1.0), torch.where(in_pixels(x, y), torch.nan, 1.0)

    for estimator in ESTIMATORS:
        picture = mcaa.render(f, SIZE, filter=mcaa.Box(), estimator=estimator, nonfinite="ignore")
        assert bool(picture.image[:, 4:8, 6:9].isnan().all())
        rest = picture.image[picture.image.isfinite()]
        assert float((rest - 1).abs().max()) < 2e-6


def test_numpy_scalars_are_described_in_one_piece() -> None:
    with pytest.raises(McaaError, match="got a numpy array") as caught:
        mcaa.render(lambda x, y: np.zeros(1000), SIZE)
    assert len(str(caught.value)) < 400


def test_a_network_is_asked_in_the_dtype_of_its_parameters() -> None:
    network = torch.nn.Linear(2, 2)
    picture = mcaa.render(mcaa.from_points(network), (4, 5), dtype=torch.float64)
    assert picture.image.dtype == torch.float64
    assert picture.image.shape == (2, 4, 5)
