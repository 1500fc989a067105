"""Where the decisions of f change along horizontal and vertical lines."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace

import torch
from torch import Tensor

from torch_mcaa import rng
from torch_mcaa.picking import numbers, one_of_each, pick
from torch_mcaa.traced.asked import Asked
from torch_mcaa.traced.visitors import Causes

_SCAN, _THINNED = 0x5CA2, 0x7417
_GROUP = 4
"""The most changes that are looked at as one thin piece."""


@dataclass(frozen=True)
class Brackets:
    """Pieces of lines between whose ends f decides differently.

    Attributes:
        axis: (N,) int64, that of the lines: 0 along x, 1 along y.
        across: (N,) the line's coordinate on the other axis, in px.
        low, high: (N,) the ends, in px.
        before, after: (N,) int64 signatures there.
        line: (N,) int64, which line of the scan; own: (N,) bool, whether it is the rectangle's, or tells of those that are.
        chance: (N,) the probability with which it was kept where there were too many; group: (N,) int64, any number.
    """

    axis: Tensor
    across: Tensor
    low: Tensor
    high: Tensor
    before: Tensor
    after: Tensor
    line: Tensor
    own: Tensor
    chance: Tensor
    group: Tensor

    def __len__(self) -> int:
        return len(self.low)

    def take(self, index: Tensor, chance: Tensor | float = 1.0) -> Brackets:
        """Those at `index`, integers or bool, that were kept with a probability of `chance`."""
        index = numbers(index)
        kept = Brackets(*(pick(getattr(self, field.name), index) for field in fields(self)))
        return replace(kept, chance=kept.chance * chance)

    def some(self, part: slice) -> Brackets:
        """A run of them."""
        return Brackets(*(getattr(self, field.name)[part] for field in fields(self)))

    def split(self, places: Tensor, signatures: Tensor) -> Brackets:
        """The parts that still hold a change when all are cut at K places (K, N), in order, where the signatures are (K, N)."""
        ends = torch.cat([self.low[None], places, self.high[None]])
        codes = torch.cat([self.before[None], signatures, self.after[None]])
        part, which = (codes[1:] != codes[:-1]).nonzero().unbind(1)
        first = part * len(self) + which
        low, high = (pick(ends.view(-1), at) for at in (first, first + len(self)))
        before, after = (pick(codes.view(-1), at) for at in (first, first + len(self)))
        return replace(self.take(which), low=low, high=high, before=before, after=after)

    def thinned(self, most: int, seed: int) -> Brackets:
        """`most` of them if there are more: of as many runs of neighbours one each, at random."""
        if len(self) <= most:
            return self
        run = torch.arange(most, device=self.low.device)
        return self.take(*one_of_each(len(self), most, rng.uniform(seed, _THINNED, run, dtype=torch.float64)))

    def numbers(self, seed: int) -> Tensor:
        """(N,) random numbers of their places."""
        return rng.bits(seed, _THINNED, (self.low * 2**20).long(), self.axis, (self.across * 2**20).long())

    def places(self, along: Tensor) -> tuple[Tensor, Tensor]:
        """Columns and rows of places (..., N) on the lines."""
        across = self.across.expand_as(along)
        return torch.where(self.axis == 0, along, across), torch.where(self.axis == 0, across, along)


def joined(parts: list[Brackets]) -> Brackets:
    """All the brackets of the parts."""
    return Brackets(*(torch.cat([getattr(p, f.name) for p in parts]) for f in fields(parts[0])))


@dataclass(frozen=True)
class Segments:
    """Segments that hold a change, with what is known of the first decision that differs between their ends.

    cause, differing: (N,), branch: (N, 3), margin: (2, N), as in `Causes`; change: (N,) how much f differs, in the channel that does most.
    """

    brackets: Brackets
    cause: Tensor
    differing: Tensor
    branch: Tensor
    margin: Tensor
    change: Tensor

    def take(self, index: Tensor, chance: Tensor | float = 1.0) -> Segments:
        """Those at `index`, integers or bool, that were kept with a probability of `chance`."""
        index = numbers(index)
        cause, differing, margin, change = (pick(each, index) for each in (self.cause, self.differing, self.margin, self.change))
        branch = self.branch.index_select(0, index)
        return Segments(self.brackets.take(index, chance), cause, differing, branch, margin, change)

    def by_lines(self, most: int) -> Iterator[Segments]:
        """All the segments of some lines after those of others, about `most` at a time; at least once."""
        order = torch.argsort(self.brackets.line, stable=True)
        line = self.brackets.line[order]
        starts = torch.searchsorted(line, line[::most].contiguous()).unique().tolist()
        for first, last in zip(starts or [0], [*starts[1:], len(line)], strict=True):
            yield self.take(order[first:last])


def scan(asked: Asked, cols: tuple[int, int], rows: tuple[int, int], lines: int, seed: int, closed: bool) -> Segments:
    """The segments of 1 px that begin in the pixels of a rectangle and hold a change, on `lines` lines a pixel along either axis.

    At the screen's first column and row those that end in it come too.

    The lines are 1 / lines px apart, from one random place for the whole screen; each is cut into segments at a random phase of its own.
    Whatever the rectangle, what is found in a pixel is the same. With them come those beside them that begin just outside, not `own`,
    which tell how thin a piece at the end is. Of a `closed` screen nothing is asked beyond.
    """
    found, count = [], 0
    for axis, along, across in ((0, cols, rows), (1, rows, cols)):
        pixel = torch.arange(*across).repeat_interleave(lines)
        number = torch.arange(lines).repeat(across[1] - across[0])
        shift = rng.uniform(seed, _SCAN, axis, dtype=torch.float64)
        lie = (pixel + (number + shift) / lines).to(asked.device)
        phase = rng.uniform(seed, _SCAN, axis, pixel, number, dtype=torch.float64).to(asked.device)
        begin = along[0] - (along[0] <= 0)
        start = torch.arange(begin - 1, along[1] + 2, device=asked.device)
        many = max(1, asked.at_once // len(start))
        for first in range(0, len(lie), many):
            part = slice(first, first + many)
            found.append(differing(asked, axis, lie[part], start + phase[part, None], count + first, closed))
        count += len(lie)
    return together(found)


def together(found: list[Segments]) -> Segments:
    """All the segments of the parts."""
    cause, differing, branch, change = (
        torch.cat([getattr(f, name) for f in found]) for name in ("cause", "differing", "branch", "change")
    )
    return Segments(joined([f.brackets for f in found]), cause, differing, branch, torch.cat([f.margin for f in found], 1), change)


def held(asked: Asked, axis: int | Tensor, place: Tensor) -> Tensor:
    """Places along an axis, those beyond the screen at its border."""
    size = torch.where(torch.as_tensor(axis, device=place.device) == 0, asked.screen.width, asked.screen.height).to(place.dtype)
    return torch.minimum(place.clamp_min(0), size * (1 - 2.0**-50))


def differing(asked: Asked, axis: int, lie: Tensor, place: Tensor, line0: int, closed: bool) -> Segments:
    """The segments that differ between neighbours among the places (lines, K) of each line; the first and the last are not `own`."""
    if closed:
        place = held(asked, axis, place)
    level = lie[:, None].expand_as(place)
    col, row = (place, level) if axis == 0 else (level, place)
    shape = (len(place), place.shape[1])
    values, seen = asked.run(col.flatten(), row.flatten(), lambda: Causes(shape, 1, False, asked.device), coarse=True)
    signature = seen.signatures(place.numel()).view(place.shape)
    differs = signature[:, 1:] != signature[:, :-1]
    differs[:, 0] &= differs[:, 1]
    differs[:, -1] &= differs[:, -2]
    line, segment = differs.nonzero().unbind(1)
    brackets = Brackets(
        torch.full_like(line, axis),
        lie[line],
        place[line, segment],
        place[line, segment + 1],
        signature[line, segment],
        signature[line, segment + 1],
        line + line0,
        (segment > 0) & (segment < shape[1] - 2),
        torch.ones_like(lie[line]),
        torch.zeros_like(line),
    )
    chosen = differs.flatten()
    low = line * shape[1] + segment
    change = (values[:, low + 1] - values[:, low]).abs().amax(0)
    return Segments(brackets, seen.cause[chosen], seen.differing[chosen], seen.branch[chosen], seen.margin[:, chosen], change)


def share(line: Tensor, place: Tensor, before: Tensor, after: Tensor, length: float = 1.0) -> Tensor:
    """The probability that segments of so many px meet each change, in the order of lines and places, if none are near but those met.

    A piece between two others of one signature is seen only if an end of a segment lies in it.
    """
    share = torch.ones_like(place)
    for off in range(1, _GROUP):
        if len(place) <= off:
            break
        chord = (place[off:] - place[:-off]) / length
        thin = ((line[off:] == line[:-off]) & (before[:-off] == after[off:]) & (chord < 1)).nonzero()[:, 0]
        for inside in range(off + 1):
            share[thin + inside] = torch.minimum(share[thin + inside], chord[thin])
    return share
