"""Where neighbouring samples of a line may hold a jump between them, from values alone."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace

import torch
from torch import Tensor

from torch_mcaa.edges.lines import Differences, Samples
from torch_mcaa.integrand import width_of
from torch_mcaa.picking import numbers, pick

_TIMES = 3.0
_AROUND = 4
"""Differences on either side that a difference is compared with the lower median of: of the steeper side where f changes its slope."""
_ALIKE = 0.03
"""How much differences are off that are jumps between the same two colours, in parts of them."""
_FLAT = 30.0
"""A side is flat whose median difference is under this part of a difference."""
_FAINT = 1e-12
"""A difference that is none, in ranges of the samples: the tail of a step that vanishes exponentially."""
_MANY = 0.02
"""The share of differences that are not 0 from which on a quick test for all of them pays."""
_ROW, _COL = 0x1E3779B97F4A7C15, 0x42B2AE3D27D4EB4F
"""Odd numbers that no small differences of rows and columns cancel, modulo 2^64."""
_AT_ONCE = 1 << 17
"""Samples whose differences a CPU holds at a time."""
_WINDOWS = 1 << 14
"""Differences whose neighbours a CPU holds at a time."""
FOLLOWED = 0.2
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
        single: bool (S,), one sample alone is between this segment and a next, which changes back: perhaps a thin piece.
        quiet: (S,) -1 or 1, the side on which the next segment shows no jump, 0 where there is none.
        decided: (S,) a number above 0 that says which decision of f, if it is followed, differs between the ends; 0 where none does.
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
    quiet: Tensor
    decided: Tensor

    def __len__(self) -> int:
        return len(self.across)

    @property
    def stream(self) -> Tensor:
        """int64 (S,): the key in one number, for one hash in the place of three."""
        line, row, col = self.key.unbind(1)
        return line + _ROW * row + _COL * col

    def take(self, index: Tensor) -> Segments:
        """The segments at `index`, integers or bool."""
        if index.dtype == torch.bool and bool(index.all()):
            return self
        index = numbers(index)
        return Segments(
            self.axis,
            *(
                self.key.index_select(0, index) if field.name == "key" else pick(getattr(self, field.name), index)
                for field in fields(self)[1:]
            ),
        )


def threshold(change: Tensor) -> Tensor:
    """`Segments.least` for changes (C, S) all of whose channels count."""
    return FOLLOWED * change.abs()


def candidates(samples: Samples, axis: int) -> Segments:
    """Segments between neighbours on a line that differ by over three times the median of the four differences on either side.

    A difference that rounding explains is none. Where f is followed, also those between whose ends it decides differently.
    """
    return _looked(samples, axis, _ranges(samples.values))[0]


def _looked(samples: Samples, axis: int, span: Tensor) -> tuple[Segments, Tensor]:
    """`candidates`, and the places (2, M), columns and rows, of differences alike beside them that are none; `span` (C,) the ranges of all values."""
    values = samples.values
    most = _AT_ONCE * width_of(values.device)
    if values.numel() <= most:
        return _candidates(samples, axis, span)
    # a few lines after the other: differences take more than the samples
    step, parts, hidden = max(1, most * samples.count // values.numel()), [], []
    for first in range(0, samples.count, step):
        part, beside = _candidates(samples.some(slice(first, first + step)), axis, span)
        part.key[:, 0] += first
        parts.append(part)
        hidden.append(beside)
    return joined(parts), torch.cat(hidden, 1)


def _ranges(values: Tensor) -> Tensor:
    """(C,): of each channel's values. One by one: along a dimension it is several times slower."""
    return torch.stack([torch.sub(*reversed(torch.aminmax(v))) if v.numel() else v.new_zeros(()) for v in values])


def _candidates(samples: Samples, axis: int, span: Tensor) -> tuple[Segments, Tensor]:
    """`_looked` on some lines."""
    differences = samples.differences(axis)
    size = differences.size
    many = int(size.count_nonzero()) > _MANY * size.numel()
    flat = (differences.pruned(_TIMES) if many else size).flatten().nonzero()[:, 0]
    channel, index = flat // max(1, size.shape[1]), flat % max(1, size.shape[1])
    clear = numbers(size.view(-1)[flat] > _FAINT * span[channel])
    channel, index = pick(channel, clear), pick(index, clear)
    windows = _WINDOWS * width_of(size.device)
    parts = zip(channel.split(windows), index.split(windows), strict=True)
    chosen = torch.cat([_stands_out(differences, *part) for part in parts])
    if samples.codes is None and not bool(chosen.any()):
        return _none(samples, axis), samples.x.new_zeros(2, 0)
    hidden = _alike(differences, channel[chosen], index[chosen])
    # from here on what is no candidate counts as no difference
    channel, index = channel[chosen], index[chosen]
    kept = size[channel, index]
    size.zero_()[channel, index] = kept
    codes = None if samples.codes is None else samples.differences(axis, codes=True)
    changed = index[:0] if codes is None else codes.size[0].nonzero()[:, 0]
    flat, owner = (
        torch.unique(torch.cat([index, changed]), return_inverse=True)
        if len(size) > 1 or codes is not None
        else (index, torch.arange(len(index), device=size.device))
    )
    owner = owner[: len(index)]
    before, after = differences.ends(flat)
    least = torch.full_like(before, torch.inf)
    least[channel, owner] = threshold(after - before)[channel, owner]
    # what lies beyond the samples may be the other end of a thin piece; the tail of a steep step is none
    near = differences.beside(flat, torch.tensor([-1, 1], device=size.device))
    beside = size[:, near.clamp_min(0)].masked_fill(near < 0, torch.inf)
    own = size[:, flat]
    # a sample inside a steep step goes on in the same direction
    start, end = (value.unflatten(1, near.shape) for value in differences.ends(near.clamp_min(0).flatten()))
    back = ((end - start) * (after - before)[..., None] < 0) | (near < 0)
    single = ((own > 0)[..., None] & (beside > FOLLOWED * own[..., None]) & back).any(2).any(0)
    decided = torch.zeros(len(flat), dtype=torch.float64, device=size.device)
    if codes is not None:
        # one kind of change where f does, another where it does not
        decided = codes.size[0, flat].to(torch.float64)
        decided += 0.5 * ((decided > 0) & (before == after).all(0))
        single |= _there_and_back(codes, flat, near)
    still = (beside == 0).all(0)
    quiet = torch.where(still[:, 0], -1, still[:, 1].long())
    line, row, col = differences.place(flat)
    row, col = row + samples.row, col + samples.col
    x, y = samples.x[line] + col, samples.y[line] + row
    low, across = (x, y) if axis == 0 else (y, x)
    phase = (samples.x if axis == 0 else samples.y)[line]
    key = torch.stack([line, row, col], 1)
    hidden_line, hidden_row, hidden_col = differences.place(hidden[~torch.isin(hidden, flat)])
    beside = torch.stack([samples.x[hidden_line] + hidden_col + samples.col, samples.y[hidden_line] + hidden_row + samples.row])
    return Segments(axis, across, low, low + 1, before, after, least, phase, key, single, quiet, decided), beside


def _none(samples: Samples, axis: int) -> Segments:
    place, colour = samples.x[:0], samples.values.new_zeros(len(samples.values), 0)
    key = torch.zeros(0, 3, dtype=torch.int64, device=place.device)
    return Segments(axis, place, place, place, colour, colour, colour, place, key, key[:, 0] > 0, key[:, 0], place)


def _stands_out(differences: Differences, channel: Tensor, index: Tensor) -> Tensor:
    """bool (N,): which differences are over three times the median of the four on either side, and more than rounding."""
    size = differences.size
    near = differences.beside(index, torch.arange(-_AROUND, _AROUND + 1, device=size.device))
    window = size[channel[:, None], near.clamp_min(0)].masked_fill(near < 0, torch.nan)
    # a side that lies beyond the samples says nothing
    left, right = (side.nanmedian(1).values.nan_to_num(0.0) for side in (window[:, :_AROUND], window[:, _AROUND + 1 :]))
    # nor does one neighbour where the other side is flat: a step may go on in it
    flat = size[channel, index] / _FLAT
    left, right = (
        torch.where(window[:, beyond].isnan() & (other < flat), 0, side)
        for side, other, beyond in ((left, right, _AROUND - 2), (right, left, _AROUND + 2))
    )
    largest = torch.maximum(*(end.abs() for end in differences.ends(index)))[channel, torch.arange(len(index), device=size.device)]
    least = torch.maximum(_TIMES * torch.maximum(left, right), 64 * torch.finfo(size.dtype).eps * largest)
    return size[channel, index] > least


def _alike(differences: Differences, channel: Tensor, index: Tensor) -> Tensor:
    """The differences (M,) near candidates (N,) that are as large: edges between two colours, where they are close.

    What stands out at the end of a line, where nothing beyond is known, may be no more than a slope.
    """
    size = differences.size
    near = differences.beside(index, torch.tensor([step for step in range(-_AROUND, _AROUND + 1) if step], device=size.device))
    own = size[channel, index][:, None]
    alike = (near >= 0).all(1, True) & ((size[channel[:, None], near.clamp_min(0)] - own).abs() <= _ALIKE * own)
    return torch.unique(near[alike])


class Finder:
    """The candidates of a lattice that is seen a few lines after the other, along both axes."""

    def __init__(self) -> None:
        self._parts: tuple[list[Segments], list[Segments]] = [], []
        self._hidden: tuple[list[Tensor], list[Tensor]] = [], []

    def look(self, samples: Samples, first: int, kept: Callable[[Segments], Segments] = lambda segments: segments) -> None:
        """See lines, of which the first is number `first` of the lattice's, for those of their segments that are to be `kept`."""
        span = _ranges(samples.values)
        for axis, parts in enumerate(self._parts):
            part, beside = _looked(samples, axis, span)
            part.key[:, 0] += first
            parts.append(kept(part))
            self._hidden[axis].append(beside)

    @property
    def looks(self) -> int:
        """How often it has looked."""
        return len(self._parts[0])

    def forget(self, looks: int) -> None:
        """All but the first looks."""
        for parts in (*self._parts, *self._hidden):
            del parts[looks:]

    def hidden(self) -> list[Tensor]:
        """(2, M) along x, and along y: columns and rows of jumps beside candidates that do not stand out."""
        return [torch.cat(parts, 1) for parts in self._hidden]

    def found(self) -> list[Segments]:
        """Along x, and along y; they are forgotten here."""
        found = [joined(parts) for parts in self._parts]
        self.forget(0)
        return found


def brackets(
    axis: int, across: Tensor, low: Tensor, high: Tensor, before: Tensor, after: Tensor, phase: Tensor, line: Tensor, kind: int = 0
) -> Segments:
    """Segments between any two places of lines, by the lines' numbers; random numbers of another `kind` are others."""
    none = torch.zeros_like(line)
    key = torch.stack([line, (low * 2**20).long(), none + kind], 1)
    return Segments(
        axis, across, low, high, before, after, threshold(after - before), phase, key, none > 0, none, torch.zeros_like(low)
    )


def joined(parts: Sequence[Segments]) -> Segments:
    """The segments of parts along one axis."""
    names = [field.name for field in fields(parts[0])[1:]]
    along = [0 if name == "key" else -1 for name in names]
    return Segments(parts[0].axis, *(torch.cat([getattr(p, n) for p in parts], d) for n, d in zip(names, along, strict=True)))


def _there_and_back(codes: Differences, flat: Tensor, near: Tensor) -> Tensor:
    """Which segments (S,) change a code that a segment beside, `near` (S, 2), changes back."""
    start, end = codes.ends(flat)
    first, last = (code.view(near.shape) for code in codes.ends(near.clamp_min(0).flatten()))
    back = torch.stack([first[:, 0] == end[0], last[:, 1] == start[0]], 1)
    return (back & (near >= 0)).any(1) & (start[0] != end[0])


def without(segments: Segments, kinds: Tensor) -> Segments:
    """The segments without those that are `decided` in such ways only, unless their values stand out."""
    if len(kinds) == 0:
        return segments
    drop = torch.isin(segments.decided, kinds)
    segments = replace(segments, decided=segments.decided.masked_fill(drop, 0))
    return segments.take(~drop | segments.least.isfinite().any(0))
