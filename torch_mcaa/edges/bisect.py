"""Bisection of many segments at once, both halves kept where both hold a jump."""

from __future__ import annotations

from dataclasses import dataclass, fields

import torch
from torch import Tensor

from torch_mcaa import rng
from torch_mcaa.edges.candidates import Segments
from torch_mcaa.edges.lines import Ask

_PLACE = 0xB15EC
_LEAF = 1 / 16
"""Px: a part no longer followed is a step of its own where it is no wider, and smooth where it is."""
_SPLIT = 0.1
"""How far the first places may move, in quarters of the segment."""
_MISSED = 0.25
"""The share of a segment's change that may lie outside the jumps found in it."""
_QUARTERED = 1 / 16
"""Px: wider segments begin with quarters."""
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

    def take(self, index: Tensor) -> Crossings:
        """The crossings at `index`, integers or bool."""
        return Crossings(self.axis, *(getattr(self, field.name)[..., index] for field in fields(self)[1:]))


def joined(parts: list[Crossings]) -> Crossings:
    """All the crossings of parts along one axis."""
    return Crossings(parts[0].axis, *(torch.cat([getattr(p, f.name) for p in parts], -1) for f in fields(parts[0])[1:]))


def ask_on(ask: Ask, axis: int, along: Tensor, across: Tensor) -> Tensor:
    """f (C, N) at places on lines along `axis`."""
    return ask(along, across) if axis == 0 else ask(across, along)


def bisect(ask: Ask, segments: Segments, finest: float, seed: int) -> Crossings:
    """Narrow brackets to `finest` px or less: whole segments by quarters at places a little random first, then by halves.

    The lines' samples are whole fractions of a pixel apart: without that all lines' brackets of an edge along an axis would be the same, and
    the middles of the last ones have the same error, which a random place in the last bracket adds to and does not remove.
    """
    count = len(segments)
    done: list[tuple[Tensor, ...]] = []

    def followed(root: Tensor, low: Tensor, high: Tensor, before: Tensor, after: Tensor) -> tuple[Tensor, ...]:
        change = (after - before).abs()
        on = (change > segments.least[:, root]).any(0)
        narrow = high - low <= finest
        leaf = torch.where(on, narrow, (high - low <= _LEAF) & (change > 0).any(0))
        if bool(leaf.any()):
            done.append((root[leaf], low[leaf], high[leaf], before[:, leaf], after[:, leaf]))
        on &= ~narrow
        if not bool(on.all()):
            root, low, high, before, after = root[on], low[on], high[on], before[:, on], after[:, on]
        few = torch.bincount(root, minlength=count)[root] <= _MOST
        if not bool(few.all()):
            root, low, high, before, after = root[few], low[few], high[few], before[:, few], after[:, few]
        return root, low, high, before, after

    root = torch.arange(count, device=segments.across.device)
    whole = (segments.high - segments.low > _QUARTERED).nonzero()[:, 0]
    rest = (segments.high - segments.low <= _QUARTERED).nonzero()[:, 0]
    live = followed(rest, segments.low[rest], segments.high[rest], segments.before[:, rest], segments.after[:, rest])
    if len(whole):
        # quarters at once: a middle alone would often miss a second thin piece close by
        some = segments.take(whole)
        moved = _SPLIT * (rng.uniform(seed, _PLACE, some.axis, *some.key.unbind(1), dtype=torch.float64) - 0.5)
        share = (torch.arange(1, 4, device=root.device)[:, None] + moved) / 4
        places = some.low + share * (some.high - some.low)
        values = ask_on(ask, some.axis, places.flatten(), some.across.repeat(3)).unflatten(1, places.shape)
        ends = torch.cat([some.low[None], places, some.high[None]])
        values = torch.cat([some.before[:, None], values, some.after[:, None]], 1)
        quarters = followed(
            whole.repeat(4), ends[:-1].flatten(), ends[1:].flatten(), values[:, :-1].flatten(1), values[:, 1:].flatten(1)
        )
        live = tuple(torch.cat(pair, -1) for pair in zip(live, quarters, strict=True))
    while len(live[0]):
        root, low, high, before, after = live
        middle = (low + high) / 2
        value = ask_on(ask, segments.axis, middle, segments.across[root])
        live = followed(
            torch.cat([root, root]),
            torch.cat([low, middle]),
            torch.cat([middle, high]),
            torch.cat([before, value], 1),
            torch.cat([value, after], 1),
        )
    done.append(live)
    root, low, high = (torch.cat([part[k] for part in done]) for k in (0, 1, 2))
    before, after = (torch.cat([part[k] for part in done], 1) for k in (3, 4))
    order = torch.argsort(low)
    order = order[torch.argsort(root[order], stable=True)]
    order = order[_whole(segments, root, after - before)[root[order]]]
    root, low, high, before, after = root[order], low[order], high[order], before[:, order], after[:, order]
    return Crossings(segments.axis, segments.across[root], (low + high) / 2, high - low, before, after, segments.phase[root], root)


def _whole(segments: Segments, root: Tensor, jump: Tensor) -> Tensor:
    """Which segments (S,) change by what was found in them; the others also change smoothly, or in too many places: they stay as they are."""
    change = segments.after - segments.before
    rest = change.index_add(1, root, jump, alpha=-1).abs()
    return (rest <= _MISSED * change.abs().amax(0)).all(0)
