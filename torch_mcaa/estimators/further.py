"""What is left of the evaluations, in the blocks of a cell whose jumps were not located."""

from __future__ import annotations

import math
from dataclasses import replace

import torch
from torch import Tensor

from torch_mcaa.estimators.audit import tile_means
from torch_mcaa.estimators.base import MANY
from torch_mcaa.estimators.blocks import BLOCK, blocks_in
from torch_mcaa.estimators.parts import FEWEST, PLAIN, SAMPLED, Part, Parts
from torch_mcaa.grid import Cell

_CLASSES = 3
"""Steps of how much f changes in a block, by which blocks are sampled together."""
_SMALL = 1e-4
"""A standard error, in ranges of the part's values, below which no more samples are taken where nothing jumps."""


def sampled_first(parts: Parts, part: Part, cell: Cell, counts: Tensor, left: int) -> Part:
    """Of the `left` evaluations so many a pixel, `counts` (blocks,), in the blocks that have had none."""
    density = torch.as_tensor(part.density).expand(cell.height, cell.width).clone()
    had = density[::BLOCK, ::BLOCK].flatten() > 0
    # neighbours alike
    steps = (2 ** ((4 * counts.to(torch.float64).log2()).ceil() / 4)).floor().long()
    heavy = torch.zeros_like(part.value, dtype=torch.bool) if part.heavy is None else part.heavy.clone()
    labels = [0 if done else int(count) for count, done in zip(steps, had, strict=True)]
    assert part.blind is not None
    pixels = [(where, labels[inside[0]]) for where, inside in cell.rectangles(BLOCK, labels) if labels[inside[0]]]
    total = sum(where.height * where.width * label for where, label in pixels)
    for where, label in pixels:
        at, count = where.within(cell), max(parts.fewest, int(label * min(1.0, left / max(1, total))))
        more = parts.sampled(where, count, where.height * where.width * count)
        part.value[:, *at], part.variance[:, *at] = more.value, more.variance
        part.blind[:, *at] = 0 if more.blind is None else more.blind
        part.points[at] += more.points
        part.invalid[at] += more.invalid
        part.model[at] = SAMPLED if count > FEWEST else PLAIN
        density[at] = count
        if more.heavy is not None:
            heavy[:, *at] |= more.heavy
    return replace(part, heavy=heavy if bool(heavy.any()) else None, density=density)


def sampled_further(
    parts: Parts, part: Part, cell: Cell, spread: Tensor, edges: Tensor | None, left: int, most: int | None
) -> Part:
    """More samples, of the `left` evaluations, in the blocks with pixels whose jumps were not located and that are not known well enough.

    With what they have had, a third in equal shares and the rest by Neyman's allocation, the `spread` (blocks,) of neighbouring samples in the
    place of the standard deviation; at most `most` a pixel on average. With lattices that suit the directions of the `edges` (blocks, DIRECTIONS).
    """
    value, variance, free = part.value, part.variance, part.model == PLAIN
    finite = value.nan_to_num(0.0, 0.0, 0.0)
    span = (finite.amax((1, 2)) - finite.amin((1, 2)))[:, None, None]
    known = _SMALL * span + 64 * torch.finfo(value.dtype).eps * finite.abs().amax((1, 2), keepdim=True)
    poor = (variance.sqrt() > known).any(0) & free
    some = tile_means(poor.to(torch.float32), BLOCK, BLOCK).flatten().cpu() > 0
    density = torch.as_tensor(part.density).expand(cell.height, cell.width)
    # what a block has had, and, in steps of a factor of 4, how much f changes in it
    steps = (spread / spread.max()).log2().div(2).ceil().clamp_min(-_CLASSES).neg()
    labels = ((1 + steps + (1 + _CLASSES) * density[::BLOCK, ::BLOCK].flatten().cpu()) * some).long().tolist()
    # rectangle, what it has had a pixel, its spread
    poorest = [
        (where, (labels[inside[0]] - 1) // (1 + _CLASSES), float(spread[inside].mean()))
        for where, inside in cell.rectangles(BLOCK, labels)
        if labels[inside[0]]
    ]
    heavy = torch.zeros_like(value, dtype=torch.bool) if part.heavy is None else part.heavy.clone()
    density, blind = density.clone(), torch.zeros_like(variance) if part.blind is None else part.blind
    for where, had, count in _counts(poorest, left, most, parts.fewest):
        at = where.within(cell)
        suited = None if edges is None else edges[blocks_in(cell, where)].sum(0).numpy()
        more, here = (
            parts.sampled(where, count, left, suited if suited is not None and 0 < suited.sum() < math.inf else None),
            free[at],
        )
        left -= more.spent
        seen = 0 if more.blind is None else more.blind
        if had:
            share = here * _share(variance[:, *at] * here, had, more.variance * here, count)
            value[:, *at] += (more.value - value[:, *at]) * share
            variance[:, *at] = variance[:, *at] * (1 - share) ** 2 + more.variance * share**2
            blind[:, *at] = blind[:, *at] * (1 - share) ** 2 + seen * share**2
        else:
            value[:, *at], variance[:, *at], blind[:, *at] = more.value, more.variance, seen
        part.points[at] += more.points
        part.invalid[at] += more.invalid
        part.model[at] = torch.where(here, SAMPLED, part.model[at])
        density[at] += here * count
        if more.heavy is not None:
            heavy[:, *at] |= more.heavy & here
    return Part(value, variance, part.points, part.invalid, heavy if bool(heavy.any()) else None, part.model, density, blind)


def _counts(parts: list[tuple[Cell, int, float]], left: int, most: int | None, fewest: int) -> list[tuple[Cell, int, float]]:
    """Of parts (cell, what it has had a pixel, spread) those that are given more, and how many evaluations a pixel: `fewest` or more."""
    while parts:
        pixels = [where.height * where.width for where, _, _ in parts]
        total, had = sum(pixels), sum(n * had for n, (_, had, _) in zip(pixels, parts, strict=True))
        each = (left + had) / total if most is None else min(most, (left + had) / total)
        mean = sum(n * spread for n, (_, _, spread) in zip(pixels, parts, strict=True)) / total
        counts = [each * (1 + 2 * spread / mean) / 3 - had for _, had, spread in parts]
        enough = [had > 0 and count < fewest for (_, had, _), count in zip(parts, counts, strict=True)]
        if not any(enough):
            return [(where, had, max(float(fewest), count)) for (where, had, _), count in zip(parts, counts, strict=True)]
        parts = [part for part, done in zip(parts, enough, strict=True) if not done]
    return []


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
