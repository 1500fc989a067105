"""Bisection of many segments at once, both halves kept where both hold a jump."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import torch
from torch import Tensor

from torch_mcaa import rng
from torch_mcaa.edges.candidates import Segments, brackets
from torch_mcaa.edges.lines import Ask
from torch_mcaa.picking import numbers, pick
from torch_mcaa.sums import add_at

BRACKET = 2.0**-7
"""Px: what is wider is no bracket of a jump, but a part of a steep step."""
_PLACE = 0xB15EC
_LEAF = 1 / 16
"""Px: a part no longer followed is a step of its own where it is no wider; wider parts are followed to there while they change at all."""
FAINT = 0.1
"""A part whose change is under this share of what would be followed is smooth: a ramp beside a jump."""
_SPLIT = 0.1
"""How far the first places may move, in quarters of the segment."""
_MISSED = 0.25
"""The share of a segment's change that may lie outside the jumps found in it."""
QUARTERED = 1 / 16
"""Px: wider segments begin with quarters."""
_SMOOTH = 0.4
"""Px: a segment that changes over more than this is smooth, and left to the samples."""
ROUNDING, _FLOATS = 1e-9, 2.0**-10
"""Px; and how far float32 may put an edge, or a sample."""
_MOST = 8
"""A segment with more pieces than this is not a few jumps: it is given up."""


@dataclass(frozen=True)
class Crossings:
    """Jumps on lines along one axis, as in `Segments`: at `place`, in a bracket of `width`, from `before` to `after` (C, N).

    `segment` (N,) is the index of the segment each was found in.
    """

    axis: int
    across: Tensor
    place: Tensor
    width: Tensor
    before: Tensor
    after: Tensor
    phase: Tensor
    segment: Tensor

    def __len__(self) -> int:
        return len(self.across)

    @property
    def jump(self) -> Tensor:
        return self.after - self.before

    def take(self, index: Tensor | slice) -> Crossings:
        """The crossings at `index`, integers, bool or a slice, of which they are views."""
        if isinstance(index, slice):
            return Crossings(self.axis, *(getattr(self, field.name)[..., index] for field in fields(self)[1:]))
        index = numbers(index)
        return Crossings(self.axis, *(pick(getattr(self, field.name), index) for field in fields(self)[1:]))


def joined(parts: list[Crossings]) -> Crossings:
    """All the crossings of parts along one axis."""
    return Crossings(parts[0].axis, *(torch.cat([getattr(p, f.name) for p in parts], -1) for f in fields(parts[0])[1:]))


def placed(axis: int, along: Tensor, across: Tensor) -> tuple[Tensor, Tensor]:
    """x and y of places on lines along `axis`."""
    return (along, across) if axis == 0 else (across, along)


def ask_on(ask: Ask, axis: int, along: Tensor, across: Tensor) -> Tensor:
    """f (C, N) at places on lines along `axis`."""
    return ask(*placed(axis, along, across))


def sided(ask: Ask, crossings: Crossings) -> Crossings:
    """The crossings, on that side of their lines' samples that `ask` tells, which asks f as those were asked: in float32 an edge lies elsewhere."""
    sample = (crossings.place - crossings.phase).round() + crossings.phase
    near = ((crossings.place - sample).abs() < _FLOATS).nonzero()[:, 0]
    if len(near) == 0:
        return crossings
    some, sample = crossings.take(near), pick(sample, near)
    value = ask_on(ask, crossings.axis, sample, some.across)
    past = (value - some.before).abs().amax(0) > (some.after - value).abs().amax(0)
    place = torch.where(past, torch.minimum(some.place, sample - ROUNDING), torch.maximum(some.place, sample + ROUNDING))
    return replace(crossings, place=crossings.place.index_copy(0, near, place))


def sharpened(ask: Ask, crossings: Crossings, line: Tensor, finest: float, seed: int, kind: int = 0) -> Crossings:
    """The crossings, each on a `line` by its number, in brackets halved further; random numbers of another `kind` are others."""
    low, high = crossings.place - crossings.width / 2, crossings.place + crossings.width / 2
    ends = crossings.before, crossings.after
    return bisect(ask, brackets(crossings.axis, crossings.across, low, high, *ends, crossings.phase, line, kind), finest, seed)


def bisect(ask: Ask, segments: Segments, finest: float, seed: int) -> Crossings:
    """`bisect_all` of segments along one axis."""
    return bisect_all(ask, [segments], finest, seed)[0]


def bisect_all(ask: Ask, parts: Sequence[Segments], finest: float, seed: int) -> list[Crossings]:
    """Narrow brackets to `finest` px or less: whole segments by quarters at places a little random first, then by halves.

    The lines' samples are whole fractions of a pixel apart: without that all lines' brackets of an edge along an axis would be the same, and
    the middles of the last ones have the same error, which a random place in the last bracket adds to and does not remove.
    """
    work = _Bisection(ask, parts, seed)
    work.start()
    work.halve(finest)
    work.beside_samples()
    return work.found()


class _Bisection:
    """Brackets at work: `root` is the segment of each, counted over all parts."""

    def __init__(self, ask: Ask, parts: Sequence[Segments], seed: int) -> None:
        self.ask, self.parts, self.seed = ask, parts, seed
        self.across, self.low, self.high, self.phase = (
            torch.cat([getattr(p, name) for p in parts]) for name in ("across", "low", "high", "phase")
        )
        self.before, self.after, self.least = (
            torch.cat([getattr(p, name) for p in parts], 1) for name in ("before", "after", "least")
        )
        self.flat = torch.cat([torch.full_like(p.single, p.axis == 0) for p in parts])
        self.done: list[tuple[Tensor, ...]] = []
        self._of: tuple[Tensor, ...] = ()

    def of(self, root: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """`across`, `flat` and `least` of segments; what was asked last is kept, for most halvings are of the same ones."""
        if not self._of or self._of[0] is not root:
            self._of = root, pick(self.across, root), pick(self.flat, root), pick(self.least, root)
        return self._of[1:]  # pyright: ignore[reportReturnType]

    def at(self, along: Tensor, across: Tensor, flat: Tensor) -> Tensor:
        """f (C, N) at places on lines, of which those along x are `flat`."""
        return self.ask(torch.where(flat, along, across), torch.where(flat, across, along))

    def start(self) -> None:
        """Quarters of the wide segments, at once: a middle alone would often miss a second thin piece close by."""
        wide = self.high - self.low > QUARTERED
        whole, rest = wide.nonzero()[:, 0], (~wide).nonzero()[:, 0]
        self.live = self.followed(rest, *(pick(ends, rest) for ends in (self.low, self.high, self.before, self.after)))
        if len(whole) == 0:
            return
        axis = pick(torch.where(self.flat, 0, 1), whole)
        stream = pick(torch.cat([p.stream for p in self.parts]), whole)
        moved = _SPLIT * (rng.uniform(self.seed, _PLACE, axis, stream).to(torch.float64) - 0.5)
        share = (torch.arange(1, 4, device=whole.device)[:, None] + moved) / 4
        low, high = pick(self.low, whole), pick(self.high, whole)
        places = low + share * (high - low)
        lines = (pick(each, whole).repeat(3) for each in (self.across, self.flat))
        values = self.at(places.flatten(), *lines).unflatten(1, places.shape)
        ends = torch.cat([low[None], places, high[None]])
        values = torch.cat([pick(self.before, whole)[:, None], values, pick(self.after, whole)[:, None]], 1)
        quarters = self.followed(
            whole.repeat(4), ends[:-1].flatten(), ends[1:].flatten(), values[:, :-1].flatten(1), values[:, 1:].flatten(1)
        )
        self.live = tuple(torch.cat(pair, -1) for pair in zip(self.live, quarters, strict=True))

    def followed(self, root: Tensor, low: Tensor, high: Tensor, before: Tensor, after: Tensor) -> tuple[Tensor, ...]:
        """The brackets that are to be narrowed further; of the others those that are steps of their own are noted."""
        change, least = (after - before).abs(), pick(self.least, root)
        on, some, wide = (change > least).any(0), (change > FAINT * least).any(0), high - low > _LEAF
        leaf = some & ~on & ~wide
        live = root, low, high, before, after
        on |= some & wide
        if bool(leaf.any()):
            self.done.append(tuple(pick(each, numbers(leaf)) for each in live))
        if not bool(on.all()):
            live = tuple(pick(each, numbers(on)) for each in live)
        pieces = torch.bincount(live[0], minlength=len(self.across))
        if bool((pieces > _MOST).any()):
            few = numbers(pick(pieces, live[0]) <= _MOST)
            live = tuple(pick(each, few) for each in live)
        return live

    def halve(self, finest: float) -> None:
        """Halve the brackets until all are narrow, the widest first: those at work are the first ones."""
        steps = torch.log2((self.live[2] - self.live[1]) / finest).ceil().clamp_min(0).long()
        order = torch.argsort(steps, descending=True, stable=True)
        self.live = tuple(pick(each, order) for each in self.live)
        more, count = torch.bincount(steps).tolist(), 0
        for step in range(len(more) - 1, 0, -1):
            count += more[step]
            if count:
                count = self._halved(count)

    def beside_samples(self) -> None:
        """Part the brackets that hold a sample of their line: on the wrong side of the jump it would err by all of its weight."""
        root, low, high, *_ = self.live
        phase = pick(self.phase, root)
        sample = (high - phase).floor() + phase
        inside = (sample > low + ROUNDING) & (sample < high - ROUNDING)
        if bool(inside.any()):
            order = torch.argsort(inside, descending=True, stable=True)
            self.live = tuple(pick(each, order) for each in self.live)
            self._halved(int(inside.count_nonzero()), pick(sample, order))

    def _halved(self, count: int, middle: Tensor | None = None) -> int:
        """Halve the first `count` brackets, or part them at a `middle` of each; how many they are then."""
        root, low, high, before, after = (field[..., :count] for field in self.live)
        middle = (low + high) / 2 if middle is None else middle[:count]
        across, flat, least = (each[..., :count] for each in self.of(self.live[0]))
        value = self.at(middle, across, flat)
        first, second = (value - before).abs(), (after - value).abs()
        left = _any(first > least)
        # almost always one half holds the jump and the other has no change
        odd = _any(torch.minimum(first, second) > FAINT * least) | (left == _any(second > least))
        if not bool(odd.any()):
            torch.where(left, low, middle, out=low)
            torch.where(left, middle, high, out=high)
            torch.where(left, before, value, out=before)
            torch.where(left, value, after, out=after)
            return count
        halves = self.followed(
            root.repeat(2),
            torch.cat([low, middle]),
            torch.cat([middle, high]),
            torch.cat([before, value], 1),
            torch.cat([value, after], 1),
        )
        self.live = tuple(torch.cat([new, old[..., count:]], -1) for new, old in zip(halves, self.live, strict=True))
        return len(halves[0])

    def found(self) -> list[Crossings]:
        """The crossings of each part, by segment and place."""
        every = (*self.done, self.live)
        root, low, high = (torch.cat([part[k] for part in every]) for k in (0, 1, 2))
        before, after = (torch.cat([part[k] for part in every], 1) for k in (3, 4))
        # a segment is at most 1 px long
        order = torch.argsort(4 * root + (low - pick(self.low, root)))
        order = pick(order, numbers(pick(self._whole(root, after - before, high - low), pick(root, order))))
        root, low, high, before, after = (pick(each, order) for each in (root, low, high, before, after))
        place, width, across, phase = (low + high) / 2, high - low, pick(self.across, root), pick(self.phase, root)
        sizes = torch.tensor([0, *(len(p) for p in self.parts)], device=root.device).cumsum(0)
        starts = torch.searchsorted(root, sizes).tolist()
        return [
            Crossings(
                part.axis, across[a:b], place[a:b], width[a:b], before[:, a:b], after[:, a:b], phase[a:b], root[a:b] - sizes[k]
            )
            for k, (part, a, b) in enumerate(zip(self.parts, starts[:-1], starts[1:], strict=True))
        ]

    def _whole(self, root: Tensor, jump: Tensor, width: Tensor) -> Tensor:
        """Which segments (S,) change by what was found in them; the others also change smoothly, or in too many places: they stay as they are."""
        change = self.after - self.before
        rest = add_at(change.clone(), root, -jump).abs()
        steep = add_at(torch.zeros_like(self.low), root, width) <= _SMOOTH
        return (rest <= _MISSED * change.abs().amax(0)).all(0) & steep


def _any(mask: Tensor) -> Tensor:
    """In any of the channels (C, N)."""
    return mask[0] if len(mask) == 1 else mask.any(0)
