"""Shares of evaluations: totals, floors, what the theory promises, and the least of all whole counts where all can be tried."""

from __future__ import annotations

import itertools
import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from torch_mcaa.allocation import Allocation, EqualVariance, Neyman, Uniform, dense
from torch_mcaa.errors import McaaError
from torch_mcaa.strata import strata_counts

EVERY = pytest.mark.parametrize("allocation", [EqualVariance(), Neyman(), Uniform()], ids=lambda a: type(a).__name__)
ADAPTIVE = pytest.mark.parametrize("allocation", [EqualVariance(), Neyman()], ids=lambda a: type(a).__name__)
LEAST = {EqualVariance: max, Neyman: math.fsum}
VALUES = st.one_of(
    st.just(0.0),
    st.sampled_from([1.0, 2.0, math.inf, math.nan, 5e-324, 1.7e308]),
    st.floats(0, 1),
    st.floats(-6, 6).map(lambda e: 10.0**e),
)


def picture(seed: int, height: int = 64, width: int = 96) -> Tensor:
    """Variances over 12 decades, a third of them 0."""
    generator = torch.Generator().manual_seed(seed)
    uniform = torch.rand(2, height, width, generator=generator, dtype=torch.float64)
    return torch.where(uniform[0] < 1 / 3, 0, 10 ** (12 * uniform[1] - 6))


@EVERY
@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_total_floor_and_cap_hold_exactly(allocation: Allocation, data: st.DataObject):
    height, width = data.draw(st.integers(1, 5)), data.draw(st.integers(1, 6))
    values = data.draw(st.lists(VALUES, min_size=height * width, max_size=height * width))
    floor = data.draw(st.integers(1, 3))
    cap = data.draw(st.one_of(st.none(), st.integers(floor, 9)))
    most = 10**6 if cap is None else cap * height * width
    total = data.draw(st.integers(floor * height * width, most))
    variance = torch.tensor(values, dtype=torch.float64).reshape(height, width)
    counts = allocation.counts(variance, total, floor, cap)
    assert counts.shape == variance.shape and counts.dtype == torch.int64
    assert counts.sum() == total and counts.min() >= floor
    assert cap is None or counts.max() <= cap


@ADAPTIVE
@settings(max_examples=40, deadline=None)
@given(
    values=st.lists(st.one_of(st.just(0.0), st.floats(1e-3, 1e3), st.sampled_from([1.0, 2.0, 3.0])), min_size=4, max_size=4),
    floor=st.integers(1, 2),
    extra=st.integers(0, 14),
    room=st.one_of(st.none(), st.integers(4, 7)),
)
def test_least_of_all_whole_counts(allocation: Allocation, values: list[float], floor: int, extra: int, room: int | None):
    """Tolerance 1e-14: sums of four quotients, and gains that differ by their rounding only."""
    total = 4 * floor + extra
    cap = total if room is None else floor + room
    objective = LEAST[type(allocation)]
    choices = (n for n in itertools.product(range(floor, cap + 1), repeat=3) if floor <= total - sum(n) <= cap)
    least = min(objective([v / k for v, k in zip(values, (*n, total - sum(n)))]) for n in choices)
    counts = allocation.counts(torch.tensor(values, dtype=torch.float64).reshape(2, 2), total, floor, None if room is None else cap)
    found = objective([v / k for v, k in zip(values, counts.flatten().tolist())])
    assert found <= least * (1 + 1e-14)


@ADAPTIVE
@pytest.mark.parametrize(("mean", "floor", "cap"), [(2, 1, None), (9, 2, None), (9, 1, 12), (300, 1, None)])
def test_no_evaluation_is_worth_more_elsewhere(allocation: Allocation, mean: int, floor: int, cap: int | None):
    """The worth of a step falls with n, so this is the least of all counts, as above but for 6,144 pixels. 1e-13: rounding."""
    variance = picture(mean)
    n = allocation.counts(variance, mean * variance.numel(), floor, cap)
    another, latest = (
        (variance / n, variance / (n - 1))
        if isinstance(allocation, EqualVariance)
        else (variance / (n * (n + 1)), variance / (n * (n - 1)))
    )
    best_step = another[n < (cap or n.max() + 1)].max()
    worst_step = latest[n > floor].min()
    assert best_step <= worst_step * (1 + 1e-13)


@pytest.mark.parametrize("mean", [3, 8, 50])
def test_largest_variance_is_close_to_15(mean: int):
    """Below no counts can go; above by mean / (mean - 1), 1.5 for three evaluations a pixel.

    For T = (15) mean / (mean - 1) the counts ⌈variance / T⌉ have variances of at most T, are at least 1, and add up to at most
    Σ variance / T + N = total. 1e-12: rounding.
    """
    variance = picture(mean).clamp(min=1e-6)
    allocation, total = EqualVariance(), mean * variance.numel()
    largest = (variance / allocation.counts(variance, total)).max().item()
    promised = allocation.predicted(variance, total)
    assert promised == pytest.approx(variance.sum().item() / total, rel=1e-12)
    assert promised <= largest <= mean / (mean - 1) * promised * (1 + 1e-12)


@pytest.mark.parametrize("mean", [3, 8, 50])
def test_sum_of_variances_is_close_to_its_minimum(mean: int):
    """Rounding a share x to n costs (n - x)**2 / (n x) of variance / x: for x >= 1.5, at √(n (n + 1)), at most 1/12, and less on average."""
    generator = torch.Generator().manual_seed(mean)
    variance = (0.5 + torch.rand(64, 64, generator=generator, dtype=torch.float64)) ** 2
    allocation = Neyman()
    total = (variance / allocation.counts(variance, mean * 4096)).sum().item()
    least = allocation.predicted(variance, mean * 4096)
    assert least == pytest.approx(variance.sqrt().sum().item() ** 2 / (mean * 4096), rel=1e-13)
    assert least <= total <= 1.08 * least
    assert total < Uniform().predicted(variance, mean * 4096)
    assert allocation.predicted(torch.full((8, 8), 3.0), 640) == pytest.approx(Uniform().predicted(torch.full((8, 8), 3.0), 640))


def test_large_counts_are_proportional():
    """With 10^12 evaluations the counts are (14) and Neyman's to one evaluation."""
    variance = torch.tensor([[1.0, 4.0], [9.0, 16.0]], dtype=torch.float64)
    exact = 10**12 * variance / 30
    assert (EqualVariance().counts(variance, 10**12) - exact).abs().max() < 1
    exact = 10**12 * variance.sqrt() / 10
    assert (Neyman().counts(variance, 10**12) - exact).abs().max() < 1


@ADAPTIVE
def test_scale_does_not_matter(allocation: Allocation):
    variance = picture(1)
    expected = allocation.counts(variance, 50_000)
    for scale in (2.0**-900, 2.0**900):
        assert torch.equal(allocation.counts(variance * scale, 50_000), expected)
    assert torch.equal(allocation.counts(variance.requires_grad_(), 50_000), expected)


@EVERY
def test_strides_do_not_matter(allocation: Allocation):
    variance = picture(4)
    variance[:, 0] = variance[0, 1]
    for shown in (variance.t(), variance[:, ::3], variance[:, :1].expand(-1, 5)):
        assert torch.equal(allocation.counts(shown, 40_000), allocation.counts(shown.contiguous(), 40_000))
        assert allocation.predicted(shown, 40_000) == allocation.predicted(shown.contiguous(), 40_000)


@ADAPTIVE
def test_unknown_variance_is_the_largest_finite(allocation: Allocation):
    variance = picture(2)
    variance[3, 5], variance[60, 90] = math.inf, math.nan
    known = variance.clone()
    known[3, 5] = known[60, 90] = variance[variance.isfinite()].max()
    assert torch.equal(allocation.counts(variance, 100_000), allocation.counts(known, 100_000))
    assert allocation.predicted(variance, 100_000) == allocation.predicted(known, 100_000)
    unknown = torch.full((3, 4), math.nan, dtype=torch.float64)
    assert allocation.counts(unknown, 60).eq(5).all()
    assert allocation.predicted(unknown, 60) == allocation.predicted(torch.ones(3, 4), 60)


@EVERY
@pytest.mark.parametrize("value", [0.0, 0.3])
def test_even_counts_are_spread_over_the_picture(allocation: Allocation, value: float):
    """What does not divide: 1000 of 4096 pixels get one more, and each 16 x 16 block its 62.5 of them to 8, half their random std of 6.8."""
    counts = allocation.counts(torch.full((64, 64), value, dtype=torch.float64), 5 * 4096 + 1000)
    assert set(counts.flatten().tolist()) == {5, 6}
    blocks = (counts - 5).reshape(4, 16, 4, 16).sum((1, 3))
    assert (blocks - 62.5).abs().max() <= 8
    assert (counts.sum(0) - 335.625).abs().max() <= 4 and (counts.sum(1) - 335.625).abs().max() <= 4


@ADAPTIVE
def test_what_full_pixels_cannot_take_goes_to_the_flat_ones(allocation: Allocation):
    variance = torch.tensor([[0.0, 5.0, 0.0], [0.0, 0.1, 0.0]])
    counts = allocation.counts(variance, 22, cap=5)
    assert counts[:, 1].eq(5).all()
    assert counts[:, ::2].eq(3).all()
    assert allocation.counts(variance, 30, cap=5).eq(5).all()


@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_strata_totals_and_floors_hold_exactly(data: st.DataObject):
    strata, pixels, floor = data.draw(st.integers(1, 9)), data.draw(st.integers(1, 5)), data.draw(st.integers(0, 3))
    values = data.draw(st.lists(VALUES, min_size=strata * pixels, max_size=strata * pixels))
    total = torch.tensor(data.draw(st.lists(st.integers(strata * floor, 1000), min_size=pixels, max_size=pixels)))
    spread = torch.tensor(values, dtype=torch.float64).reshape(strata, pixels)
    counts = strata_counts(spread, total, floor)
    assert counts.shape == spread.shape and counts.dtype == torch.int64
    assert torch.equal(counts.sum(0), total) and counts.min() >= floor


def test_strata_are_the_largest_remainders():
    """Against the rule written out for one pixel at a time, and within one evaluation of (16)."""
    generator = torch.Generator().manual_seed(3)
    spread = 1 + 3 * torch.rand(5, 8, 9, generator=generator, dtype=torch.float64)
    total = torch.randint(20, 200, (8, 9), generator=generator)
    counts = strata_counts(spread, total)
    exact = total * spread / spread.sum(0)
    assert exact.min() > 1
    assert (counts - exact).abs().max() < 1
    for row, column in itertools.product(range(8), range(9)):
        share = exact[:, row, column].tolist()
        whole = [math.floor(x) for x in share]
        largest = sorted(range(5), key=lambda j: whole[j] - share[j])
        for j in largest[: int(total[row, column]) - sum(whole)]:
            whole[j] += 1
        assert counts[:, row, column].tolist() == whole


def test_strata_floors_take_from_the_others_in_proportion():
    """Shares of 100: 50 : 30 : 19.9 : 0.1. A floor of 10 leaves 90 for 50 : 30 : 19.9, and one of 20 leaves 60 for 50 : 30, a tie."""
    spread = torch.tensor([50, 30, 19.9, 0.1], dtype=torch.float64)
    assert strata_counts(spread, 100).tolist() == [49, 30, 20, 1]
    assert strata_counts(spread, 100, 10).tolist() == [45, 27, 18, 10]
    assert strata_counts(spread, 100, 20).tolist() == [38, 22, 20, 20]
    assert strata_counts(spread, 100, 25).tolist() == [25, 25, 25, 25]
    assert strata_counts(torch.tensor([1.0, 0.0, math.inf, math.nan]), 9, 0).tolist() == [3, 0, 3, 3]


def test_strata_without_spread_take_turns():
    counts = strata_counts(torch.zeros(4, 3, 4), 6)
    assert torch.equal(counts.sum(0), torch.full((3, 4), 6))
    assert set(counts.flatten().tolist()) == {1, 2}
    assert counts.sum((1, 2)).tolist() == [18] * 4
    assert torch.equal(counts, strata_counts(torch.full((4, 3, 4), 0.7), 6))


def test_threads_do_not_change_a_bit():
    """A plain sum of these variances differs in its last bit between numbers of threads."""
    generator = torch.Generator().manual_seed(0)
    variance = torch.rand(301, 517, generator=generator, dtype=torch.float64) ** 6
    tall = torch.rand(11, 20_011, generator=generator, dtype=torch.float64)
    results: list[list[Tensor]] = []
    before = torch.get_num_threads()
    try:
        for threads in (1, 2, 3, 7):
            torch.set_num_threads(threads)
            results.append([strata_counts(tall, 57), strata_counts(tall, 2**47)])
            for allocation in (EqualVariance(), Neyman(), Uniform()):
                for shown in (variance, variance.reshape(1, -1), torch.ones_like(variance)):
                    predicted = torch.tensor(allocation.predicted(shown, 1_000_003), dtype=torch.float64)
                    results[-1] += [allocation.counts(shown, 1_000_003), predicted]
    finally:
        torch.set_num_threads(before)
    for result in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(results[0], result))


@ADAPTIVE
def test_known_is_a_float64_copy(allocation: Allocation):
    given = torch.tensor([[1.0, 2.0]], dtype=torch.float64)
    known = type(allocation)(given).known  # pyright: ignore[reportCallIssue, reportAttributeAccessIssue]
    given.zero_()
    assert torch.equal(known, torch.tensor([[1.0, 2.0]], dtype=torch.float64))
    assert type(allocation)(torch.tensor([[3]])).known.dtype == torch.float64  # pyright: ignore[reportCallIssue, reportAttributeAccessIssue]


@pytest.mark.parametrize("make", [EqualVariance, Neyman])
@pytest.mark.parametrize(
    ("known", "message"),
    [
        (torch.ones(3, 4, 5), r"known must be \(H, W\), one value a pixel, got \(3, 4, 5\)"),
        (torch.ones(4, 5, dtype=torch.complex64), "known must be real numbers, got torch.complex64"),
        (torch.full((4, 5), -2.0), "known must not be negative, got -2"),
        (torch.tensor([[1.0, math.nan, math.inf]]), "known must be finite, got 2 values of 3"),
        ([[1.0]], r"known must be a \(H, W\) tensor, got list"),
    ],
)
def test_bad_known(make: type[EqualVariance] | type[Neyman], known: Tensor, message: str):
    with pytest.raises(McaaError, match=message):
        make(known)


@EVERY
@pytest.mark.parametrize(
    ("variance", "arguments", "message"),
    [
        (torch.ones(4), (10,), r"variance must be \(H, W\), one value a pixel, got \(4,\)"),
        (torch.ones(0, 4), (10,), r"got \(0, 4\)"),
        (torch.tensor([[1, -0.5]]), (10,), "variance must not be negative, got -0.5"),
        (torch.tensor([[1, -math.inf]]), (10,), "variance must not be negative, got -inf"),
        (torch.ones(2, 3), (11, 2), "11 evaluations for 2 x 3 pixels are too few for 2 in each: raise spp to at least 2"),
        (
            torch.ones(2, 3),
            (31, 2, 5),
            "31 evaluations for 2 x 3 pixels are too many for at most 5 in each: lower spp to at most 5",
        ),
        (torch.ones(2, 3), (10.0,), "total must be a whole number >= 1, got 10.0"),
        (torch.ones(2, 3), (10, 0), "floor must be a whole number >= 1, got 0"),
        (torch.ones(2, 3), (10, 1, True), "cap must be a whole number >= 1, got True"),
        (torch.ones(2, 3), (2**50,), "more than 2\\*\\*48"),
    ],
)
def test_bad_counts(allocation: Allocation, variance: Tensor, arguments: tuple[int, ...], message: str):
    with pytest.raises(McaaError, match=message):
        allocation.counts(variance, *arguments)


@EVERY
def test_bad_predicted(allocation: Allocation):
    with pytest.raises(McaaError, match="total must be a whole number >= 1, got 0"):
        allocation.predicted(torch.ones(2, 3), 0)
    with pytest.raises(McaaError, match="variance must not be negative"):
        allocation.predicted(-torch.ones(2, 3), 5)


@pytest.mark.parametrize(
    ("spread", "total", "floor", "message"),
    [
        (torch.tensor(1.0), 4, 1, r"spread must be \(strata, \*pixels\), got \(\)"),
        (torch.ones(0, 3), 4, 1, r"got \(0, 3\)"),
        (-torch.ones(2, 3), 4, 1, "spread must not be negative, got -1"),
        (torch.ones(2, 3), 3, 2, "2 strata of at least 2.*got 3 to 3: raise spp to at least 4"),
        (torch.ones(2, 3), torch.tensor([4, 4, 1]), 1, "got 1 to 4: raise spp to at least 2"),
        (torch.ones(2, 3), torch.tensor([4, 4]), 1, r"total must be int64 of shape \(3,\), got torch.int64 of \(2,\)"),
        (torch.ones(2, 3), torch.ones(3), 1, r"got torch.float32 of \(3,\)"),
        (torch.ones(2, 3), 4, -1, "floor must be a whole number >= 0, got -1"),
        (torch.ones(2, 3), 4.0, 1, "total must be a whole number >= 1, got 4.0"),
    ],
)
def test_bad_strata(spread: Tensor, total: int, floor: int, message: str):
    with pytest.raises(McaaError, match=message):
        strata_counts(spread, total, floor)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.integers(0, 3000), min_size=1, max_size=300))
def test_dense_counts(counts: list[int]) -> None:
    """Few values, none more than 7 % and one off, in their old order, with their old sum."""
    before = torch.tensor(counts)
    after = dense(before)
    assert after.sum() == before.sum()
    assert ((after - before).abs() <= 0.07 * before + 1).all()
    assert (after[before.argsort(stable=True)].diff() >= -1).all()
    assert (after == 0).equal(before == 0)
    # two values in each of log(3001) / log(1.07) bands
    assert len(after.unique()) <= 2 * 119
