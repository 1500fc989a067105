"""A square along the axes: what the lines along each of its edges miss at its corners."""

from __future__ import annotations

import pytest
import torch
from on_lines import View, all_lines, crossings, sampled, scatter, step, weighed
from torch import Tensor

import torch_mcaa as mcaa
from torch_mcaa.edges.bisect import Crossings, joined
from torch_mcaa.edges.lines import Everywhere
from torch_mcaa.filters import SeparableFilter

SIZE = 16
LEFT, RIGHT, TOP, BOTTOM = 5.27, 10.83, 4.61, 11.34


def rectangle(x: Tensor, y: Tensor) -> Tensor:
    return step((x > LEFT) & (x < RIGHT) & (y > TOP) & (y < BOTTOM))


def exact(axis: int, samples: Everywhere) -> Crossings:
    """Both crossings of every line along `axis` that meets the rectangle."""
    (low, high), (first, last) = ((LEFT, RIGHT), (TOP, BOTTOM)) if axis == 0 else ((TOP, BOTTOM), (LEFT, RIGHT))
    lines = all_lines(samples, axis)
    lines = lines[(lines > first) & (lines < last)]
    one = torch.ones(1, len(lines), dtype=torch.float64)
    return joined(
        [
            crossings(axis, lines, torch.full_like(lines, low), one, samples),
            crossings(axis, lines, torch.full_like(lines, high), -one, samples, before=one),
        ]
    )


def truth(filter: SeparableFilter) -> Tensor:
    centres = torch.arange(SIZE, dtype=torch.float64) + 0.5
    x = filter.profile_cdf(RIGHT - centres) - filter.profile_cdf(LEFT - centres)
    y = filter.profile_cdf(BOTTOM - centres) - filter.profile_cdf(TOP - centres)
    return y[:, None] * x


def errors(filter: SeparableFilter, lines: int, axis: int) -> tuple[Tensor, Tensor]:
    """What remains of the error with one axis' crossings, without and with the ends of the edges along its lines."""
    samples = sampled(rectangle, lines, SIZE, SIZE)
    view = View(3, 3, SIZE - 6, SIZE - 6, filter)
    rows, cols = (index.flatten() + 3 for index in torch.meshgrid(*(torch.arange(SIZE - 6),) * 2, indexing="ij"))
    plain = weighed(scatter(samples), filter, rows, cols, 3).view(SIZE - 6, SIZE - 6)
    corrected = plain + view.correction(exact(axis, samples), lines)[0][0]
    missed = view.ends(exact(1 - axis, samples), samples)[0]
    expected = truth(filter)[3:-3, 3:-3]
    return corrected - expected, corrected + missed - expected


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize(("lines", "least", "left"), [(5, 3e-2, 3e-3), (9, 5e-3, 1.1e-3), (15, 3e-3, 5e-4)])
@pytest.mark.parametrize("filter", [mcaa.Gaussian(0.5), mcaa.Tent(), mcaa.Mitchell()], ids=str)
def test_the_ends_of_edges_are_corrected(filter: SeparableFilter, lines: int, least: float, left: float, axis: int) -> None:
    """The lines along one axis miss what a rectangle's edges along them cover: 6e-2 at worst with 5 lines a pixel, 4e-2 with 9.

    What is left with the ends is of second order in the lines' distance, at the corners alone: 2.4e-3 with 5, 9e-4 with 9, 4e-4 with 15.
    """
    without, whole = errors(filter, lines, axis)
    assert float(without.abs().max()) > least
    assert float(whole.abs().max()) < min(left, float(without.abs().max()) / 5)
    # away from the corners, where one axis' lines are alone, the sum is right
    rows, cols = torch.meshgrid(*(torch.arange(SIZE - 6) + 3.5,) * 2, indexing="ij")
    reach = filter.half_width + 0.5
    corner = (torch.minimum((cols - LEFT).abs(), (cols - RIGHT).abs()) < reach) & (
        torch.minimum((rows - TOP).abs(), (rows - BOTTOM).abs()) < reach
    )
    if bool((~corner).any()):
        assert float(whole[~corner].abs().max()) < 2e-5  # the Gaussian's weights add up to 1 within 1e-5 at 5 lines


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("place", [8.237, 8.5])
@pytest.mark.parametrize("filter", [mcaa.Tent(), mcaa.Box(), mcaa.Mitchell()], ids=str)
def test_a_whole_edge_along_the_lines(filter: SeparableFilter, place: float, axis: int) -> None:
    """f = 1 beyond `place` across the lines along `axis`, between two of them or on one: mean and ends are its integral to rounding.

    For filters whose weights add up to one at every lattice.
    """

    def beyond(x: Tensor, y: Tensor) -> Tensor:
        return step((y if axis == 0 else x) > place)

    samples = sampled(beyond, 5, SIZE, SIZE, shift=(0.5, 0.5))
    lines = all_lines(samples, 1 - axis)
    some = crossings(1 - axis, lines, torch.full_like(lines, place), torch.ones(1, len(lines), dtype=torch.float64), samples)
    view = View(3, 3, SIZE - 6, SIZE - 6, filter)
    rows, cols = (index.flatten() + 3 for index in torch.meshgrid(*(torch.arange(SIZE - 6),) * 2, indexing="ij"))
    plain = weighed(scatter(samples), filter, rows, cols, 3).view(SIZE - 6, SIZE - 6)
    expected = 1 - filter.profile_cdf(place - torch.arange(3, SIZE - 3, dtype=torch.float64) - 0.5)
    expected = (expected[:, None] if axis == 0 else expected).expand(SIZE - 6, SIZE - 6)
    assert float((plain - expected).abs().max()) > 1e-3
    assert float((plain + view.ends(some, samples)[0] - expected).abs().max()) < 1e-12


def test_edges_that_cross_the_lines_have_no_ends() -> None:
    """A slope of a fifth is steeper than 0.1: none of its crossings says anything of a jump between lines."""
    samples = sampled(lambda x, y: step(y > 5 + 0.2 * x), 5, SIZE, SIZE)
    lines = all_lines(samples, 1)
    some = crossings(1, lines, 5 + 0.2 * lines, torch.ones(1, len(lines), dtype=torch.float64), samples)
    view = View(3, 3, SIZE - 6, SIZE - 6, mcaa.Tent())
    some = some.take((lines > 0) & (lines < SIZE))
    assert not view.ends(some, samples).any()
    flat = crossings(1, lines, 5 + 0.05 * lines, torch.ones(1, len(lines), dtype=torch.float64), samples)
    assert float(view.ends(flat, samples).abs().max()) > 1e-4


def test_neighbouring_crossings_of_other_jumps_are_no_edge() -> None:
    """Jumps of alternating sign at one height: no edge goes on from one line to the next."""
    samples = sampled(lambda x, y: x, 5, SIZE, SIZE)
    lines = all_lines(samples, 1)
    signs = (-torch.ones(len(lines), dtype=torch.float64)).pow(torch.arange(len(lines)))
    view = View(3, 3, SIZE - 6, SIZE - 6, mcaa.Tent())
    height = torch.full_like(lines, 8.23)
    assert not view.ends(crossings(1, lines, height, signs[None], samples), samples).any()
    assert view.ends(crossings(1, lines, height, signs.abs()[None], samples), samples).any()


def test_channels_and_no_crossings() -> None:
    samples = sampled(rectangle, 5, SIZE, SIZE)
    view = View(3, 3, SIZE - 6, SIZE - 6, mcaa.Tent())
    some = exact(1, samples)
    two = Crossings(
        1,
        some.across,
        some.place,
        some.width,
        torch.cat([some.before, -2 * some.before]),
        torch.cat([some.after, -2 * some.after]),
        some.phase,
        some.segment,
    )
    found = view.ends(two, samples)
    assert torch.allclose(found[1], -2 * found[0], atol=1e-15) and found[0].any()
    assert not view.ends(some.take(torch.tensor([], dtype=torch.long)), samples).any()
