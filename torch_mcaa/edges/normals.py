"""Which way an edge faces, from a jump on a line and where the edge meets another line close by."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_mcaa.edges.bisect import Crossings, ask_on, bisect, sharpened
from torch_mcaa.edges.candidates import brackets
from torch_mcaa.edges.lines import Ask
from torch_mcaa.edges.pieces import SAME

_BESIDE, REACH = 1 / 16, 3.0
"""Px: how far off the other line is; and how far along it the edge may have gone, in parts of that."""
_FINEST = 2.0**-11


def slopes(ask: Ask, jumps: Crossings, seed: int) -> tuple[Tensor, Tensor]:
    """The indices (M,) of jumps whose edge was met again, and how far it goes along their line for each px across.

    Edges flatter than a third to their line are not: the lines of the other axis see them.
    """
    number = torch.arange(len(jumps), device=jumps.place.device)
    here = sharpened(ask, jumps, number, _FINEST, seed)
    low, high, across = jumps.place - REACH * _BESIDE, jumps.place + REACH * _BESIDE, jumps.across + _BESIDE
    before, after = ask_on(ask, jumps.axis, torch.cat([low, high]), across.repeat(2)).unflatten(1, (2, -1)).unbind(1)
    beside = bisect(ask, brackets(jumps.axis, across, low, high, before, after, jumps.phase, number, kind=1), _FINEST, seed)
    first, second = (_alone(found, jumps) for found in (here, beside))
    both = (first >= 0) & (second >= 0)
    return both.nonzero()[:, 0], (beside.place[second[both]] - here.place[first[both]]) / _BESIDE


def _alone(found: Crossings, jumps: Crossings) -> Tensor:
    """(N,): which of the crossings found is that of each of the jumps, -1 where it is not the only one."""
    count = torch.bincount(found.segment, minlength=len(jumps))
    index = torch.full_like(count, -1)
    index[found.segment] = torch.arange(len(found), device=count.device)
    jump = jumps.jump[:, found.segment]
    off = (found.jump - jump).abs().amax(0) > SAME * jump.abs().amax(0)
    count[found.segment[off]] = 0
    return torch.where(count == 1, index, -1)
