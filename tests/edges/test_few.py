"""Brackets narrowed a few at a time: as `bisect` does, in fewer calls."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from on_lines import FINEST, Ask, step

from torch_mcaa.edges.few import Brackets, Few

SLOPE = 0.037


def edge(across: np.ndarray) -> np.ndarray:
    return 4.031 + SLOPE * across


def brackets(count: int, width: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, Brackets]:
    """On lines a fifth of a pixel apart, about an edge up to 2: their numbers, places, phases of samples, and the brackets."""
    line = np.arange(count)
    across = line / 5
    low = edge(across) - 0.31 * width
    return line, across, np.full(count, 0.9), Brackets(low, low + width, np.zeros((1, count)), np.full((1, count), 2.0))


@pytest.mark.parametrize(("count", "calls"), [(1, 2), (12, 2), (13, 6), (200, 6)])
def test_brackets_hold_the_jump(count: int, calls: int) -> None:
    """From 2^-6 to 2^-12 px: in 16 parts and 4 up to one for each 2^14 pixels, more by halves."""
    ask = Ask(lambda x, y: 2 * step(x > 4.031 + SLOPE * y))
    line, across, phase, wide = brackets(count, 2.0**-6)
    single, found = Few(ask, 0, torch.device("cpu"), 12 << 14).narrowed(line, across, phase, wide, 1.1 * 2.0**-12)
    assert single.all()
    assert ((found.low < edge(across)) & (edge(across) < found.high)).all()
    assert (found.high - found.low).max() <= 1.1 * 2.0**-12
    assert (found.before == 0).all() and (found.after == 2).all()
    assert len(ask.places) == calls
    # along the other axis the places are rows
    turned = Few(Ask(lambda x, y: 2 * step(y > 4.031 + SLOPE * x)), 1, torch.device("cpu"), 12 << 14)
    assert (turned.narrowed(line, across, phase, wide, 1.1 * 2.0**-12)[1].low == found.low).all()


def test_brackets_of_a_straight_edge_do_not_err_alike() -> None:
    """The edge lies at the same place in all first brackets; where it lies in the last ones is as good as uniform: the mean of 200 within 4 sigma."""
    ask = Ask(lambda x, y: 2 * step(x > 4.031 + SLOPE * y))
    line, across, phase, wide = brackets(200, 2.0**-6)
    _, found = Few(ask, 0, torch.device("cpu"), 12 << 14).narrowed(line, across, phase, wide, FINEST)
    share = (edge(across) - found.low) / (found.high - found.low)
    assert abs(share.mean() - 0.5) < 4 / np.sqrt(12 * 200)
    assert share.std() > 0.2


def test_what_is_not_one_jump_is_told() -> None:
    """A second jump, a ramp beside the jump, and no jump at all."""
    line, across, phase, wide = brackets(3, 2.0**-6)

    def f(x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        off = x - (4.031 + SLOPE * y)
        two = step(off > 0) + step(off > 0.002)
        ramp = step(off > 0) + ((off + 0.005) * 64).clamp(0, 1)
        return torch.where(y < 0.1, two, torch.where(y < 0.3, ramp, (off + 0.31 * 2.0**-6) * 128))

    single, _ = Few(Ask(f), 0, torch.device("cpu"), 12 << 14).narrowed(line, across, phase, wide, FINEST)
    assert not single.any()


def test_no_bracket_holds_a_sample() -> None:
    ask = Ask(lambda x, y: 2 * step(x > 4.031 + SLOPE * y))
    line, across, _, wide = brackets(5, 2.0**-6)
    for off in (-1e-6, 1e-6):
        phase = (edge(across) + off) % 1
        single, found = Few(ask, 0, torch.device("cpu"), 12 << 14).narrowed(line, across, phase, wide, FINEST)
        sample = np.floor(edge(across)) + phase
        assert single.all()
        assert ((sample <= found.low) | (sample >= found.high)).all()
        assert ((found.low < edge(across)) & (edge(across) < found.high)).all()


def test_no_places_are_no_calls_of_f() -> None:
    ask = Ask(lambda x, y: x)
    none = np.zeros(0)
    single, found = Few(ask, 0, torch.device("cpu"), 12 << 14).narrowed(
        np.zeros(0, dtype=np.int64), none, none, Brackets(none, none, none[None], none[None]), FINEST
    )
    assert len(single) == len(found.low) == ask.count == 0
