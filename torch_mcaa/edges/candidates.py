"""Where neighbouring samples of a line may hold a jump between them, from values alone."""

from __future__ import annotations

from dataclasses import dataclass, fields

import torch
from torch import Tensor

from torch_mcaa.edges.lines import Samples

_TIMES = 3.0
_AROUND = 4
"""Differences on either side that a difference is compared with the lower median of: of the steeper side where f changes its slope."""
_FAINT = 1e-12
"""A difference that is none, in ranges of the samples: the tail of a step that vanishes exponentially."""
_MANY = 0.02
"""The share of differences that are not 0 from which on a quick test for all of them pays."""
_FOLLOWED = 0.2
"""A part of a segment may hold a jump while its change is over this share of the segment's."""


@dataclass(frozen=True)
class Segments:
    """Pieces of lines along one axis (0: horizontal, along x; 1: vertical, along y), all coordinates float64 screen pixels.

    Attributes:
        across: (S,) the line's coordinate on the other axis.
        low, high: (S,) the ends, low < high.
        before, after: (C, S) f at the ends.
        least: (C, S) the change of a part, in each channel, from which on it may hold a jump; +inf in channels that do not stand out.
        phase: (S,) where on the line its samples lie, modulo 1.
        key: int64 (S, 3), line, row and column: what random numbers hang on.
        single: bool (S,), one sample alone is between this segment and a next: perhaps a thin piece.
    """

    axis: int
    across: Tensor
    low: Tensor
    high: Tensor
    before: Tensor
    after: Tensor
    least: Tensor
    phase: Tensor
    key: Tensor
    single: Tensor

    def __len__(self) -> int:
        return len(self.across)

    def take(self, index: Tensor) -> Segments:
        """The segments at `index`, integers or bool."""
        return Segments(self.axis, *(getattr(self, field.name)[_along(field.name, index)] for field in fields(self)[1:]))


def _along(name: str, index: Tensor) -> Tensor | tuple[slice, Tensor]:
    return (slice(None), index) if name in ("before", "after", "least") else index


def threshold(change: Tensor) -> Tensor:
    """`Segments.least` for changes (C, S) all of whose channels count."""
    return _FOLLOWED * change.abs()


def candidates(samples: Samples, axis: int) -> Segments:
    """Segments between neighbours on a line that differ by over three times the median of the four differences on either side.

    A difference that rounding explains is none; where f was not asked the differences count as 0.
    """
    dim = -1 if axis == 0 else 1
    values, asked = samples.values, samples.asked
    size = values.shape[dim]
    first, second = values.narrow(dim, 0, size - 1), values.narrow(dim, 1, size - 1)
    along = 1 if axis == 0 else 0
    both = asked.narrow(along, 0, size - 1) & asked.narrow(along, 1, size - 1)
    difference = (second - first).abs_()
    if not bool(both.all()):
        difference.masked_fill_(~both[:, None], 0)
    some = difference > _FAINT * (values.amax((1, 2, 3)) - values.amin((1, 2, 3)))[:, None, None, None]
    if int(some.count_nonzero()) > _MANY * some.numel():
        # two of four are below a third only if one of any three is
        padded = torch.nn.functional.pad(difference, (3, 3) if axis == 0 else (0, 0, 0, 0, 3, 3))
        for start in (0, 4):
            least = torch.minimum(padded.narrow(dim, start, size - 1), padded.narrow(dim, start + 1, size - 1))
            some &= difference > _TIMES * torch.minimum(least, padded.narrow(dim, start + 2, size - 1))
    channel, row, line, col = some.nonzero().unbind(1)
    near = (col if axis == 0 else row)[:, None] + torch.arange(-_AROUND, _AROUND + 1, device=values.device)
    inside = (near >= 0) & (near < size - 1)
    near = near.clamp(0, size - 2)
    at = (row[:, None], line[:, None], near) if axis == 0 else (near, line[:, None], col[:, None])
    window = difference[channel[:, None], *at].masked_fill(~inside, torch.nan)
    # a side that lies beyond the samples says nothing
    sides = (side.nanmedian(1).values.nan_to_num(0.0) for side in (window[:, :_AROUND], window[:, _AROUND + 1 :]))
    change = difference[channel, row, line, col]
    largest = torch.maximum(first[channel, row, line, col].abs(), second[channel, row, line, col].abs())
    chosen = change > torch.maximum(_TIMES * torch.maximum(*sides), 64 * torch.finfo(values.dtype).eps * largest)
    channel, row, line, col = (index[chosen] for index in (channel, row, line, col))
    _, lines, cols = difference.shape[1:]
    flat, owner = torch.unique((row * lines + line) * cols + col, return_inverse=True)
    marked = torch.zeros_like(difference)
    marked[channel, row, line, col] = change[chosen]
    # what lies beyond the samples may be the other end of a thin piece; the tail of a steep step is none
    beside = torch.nn.functional.pad(
        marked.masked_fill_(~both[:, None], torch.inf), (1, 1) if axis == 0 else (0, 0, 0, 0, 1, 1), value=torch.inf
    )
    pairs = torch.maximum(beside.narrow(dim, 0, size - 1), beside.narrow(dim, 2, size - 1)) > _FOLLOWED * difference
    single = (pairs & (marked > 0)).any(0).reshape(-1)[flat]
    col, line, row = flat % cols, flat // cols % lines, flat // (cols * lines)
    before, after = first[:, row, line, col], second[:, row, line, col]
    least = torch.full_like(before, torch.inf)
    least[channel, owner] = threshold(after - before)[channel, owner]
    row, col = row + samples.row, col + samples.col
    x, y = samples.x[line] + col, samples.y[line] + row
    low, across = (x, y) if axis == 0 else (y, x)
    phase = (samples.x if axis == 0 else samples.y)[line]
    key = torch.stack([line, row, col], 1)
    return Segments(axis, across, low, low + 1, before, after, least, phase, key, single)
