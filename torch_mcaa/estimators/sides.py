"""Filters that end in a step, as the box does: a line just inside counts whole and one just outside not at all."""

from __future__ import annotations

import math

import torch

from torch_mcaa.filters import Filter, SeparableFilter

_CUT = 0.01
"""What w may have at its sides, in parts of what it has in the middle, to go to 0 there."""


def ends_in_step(filter: SeparableFilter) -> bool:
    """Whether w does not go to 0 at its sides."""
    middle, side = filter.profile(torch.tensor([0.0, filter.half_width], dtype=torch.float64)).abs().tolist()
    return side >= _CUT * middle


def sides(filter: Filter) -> float | None:
    """The fraction of a pixel at which the sides of the filters of all pixels lie, if they end in a step there; None if not.

    Lines halfway about it make the mean over lines a midpoint rule, whose error is of the order of n^-2 in the place of 0.3 / n.
    """
    if not isinstance(filter, SeparableFilter) or math.isinf(filter.half_width) or not ends_in_step(filter):
        return None
    width = 2 * filter.half_width
    return (0.5 + filter.half_width) % 1.0 if abs(width - round(width)) < 1e-9 else None
