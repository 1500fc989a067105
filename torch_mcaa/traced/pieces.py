"""Random pieces of lines across the screen, and bisection of those along which f changes most though it decides alike."""

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


@dataclass(frozen=True)
class Pieces:
    """Parts of pieces of lines of up to 1 px between whose ends f decides alike, N of them, those first along which f changed most.

    Attributes:
        col, row: (N,) float64 screen pixels where the pieces begin; over, down: (N,) what they span, one of them 0.
        low, high: (N,) the part that is left, in parts of the piece; before, after: (C, N) f there.
        signature: (N,); change: (N,) the largest that was seen of f, in any channel, along the whole piece or a part.
    """

    col: Tensor
    row: Tensor
    over: Tensor
    down: Tensor
    low: Tensor
    high: Tensor
    before: Tensor
    after: Tensor
    signature: Tensor
    change: Tensor

    def __len__(self) -> int:
        return len(self.col)

    @property
    def size(self) -> Tensor:
        """(N,): what f changes by along the part that is left."""
        return (self.after - self.before).abs().amax(0)

    def at(self, share: Tensor) -> tuple[Tensor, Tensor]:
        """Columns and rows at a share (..., N) of each piece."""
        return self.col + share * self.over, self.row + share * self.down

    def take(self, index: Tensor) -> Pieces:
        """Those at `index`, integers or bool."""
        index = numbers(index)
        return Pieces(*(pick(getattr(self, name), index) for name in self.__dataclass_fields__))

    def halved(self, asked: Asked, steps: int) -> Pieces:
        """The half along which f changes most of the half ..., of those where f decides alike at all places asked."""
        kept = self
        for _ in range(steps):
            half = (kept.low + kept.high) / 2
            there, signature = asked.values(*kept.at(half))
            left = (there - kept.before).abs().amax(0) >= (kept.after - there).abs().amax(0)
            part = replace(
                kept,
                low=torch.where(left, kept.low, half),
                high=torch.where(left, half, kept.high),
                before=torch.where(left, kept.before, there),
                after=torch.where(left, there, kept.after),
            )
            kept = replace(part, change=torch.maximum(part.change, part.size)).take(signature == kept.signature)
        return kept


def pieces(asked: Asked, seed: int, looked: int, followed: int) -> Pieces | None:
    """The `followed` of `looked` random pieces along which f changes most; None if f gave two values for one point."""
    screen, device = asked.screen, asked.device
    index = torch.arange(looked, device=device)
    across, along, axis = (rng.uniform(seed, _AUDIT, k, index, dtype=torch.float64) for k in range(3))
    flat = (axis < 0.5).to(torch.float64)
    over, down = flat * min(1, screen.width / 2), (1 - flat) * min(1, screen.height / 2)
    col, row = torch.minimum(across * screen.width, screen.width - over), torch.minimum(along * screen.height, screen.height - down)
    before, first = asked.values(col, row)
    again, _ = asked.values(col[:16], row[:16])
    if not torch.equal(again, before[:, :16]):
        return None
    after, last = asked.values(col + over, row + down)
    size = (after - before).abs().amax(0)
    noticed = size.masked_fill((first != last) | (size <= _ROUNDING * before.abs().amax()), 0)
    number = torch.argsort(noticed, descending=True)[: min(followed, int(noticed.count_nonzero()))]
    whole = Pieces(col, row, over, down, torch.zeros_like(col), torch.ones_like(col), before, after, first, noticed)
    return whole.take(number)
