"""Where the decisions of f change along horizontal and vertical lines."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import torch
from torch import Tensor

from torch_mcaa import rng
from torch_mcaa.edges.asked import AT_ONCE, Asked
from torch_mcaa.edges.trace import Causes

_SCAN = 0x5CA2
_GROUP = 4
"""The most changes that are looked at as one thin piece."""


@dataclass(frozen=True)
class Brackets:
    """Pieces of lines along one axis (0: along x), between whose ends f decides differently.

    Attributes:
        across: (N,) the line's coordinate on the other axis, in px.
        low, high: (N,) the ends, in px.
        before, after: (N,) int64 signatures there.
        line, segment: (N,) int64, which line of the scan, and which segment on it.
    """

    axis: int
    across: Tensor
    low: Tensor
    high: Tensor
    before: Tensor
    after: Tensor
    line: Tensor
    segment: Tensor

    def __len__(self) -> int:
        return len(self.low)

    def take(self, index: Tensor) -> Brackets:
        """Those at `index`, integers or bool."""
        return Brackets(self.axis, *(getattr(self, field.name)[index] for field in fields(self)[1:]))

    def split(self, places: Tensor, signatures: Tensor) -> Brackets:
        """The parts that still hold a change when all are cut at K places (K, N), in order, where the signatures are (K, N)."""
        ends = torch.cat([self.low[None], places, self.high[None]])
        codes = torch.cat([self.before[None], signatures, self.after[None]])
        part, which = (codes[1:] != codes[:-1]).nonzero().unbind(1)
        return replace(
            self.take(which),
            low=ends[part, which],
            high=ends[part + 1, which],
            before=codes[part, which],
            after=codes[part + 1, which],
        )

    def places(self, along: Tensor) -> tuple[Tensor, Tensor]:
        """Columns and rows of places (..., N) on the lines."""
        across = self.across.expand_as(along)
        return (along, across) if self.axis == 0 else (across, along)


def joined(parts: list[Brackets]) -> Brackets:
    """All the brackets of parts along one axis."""
    return Brackets(parts[0].axis, *(torch.cat([getattr(p, f.name) for p in parts]) for f in fields(parts[0])[1:]))


@dataclass(frozen=True)
class Segments:
    """Segments that hold a change, with what is known of the first decision that differs between their ends.

    cause: (N,), branch: (N, 3), margin: (2, N), as in `Causes`.
    """

    brackets: Brackets
    cause: Tensor
    branch: Tensor
    margin: Tensor


def scan(
    asked: Asked, axis: int, along: tuple[int, int], across: tuple[int, int], lines: int, seed: int, limits: tuple[float, float]
) -> tuple[Segments, int]:
    """The segments of 1 px that begin in the pixels [along[0], along[1]) and hold a change, on `lines` lines in each pixel of `across`.

    The lines are 1 / lines px apart, from one random place for the whole screen; each is cut into segments at a random phase of its own.
    Whatever the rectangle, what is found in a pixel is the same. With them come those beside them that begin just outside, which tell how
    thin a piece at the end is: segments 0, and the last, whose number is returned.

    limits: f is not asked outside them, along the lines.
    """
    device = asked.device
    pixel = torch.arange(across[0], across[1]).repeat_interleave(lines)
    number = torch.arange(lines).repeat(across[1] - across[0])
    shift = rng.uniform(seed, _SCAN, axis, dtype=torch.float64)
    lie = (pixel + (number + shift) / lines).to(device)
    phase = rng.uniform(seed, _SCAN, axis, pixel, number, dtype=torch.float64).to(device)
    start = torch.arange(along[0] - 1, along[1] + 2, device=device)
    found = []
    size = max(1, AT_ONCE // len(start))
    for begin in range(0, len(lie), size):
        found.append(_differing(asked, axis, lie[begin : begin + size], phase[begin : begin + size], begin, start, limits))
    brackets = joined([f.brackets for f in found])
    cause, branch = (torch.cat(parts) for parts in ([f.cause for f in found], [f.branch for f in found]))
    return Segments(brackets, cause, branch, torch.cat([f.margin for f in found], 1)), len(start) - 2


def _differing(
    asked: Asked, axis: int, lie: Tensor, phase: Tensor, begin: int, start: Tensor, limits: tuple[float, float]
) -> Segments:
    """The segments between neighbours among the places start + phase of each line that differ."""
    place = (start + phase[:, None]).clamp(*limits)
    level = lie[:, None].expand_as(place)
    col, row = (place, level) if axis == 0 else (level, place)
    index = torch.arange(place.numel(), device=asked.device).view(place.shape)
    first, second = index[:, :-1].flatten(), index[:, 1:].flatten()
    _, seen = asked.run(col.flatten(), row.flatten(), lambda: Causes(first, second, False))
    signature = seen.signatures(place.numel()).view(place.shape)
    differs = signature[:, 1:] != signature[:, :-1]
    differs[:, 0] &= differs[:, 1]
    differs[:, -1] &= differs[:, -2]
    line, segment = differs.nonzero().unbind(1)
    brackets = Brackets(
        axis,
        lie[line],
        place[line, segment],
        place[line, segment + 1],
        signature[line, segment],
        signature[line, segment + 1],
        line + begin,
        segment,
    )
    chosen = differs.flatten()
    return Segments(brackets, seen.cause[chosen], seen.branch[chosen], seen.margin[:, chosen])


def share(line: Tensor, place: Tensor, before: Tensor, after: Tensor) -> Tensor:
    """The probability that segments of 1 px meet each change, in the order of lines and places.

    A piece between two others of one signature is seen only if an end of a segment lies in it.
    """
    share = torch.ones_like(place)
    for off in range(1, _GROUP):
        if len(place) <= off:
            break
        chord = place[off:] - place[:-off]
        thin = ((line[off:] == line[:-off]) & (before[:-off] == after[off:]) & (chord < 1)).nonzero()[:, 0]
        for inside in range(off + 1):
            share[thin + inside] = torch.minimum(share[thin + inside], chord[thin])
    return share
