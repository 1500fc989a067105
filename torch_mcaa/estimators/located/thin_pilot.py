"""The thin pieces that a pilot's samples hit, followed over its lines: which blocks they cross without being hit there."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from torch_mcaa.edges.bisect import Crossings, bisect_all
from torch_mcaa.edges.candidates import Segments
from torch_mcaa.edges.lines import Lines
from torch_mcaa.edges.pilot import Judged, Verdict
from torch_mcaa.edges.thin import complete
from torch_mcaa.estimators.located.blocks import blocks_at, blocks_of, pixels_of
from torch_mcaa.estimators.located.counted import Counted, Spent
from torch_mcaa.estimators.located.thin_pieces import THINNEST

_SHARE, _LINE = 0.05, 16.0
"""Of what is left, what it may take, and what a line takes: dense detail does not pay for it, and is told by how often samples hit it."""


def with_thin_pieces(ask: Counted, judged: Judged, found: list[Segments], samples: Lines, seed: int) -> Judged:
    """With the blocks that thin pieces cross among those that jump, and so many lines of the pilot that cross them.

    samples: one a pixel. found: the candidates along either axis.
    """
    cell = ask.cell
    jumps = judged.verdict == Verdict.JUMPS
    thin = [s.take(s.single & s.least.isfinite().any(0) & jumps[blocks_of(cell, s)]) for s in found]
    if not any(len(s) for s in thin) or _LINE * float(judged.lines.sum()) > _SHARE * ask.left:
        return judged
    wanted = torch.ones(cell.height, cell.width, dtype=torch.bool, device=jumps.device)
    try:
        with ask.keeping(1 - _SHARE):
            every = [
                complete(ask, crossings, samples, wanted, (cell.row, cell.col), THINNEST, seed)
                for crossings in bisect_all(ask, thin, THINNEST, seed)
            ]
    except Spent:
        return judged
    seen = sum((_blocks(ask, crossings, len(jumps)) for crossings in every), torch.zeros_like(judged.tried)) / 2
    verdict = judged.verdict.clone()
    verdict[(verdict == Verdict.NONE) & (seen > 0)] = Verdict.JUMPS
    # what could not be followed, or was not hit in all of the cell, is as much as the hits tell
    none = verdict == Verdict.NONE
    lines = torch.where(none, 0, torch.where(jumps, torch.maximum(seen, judged.lines), seen))
    rest = (judged.lines.sum() - lines.sum()).clamp_min(0)
    return replace(judged, verdict=verdict, lines=lines + none * (rest / none.count_nonzero().clamp_min(1)))


def _blocks(ask: Counted, crossings: Crossings, count: int) -> Tensor:
    """(blocks,): how many crossings lie in each block."""
    at = pixels_of(ask.cell, crossings.axis, crossings.place, crossings.across)
    return torch.bincount(blocks_at(ask.cell, *at), minlength=count)
