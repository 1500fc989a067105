"""Bisection of many segments at once: where jumps lie, how many there are, and what is no jump."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from on_lines import FINEST, Ask, sampled, segments, step
from torch import Tensor

from torch_mcaa import rng
from torch_mcaa.edges.bisect import bisect, joined, sided
from torch_mcaa.edges.candidates import brackets, candidates

MOST = 16
"""Evaluations of a segment with one jump: 3 for the quarters, then quarters of at most 0.2625 px halved 12 times make 1.1 * 2**-14."""


def places(count: int, seed: int) -> Tensor:
    """Random places in [0, 1)."""
    return torch.rand(count, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def on_own_lines(t: Tensor, axis: int = 0) -> Ask:
    """A step of 1 at low + t[i] on line i, where low is 10."""

    def f(x: Tensor, y: Tensor) -> Tensor:
        along, across = (x, y) if axis == 0 else (y, x)
        return step(along - 10 > t[across.long()])

    return Ask(f)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("steps", [8, 11, 14])
def test_a_jump_lies_in_its_bracket(axis: int, steps: int) -> None:
    finest, count = 1.1 * 2.0**-steps, 500
    t = places(count, 1)
    ask = on_own_lines(t, axis=axis)
    found = bisect(ask, segments([10.0] * count, [0.0] * count, [1.0] * count, axis=axis), finest, 3)
    assert torch.equal(found.segment, torch.arange(count)) and found.axis == axis
    assert torch.equal(found.across, torch.arange(count, dtype=torch.float64))
    # 1e-12: the place is the middle of the bracket to rounding at 10
    assert bool(((found.place - 10 - t).abs() <= found.width / 2 + 1e-12).all())
    assert float(found.width.max()) <= finest and float(found.width.min()) > finest / 2.5
    assert bool((found.before == 0).all()) and bool((found.after == 1).all()) and bool((found.jump == 1).all())
    assert ask.count <= (MOST - 14 + steps) * count


def test_brackets_of_an_axis_edge_do_not_err_alike() -> None:
    """5 lines a pixel in 60 rows, sampled at 5 phases: without a random place there would be 5 errors, and their mean would not be small.

    A place uniform in its bracket errs by width / √12. The mean of 300 such is 0 within 4.42 standard errors but once in 10^5 seeds.
    """
    t = 6.377
    f = Ask(lambda x, y: step(x > t))
    samples = sampled(f, 5, 60, 12)
    found = bisect(f, candidates(samples, 0), FINEST, 11)
    error = (found.place - t) / (found.width / math.sqrt(12))
    assert len(error) == 300
    assert len(torch.unique((error * 1e6).round())) > 290
    assert 0.85 < float(error.std()) < 1.15  # five standard errors of the deviation of 300 uniform numbers, 0.45 / √300
    assert abs(float(error.mean())) < 4.42 / math.sqrt(300)


def test_another_seed_gives_other_brackets_and_the_same_seed_the_same() -> None:
    t = places(50, 2)
    some = segments([10.0] * 50, [0.0] * 50, [1.0] * 50)
    one, again, other = (bisect(on_own_lines(t), some, FINEST, seed).place for seed in (1, 1, 2))
    assert torch.equal(one, again)
    assert int((one != other).sum()) > 45


@pytest.mark.parametrize("jumps", [(0.5, 0.5), (0.3, 0.7), (3.0, -2.0), (-1.0, 0.5)])
def test_both_jumps_of_three_colours(jumps: tuple[float, float]) -> None:
    """A|B|C with B of 0.3 px, which holds one of the quarters' places for certain."""
    count = 200
    t = 0.7 * places(count, 3)
    ask = Ask(lambda x, y: jumps[0] * step(x - 10 > t[y.long()]) + jumps[1] * step(x - 10.3 > t[y.long()]))
    found = bisect(ask, segments([10.0] * count, [0.0] * count, [sum(jumps)] * count), FINEST, 4)
    assert torch.equal(found.segment, torch.arange(count).repeat_interleave(2))
    for k, shift in enumerate((0.0, 0.3)):
        assert bool(((found.place[k::2] - 10 - shift - t).abs() <= found.width[k::2] / 2 + 1e-12).all())
        assert float((found.jump[0, k::2] - jumps[k]).abs().max()) < 1e-12


def test_a_small_jump_beside_a_large_one_is_found_to_a_sixteenth() -> None:
    """A tenth of the change is less than what is followed to the end; a hundredth is less than what is followed at all."""
    found = bisect(Ask(lambda x, y: 0.1 * step(x > 10.2) + 0.9 * step(x > 10.7)), segments([10.0], [0.0], [1.0]), FINEST, 4)
    assert found.jump[0].tolist() == pytest.approx([0.1, 0.9], abs=1e-15)
    assert abs(float(found.place[0]) - 10.2) <= float(found.width[0]) / 2 <= 1 / 32
    assert abs(float(found.place[1]) - 10.7) <= FINEST / 2
    found = bisect(Ask(lambda x, y: 0.01 * step(x > 10.2) + 0.99 * step(x > 10.7)), segments([10.0], [0.0], [1.0]), FINEST, 4)
    assert len(found) == 1 and float(found.jump) == pytest.approx(0.99, abs=1e-15)


@pytest.mark.parametrize("width", [0.65, 0.8, 1.0])
def test_a_ramp_is_no_jump(width: float) -> None:
    """Parts of a ramp are followed to 1/16 px; those of more than 0.4 px in all are no steps."""
    ask = Ask(lambda x, y: ((x - 10.5) / width + 0.5).clamp(0, 1))
    assert len(bisect(ask, segments([10.0] * 20, [0.0] * 20, [1.0] * 20), FINEST, 5)) == 0
    assert ask.count <= 20 * 19  # three quarters' places, sixteenths, and no more


@pytest.mark.parametrize("width", [0.001, 0.01, 0.03, 0.1])
def test_a_short_ramp_is_several_steps_that_add_up(width: float) -> None:
    """Each leaf is within half its width, 1/32 px at most, of its part of the ramp: so is their centre.

    Nothing is missing but where a quarter ends in the ramp; never more than the fourth that may lie outside the jumps.
    """
    count = 100
    t = 0.35 + 0.3 * places(count, 6)
    ask = Ask(lambda x, y: ((x - 10 - t[y.long()]) / width + 0.5).clamp(0, 1))
    found = bisect(ask, segments([10.0] * count, [0.0] * count, [1.0] * count), FINEST, 7)
    zero = torch.zeros(count, dtype=torch.float64)
    total = zero.index_add(0, found.segment, found.jump[0])
    centre = zero.index_add(0, found.segment, found.jump[0] * (found.place - 10)) / total
    missing = 1 - total
    assert float(missing.max()) <= 0.25 and float(missing.min()) > -1e-12
    whole = missing < 1e-12
    assert float(whole.double().mean()) > 0.5
    assert float((centre - t)[whole].abs().max()) <= 1 / 32
    assert float(found.width.max()) <= 1 / 16
    assert bool((found.jump > 0).all())


def test_a_steep_step_loses_next_to_nothing_where_a_quarter_ends_in_it() -> None:
    """A ramp of 0.01 px anywhere in the segment: parts with a fiftieth of its change are smooth, one on either side at most."""
    count = 2000
    t = 0.1 + 0.8 * places(count, 16)
    ask = Ask(lambda x, y: ((x - 10 - t[y.long()]) / 0.01 + 0.5).clamp(0, 1))
    found = bisect(ask, segments([10.0] * count, [0.0] * count, [1.0] * count), FINEST, 7)
    total = torch.zeros(count, dtype=torch.float64).index_add(0, found.segment, found.jump[0])
    assert float((1 - total).abs().max()) < 0.04


def test_a_channel_that_does_not_stand_out_is_not_followed_but_jumps_along() -> None:
    """`least` is infinite for a ramp in the second channel: brackets are those of the first, and hold the second's change."""
    some = segments([10.0], [0.0], [1.0])
    two = segments([10.0], [0.0], [1.0]).take(torch.tensor([0]))
    both = type(two)(
        0,
        two.across,
        two.low,
        two.high,
        torch.cat([two.before, two.before]),
        torch.cat([two.after, two.after]),
        torch.cat([some.least, torch.full_like(some.least, math.inf)]),
        two.phase,
        two.key,
        two.single,
        two.quiet,
        two.decided,
    )
    ask = Ask(lambda x, y: torch.stack([step(x > 10.4), 4 * step(x > 10.4) + step(x > 10.2)]))
    both.after[1] = 5
    found = bisect(ask, both, FINEST, 8)
    assert len(found) == 1
    assert found.jump[:, 0].tolist() == [1.0, 4.0]
    assert abs(float(found.place) - 10.4) <= float(found.width) / 2


def test_a_jump_that_is_a_small_part_of_the_change_is_left_to_the_samples() -> None:
    """0.3 of jump on 0.7 of ramp: what was found is less than three quarters of the change, so the segment stays as it is."""
    ask = Ask(lambda x, y: 0.3 * step(x > 10.45) + 0.7 * (x - 10))
    assert len(bisect(ask, segments([10.0], [0.0], [1.0]), FINEST, 4)) == 0
    steeper = Ask(lambda x, y: 0.85 * step(x > 10.45) + 0.15 * (x - 10))
    found = bisect(steeper, segments([10.0], [0.0], [1.0]), FINEST, 4)
    largest = int(found.jump[0].argmax())
    assert float(found.jump[0, largest]) == pytest.approx(0.85, abs=1e-4)
    assert abs(float(found.place[largest]) - 10.45) <= float(found.width[largest]) / 2


def test_too_many_pieces_are_given_up() -> None:
    """Noise changes by over a fifth in both halves of most parts: 8 pieces at most are followed, through 12 halvings, not 2^12."""
    ask = Ask(lambda x, y: rng.uniform(5, (x * 2**30).long(), y.long(), dtype=torch.float64))
    bisect(ask, segments([10.0] * 20, [0.0] * 20, [1.0] * 20), FINEST, 9)
    assert ask.count <= 20 * (3 + 8 * 12)


def test_no_segments() -> None:
    ask = Ask(lambda x, y: x)
    some = segments([10.0], [0.0], [1.0]).take(torch.tensor([], dtype=torch.long))
    found = bisect(ask, some, FINEST, 1)
    assert len(found) == 0 and ask.count == 0 and found.before.shape == (1, 0)


def test_short_segments_are_halved_at_once() -> None:
    """A segment of 2^-6 px takes 8 halvings and no quarters."""
    ask = Ask(lambda x, y: step(x > 10.007))
    found = bisect(ask, segments([10.0], [0.0], [1.0], length=2.0**-6), 2.0**-14, 1)
    assert ask.count == 8 and len(found) == 1
    assert abs(float(found.place) - 10.007) <= 2.0**-15


def test_joined_and_take() -> None:
    one = bisect(Ask(lambda x, y: step(x > 10.4)), segments([10.0], [0.0], [1.0]), FINEST, 1)
    two = bisect(Ask(lambda x, y: 2 * step(x > 20.4)), segments([20.0], [0.0], [2.0]), FINEST, 1)
    both = joined([one, two])
    assert len(both) == 2 and both.jump[0].tolist() == [1.0, 2.0]
    assert torch.equal(both.take(torch.tensor([1])).place, two.place)


def test_a_sample_inside_a_bracket_stays_on_its_side_of_the_jump() -> None:
    """Brackets between any two places, with a sample of their line within the last one: on the wrong side all of its weight would be lost."""
    count = 400
    t = places(count, 5)
    ask = on_own_lines(t)
    line = torch.arange(count)
    # as near as the bracket is wide, on either side
    sample = 10 + t + FINEST * (places(count, 6) - 0.5)
    low, high = 10 + t - 2.0**-10 * (0.5 + places(count, 7)), 10 + t + 2.0**-10 * (0.5 + places(count, 8))
    before, after = torch.zeros(1, count, dtype=torch.float64), torch.ones(1, count, dtype=torch.float64)
    found = bisect(ask, brackets(0, line.to(torch.float64), low, high, before, after, sample.frac(), line), FINEST, 1)
    assert len(found) == count
    assert torch.equal(found.place < sample, t < sample - 10)
    assert bool(((found.place - 10 - t).abs() <= found.width / 2 + 1e-12).all())


def test_crossings_lie_on_the_side_that_the_samples_were_seen_on() -> None:
    """Samples up to 2^-16 px off their jumps, of an f that sees these half as far off elsewhere, as float32 does; others stay where they are."""
    count = 400
    t, off = places(count, 5), places(count, 7) - 0.5
    found = bisect(on_own_lines(t), segments([10.0] * count, [0.0] * count, [1.0] * count), FINEST, 1)
    sample = found.place + 2.0**-16 * off
    sample[::4] += 0.1
    found = replace(found, phase=sample.frac())
    moved = sided(on_own_lines(sample - 10 + 2.0**-17 * (places(count, 9) - 0.5)), found)
    seen = on_own_lines(sample - 10 + 2.0**-17 * (places(count, 9) - 0.5))(sample, torch.arange(count, dtype=torch.float64))[0] > 0
    near = torch.arange(count) % 4 > 0
    assert torch.equal(moved.place < sample, torch.where(near, seen, found.place < sample))
    assert torch.equal(moved.place[~near], found.place[~near]) and float((moved.place - found.place).abs().max()) < 2.0**-16
    assert 100 < int((moved.place != found.place).sum()) < 200
