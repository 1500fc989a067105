"""What is left of the evaluations, in the blocks of a cell whose jumps were not located."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from torch_mcaa.edges.pilot import Judged, Verdict
from torch_mcaa.estimators.base import MANY, dilated
from torch_mcaa.estimators.differences import Differences
from torch_mcaa.estimators.lattice.audit import tile_means
from torch_mcaa.estimators.located.blocks import BLOCK, blocks_in, by_pixel, shape_of, sizes_of
from torch_mcaa.estimators.located.counted import Counted
from torch_mcaa.estimators.located.jump_level import FEWEST_LINES
from torch_mcaa.estimators.parts import PLAIN, SAMPLED, Part, Parts, located
from torch_mcaa.grid import Cell

_CLASSES = 3
"""Steps of how much f changes in a block, by which blocks are sampled together."""
_COARSEST = 3.0
"""Evaluations a pixel: lattices of fewer points take a slope for detail, so that what is saved where f is smooth costs more than it gives."""
_EQUAL = 1 / 3
"""The part of the evaluations that all rectangles have alike."""
_FALLS, _FALLS_SMOOTH = 1.5, 3.0
"""The power of their number that the variance of shared points falls with, on edges and, at least, where f is continuous."""
_SIMPLER = 1.1
"""How much larger the squares may be that fewer rectangles are expected to err by."""
_SLOWER = 3.0
"""How much larger a lattice's character sums are, over its variance, on what changes over no less than a quarter of a pixel than on jumps: its
power is that of jumps over 1 + 2 (pi k / 4)^2, and falls by 3 to 4 more from half a dual vector to the whole."""
_SMALL = 1e-4
"""A standard error, in ranges of the part's values, below which no more samples are taken where nothing jumps."""


class Poor(NamedTuple):
    """A rectangle that is not known well enough.

    Attributes:
        had: how many evaluations a pixel it has had.
        area: the pixels of the cell in which f is asked for it: its own, and those about it that the filter reaches.
        spread: of f in it.
        doubt: the sum of its pixels' squared spreads.
        continuous: whether f is.
    """

    where: Cell
    had: int
    area: int
    spread: float
    doubt: float
    continuous: bool


def sampled_first(parts: Parts, part: Part, ask: Counted, counts: Tensor, left: int) -> None:
    """Give the blocks of `part`, from `Parts.joined`, that have had none so many of the `left` evaluations a pixel, `counts` (blocks,)."""
    cell, had = ask.cell, torch.as_tensor(part.density)[::BLOCK, ::BLOCK].flatten() > 0
    # neighbours alike
    steps = (2 ** ((4 * counts.to(torch.float64).log2()).ceil() / 4)).floor().long()
    labels = [0 if done else int(count) for count, done in zip(steps, had, strict=True)]
    wanted = [(where, labels[inside[0]]) for where, inside in cell.rectangles(BLOCK, labels) if labels[inside[0]]]
    total = sum(parts.area(ask, where) * label for where, label in wanted)
    share = min(1.0, left / max(1, total))
    for where, label in wanted:
        count = max(parts.fewest, int(label * share))
        more, took = parts.sampled(ask, where, count, left)
        left -= took
        _add(part.cut(where.within(cell)), more, 0, count, SAMPLED if count > FEWEST_LINES else PLAIN)


def poorest_of(parts: Parts, part: Part, ask: Counted, differences: Differences, judged: Judged) -> list[list[Poor]]:
    """The pixels of a cell's `part`, from `Parts.joined`, whose jumps were not located and that are not known well enough.

    In rectangles, in several ways: all alike, and in wide and narrow steps of how much f changes, by what the `differences` in its blocks
    say as they were judged. Each rectangle is asked about, so that more of them suit f better and take more.
    """
    value, variance, density = part.value, part.variance, torch.as_tensor(part.density)
    finite = value.nan_to_num(0.0, 0.0, 0.0)
    span = (finite.amax((1, 2)) - finite.amin((1, 2)))[:, None, None]
    known = _SMALL * span + 64 * torch.finfo(value.dtype).eps * finite.abs().amax((1, 2), keepdim=True)
    # beside pixels whose jumps were located the variance is pooled with that of samples which these do not need
    plain = (part.model == PLAIN) & ~dilated(located(part.model), 1)
    poor = (variance.sqrt() > known).any(0) & plain
    some = tile_means(poor.to(torch.float32), BLOCK, BLOCK).flatten().cpu() > 0
    if not bool(some.any()):
        return []
    spread, sizes, had = differences.doubt(judged), sizes_of(ask.cell), density[::BLOCK, ::BLOCK].flatten().cpu()
    steps = (spread / spread.max()).log2().div(2).ceil().clamp_min(-_CLASSES).neg()
    ways = []
    for width in (1 + _CLASSES, 2, 1):
        labels = ((1 + (steps / width).floor() + (1 + _CLASSES) * had) * some).long().tolist()
        ways.append(
            [
                Poor(
                    where,
                    (labels[inside[0]] - 1) // (1 + _CLASSES),
                    parts.area(ask, where),
                    float(spread[inside].mean()),
                    float((spread.square() * sizes)[inside].sum()),
                    not bool((judged.verdict[inside] >= Verdict.NOISE).any()),
                )
                for where, inside in ask.cell.rectangles(BLOCK, labels)
                if labels[inside[0]]
            ]
        )
    return ways


def sampled_further(
    parts: Parts, part: Part, ask: Counted, ways: list[list[Poor]], edges: Tensor | None, slow: Tensor, left: int, most: int | None
) -> None:
    """Give more samples, of the `left` evaluations, to the rectangles of a `part` of the cell, in the first of the ways in which it errs about least.

    slow: bool (blocks,), in which f is continuous, and has no detail: there a lattice errs by less than on jumps that it sees as much of.
    With what they have had, a third in equal shares and the rest by Neyman's allocation, the spread of neighbouring samples in the
    place of the standard deviation; at most `most` a pixel on average. With lattices that suit the directions of the `edges` (blocks, DIRECTIONS).
    """
    several = [_counts(way, left, most, parts.fewest) for way in ways]
    enough = _SIMPLER * min(counts.doubt for counts in several)
    counts = next(counts for counts in several if counts.doubt <= enough)
    steady = by_pixel(slow.to(part.model.device).view(shape_of(ask.cell)), ask.cell)
    expected = sum(poor.area * count for poor, count in counts.more)
    for poor, count in counts.more:
        # strips that are whole may have taken more than their share
        share = max(float(parts.fewest), count * min(1.0, left / expected))
        expected -= poor.area * count
        suited = None if edges is None else edges[blocks_in(ask.cell, poor.where)].sum(0).numpy()
        if suited is not None and not 0 < suited.sum() < math.inf:
            suited = None
        more, took = parts.sampled(ask, poor.where, share, left, suited, poor.continuous)
        left -= took
        at = poor.where.within(ask.cell)
        _add(part.cut(at), _calmed(more, steady[at]), poor.had, share, SAMPLED)


def _calmed(part: Part, slow: Tensor) -> Part:
    """Where f is `slow` (h, w) the variance that the samples told of is smaller."""
    blind = 0 if part.blind is None else part.blind
    return replace(part, variance=torch.where(slow, blind + (part.variance - blind) / _SLOWER, part.variance))


def _add(here: Part, more: Part, had: int, count: float, model: int) -> None:
    """Merge a lattice of `count` points a pixel, in place, into a rectangle that has `had` some, but for pixels whose jumps were located."""
    assert here.blind is not None and here.heavy is not None and isinstance(here.density, Tensor)
    free, seen = here.model == PLAIN, 0 if more.blind is None else more.blind
    if had:
        share = free * _share(here.variance * free, had, more.variance * free, count)
        here.value.add_((more.value - here.value) * share)
        here.variance.copy_(here.variance * (1 - share) ** 2 + more.variance * share**2)
        here.blind.copy_(here.blind * (1 - share) ** 2 + seen * share**2)
    else:
        here.value[:], here.variance[:], here.blind[:] = more.value, more.variance, seen
    here.model.masked_fill_(free, model)
    here.density.add_(free * count)
    if more.heavy is not None:
        here.heavy.logical_or_(more.heavy & free)


class _Counts(NamedTuple):
    """How many more evaluations a pixel some rectangles are given, and by what all are then expected to be off: the sum of the squares."""

    more: list[tuple[Poor, float]]
    doubt: float


def _counts(poor: list[Poor], left: int, most: int | None, fewest: int) -> _Counts:
    """Of rectangles those that are given more: `fewest` or more."""
    falls = _FALLS_SMOOTH if all(part.continuous for part in poor) else _FALLS
    doubt, parts = sum(part.doubt / max(part.had, 1) ** falls for part in poor), poor
    while parts:
        area = [part.area for part in parts]
        total, had = sum(area), sum(n * part.had for n, part in zip(area, parts, strict=True))
        each = (left + had) / total if most is None else min(most, (left + had) / total)
        mean = sum(n * part.spread for n, part in zip(area, parts, strict=True)) / total
        counts = [each * (_EQUAL + (1 - _EQUAL) * part.spread / mean) - part.had for part in parts]
        if all(part.continuous and not part.had for part in parts):
            counts = _raised(counts, area, min(_COARSEST, each))
        enough = [part.had > 0 and count < fewest for part, count in zip(parts, counts, strict=True)]
        if not any(enough):
            more = [(part, max(float(fewest), count)) for part, count in zip(parts, counts, strict=True)]
            gain = (part.doubt * (max(part.had, 1) ** -falls - (part.had + count) ** -falls) for part, count in more)
            return _Counts(more, doubt - sum(gain))
        parts = [part for part, done in zip(parts, enough, strict=True) if not done]
    return _Counts([], doubt)


def _raised(counts: list[float], area: list[int], least: float) -> list[float]:
    """The counts, none of them under `least`, which is no more than their mean; the others pay for it in proportion."""
    low: list[bool] = []
    while (lower := [count <= least for count in counts]) != low:
        low = lower
        paid = sum(n * (least - count) for n, count, under in zip(area, counts, low, strict=True) if under)
        rest = sum(n * count for n, count, under in zip(area, counts, low, strict=True) if not under)
        counts = [least if under else count * (1 - paid / rest) for count, under in zip(counts, low, strict=True)]
    return counts


def _share(first: Tensor, had: float, second: Tensor, more: float) -> float:
    """The weight of a second lattice of `more` points a pixel beside a first of `had`.

    n^1.5, the inverse variance on edges, or, if that is more for the larger lattice, the inverse means of their variances over a block, of
    which a few pixels tell too little: a small lattice may take detail for none, and a large one is far better where f is smooth.
    """
    share = more**_FALLS / (more**_FALLS + had**_FALLS)
    mine, theirs = (float(v.to(torch.float64).mean()) for v in (first, second))
    if first[0].numel() < MANY or not 0 < mine + theirs < math.inf:
        return share
    return (max if more > had else min)(share, mine / (mine + theirs))
