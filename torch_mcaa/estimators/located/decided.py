"""Jumps where f decides: from segments between whose ends a trace saw it decide differently to crossings, by the decisions' margins."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from torch_mcaa.edges.bisect import Crossings, joined
from torch_mcaa.edges.candidates import Segments, threshold, without
from torch_mcaa.edges.candidates import joined as together
from torch_mcaa.estimators.located.blocks import deciding, told
from torch_mcaa.estimators.located.counted import Counted
from torch_mcaa.grid import Cell
from torch_mcaa.picking import ranked
from torch_mcaa.traced.refine import located
from torch_mcaa.traced.scan import Brackets
from torch_mcaa.traced.scan import Segments as Differing
from torch_mcaa.traced.visitors import Causes

_FREQUENT, _TRIED = 64, 32
_MIX = 0x1E3779B97F4A7C15
"""An odd number: products with it are in an order that looks random."""
_PART = 1 << 14
"""Segments that are looked at together."""
_SMOOTH = 0.02
"""A jump is at least so much of what f changes by in the segments that hold it, or f is continuous there."""
_NONE = 1e-12
"""A jump that is none, in magnitudes of f there."""
_WIDTH = 2.0**-17
"""Px: how exactly the margins tell a place."""


def crossings(ask: Counted, segments: Segments, seed: int) -> tuple[Crossings, Segments]:
    """The jumps in segments that are `decided`, and the segments between whose ends f decides alike when it is asked in float64.

    Those are for bisection: an edge lies within the rounding of a sample.
    """
    every = torch.arange(len(segments), device=segments.low.device)
    if len(segments) <= _PART:
        return _crossings(ask, segments, seed)
    # what is known of a segment while it is looked at is ten times as much as in the end
    found, rest = zip(*(_crossings(ask, segments.take(part), seed) for part in every.split(_PART)), strict=True)
    found = [replace(one, segment=one.segment + number * _PART) for number, one in enumerate(found)]
    return joined(found), together(list(rest))


def _crossings(ask: Counted, segments: Segments, seed: int) -> tuple[Crossings, Segments]:
    found = _differing(ask, segments)
    # where nothing crosses zero, bisection of values tells the place
    met = (found.cause >= 0) & (found.margin[0] != found.margin[1])
    changes = located(ask.decisions, found.take(met), seed)
    (before, after), (low, high) = changes.values.unbind(1), changes.margin
    some = ((after - before).abs() > _NONE * changes.values.abs().amax(1)).any(0)
    share = (low / (low - high)).nan_to_num(0.5).clamp(0, 1)
    place = torch.lerp(changes.brackets.low, changes.brackets.high, share)[some]
    root = changes.brackets.line[some]
    kind = segments.before.dtype
    unmet = segments.take(~met)
    return Crossings(
        segments.axis,
        segments.across[root],
        place,
        torch.full_like(place, _WIDTH),
        before[:, some].to(kind),
        after[:, some].to(kind),
        segments.phase[root],
        root,
    ), replace(unmet, least=threshold(unmet.after - unmet.before), decided=torch.zeros_like(unmet.decided))


def _differing(ask: Counted, segments: Segments) -> Differing:
    """The segments as the trace has them, with the first decision that differs; `line` is the number of the segment."""
    count, number = len(segments), torch.arange(len(segments), device=segments.low.device)
    none = torch.zeros_like(number)
    flat, whole = torch.full_like(number, segments.axis), torch.ones_like(segments.low)
    brackets = Brackets(flat, segments.across, segments.low, segments.high, none, none, number, none == 0, whole, none)
    seen, step = [], ask.decisions.at_once // 2
    for start in range(0, count, step):
        part = brackets.some(slice(start, start + step))
        col, row = part.places(torch.stack([part.low, part.high]))
        n = len(part)
        seen.append(ask.decisions.run(col.flatten(), row.flatten(), lambda n=n: Causes((2, n), 0, False, ask.decisions.device))[1])
    if not seen:
        return Differing(brackets, none, none, none.expand(3, 0).T, whole.expand(2, 0), whole)
    signature = torch.cat([s.signatures(2 * s.pairs).view(2, -1) for s in seen], 1)
    cause, differing, branch = (torch.cat([getattr(s, name) for s in seen]) for name in ("cause", "differing", "branch"))
    brackets = replace(brackets, before=signature[0], after=signature[1])
    return Differing(brackets, cause, differing, branch, torch.cat([s.margin for s in seen], 1), whole)


def worthwhile(ask: Counted, cell: Cell, found: list[Segments], seed: int) -> tuple[list[Segments], Tensor, Tensor]:
    """The segments without those whose decisions do not make f jump, the kinds of these, and in which blocks of the cell f decides."""
    kinds = smooth(ask, found, seed)
    found = [without(s, kinds) for s in found]
    blocks = deciding(cell, found)
    return [told(cell, s, blocks) for s in found], kinds, blocks


def smooth(ask: Counted, found: list[Segments], seed: int) -> Tensor:
    """The kinds of decisions (`Segments.decided`) that many segments hold and that do not seem to make f jump, as at the borders of texels."""
    every = torch.cat([s.decided for s in found])
    kinds, kind, counts = torch.unique(every, return_inverse=True, return_counts=True)
    frequent = (counts > _FREQUENT) & (kinds > 0)
    # some of each, at random
    order, rank, _ = ranked(kind, torch.cat([s.stream for s in found]) * _MIX)
    tried = torch.zeros_like(every, dtype=torch.bool)
    tried[order] = (rank < _TRIED) & frequent[kind[order]]
    jump, size = torch.zeros_like(kinds), torch.zeros_like(kinds)
    for segments, some, which in zip(found, *(t.split([len(s) for s in found]) for t in (tried, kind)), strict=True):
        segments, which = segments.take(some), which[some]
        jumps, _ = crossings(ask, segments, seed)
        for total, change, where in ((jump, jumps.jump, which[jumps.segment]), (size, segments.after - segments.before, which)):
            total.scatter_reduce_(0, where, change.abs().amax(0).to(total.dtype), "amax")
    return kinds[frequent & (jump <= _SMOOTH * size)]
