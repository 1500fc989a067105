"""From segments in which f decides differently to where it does, by the margins where they lead there, by bisection where not."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torch_mcaa import rng
from torch_mcaa.picking import numbers, pick
from torch_mcaa.traced.asked import Asked
from torch_mcaa.traced.derivatives import derivatives
from torch_mcaa.traced.scan import Brackets, Segments, joined
from torch_mcaa.traced.visitors import MANY, Causes, Margins

_NARROW = 2.0**-10
"""Px: the width of the last brackets."""
_NARROWEST = 2.0**-26
"""Px: of those where the margin looks like a step."""
_BESIDE = 2.0**-20
"""How far from its end a piece is asked beside a root, in parts of that."""
_FREQUENT, _TRIED, _KEPT = 256, 32, 16
_SMOOTH = 0.02
"""A jump is at least so much of what f changes by in segments of 1 px."""
_WORTH, _LINES = 0x3057, 0x11E5
_DEARER = 2
"""Of the segments that may be followed, one in so many may be quartered at once, which costs most."""
_TIMES = 100
"""A margin that changes so many times more than its slope explains is not continuous."""
_LAST = ("signatures", "values", "cause", "margin", "slope", "behind", "rival")
"""What `Changes` has along the last axis."""


@dataclass(frozen=True)
class Changes:
    """The changes in narrow brackets, N of them.

    Attributes:
        signatures: (2, N) at the low and at the high end; values: (C, 2, N) float64, f there.
        cause, branch: (N,) and (N, 3), as in `Causes`, with margin: (2, N) at the ends.
        slope: (2, 2, N) the margins' derivatives by column and row (first index) at the ends.
        behind: (N,) bool, whether an edge that does not move is there too, and before it in f's order; rival: (4, N), as in `Causes`.
    """

    brackets: Brackets
    signatures: Tensor
    values: Tensor
    cause: Tensor
    branch: Tensor
    margin: Tensor
    slope: Tensor
    behind: Tensor
    rival: Tensor

    def __len__(self) -> int:
        return len(self.cause)

    @property
    def flat(self) -> Tensor:
        """bool (N,): margins without a slope at either end."""
        return ~(self.slope.abs().sum(0) > 0).any(0)

    @property
    def leap(self) -> Tensor:
        """bool (N,): margins that change far more than their slopes explain, so that they are not continuous, or nearly steps."""
        along = self.along(self.slope).abs().amax(0) * (self.brackets.high - self.brackets.low)
        return ~self.flat & ((self.margin[1] - self.margin[0]).abs() > _TIMES * along)

    def along(self, slope: Tensor) -> Tensor:
        """What belongs to the bracket's own axis, of (2, ..., N): one for columns, one for rows."""
        return torch.where(self.brackets.axis == 0, slope[0], slope[1])

    def take(self, index: Tensor, chance: float = 1.0) -> Changes:
        """Those at `index`, integers or bool, that were kept with a probability of `chance`."""
        index = numbers(index)
        signatures, values, cause, margin, slope, behind, rival = (pick(getattr(self, name), index) for name in _LAST)
        return Changes(
            self.brackets.take(index, chance),
            signatures,
            values,
            cause,
            self.branch.index_select(0, index),
            margin,
            slope,
            behind,
            rival,
        )


def on_some_lines(found: Segments, most: int, seed: int) -> Segments:
    """The segments or, of more than `most`, those of some lines at random, which count for the others: all of a line, for how thin a piece is
    both its ends tell.
    """
    if len(found.cause) <= most:
        return found
    kept, chance = _some_lines(found.brackets.line, most / len(found.cause), seed, 0)
    return found.take(kept, chance)


def _some_lines(line: Tensor, part: float, seed: int, stage: int) -> tuple[Tensor, float]:
    """bool (N,): what lies on about that part of the lines, at least one, and the exact part of them.

    Evenly spaced from a random first one: lines that are left out at random would cost most of what even ones are worth.
    """
    lines, which = line.unique(return_inverse=True)
    some = max(1, len(lines) // max(1, round(1 / part)))
    # of another part, and of what another stage has left, independent
    first = rng.uniform(seed, _LINES, stage, int(lines[0]), dtype=torch.float64).to(line.device)
    kept = torch.zeros_like(lines, dtype=torch.bool)
    kept[((torch.arange(some, device=line.device) + first) * len(lines) / some).long()] = True
    return kept[which], some / len(lines)


def located(asked: Asked, found: Segments, seed: int) -> Changes:
    """All changes in all the segments, without the margins' derivatives."""
    return refined(asked, found, 1 << 62, seed, sloped=False)


def worthwhile(asked: Asked, found: Segments, most: int, seed: int) -> Segments:
    """Fewer of the segments in which such decisions differ as do not seem to make f jump, like those at texels' borders in a bilinear texture.

    Of all those in which the same decisions differ, if there are many, some are tried; where f changes no more across any edge in them than
    it does smoothly, one of 16 is kept.
    """
    patterns, group, counts = torch.unique(found.differing, return_inverse=True, return_counts=True)
    frequent = ((counts > _FREQUENT) & (patterns < 1 << MANY)).nonzero()[:, 0].tolist()
    if not frequent:
        return found
    number = found.brackets.numbers(seed)
    order = torch.argsort(number, stable=True)
    tried = found.take(torch.cat([order[group[order] == k][:_TRIED] for k in frequent]))
    groups = torch.tensor(frequent, device=asked.device).repeat_interleave(_TRIED)
    tried = replace(tried, brackets=replace(tried.brackets, group=groups))
    changes = refined(asked, tried, most, seed)
    jump, size = (torch.zeros(len(patterns), dtype=torch.float64, device=asked.device) for _ in range(2))
    jump.scatter_reduce_(0, changes.brackets.group, (changes.values[:, 1] - changes.values[:, 0]).abs().amax(0), "amax")
    size.scatter_reduce_(0, groups, tried.change, "amax")
    chance = torch.ones_like(size)
    chance[frequent] = torch.where(jump[frequent] < _SMOOTH * size[frequent], 1 / _KEPT, 1.0).to(torch.float64)
    if bool((chance == 1).all()):
        return found
    # another random number than that which chose those tried
    kept = rng.uniform(seed, _WORTH, number, dtype=torch.float64) < chance[group]
    return found.take(kept, chance[group][kept])


def refined(asked: Asked, found: Segments, most: int, seed: int, sloped: bool = True) -> Changes:
    """All changes in segments between whose ends the signatures differ; the margins' derivatives only if `sloped`.

    The margin of the first decision that differs is known at both ends; with that at one place more, found by a straight line, its root is
    foretold: where the signatures on either side of that are those of the ends, nothing else lies between. The others are quartered, and
    all quarters kept where they differ: margins that lead astray cost evaluations, no accuracy. Of more than half of `most` at once, as
    where f is noise, those of about as many are kept, on lines that lie evenly, and count for the others.
    """
    segments = found.brackets
    first = _straight(segments, found.margin)
    _, signature, margin = _at(asked, *segments.places(first), found.cause, found.branch)
    left, right = signature != segments.before, signature != segments.after
    several = segments.take(left & right)
    rest = [several.split(first[None, left & right], signature[None, left & right])]
    single = left ^ right
    low, high = torch.where(left, segments.low, first), torch.where(left, first, segments.high)
    root = _parabola(segments, first, found.margin, margin)[single]
    one = segments.take(single)
    one = replace(
        one,
        low=low[single],
        high=high[single],
        before=torch.where(left[single], one.before, signature[single]),
        after=torch.where(left[single], signature[single], one.after),
    )
    root = torch.where((root >= one.low) & (root <= one.high), root, (one.low + one.high) / 2)
    near = replace(one, low=torch.maximum(one.low, root - _NARROW / 2), high=torch.minimum(one.high, root + _NARROW / 2))
    tried = _examined(asked, near) if sloped else _foreseen(asked, near, pick(found.cause, numbers(single)), found.branch[single])
    hit = (tried.signatures == torch.stack([near.before, near.after])).all(0)
    missed = near.take(~hit)
    rest.append(one.take(~hit).split(torch.stack([missed.low, missed.high]), tried.signatures[:, ~hit]))
    dear, cheap = joined(rest), tried.take(hit)
    if len(dear) * _DEARER > most:
        kept, chance = _some_lines(torch.cat([dear.line, cheap.brackets.line]), most / (_DEARER * len(dear)), seed, 1)
        dear, cheap = dear.take(kept[: len(dear)], chance), cheap.take(kept[len(dear) :], chance)
    halved = _examined(asked, _quartered(asked, dear, _NARROW, most, seed), sloped)
    changes = _joined([cheap, halved])
    if not sloped:
        return changes
    # the margin may saturate a little beside the edge
    astray = (changes.flat | changes.leap) & ~changes.behind
    if not bool(astray.any()):
        return changes
    closer = _examined(asked, _quartered(asked, changes.brackets.take(astray), _NARROWEST, most, seed))
    return _joined([changes.take(~astray), closer])


def _quartered(asked: Asked, brackets: Brackets, width: float, most: int, seed: int) -> Brackets:
    """All changes in them, in brackets no wider than `width`."""
    most = max(len(brackets), most // _DEARER)
    done, level, share = [], 0, torch.tensor([[0.25], [0.5], [0.75]], dtype=torch.float64, device=asked.device)
    while len(brackets):
        narrow = brackets.high - brackets.low <= width
        done.append(brackets.take(narrow))
        # independent of what was left out before
        level += 1
        brackets = brackets.take(~narrow).thinned(most, int(rng.bits(seed, level)))
        places = torch.lerp(brackets.low, brackets.high, share)
        col, row = brackets.places(places)
        signatures = asked.signatures(col.flatten(), row.flatten()).view(places.shape)
        brackets = brackets.split(places, signatures)
    return joined([*done, brackets])


def _straight(segments: Brackets, margin: Tensor) -> Tensor:
    """Beside the root of the line through the margins at the ends, kept away from them; the middle where they have one sign.

    Beside it, for at the root itself an f that divides by its margin has no value.
    """
    share = margin[0] / (margin[0] - margin[1])
    share = torch.where((share > 0) & (share < 1), share.clamp(0.02, 0.98), 0.5) * (1 - _BESIDE)
    return segments.low + share * (segments.high - segments.low)


def _parabola(segments: Brackets, first: Tensor, margin: Tensor, there: Tensor) -> Tensor:
    """The place as a parabola in the margin, through its three values, where that is 0 (inverse quadratic interpolation)."""
    a, b, c = margin[0], there, margin[1]
    low = segments.low * (b * c / ((a - b) * (a - c)))
    return low + first * (a * c / ((b - a) * (b - c))) + segments.high * (a * b / ((c - a) * (c - b)))


def _at(asked: Asked, col: Tensor, row: Tensor, cause: Tensor, branch: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """f's values (C, N), (N,) signatures, and margins of the causes, at places (N,)."""
    if len(col) == 0:
        return col.new_zeros(asked.channels, 0), cause, col
    found = []
    for start in range(0, len(col), asked.at_once):
        part = slice(start, start + asked.at_once)
        values, seen = asked.run(col[part], row[part], lambda c=cause[part], b=branch[part]: Margins(c, b, False))
        found.append((values, seen.signatures(values.shape[1]), seen.total.detach()))
    values, signature, margin = (torch.cat(parts, -1) for parts in zip(*found, strict=True))
    return values, signature, margin


def _examined(asked: Asked, brackets: Brackets, sloped: bool = True) -> Changes:
    """f again at the ends of brackets, with what changes between them and, if `sloped`, its margin's derivatives."""
    parts, step = [], asked.at_once // 2
    for start in range(0, max(1, len(brackets)), step):
        part = brackets.some(slice(start, start + step))
        count = len(part)
        if count == 0:
            none = part.low.new_zeros
            whole = part.line.new_zeros
            return Changes(
                part,
                whole(2, 0),
                none(asked.channels, 2, 0),
                whole(0),
                whole(0, 3),
                none(2, 0),
                none(2, 2, 0),
                whole(0) > 0,
                whole(4, 0),
            )
        with torch.set_grad_enabled(sloped):
            col, row = (t.flatten().requires_grad_(sloped) for t in part.places(torch.stack([part.low, part.high])))
            values, seen = asked.run(col, row, lambda c=count: Causes((2, c), 0, sloped, asked.device))
            slope = _slopes(seen.total, col, row)
        parts.append(
            Changes(
                part,
                seen.signatures(2 * count).view(2, count),
                values.detach().unflatten(1, (2, count)),
                seen.cause,
                seen.branch,
                seen.margin,
                slope.unflatten(1, (2, count)),
                seen.behind,
                seen.rival,
            )
        )
    return _joined(parts)


def _foreseen(asked: Asked, brackets: Brackets, cause: Tensor, branch: Tensor) -> Changes:
    """The same without slopes, if what changes between the ends is what is expected to: the margins are of that cause."""
    col, row = (t.flatten() for t in brackets.places(torch.stack([brackets.low, brackets.high])))
    values, signatures, margin = (
        t.unflatten(-1, (2, len(brackets))) for t in _at(asked, col, row, cause.repeat(2), branch.repeat(2, 1))
    )
    none = col.new_zeros(2, 2, len(brackets))
    return Changes(brackets, signatures, values, cause, branch, margin, none, none[0, 0] > 0, cause.new_full((4, len(cause)), -1))


def _slopes(total: Tensor | None, col: Tensor, row: Tensor) -> Tensor:
    """(2, N): the derivatives of the margins along columns and rows, 0 where there is none."""
    if total is None or not total.requires_grad:
        return torch.zeros(2, len(col), dtype=col.dtype, device=col.device)
    slopes = derivatives((total,), (col, row))
    return torch.stack([torch.zeros_like(col) if slope is None else slope for slope in slopes]).nan_to_num(0.0, 0.0, 0.0)


def _joined(parts: list[Changes]) -> Changes:
    signatures, values, cause, margin, slope, behind, rival = (torch.cat([getattr(p, name) for p in parts], -1) for name in _LAST)
    branch = torch.cat([p.branch for p in parts])
    return Changes(joined([p.brackets for p in parts]), signatures, values, cause, branch, margin, slope, behind, rival)
