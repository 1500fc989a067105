"""Where changes crowd: segments of 1 px then meet one with another probability than that of the thin piece that it ends.

A segment shows that it holds changes only if its ends differ. A piece A|B|A by itself is met with the probability of its chord; of
A|B|A|B|A, repeated within a pixel or two, a segment may hold two changes or three, and which of them are seen depends on them all. So a few of
the segments that differ are looked at closely, with a pixel on either side. In blocks where changes are met with other probabilities than thin
pieces by themselves, segments at random take the place of those that differ, and are cut finely. What every other line tells decides for the
lines between: if a piece that is met now and then decided what becomes of itself, that would be a selection.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torch_mcaa import rng
from torch_mcaa.picking import numbers, pick, ranked
from torch_mcaa.traced.asked import Asked
from torch_mcaa.traced.scan import Brackets, Segments, differing, held, joined, share, together
from torch_mcaa.traced.visitors import Causes

FINE = 8
"""Parts of a pixel that a segment is cut into."""
_BLOCK = 16
"""Px: what is found of a segment is taken to hold in squares of this size."""
_EACH, _PARTS = 6, 4
"""One of so many segments of a block, or one at least, tells whether changes crowd there; and what a pixel of it is cut into."""
_OFF = 0.05
"""From this difference on a probability is another one."""
_RARE = 0.01
"""The share of looks that may be off where changes do not crowd."""
_CLOSE, _FINELY = 0xC105E, 0xF17E


@dataclass(frozen=True)
class Blocks:
    """Squares of the screen, each with every other of `lines` lines a pixel, by number."""

    numbers: Tensor
    lines: int

    def hold(self, axis: int | Tensor, along: Tensor, across: Tensor) -> Tensor:
        """bool (N,): whether they hold places on lines along an axis."""
        return torch.isin(_block(axis, along, across, self.lines), self.numbers)


def _block(axis: int | Tensor, along: Tensor, across: Tensor, lines: int) -> Tensor:
    """(N,): the number of the block that each place is in, with the lines that its own is one of."""
    horizontal = torch.as_tensor(axis, device=along.device) == 0
    ends = torch.where(horizontal, along, across), torch.where(horizontal, across, along)
    col, row = (place.div(_BLOCK, rounding_mode="floor").long() for place in ends)
    # a screen has fewer columns
    return 2 * (row * 2**31 + col) + (across * lines).floor().long() % 2


def crowded(asked: Asked, found: Brackets, lines: int, seed: int, closed: bool) -> Blocks:
    """The blocks in which changes crowd, by what the lines beside tell; `found`: the segments of 1 px that differ, on `lines` lines a pixel."""
    block = _block(found.axis, found.low, found.across, lines)
    order, rank, count = ranked(2 * block + found.axis, found.numbers(seed))
    chosen = rank < (count // _EACH).clamp_min(1)
    order, rank = order[chosen], rank[chosen]
    looked, block = found.take(order), block[order]
    # what segments seldom meet lies elsewhere on their lines
    anywhere = rng.uniform(seed, _CLOSE, _CLOSE, looked.numbers(seed), dtype=torch.float64)
    anywhere = _BLOCK * (looked.low.div(_BLOCK, rounding_mode="floor") + anywhere)
    differing = rank % 2 == 0
    low = torch.where(differing, looked.low, anywhere)
    looked = replace(looked, low=low, high=low + 1)
    other = torch.zeros_like(block, dtype=torch.bool)
    count = 3 * _PARTS + 2
    most = max(1, asked.at_once // count)
    for part in (slice(start, start + most) for start in range(0, len(looked), most)):
        some = looked.some(part)
        phase = rng.uniform(seed, _CLOSE, some.numbers(seed), dtype=torch.float64)
        place = some.low - 1 + (torch.arange(-1, count - 1, device=phase.device)[:, None] + phase) / _PARTS
        if closed:
            place = held(asked, some.axis, place)
        col, row = some.places(place)
        shape = (count, len(some))
        _, seen = asked.run(col.flatten(), row.flatten(), lambda shape=shape: Causes(shape, 0, False, asked.device), coarse=True)
        signature = seen.signatures(place.numel()).view(place.shape)
        differs = signature[1:] != signature[:-1]
        before, after = seen.margin.view(2, *differs.shape)
        ratio = torch.where(differs, (before / (before - after)).nan_to_num(0.5).clamp(0, 1), 0.5)
        cut = torch.lerp(place[:-1], place[1:], ratio).T.contiguous()
        signature = signature.T.contiguous()
        line, step = differs.T.nonzero().unbind(1)
        change = cut[line, step]
        before, after = signature[line, step], signature[line, step + 1]
        inside = (change >= some.low[line]) & (change < some.high[line])
        off = inside & ((share(line, change, before, after) - _met(cut, signature, line, change)).abs() > _OFF)
        # a segment that differs and holds a piece holds three changes, of which two are overlooked if it is taken for one
        whole = inside[1:] & inside[:-1] & (line[1:] == line[:-1]) & (before[:-1] == after[1:])
        off[1:] |= whole & differing[part][line[1:]]
        other[part][line[off]] = True
    # of few that are off less is lost than the fine scan's noise is
    numbers, which, looks = block.unique(return_inverse=True, return_counts=True)
    often = torch.zeros_like(looks).index_add_(0, which, other.long()) > _RARE * looks
    # the lines beside
    return Blocks((numbers[often] ^ 1).unique(), lines)


def _met(cut: Tensor, signature: Tensor, line: Tensor, place: Tensor) -> Tensor:
    """(M,): the share of the phases at which the ends of the segment of 1 px that holds `place` (M,) on the line (M,) differ.

    cut: (N, K) the places, in order, between which the lines' signatures (N, K + 1) are the same.
    """
    ends = torch.cat([cut, cut - 1], 1).sort(1).values
    middle = (ends[:, 1:] + ends[:, :-1]) / 2
    differ = signature.gather(1, torch.searchsorted(cut, middle)) != signature.gather(1, torch.searchsorted(cut, middle + 1))
    place = place[:, None]
    return (ends[line].minimum(place).maximum(place - 1).diff(dim=1) * differ[line]).sum(1)


def finely(
    asked: Asked, blocks: Blocks, cols: tuple[int, int], rows: tuple[int, int], most: int, seed: int, closed: bool
) -> Segments | None:
    """The changes in about `most` segments of those that `scan` has in the blocks, at random, in parts of 1 / `FINE` px; None if it has none.

    With those in the parts beside the segments, not `own`. Their lines are numbered by the segments.
    """
    chosen, lines = [], blocks.lines
    for axis, along, across in ((0, cols, rows), (1, rows, cols)):
        begin = torch.arange(along[0] - (along[0] <= 0), along[1], device=asked.device, dtype=torch.float64)
        level = torch.arange(*across, device=asked.device, dtype=torch.float64)
        low, lie = (t.flatten().repeat_interleave(lines) for t in torch.meshgrid(begin, level, indexing="ij"))
        number = torch.arange(lines, device=asked.device).repeat(len(low) // lines)
        # those of the block that their pixel is in
        inside = numbers(blocks.hold(axis, low, lie + (number + 0.5) / lines))
        low, lie, number = (pick(each, inside) for each in (low, lie, number))
        keys = axis, low.long(), lie.long(), number
        phase, off = (rng.uniform(seed, _FINELY, which, *keys, dtype=torch.float64) for which in (0, 1))
        low, none = low + phase, torch.zeros_like(number)
        own = torch.ones_like(none, dtype=torch.bool)
        chosen.append(Brackets(none + axis, lie + (number + off) / lines, low, low + 1, none, none, none, own, own.double(), none))
    whole = joined(chosen).thinned(most, seed)
    parts, found, step = torch.arange(-1, FINE + 2, device=asked.device) / FINE, [], max(1, asked.at_once // (FINE + 3))
    for axis in range(2):
        some = whole.take(whole.axis == axis)
        for start in range(0, len(some), step):
            part = some.some(slice(start, start + step))
            place = part.low[:, None] + parts
            line0 = axis * len(whole) + start
            fine = differing(asked, axis, part.across, place, line0, closed)
            chance = part.chance[fine.brackets.line - line0]
            found.append(replace(fine, brackets=replace(fine.brackets, chance=chance)))
    # on a screen of a pixel there may be no lines beside
    if not found:
        return None
    return together(found)
