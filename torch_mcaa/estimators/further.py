"""What is left of the evaluations, in the blocks of a cell whose jumps were not located."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torch_mcaa.edges.pilot import Verdict
from torch_mcaa.estimators.base import MANY, dilated
from torch_mcaa.estimators.differences import Differences
from torch_mcaa.estimators.lattice.audit import tile_means
from torch_mcaa.estimators.located.blocks import BLOCK, blocks_in
from torch_mcaa.estimators.located.jump_level import FEWEST_LINES
from torch_mcaa.estimators.parts import PLAIN, SAMPLED, Part, Parts, located
from torch_mcaa.grid import Cell

_CLASSES = 3
"""Steps of how much f changes in a block, by which blocks are sampled together."""
_COARSEST = 3.0
"""Evaluations a pixel: lattices of fewer points take a slope for detail, so that what is saved where f is smooth costs more than it gives."""
_SMALL = 1e-4
"""A standard error, in ranges of the part's values, below which no more samples are taken where nothing jumps."""


class Poor(NamedTuple):
    """A rectangle that is not known well enough, how many evaluations a pixel it has had, the spread of f in it, and whether f is continuous."""

    where: Cell
    had: int
    spread: float
    continuous: bool


def sampled_first(parts: Parts, part: Part, cell: Cell, counts: Tensor, left: int) -> None:
    """Give the blocks of `part`, from `Parts.joined`, that have had none so many of the `left` evaluations a pixel, `counts` (blocks,)."""
    had = torch.as_tensor(part.density)[::BLOCK, ::BLOCK].flatten() > 0
    # neighbours alike
    steps = (2 ** ((4 * counts.to(torch.float64).log2()).ceil() / 4)).floor().long()
    labels = [0 if done else int(count) for count, done in zip(steps, had, strict=True)]
    pixels = [(where, labels[inside[0]]) for where, inside in cell.rectangles(BLOCK, labels) if labels[inside[0]]]
    total = sum(where.height * where.width * label for where, label in pixels)
    for where, label in pixels:
        count = max(parts.fewest, int(label * min(1.0, left / max(1, total))))
        more = parts.sampled(where, count, where.height * where.width * count)
        _add(part.cut(where.within(cell)), more, 0, count, SAMPLED if count > FEWEST_LINES else PLAIN)


def poorest_of(part: Part, cell: Cell, differences: Differences, verdict: Tensor) -> list[Poor]:
    """The rectangles of a cell's `part`, from `Parts.joined`, with pixels whose jumps were not located and that are not known well enough.

    By what its blocks' `differences` under their verdicts (blocks,) say in the place of the standard deviation.
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
    spread = differences.doubt(verdict)
    # what a block has had, and, in steps of a factor of 4, how much f changes in it
    steps = (spread / spread.max()).log2().div(2).ceil().clamp_min(-_CLASSES).neg()
    labels = ((1 + steps + (1 + _CLASSES) * density[::BLOCK, ::BLOCK].flatten().cpu()) * some).long().tolist()
    return [
        Poor(
            where,
            (labels[inside[0]] - 1) // (1 + _CLASSES),
            float(spread[inside].mean()),
            not bool((verdict[inside] >= Verdict.NOISE).any()),
        )
        for where, inside in cell.rectangles(BLOCK, labels)
        if labels[inside[0]]
    ]


def sampled_further(
    parts: Parts, part: Part, cell: Cell, poorest: list[Poor], edges: Tensor | None, left: int, most: int | None
) -> None:
    """Give more samples, of the `left` evaluations, to the `poorest` of a `part` of the cell.

    With what they have had, a third in equal shares and the rest by Neyman's allocation, the spread of neighbouring samples in the
    place of the standard deviation; at most `most` a pixel on average. With lattices that suit the directions of the `edges` (blocks, DIRECTIONS).
    """
    for (where, had, _, continuous), count in _counts(poorest, left, most, parts.fewest):
        suited = None if edges is None else edges[blocks_in(cell, where)].sum(0).numpy()
        if suited is not None and not 0 < suited.sum() < math.inf:
            suited = None
        more = parts.sampled(where, count, left, suited, continuous)
        left -= more.spent
        _add(part.cut(where.within(cell)), more, had, count, SAMPLED)


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
    here.points.add_(more.points)
    here.invalid.add_(more.invalid)
    here.model.masked_fill_(free, model)
    here.density.add_(free * count)
    if more.heavy is not None:
        here.heavy.logical_or_(more.heavy & free)


def _counts(parts: list[Poor], left: int, most: int | None, fewest: int) -> list[tuple[Poor, float]]:
    """Of parts those that are given more, and how many more evaluations a pixel: `fewest` or more."""
    while parts:
        pixels = [part.where.height * part.where.width for part in parts]
        total, had = sum(pixels), sum(n * part.had for n, part in zip(pixels, parts, strict=True))
        each = (left + had) / total if most is None else min(most, (left + had) / total)
        mean = sum(n * part.spread for n, part in zip(pixels, parts, strict=True)) / total
        counts = [each * (1 + 2 * part.spread / mean) / 3 - part.had for part in parts]
        if all(part.continuous and not part.had for part in parts):
            counts = _raised(counts, pixels, min(_COARSEST, each))
        enough = [part.had > 0 and count < fewest for part, count in zip(parts, counts, strict=True)]
        if not any(enough):
            return [(part, max(float(fewest), count)) for part, count in zip(parts, counts, strict=True)]
        parts = [part for part, done in zip(parts, enough, strict=True) if not done]
    return []


def _raised(counts: list[float], pixels: list[int], least: float) -> list[float]:
    """The counts, none of them under `least`, which is no more than their mean; the others pay for it in proportion."""
    low: list[bool] = []
    while (lower := [count <= least for count in counts]) != low:
        low = lower
        paid = sum(n * (least - count) for n, count, under in zip(pixels, counts, low, strict=True) if under)
        rest = sum(n * count for n, count, under in zip(pixels, counts, low, strict=True) if not under)
        counts = [least if under else count * (1 - paid / rest) for count, under in zip(counts, low, strict=True)]
    return counts


def _share(first: Tensor, had: float, second: Tensor, more: float) -> float:
    """The weight of a second lattice of `more` points a pixel beside a first of `had`.

    n^1.5, the inverse variance on edges, or, if that is more for the larger lattice, the inverse means of their variances over a block, of
    which a few pixels tell too little: a small lattice may take detail for none, and a large one is far better where f is smooth.
    """
    share = more**1.5 / (more**1.5 + had**1.5)
    mine, theirs = (float(v.to(torch.float64).mean()) for v in (first, second))
    if first[0].numel() < MANY or not 0 < mine + theirs < math.inf:
        return share
    return (max if more > had else min)(share, mine / (mine + theirs))
