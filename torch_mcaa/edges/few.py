"""f at a few places at a time, in NumPy: where each step hangs on the last one calls are all it costs, and a tensor's take several times as long."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, Self, TypeAlias

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torch_mcaa.edges.bisect import FAINT, QUARTERED, ROUNDING
from torch_mcaa.edges.candidates import FOLLOWED
from torch_mcaa.edges.lines import Ask

Floats: TypeAlias = NDArray[Any]
Colours: TypeAlias = NDArray[Any]
Mask: TypeAlias = NDArray[Any]
Integers: TypeAlias = NDArray[Any]
"""What arrays hold: float64, the picture's dtype, bool and int64; NumPy's own types of what operators return are unions of these."""

_GOLDEN = (5**0.5 - 1) / 2
_UNEVEN = 0.2
"""How much the first parts of brackets differ, in parts: were they alike on all lines, the middles of the last ones would all err alike."""
_PIXELS, _PARTS = 1 << 14, 16
"""For each so many pixels a bracket may be cut into up to so many parts at once: a call takes longer than a few places do, which small areas cannot
pay for."""
_CLEAR = 0.5
"""One jump has to be this much of what a bracket changes by."""


def on_host(values: Tensor) -> NDArray[Any]:
    """Whatever device they are on."""
    return values.cpu().numpy()


def uneven(line: Integers) -> Floats:
    """(N,) in [0, 1): no two of a few lines next to each other, by their numbers, have nearly the same."""
    return line * _GOLDEN % 1


@dataclass(frozen=True)
class Arrays:
    """Arrays whose last axes are of the same things."""

    @property
    def each(self) -> tuple[NDArray[Any], ...]:
        """The arrays, in order."""
        return tuple(getattr(self, field.name) for field in fields(self))

    def take(self, index: Mask | Integers) -> Self:
        """Those at `index`, integers or bool."""
        return type(self)(*(values[..., index] for values in self.each))

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """Those of all parts."""
        return cls(*(np.concatenate(values, -1) for values in zip(*(part.each for part in parts), strict=True)))


@dataclass(frozen=True)
class Brackets(Arrays):
    """Parts of lines (..., N) from low to high, with f before and after (C, ..., N)."""

    low: Floats
    high: Floats
    before: Colours
    after: Colours


class Few:
    """f on lines along `axis`, asked by tensors on a device, in an area of so many `pixels`."""

    def __init__(self, ask: Ask, axis: int, device: torch.device, pixels: int) -> None:
        self.ask, self.axis, self.device, self.few = ask, axis, device, pixels // _PIXELS

    def at(self, along: Floats, across: Floats) -> Colours:
        """f (C, ..., N) at places (..., N) on lines `across` (N,)."""
        places = along, np.broadcast_to(across, along.shape)
        col, row = (torch.from_numpy(each.flatten()).to(self.device) for each in (places if self.axis == 0 else places[::-1]))
        values = on_host(self.ask(col, row))
        return values.reshape(len(values), *along.shape)

    def narrowed(self, line: Integers, across: Floats, phase: Floats, wide: Brackets, finest: float) -> tuple[Mask, Brackets]:
        """Which of the brackets (N,) hold one jump and no other change, and all of them, in those no wider than `finest` px about it.

        Nor with a sample of their line in them, as `bisect` has it.

        line: the lines' numbers; phase: where on them their samples lie, modulo 1.
        """
        size = np.abs(wide.after - wide.before)
        faint, single = FAINT * FOLLOWED * size, np.ones(len(line), dtype=np.bool_)
        low, high, before, after = (each.copy() for each in wide.each)

        def cut(index: Integers, ends: Floats, share: float = 1.0) -> None:
            """Take the part, of those between the `ends` (parts + 1, n), that changes by more than a share of what is faint."""
            inner = self.at(ends[1:-1], across[index])
            values = np.concatenate([before[:, None, index], inner, after[:, None, index]], 1)
            changed = (np.abs(values[:, 1:] - values[:, :-1]) > share * faint[:, None, index]).any(0)
            single[index] = changed.sum(0) == 1
            part, each = changed.argmax(0), np.arange(len(index))
            low[index], high[index] = ends[part, each], ends[part + 1, each]
            before[:, index], after[:, index] = values[:, part, each], values[:, part + 1, each]

        moved = _UNEVEN * (uneven(line) - 0.5)
        while len(index := np.flatnonzero(single & (high - low > finest))):
            width = high[index] - low[index]
            parts = least = 4 if width.max() > QUARTERED else 2
            if len(index) <= self.few:
                parts = min(_PARTS, max(least, 2 ** int(np.ceil(np.log2(width.max() / finest)))))
            number = np.arange(parts + 1.0)[:, None].repeat(len(index), 1)
            number[1:-1] += moved[index]
            moved[index] = 0
            # of a slope each of more parts has less
            cut(index, low[index] + number / parts * width, least / parts)
        sample = np.floor(high - phase) + phase
        held = np.flatnonzero(single & (sample > low + ROUNDING) & (sample < high - ROUNDING))
        if len(held):
            cut(held, np.stack([low[held], sample[held], high[held]]))
        single &= np.abs(after - before).max(0) > _CLEAR * size.max(0)
        return single, Brackets(low, high, before, after)
