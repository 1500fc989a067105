"""Which neighbours on a line may have a jump between them: steps, and nothing else."""

from __future__ import annotations

import dataclasses
import math

import pytest
import torch
from on_lines import all_lines, sampled, scatter, step
from torch import Tensor

from torch_mcaa import rng
from torch_mcaa.edges.candidates import Segments, candidates, threshold
from torch_mcaa.edges.lines import Scattered

EDGE = 6.377


@pytest.mark.parametrize("axis", [0, 1])
def test_a_step_is_found_on_every_line_across_it_and_on_none_along_it(axis: int) -> None:
    row, col = -2, 30
    t = EDGE + (col if axis == 0 else row)
    samples = sampled(lambda x, y: 2 - 3 * step((x if axis == 0 else y) > t), row=row, col=col)
    found, along = candidates(samples, axis), candidates(samples, 1 - axis)
    assert len(along) == 0
    assert torch.equal(torch.sort(found.across).values, all_lines(samples, axis))
    assert bool(((found.low < t) & (found.high > t)).all())
    assert torch.allclose(found.high - found.low, torch.ones(len(found), dtype=torch.float64), atol=1e-12)
    assert bool((found.before == 2).all()) and bool((found.after == -1).all())
    assert torch.equal(found.least, threshold(found.after - found.before))
    assert not found.single.any()
    # where the samples lie, and what random numbers hang on: no two alike
    assert float((torch.remainder(found.low - found.phase + 0.5, 1) - 0.5).abs().max()) < 1e-12
    assert len(torch.unique(found.key, dim=0)) == len(found)
    line, at_row, at_col = found.key.unbind(1)
    x, y = samples.x[line] + at_col, samples.y[line] + at_row
    assert torch.allclose(found.low, x if axis == 0 else y) and torch.allclose(found.across, y if axis == 0 else x)


def noise(x: Tensor, y: Tensor) -> Tensor:
    keys = ((x * 2**20).long(), (y * 2**20).long())
    return rng.uniform(5, *keys, dtype=torch.float64)


SMOOTH = {
    "constant": lambda x, y: torch.full_like(x, 0.7),
    "ramp": lambda x, y: 0.1 * x - 3 * y,
    "steep ramp": lambda x, y: 1e6 * (x + y),
    "sinusoid": lambda x, y: (2 * math.pi * x / 16 + 1).sin() * (2 * math.pi * y / 20).cos(),
    "parabola": lambda x, y: (x - EDGE).square() + (y - 5.1).square(),
    "kink": lambda x, y: (x - EDGE).abs() + 2 * (y - EDGE).clamp_min(0),
    "rounding noise": lambda x, y: 1 + 8 * torch.finfo(torch.float64).eps * noise(x, y),
}


AROUND = 4
"""Segments on either side that one is compared with."""


@pytest.mark.parametrize("name", SMOOTH)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_what_does_not_jump_is_no_candidate(name: str, dtype: torch.dtype) -> None:
    """Away from the samples' border, where there are four differences on either side."""
    samples = sampled(lambda x, y: SMOOTH[name](x, y).to(dtype), rows=20, cols=20)
    for axis in (0, 1):
        low = candidates(samples, axis).low
        assert int(((low > AROUND) & (low < 20 - AROUND - 2)).sum()) == 0


@pytest.mark.xfail(reason="of a side that the samples cut off only what is left of it is compared with")
def test_what_does_not_jump_is_no_candidate_at_the_border_either() -> None:
    """x² with its minimum four pixels from the border: differences 11, 9, 7, 5, 3, 1, 1, 3, 5 of the samples."""
    samples = sampled(lambda x, y: SMOOTH["parabola"](x, y), rows=20, cols=20)
    assert [len(candidates(samples, axis)) for axis in (0, 1)] == [0, 0]


def test_rounding_noise_of_float32_is_no_candidate() -> None:
    """Values of 1000 ± 8 units in the last place."""
    samples = sampled(lambda x, y: (1000 * (1 + 8 * torch.finfo(torch.float32).eps * (noise(x, y) - 0.5))).to(torch.float32))
    assert len(torch.unique(samples.values)) > 4
    assert [len(candidates(samples, axis)) for axis in (0, 1)] == [0, 0]


@pytest.mark.parametrize("over_rounding", [1e3, 1e9])
def test_a_step_is_found_however_small_beside_its_values(over_rounding: float) -> None:
    """1 and 1 + a thousand times the rounding: 64 units in the last place are rounding, no more."""
    size = over_rounding * 64 * torch.finfo(torch.float64).eps
    samples = sampled(lambda x, y: 1 + size * step(x > EDGE))
    assert len(candidates(samples, 0)) == 12 * 5


def test_a_step_on_a_ramp_is_found_from_three_times_the_slope_on() -> None:
    """A ramp of slope 1 changes by 1 a segment: with a jump of 1.5 by 2.5 there, with one of 2.5 by 3.5."""
    counts = [len(candidates(sampled(lambda x, y, s=size: x + s * step(x > EDGE)), 0)) for size in (1.5, 2.5)]
    assert counts == [0, 12 * 5]


@pytest.mark.parametrize("width", [0.002, 0.01, 0.02])
def test_the_tail_of_a_steep_step_is_no_candidate(width: float) -> None:
    """A sigmoid's differences fall by e^(1 / width) from each segment to the next, e^50 or more: far more than three times, but to nothing.

    A place within 28 widths of a sample, e^-28 being the 1e-12 that counts as nothing, has two segments with a difference.
    """
    samples = sampled(lambda x, y: torch.sigmoid((x - EDGE) / width), lines=21)
    found = candidates(samples, 0)
    beyond = torch.maximum(found.low - EDGE, EDGE - found.high)
    assert len(torch.unique(found.across)) == 12 * 21
    assert float(beyond.max()) < 28 * width


def two_edges(x: Tensor, y: Tensor) -> Tensor:
    return torch.stack([step(x > 4.4), 5 * step(x > 8.6), x / 10])


def test_channels_with_edges_of_their_own() -> None:
    """`least` is finite only in the channel that stands out; the others' values are there all the same."""
    found = candidates(sampled(two_edges), 0)
    left, right = found.low < 6, found.low >= 6
    assert int(left.sum()) == int(right.sum()) == 12 * 5
    finite = found.least.isfinite()
    assert torch.equal(finite, torch.stack([left, right, torch.zeros_like(left)]))
    assert torch.equal(found.least[finite], threshold(found.after - found.before)[finite])
    assert torch.allclose((found.after - found.before)[2], torch.full((120,), 0.1, dtype=torch.float64))


def test_one_segment_for_two_channels_that_jump_together() -> None:
    found = candidates(sampled(lambda x, y: torch.stack([step(x > EDGE), -2 * step(x > EDGE + 1e-3)])), 0)
    assert len(found) == 12 * 5
    assert bool((found.least == torch.tensor([[0.2], [0.4]], dtype=torch.float64)).all())


@pytest.mark.parametrize("axis", [0, 1])
def test_single_marks_both_segments_beside_a_lone_sample(axis: int) -> None:
    """A stripe of 0.7 px holds one sample of a line or none: its two segments, and nobody else's."""
    samples = sampled(lambda x, y: step(((x if axis == 0 else y) - 5.9).abs() < 0.35) + step((x if axis == 0 else y) > 9.3))
    found = candidates(samples, axis)
    lone = found.low < 8
    assert bool(found.single[lone].all())
    assert not bool(found.single[~lone].any())
    hit = torch.unique(found.across[lone])
    assert int(lone.sum()) == 2 * len(hit) > 0
    assert int((~lone).sum()) == 12 * 5


def test_single_where_the_samples_end() -> None:
    """What lies beyond the samples may be the other end of a thin piece."""
    found = candidates(sampled(lambda x, y: step(x > 0.95)), 0)
    assert len(found) > 0 and bool(found.single.all())


def test_a_steep_continuous_step_is_no_thin_piece() -> None:
    """One sigmoid of 0.03 px: no sample lies alone between two changes of like size."""
    found = candidates(sampled(lambda x, y: torch.sigmoid((x - EDGE) / 0.03), lines=21), 0)
    most = (found.after - found.before).abs()[0] > 0.9
    assert int(most.sum()) > 0
    assert not bool(found.single[most].any())


def unasked() -> Scattered:
    asked = torch.ones(12, 12, dtype=torch.bool)
    asked[:, 6:] = False
    return scatter(sampled(lambda x, y: 5 + step(x > 2.4)), asked)


def test_nothing_is_found_between_samples_and_what_was_not_asked() -> None:
    """The jump among the samples is found, and nothing at their end."""
    found = candidates(unasked(), 0)
    assert len(found) == 12 * 5
    assert float(found.high.max()) < 4
    assert len(candidates(unasked(), 1)) == 0


@pytest.mark.parametrize("axis", [0, 1])
def test_scattered_samples_have_the_candidates_that_all_have(axis: int) -> None:
    """Edges, a thin piece and noise in three channels, all pixels asked: the same segments, but for their order."""

    def f(x: Tensor, y: Tensor) -> Tensor:
        return torch.stack([step((x - y).abs() < 0.2), step(torch.hypot(x - 6, y - 6) < 4), noise(x, y)])

    samples = sampled(f)
    every, some = candidates(samples, axis), candidates(scatter(samples), axis)
    assert len(every) > 100

    def ordered(s: Segments) -> Segments:
        return s.take(torch.argsort((s.key[:, 1] * 100 + s.key[:, 2]) * 100 + s.key[:, 0]))

    for field in dataclasses.fields(Segments)[1:]:
        assert torch.equal(getattr(ordered(every), field.name), getattr(ordered(some), field.name)), field.name


def test_take_keeps_channels() -> None:
    found = candidates(sampled(two_edges), 0)
    some = found.take(found.low < 6)
    assert len(some) == 60 and some.before.shape == (3, 60) and some.key.shape == (60, 3)
    assert torch.equal(found.take(torch.tensor([7])).after[:, 0], found.after[:, 7])
