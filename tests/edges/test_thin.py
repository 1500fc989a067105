"""Thin pieces: found again on every line that they cross, and nothing else."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
import torch
from on_lines import FINEST, Ask, all_lines, crossings, sampled, step
from torch import Tensor

from torch_mcaa.edges.bisect import Crossings, bisect, joined
from torch_mcaa.edges.candidates import candidates
from torch_mcaa.edges.lines import Samples
from torch_mcaa.edges.pieces import SHORT, Known, Numbered, pieces_of
from torch_mcaa.edges.thin import beside, complete, unfollowed

SIZE, AROUND = 24, 4
EVERYWHERE = torch.ones(SIZE, SIZE, dtype=torch.bool)
Function = Callable[[Tensor, Tensor], Tensor]


def wanted() -> Tensor:
    inside = torch.zeros(SIZE, SIZE, dtype=torch.bool)
    inside[AROUND:-AROUND, AROUND:-AROUND] = True
    return inside


def found_by(
    f: Function, axis: int = 0, finest: float = FINEST, lines: int = 5, shift: tuple[float, float] = (0.3217, 0.7113), seed: int = 1
) -> tuple[Crossings, Crossings, Samples, Ask]:
    """The crossings that samples found, those completed, the samples, and what completing them took."""
    ask = Ask(f)
    samples = sampled(ask, lines, SIZE, SIZE, shift=shift)
    hit = bisect(ask, candidates(samples, axis), finest, seed)
    ask.count = 0
    return hit, complete(ask, hit, samples, wanted(), (0, 0), finest, seed), samples, ask


class Stripe:
    """Points within `width` / 2 of a straight line through the screen's centre and `off` px beside it, whose normal is at `angle` to x."""

    def __init__(self, angle: float, width: float, off: float = 0.0) -> None:
        self.cos, self.sin, self.width = math.cos(math.radians(angle)), math.sin(math.radians(angle)), width
        self.middle = (self.cos + self.sin) * SIZE / 2 + off

    def __call__(self, x: Tensor, y: Tensor) -> Tensor:
        return step((self.cos * x + self.sin * y - self.middle).abs() < self.width / 2)

    def ends(self, line: Tensor) -> tuple[Tensor, Tensor]:
        """Where horizontal lines meet it."""
        return tuple((self.middle + side * self.width / 2 - self.sin * line) / self.cos for side in (-1, 1))


def misses(found: Crossings, lines: Tensor, place: Tensor, jump: float, slack: float) -> tuple[int, int]:
    """How many of the jumps (one a line) were not found, and how many more than once."""
    on = (found.across[:, None] - lines).abs() < 1e-6
    hits = (on & ((found.place[:, None] - place).abs() <= slack) & ((found.jump[0, :, None] - jump).abs() < 1e-9)).sum(0)
    return int((hits == 0).sum()), int((hits > 1).sum())


def inside(lines: Tensor, first: Tensor, second: Tensor) -> Tensor:
    middle = (first + second) / 2
    return (lines > AROUND) & (lines < SIZE - AROUND) & (middle > AROUND) & (middle < SIZE - AROUND)


def check_stripe(stripe: Stripe, axis: int, finest: float, **options: object) -> int:
    """All lines inside `wanted` that a stripe crosses have both crossings once; no crossing is elsewhere. How many samples had found."""
    f: Function = stripe if axis == 0 else lambda x, y: stripe(y, x)
    hit, found, samples, _ = found_by(f, axis, finest, **options)  # type: ignore[arg-type]
    assert len(hit) > 0
    lines = all_lines(samples, axis)
    first, second = stripe.ends(lines)
    chosen = inside(lines, first, second)
    assert int(chosen.sum()) > 20
    for place, jump in ((first, 1.0), (second, -1.0)):
        assert misses(found, lines[chosen], place[chosen], jump, finest / 2 + 1e-9) == (0, 0)
    ends = torch.stack(stripe.ends(found.across))
    assert float((found.place - ends).abs().amin(0).max()) <= finest / 2 + 1e-9
    return len(hit)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("angle", [0.7, 10, 25, 40, 55, 65, -33])
def test_a_stripe_of_a_tenth_of_a_pixel(angle: float, axis: int) -> None:
    """Its 80 lines inside are all found from the tenth or so that samples hit: so is it for four places of the stripe."""
    for k in range(4):
        stripe = Stripe(angle, 0.1, 0.21 * k)
        most = check_stripe(stripe, axis, FINEST, shift=(0.1 + 0.137 * k, 0.05 + 0.157 * k))
        assert most < 2 * SIZE * 5 / 2


def test_a_stripe_under_nine_lines_and_three_channels() -> None:
    stripe = Stripe(17, 0.05, 0.3)
    _, found, samples, _ = found_by(lambda x, y: stripe(x, y) * torch.tensor([[1.0], [0.0], [-2.0]], dtype=torch.float64), lines=9)
    lines = all_lines(samples, 0)
    first, second = stripe.ends(lines)
    chosen = inside(lines, first, second)
    assert int(chosen.sum()) == 9 * 16
    for place, jump in ((first, 1.0), (second, -1.0)):
        assert misses(found, lines[chosen], place[chosen], jump, FINEST) == (0, 0)
    assert float((found.jump[2] + 2 * found.jump[0]).abs().max()) < 1e-12 and not found.jump[1].any()


def test_a_hairline_is_followed_as_far_as_it_goes() -> None:
    """Of 0.003 px under 151 lines, 1,000 of which have no sample in it: found on all of them, and not with calls of f for each."""
    stripe = Stripe(12, 0.003, 0.3)
    hit, found, samples, ask = found_by(stripe, lines=151, shift=(0.31, 0.05))
    lines = all_lines(samples, 0)
    first, second = stripe.ends(lines)
    chosen = inside(lines, first, second)
    assert float(hit.across.sort().values.diff().max()) > 6 and int(chosen.sum()) > 2400
    for place, jump in ((first, 1.0), (second, -1.0)):
        assert misses(found, lines[chosen], place[chosen], jump, FINEST) == (0, 0)
    assert len(ask.places) < 400


def test_the_ends_foretold_do_not_err_alike() -> None:
    """The mean error of the brackets' middles: within 4.4 (1e-5 of a normal's) of what independent errors of uniform distribution have."""
    stripe = Stripe(12, 0.05, 0.3)
    _, found, _, _ = found_by(stripe, lines=61)
    ends = torch.stack(stripe.ends(found.across))
    error = (found.place - ends)[(found.place - ends).abs().argmin(0), torch.arange(len(found))]
    assert abs(float(error.mean())) < 4.4 * FINEST / math.sqrt(12 * len(found))


def test_ends_known_roughly_are_followed_too() -> None:
    """Of 0.05 px, hit ends in brackets of 2^-8 px: slopes over a hundredth of a pixel would lead nowhere. Found on all lines, to `FINEST`."""
    for k in range(4):
        stripe = Stripe(14, 0.05, 0.21 * k)
        ask = Ask(stripe)
        samples = sampled(ask, 7, SIZE, SIZE, shift=(0.1 + 0.137 * k, 0.05 + 0.157 * k))
        hit = bisect(ask, candidates(samples, 0), 1.1 * 2.0**-8, 1)
        found = complete(ask, hit, samples, wanted(), (0, 0), FINEST, 1)
        lines = all_lines(samples, 0)
        first, second = stripe.ends(lines)
        chosen = inside(lines, first, second)
        for place, jump in ((first, 1.0), (second, -1.0)):
            assert misses(found, lines[chosen], place[chosen], jump, FINEST) == (0, 0)


def test_no_crossing_is_there_twice_where_brackets_are_wide() -> None:
    finest = 1.1 * 2.0**-8
    twice = 0
    for k in range(6):
        stripe = Stripe(40, 0.1, 0.05 + 0.13 * k)
        _, found, samples, _ = found_by(stripe, 0, finest, shift=(0.1 + 0.137 * k, 0.05 + 0.157 * k))
        lines = all_lines(samples, 0)
        for place, jump in zip(stripe.ends(lines), (1.0, -1.0), strict=True):
            twice += misses(found, lines, place, jump, finest)[1]
    assert twice == 0


def test_two_hairlines_close_by_are_not_confused() -> None:
    """0.1 px each and 0.8 px apart: each line has all four crossings once, those of the first hairline and those of the second."""
    for angle in (5, 30, 50):
        for k in range(3):
            one, two = (Stripe(angle, 0.1, 0.17 * k + side * 0.4) for side in (-1, 1))
            _, found, samples, _ = found_by(lambda x, y: one(x, y) + two(x, y), shift=(0.2 + 0.137 * k, 0.4 + 0.157 * k))  # noqa: B023
            lines = all_lines(samples, 0)
            for stripe in (one, two):
                first, second = stripe.ends(lines)
                chosen = inside(lines, first, second)
                for place, jump in ((first, 1.0), (second, -1.0)):
                    assert misses(found, lines[chosen], place[chosen], jump, FINEST) == (0, 0)
            ends = torch.stack([*one.ends(found.across), *two.ends(found.across)])
            assert float((found.place - ends).abs().amin(0).max()) < FINEST


def test_what_lies_between_two_hairlines_keeps_their_ends() -> None:
    """0.6 px apart, both met on every third line, and one of them on those beside it, where what is between them is no piece."""
    one, two = (Stripe(15, 0.1, side * 0.3) for side in (-1, 1))
    ask = Ask(lambda x, y: one(x, y) + two(x, y))
    samples = sampled(ask, 7, SIZE, SIZE)
    lines = all_lines(samples, 0)
    jump = torch.ones(1, len(lines), dtype=torch.float64)
    ends = [
        (crossings(0, lines, a, jump, samples), crossings(0, lines, b, -jump, samples, jump))
        for a, b in (one.ends(lines), two.ends(lines))
    ]
    third = torch.arange(len(lines)) % 3
    some = joined([*ends[0], *(end.take((third == 1).nonzero()[:, 0]) for end in ends[1])])
    found = complete(ask, some, samples, wanted(), (0, 0), FINEST, 1)
    for stripe in (one, two):
        first, second = stripe.ends(lines)
        chosen = inside(lines, first, second)
        for place, size in ((first, 1.0), (second, -1.0)):
            assert misses(found, lines[chosen], place[chosen], size, FINEST) == (0, 0)


HIDDEN = pytest.mark.xfail(reason="a gap of 0.2 px is missed on some of the lines that cross it, though all neighbours have it")


@pytest.mark.parametrize(("width", "apart"), [(0.2, 0.95), pytest.param(0.45, 0.65, marks=HIDDEN)])
def test_what_two_neighbouring_samples_hide_between_them(width: float, apart: float) -> None:
    """Two stripes that neighbouring samples hit, one each: the outer ends look like one piece, and the gap of 0.75 or 0.2 px is found too."""
    one, two = (Stripe(3, width, side * apart / 2) for side in (-1, 1))
    hit, found, samples, _ = found_by(lambda x, y: one(x, y) + two(x, y))
    lines = all_lines(samples, 0)
    first, second = one.ends(lines)[1], two.ends(lines)[0]
    hidden = inside(lines, first, second) & (misses_each(hit, lines, first) & misses_each(hit, lines, second))
    assert int(hidden.sum()) > 0
    for stripe in (one, two):
        for place, jump in zip(stripe.ends(lines), (1.0, -1.0), strict=True):
            chosen = inside(lines, place, place)
            assert misses(found, lines[chosen], place[chosen], jump, FINEST) == (0, 0)


def misses_each(found: Crossings, lines: Tensor, place: Tensor) -> Tensor:
    """The lines whose crossing at `place` was not found, but which have others."""
    on = (found.across[:, None] - lines).abs() < 1e-6
    return on.any(0) & ~(on & ((found.place[:, None] - place).abs() < FINEST)).any(0)


def test_a_tapered_tip_ends() -> None:
    """A needle of 4° from its tip at y = 9.03 on: found as far as it is wider than 0.01 px, 0.15 px from its tip, and not beyond the tip."""
    slope, tip, middle = 0.035, 9.03, 12.37
    half = slope * 1.0

    def needle(x: Tensor, y: Tensor) -> Tensor:
        return step((x - middle - 0.21 * (y - tip)).abs() < half * (y - tip))

    _, found, samples, ask = found_by(needle)
    lines = all_lines(samples, 0)
    width, centre = 2 * half * (lines - tip), middle + 0.21 * (lines - tip)
    chosen = (width > 0.01) & (lines < SIZE - AROUND)
    assert int(chosen.sum()) > 50
    for side, jump in ((-0.5, 1.0), (0.5, -1.0)):
        assert misses(found, lines[chosen], (centre + side * width)[chosen], jump, FINEST) == (0, 0)
    assert float(found.across.min()) > tip
    assert ask.count < 40 * len(lines)


def test_a_hairline_too_steep_to_follow_is_left_to_the_samples() -> None:
    """At a slope of tan 80° = 5.7 px a line the samples' pairs are dropped: either all of a piece's lines are corrected or none."""
    stripe = Stripe(80, 0.1, 0.3)
    hit, found, _, _ = found_by(stripe)
    assert len(hit) >= 4
    kept = inside(found.across, found.place, found.place)
    assert int(kept.sum()) == 0


def test_wide_edges_are_not_touched() -> None:
    """A disc of 5 px has no thin pieces but where its lines' chords are short, at its top and bottom."""
    f: Function = lambda x, y: step((x - 12.1).square() + (y - 11.7).square() < 25)  # noqa: E731
    hit, found, _, _ = found_by(f)
    middle = (hit.across - 11.7).abs() < 4.9
    kept = (found.across - 11.7).abs() < 4.9
    assert int(middle.sum()) == int(kept.sum()) == 2 * 49
    assert torch.equal(torch.sort(hit.place[middle]).values, torch.sort(found.place[kept]).values)
    on_circle = ((found.place - 12.1).square() + (found.across - 11.7).square()).sqrt()
    # a chord's end errs by the bracket along the line
    error = (found.place - 12.1).abs() - (25 - (found.across - 11.7).square()).sqrt()
    assert float(error.abs().max()) < FINEST and float((on_circle - 5).abs().max()) < FINEST


def test_unfollowed_drops_the_pieces_that_samples_hit_and_no_others() -> None:
    """A stripe of 0.1 px beside an edge 1.7 px off, with its crossings known on all lines: only pairs about a sample go."""
    samples = sampled(lambda x, y: x, 5, SIZE, SIZE)
    lines = all_lines(samples, 0)
    one = torch.ones(1, len(lines), dtype=torch.float64)
    first = 8.03 + 0.31 * lines
    some = joined(
        [
            crossings(0, lines, first, one, samples),
            crossings(0, lines, first + 0.1, -one, samples, before=one),
            crossings(0, lines, first + 1.8, 3 * one, samples),
        ]
    )
    left, met, cost = unfollowed(some, samples, EVERYWHERE, (0, 0))
    grid = Numbered(samples, 0)
    phase = grid.phase(grid.number(lines))
    hit = torch.remainder(phase - first, 1) < 0.1
    assert 5 < int(hit.sum()) < 20
    expected = torch.cat([first[~hit], first[~hit] + 0.1, first + 1.8])
    assert torch.equal(torch.sort(left.place).values, torch.sort(expected).values)
    assert len(left) + len(met) == len(some) and len(met) == 2 * int(hit.sum())
    assert cost == pytest.approx(16 * (1 / 0.1 - 1) * int(hit.sum()), rel=1e-9)
    # those elsewhere go too, and nobody misses them
    nowhere, none, nothing = unfollowed(some, samples, ~EVERYWHERE, (0, 0))
    assert len(nowhere) == len(left) and len(none) == 0 and nothing == 0
    assert unfollowed(some, samples, EVERYWHERE, (0, 0), True)[2] == pytest.approx(
        16 * max(0, int(hit.sum()) / 0.1 - len(lines)), rel=1e-9
    )


def test_unfollowed_keeps_what_is_wider_than_the_samples_distance() -> None:
    samples = sampled(lambda x, y: x, 5, SIZE, SIZE)
    lines = all_lines(samples, 0)
    one = torch.ones(1, len(lines), dtype=torch.float64)
    some = joined(
        [
            crossings(0, lines, 8.03 + 0.31 * lines, one, samples),
            crossings(0, lines, 9.04 + 0.31 * lines, -one, samples, before=one),
        ]
    )
    left, met, cost = unfollowed(some, samples, EVERYWHERE, (0, 0))
    assert len(left) == len(some) and len(met) == 0 and cost == 0


def by_hand(places: list[float], colours: list[float], width: float = 0.0, across: float | None = None) -> Crossings:
    """Crossings of one line between colours[0], colours[1], ..."""
    samples = sampled(lambda x, y: x, 5, 4, 4)
    line = float(samples.y[0]) if across is None else across
    values = torch.tensor([colours], dtype=torch.float64)
    place = torch.tensor(places, dtype=torch.float64)
    return crossings(
        0, torch.full_like(place, line), place, values[:, 1:] - values[:, :-1], samples, before=values[:, :-1], width=width
    )


def test_pieces_between_neighbouring_crossings() -> None:
    """A piece for each pair with one colour between them, in the line's order, with the colours before, in and after it."""
    samples = sampled(lambda x, y: x, 5, 4, 4)
    grid = Numbered(samples, 0)
    some = by_hand([1.0, 1.2, 2.9], [0, 1, 0.5, 3]).take(torch.tensor([2, 0, 1]))
    pieces, ends = pieces_of(some, grid)
    assert some.place.numpy()[ends].tolist() == [[1.0, 1.2], [1.2, 2.9]]
    assert [pieces.first.tolist(), pieces.second.tolist()] == [[1.0, 1.2], [1.2, 2.9]]
    assert np.concatenate([pieces.before, pieces.inside, pieces.after]).tolist() == [[0, 1], [1, 0.5], [0.5, 3]]
    assert pieces.width == pytest.approx([0.2, 1.7], rel=1e-12)
    assert pieces.tolerance == pytest.approx([0.35 * 0.5, 0.35 * 0.5], rel=1e-12)
    assert pieces.line.tolist() == grid.number(some.across[:2]).tolist()


def test_no_piece_where_colours_do_not_meet_or_leaves_touch() -> None:
    samples = sampled(lambda x, y: x, 5, 4, 4)
    grid = Numbered(samples, 0)
    up, again = by_hand([1.0], [0, 1]), by_hand([1.4], [0, 1])
    assert len(pieces_of(joined([up, again]), grid)[0]) == 0
    # but what is longer than SHORT has room for a ramp
    assert len(pieces_of(joined([up, by_hand([1.1 + SHORT], [0, 1])]), grid)[0]) == 1
    # leaves of one steep step lie at the distance of their brackets
    assert len(pieces_of(by_hand([1.0, 1.03, 1.06], [0, 1, 2, 3], width=0.03), grid)[0]) == 0
    assert len(pieces_of(by_hand([1.0, 1.2], [0, 1, 0], width=0.03), grid)[0]) == 1
    one, next_one = torch.sort(samples.y).values[:2].tolist()
    ends = [by_hand([1.0], [0, 1], across=one), by_hand([1.2], [1, 0], across=next_one)]
    assert len(pieces_of(joined(ends), grid)[0]) == 0


def test_lines_are_counted_in_order_over_the_screen() -> None:
    """Also at negative pixels: each next line is 1 / n further, and number, across and phase agree with the samples'."""
    samples = sampled(lambda x, y: x, 7, 6, 6, -3, -2)
    for axis in (0, 1):
        grid = Numbered(samples, axis)
        lines = all_lines(samples, axis)
        number = grid.number(lines)
        assert torch.equal(torch.diff(number), torch.ones(len(lines) - 1, dtype=torch.long))
        assert float((grid.across(number) - lines).abs().max()) < 1e-9
        across, phase = (samples.y, samples.x) if axis == 0 else (samples.x, samples.y)
        index = (torch.remainder(lines[:, None] - across + 0.5, 1) - 0.5).abs().argmin(1)
        assert torch.equal(grid.phase(number), phase[index])
        assert grid.across_of(number.numpy()).tolist() == grid.across(number).tolist()
        assert grid.phase_of(number.numpy()).tolist() == grid.phase(number).tolist()


def test_known_pieces_by_place_width_and_colour() -> None:
    samples = sampled(lambda x, y: x, 5, 4, 4)
    pieces, _ = pieces_of(by_hand([1.0, 1.2, 2.9, 3.1], [0, 1, 0, 1, 0]), Numbered(samples, 0))
    known = Known(pieces)
    line = pieces.line[:1]

    def at(first: float, second: float, colour: float, slack: float = 0.05, step: int = 0) -> bool:
        return bool(known.at(line + step, np.array([first]), np.array([second]), np.array([[colour]]), np.array([0.3]), slack) >= 0)

    assert at(1.0, 1.2, 1.0) and at(1.22, 1.42, 1.0) and at(0.78, 0.98, 1.0) and at(3.0, 3.2, 0.8)
    assert not at(1.26, 1.46, 1.0)  # beyond the slack
    assert not at(0.7, 0.9, 1.0)
    assert not at(1.0, 1.2, 0.6)  # another colour
    assert not at(1.0, 1.2, 1.0, step=1)  # another line
    assert not at(1.05, 1.1, 1.0) and not at(0.9, 1.35, 1.0)  # less than half, or more than twice, as wide
    none = Known(pieces.take(np.array([], dtype=np.int64)))
    one = pieces.take(np.array([0]))
    assert none.at(line, one.first, one.second, one.inside, one.tolerance, 0.1).tolist() == [-1]


def test_fewer_than_two_crossings_are_returned_as_they_are() -> None:
    samples = sampled(lambda x, y: x, 5, 4, 4)
    ask = Ask(lambda x, y: x)
    one = by_hand([1.0], [0, 1])
    assert complete(ask, one, samples, wanted(), (0, 0), FINEST, 1) is one
    assert ask.count == 0


def test_what_one_axis_loses_the_other_may_have() -> None:
    """Hits of a stripe on vertical lines: beside the stripe's crossings on horizontal lines all, beside those of another 0.6 px off none."""
    samples, one = sampled(lambda x, y: x, 9, SIZE, SIZE), torch.ones(1, 16 * 9, dtype=torch.float64)
    grid = Numbered(samples, 0)
    lines = all_lines(samples, 0)
    lines = lines[(lines > AROUND) & (lines < SIZE - AROUND)]
    columns = torch.linspace(6, 10, len(lines), dtype=torch.float64)
    hit = crossings(1, columns, (columns - 4.0) / 0.4 + 0.01, one, samples)
    for off, expected in ((0.0, True), (0.6, False)):
        other = crossings(0, lines, 4.0 + 0.4 * lines + off, one, samples)
        assert bool((beside(hit, other, grid) == expected).all())
    assert not bool(beside(hit, crossings(0, lines[:0], lines[:0], one[:, :0], samples), grid).any())
