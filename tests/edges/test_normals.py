"""Which way edges face, from jumps on lines."""

from __future__ import annotations

import math

import pytest
import torch
from on_lines import FINEST, Ask, sampled, step

from torch_mcaa.edges.bisect import bisect
from torch_mcaa.edges.candidates import candidates
from torch_mcaa.edges.normals import REACH, slopes


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("angle", [0.0, 20.0, 45.0, -65.0])
def test_slopes_of_a_straight_edge(angle: float, axis: int) -> None:
    """Two places known to 2^-12 px each, 1/16 px apart: within 2^-7 of a slope, and none from 3 on."""
    c, s = math.cos(math.radians(angle)), math.sin(math.radians(angle))

    def f(x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        along, across = (x, y) if axis == 0 else (y, x)
        return step(c * along + s * across > 6 * (c + s) + 0.13)

    ask = Ask(f)
    jumps = bisect(ask, candidates(sampled(ask), axis), 2.0**-8, 1)
    index, slope = slopes(ask, jumps, 1)
    assert abs(s / c) < REACH and len(jumps) >= 20 and len(index) == len(jumps)
    assert float((slope + s / c).abs().max()) <= 2.0**-7


def test_no_slope_of_noise_of_flat_edges_or_of_two_close_by() -> None:
    flat = Ask(lambda x, y: step(0.2 * x + y > 7.1))
    jumps = bisect(flat, candidates(sampled(flat), 0), FINEST, 1)
    assert len(jumps) > 5 and len(slopes(flat, jumps, 1)[0]) == 0
    stripes = Ask(lambda x, y: step(torch.remainder(x + 0.3 * y, 1.7) < 0.1))
    jumps = bisect(stripes, candidates(sampled(stripes), 0), FINEST, 1)
    assert len(jumps) > 5 and len(slopes(stripes, jumps, 1)[0]) == 0
    noise = Ask(lambda x, y: torch.remainder(torch.sin(x * 12.9898e3 + y * 78.233e3) * 43758.5453, 1.0))
    jumps = bisect(noise, candidates(sampled(noise), 0), 2.0**-8, 1)
    assert len(slopes(noise, jumps, 1)[0]) <= 0.2 * len(jumps)
