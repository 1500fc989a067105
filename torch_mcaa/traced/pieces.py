"""Random pieces of lines across the screen, and bisection of those in which f is sharpest though it decides alike."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torch_mcaa import rng
from torch_mcaa.picking import numbers, pick
from torch_mcaa.traced.asked import Asked

_AUDIT = 0xA0D17
_ROUNDING = 1e-5
"""What is no change, in magnitudes of f."""
_STANDS_OUT = 0.05
"""Of what f changes by along the whole piece, the least of a jump."""
_FEW = 4
"""Lengths of what is left of a piece, that it is compared with what is around it over."""
_STAGES = (4, 16)
"""Of the pieces, halved twice, one in so many, the sharpest, are halved twice more."""
HALVED = 2 + 2 * len(_STAGES)
"""How often `pieces` have been halved."""
_TOGETHER = 1 << 12
"""Pieces that are looked at together."""
_OF_ALL = ("range", "magnitude")
"""The attributes that all pieces share."""


@dataclass(frozen=True)
class Pieces:
    """Parts of pieces of lines of up to 1 px at whose ends and middle f decides alike, N of them.

    By second differences: across a jump that of f is the jump, however steep f is beside it, and of what is smooth a quarter is left in a half.

    Attributes:
        col, row: (N,) float64 screen pixels where the pieces begin; over, down: (N,) what they span, one of them 0.
        low, high: (N,) the part that is left, in parts of the piece; values: (3, C, N) f at its ends, the middle between.
        signature: (N,); change: (C, N) the largest `jump` that was seen of the piece or a part, since `pieces` found it;
            across: (C, N) what f changes by along the whole piece.
        range, magnitude: (C,) of f over the screen.
    """

    col: Tensor
    row: Tensor
    over: Tensor
    down: Tensor
    low: Tensor
    high: Tensor
    values: Tensor
    signature: Tensor
    change: Tensor
    across: Tensor
    range: Tensor
    magnitude: Tensor

    def __len__(self) -> int:
        return len(self.col)

    @property
    def jump(self) -> Tensor:
        """(C, N): the second difference of f."""
        before, middle, after = self.values
        return (before - 2 * middle + after).abs()

    def size(self, jumps: Tensor | None = None) -> Tensor:
        """(N,): the largest of a channel's `jump`, or of others like it (C, N), in ranges of that."""
        return self._relative(self.jump if jumps is None else jumps).amax(0)

    def channel(self, jumps: Tensor) -> Tensor:
        """(N,): the channel of which the jump (C, N) is largest in ranges of that."""
        return self._relative(jumps).argmax(0)

    def stands_out(self) -> Tensor:
        """bool (N,): where a jump is no rounding, and not the foot of a wider ramp."""
        return ((self.jump > _STANDS_OUT * self.across) & self._unrounded()).any(0)

    def changes(self) -> Tensor:
        """bool (N,): where f changes by more than it may be rounded by."""
        return self._unrounded().any(0)

    def _unrounded(self) -> Tensor:
        return self.jump > _ROUNDING * self.magnitude[:, None]

    def alone(self, asked: Asked) -> Tensor:
        """bool (N,): where f changes in what is left by over half of what it does a few lengths around it: no end of a wider ramp."""
        middle, beside = (self.low + self.high) / 2, _FEW * (self.high - self.low)
        share = torch.stack([middle - beside, middle + beside]).clamp(0, 1)
        around = asked.values(*(place.flatten() for place in self.at(share)))[0].unflatten(1, (2, -1)).movedim(1, 0)
        inside, all_of_it = (
            (values.amax(0) - values.amin(0)).gather(0, self.channel(self.jump)[None])[0]
            for values in (self.values, torch.cat([self.values, around]))
        )
        return inside > 0.5 * all_of_it

    def _relative(self, jumps: Tensor) -> Tensor:
        return jumps / self.range[:, None]

    def left(self) -> Tensor:
        """(N,): the parts of what `change` was that are left in the channels' sharpest."""
        return self.size() / self.size(self.change)

    def at(self, share: Tensor) -> tuple[Tensor, Tensor]:
        """Columns and rows at a share (..., N) of each piece."""
        return self.col + share * self.over, self.row + share * self.down

    def take(self, index: Tensor) -> Pieces:
        """Those at `index`, integers or bool."""
        index = numbers(index)
        return replace(self, **{name: pick(getattr(self, name), index) for name in _each()})

    def halved(self, asked: Asked, steps: int) -> Pieces:
        """The sharper half of the half ..., of those where f decides alike at all places asked."""
        kept = self
        for _ in range(steps):
            middle = (kept.low + kept.high) / 2
            before, there, after = kept.values
            places = kept.at(torch.stack([(kept.low + middle) / 2, (middle + kept.high) / 2]))
            asked_for, signature = asked.values(*(place.flatten() for place in places))
            first, second = asked_for.unflatten(1, (2, -1)).unbind(1)
            halves = (
                replace(kept, high=middle, values=torch.stack([before, first, there])),
                replace(kept, low=middle, values=torch.stack([there, second, after])),
            )
            left = halves[0].size() >= halves[1].size()
            low, high, values = (torch.where(left, *(getattr(half, name) for half in halves)) for name in ("low", "high", "values"))
            kept = replace(kept, low=low, high=high, values=values)
            kept = replace(kept, change=torch.maximum(kept.change, kept.jump))
            kept = kept.take((signature.unflatten(0, (2, -1)) == kept.signature).all(0))
        return kept


def pieces(asked: Asked, seed: int, looked: int, followed: int) -> Pieces | None:
    """The `followed` of `looked` random pieces in which f is sharpest, `HALVED` times; None if f gave two values for one point."""
    parts: list[Pieces] = []
    for index in torch.arange(looked, device=asked.device).split(_TOGETHER):
        part = _begun(asked, seed, index)
        if not parts:
            values, _ = asked.values(*(place[:16] for place in part.at(part.low)))
            if not torch.equal(values, part.values[0, :, :16]):
                return None
        part = part.halved(asked, 2)
        parts.append(part.take(_sharpest(part, max(followed, len(index) // _STAGES[0]))))
    found = _joined(parts)
    for share in _STAGES[1:]:
        found = found.halved(asked, 2)
        found = found.take(_sharpest(found, max(followed, looked // share)))
    found = found.halved(asked, 2)
    found = found.take(found.changes())
    found = found.take(_sharpest(found, followed))
    return replace(found, change=found.jump)


def _begun(asked: Asked, seed: int, index: Tensor) -> Pieces:
    """Whole pieces, those of some numbers (N,), where f decides alike in the middle and at the ends."""
    screen = asked.screen
    across, along, axis = (rng.uniform(seed, _AUDIT, k, index, dtype=torch.float64) for k in range(3))
    flat = (axis < 0.5).to(torch.float64)
    over, down = flat * min(1, screen.width / 2), (1 - flat) * min(1, screen.height / 2)
    col, row = torch.minimum(across * screen.width, screen.width - over), torch.minimum(along * screen.height, screen.height - down)
    (before, first), (middle, between), (after, last) = (
        asked.values(col + share * over, row + share * down) for share in (0, 0.5, 1)
    )
    values = torch.stack([before, middle, after])
    span = values.amax((0, 2)) - values.amin((0, 2))
    whole = Pieces(
        *(col, row, over, down, torch.zeros_like(col), torch.ones_like(col)),
        *(
            values,
            first,
            torch.zeros_like(before),
            (after - before).abs(),
            torch.where(span > 0, span, 1),
            values.abs().amax((0, 2)),
        ),
    )
    return whole.take((first == between) & (between == last))


def _joined(parts: list[Pieces]) -> Pieces:
    each = {name: torch.cat([getattr(part, name) for part in parts], -1) for name in _each()}
    largest = {name: torch.stack([getattr(part, name) for part in parts]).amax(0) for name in _OF_ALL}
    return Pieces(**each, **largest)


def _each() -> list[str]:
    """The attributes that each piece has its own of."""
    return [name for name in Pieces.__dataclass_fields__ if name not in _OF_ALL]


def _sharpest(found: Pieces, count: int) -> Tensor:
    return torch.argsort(found.size(), descending=True)[:count]
