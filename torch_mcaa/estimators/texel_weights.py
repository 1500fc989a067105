"""What the texels of one axis weigh in its pixels: integrals of the filter's profile times a texel's piecewise polynomial."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from torch_mcaa.filters import SeparableFilter
from torch_mcaa.filters.gauss import legendre
from torch_mcaa.filters.quadrature import FEW, panels
from torch_mcaa.texture import TAPS, Interpolation, Wrap, blending, origin, wrapped

_NODES = 2**20
"""That are held at once."""
_MOST = 2**12
"""Texels under a filter of a texture that has no end."""
_BEYOND = 3
"""Texels beyond the border from which on one that ends there is constant."""
_FAR = 2.0**40
"""Texels from the origin, where places are still known to 1e-4 of one."""


class Weights(NamedTuple):
    """A sparse matrix, row by row: the places and values of row i begin at `start[i]`."""

    start: Tensor
    place: Tensor
    value: Tensor

    def times(self, lines: Tensor) -> Tensor:
        """(rows, m) of lines (places, m): each sum in one order, whatever the number of threads."""
        return torch.nn.functional.embedding_bag(self.place, lines, self.start, mode="sum", per_sample_weights=self.value)

    def transposed(self, places: int) -> Weights:
        rows = torch.arange(len(self.start), device=self.start.device)
        ends = torch.cat([self.start[1:], self.start.new_tensor([len(self.place)])])
        row = rows.repeat_interleave(ends - self.start)
        order = self.place.argsort(stable=True)
        counts = torch.bincount(self.place, minlength=places)
        return Weights(counts.cumsum(0) - counts, row[order], self.value[order])

    def sizes(self) -> Tensor:
        """The sum of each row's moduli."""
        none = Weights(self.start, torch.zeros_like(self.place), self.value.abs())
        return none.times(self.value.new_ones(1, 1))[:, 0]


@dataclass(frozen=True)
class Axis:
    """One axis of the screen and of the texture: u = scale t + shift, t in screen pixels, u in texels."""

    scale: float
    shift: float
    pixels: int
    texels: int
    interpolation: Interpolation
    wrap: Wrap

    @property
    def endless(self) -> bool:
        return self.wrap in ("repeat", "mirror")

    def fits(self, filter: SeparableFilter) -> bool:
        """Whether the weights are finite, and few enough to be held."""
        farthest = max(abs(self.shift), abs(self.scale * self.pixels + self.shift))
        few = not self.endless or 2 * filter.half_width * abs(self.scale) <= _MOST
        return few and self.scale != 0 and farthest <= _FAR

    def weights(self, filter: SeparableFilter, boundary: str, first: int, count: int) -> Weights:
        """What the texels weigh in some pixels, by Gauss-Legendre rules on pieces that end where profile or texel has a kink."""
        most = math.ceil(2 * filter.half_width * abs(self.scale)) + 2
        if not self.endless:
            most = min(most, self.texels + 2 * _BEYOND + 1)
        ends = panels(filter)
        step = max(1, _NODES // (FEW * (most + len(ends))))
        parts = [
            self._of(filter, boundary, ends, most, torch.arange(start, min(start + step, first + count), dtype=torch.float64) + 0.5)
            for start in range(first, first + count, step)
        ]
        counts, places, values = (torch.cat(part) for part in zip(*parts, strict=True))
        return Weights(counts.cumsum(0) - counts, places, values)

    def _of(self, filter: SeparableFilter, boundary: str, ends: Tensor, most: int, centre: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """How many weights the pixels about some centres have, the texels they are of, and the weights."""
        low, high = torch.full_like(centre, -filter.half_width), torch.full_like(centre, filter.half_width)
        if boundary != "extend":
            low, high = torch.maximum(low, -centre), torch.minimum(high, self.pixels - centre)
        # in texels from the beginning of an interval; d is in pixels from the centre
        middle = self.scale * centre + self.shift - origin(self.interpolation)
        begin = torch.minimum(middle + self.scale * low, middle + self.scale * high).floor()
        if not self.endless:
            begin = begin.clamp(-_BEYOND, self.texels + _BEYOND)
        knots = (begin[:, None] + torch.arange(1, most) - middle[:, None]) / self.scale
        cuts = torch.cat([knots, ends.expand(len(centre), -1)], 1).clamp(low[:, None], high[:, None]).sort(1).values
        rule, rule_weights = (t.view(-1) for t in legendre(torch.tensor([0.0, 1.0], dtype=torch.float64), FEW))
        width = cuts.diff(dim=1)[:, :, None]
        d = cuts[:, :-1, None] + width * rule
        mass = width * rule_weights * filter.profile(d)
        along = middle[:, None, None] + self.scale * d
        interval = along.mean(2).floor().clamp(begin[:, None], begin[:, None] + most - 1)
        others = [(mass * b).sum(2) for b in blending(self.interpolation, (along - interval[:, :, None]).clamp(0, 1))]
        taps = TAPS[self.interpolation]
        here = taps.index(0)
        pieces = [*others[:here], mass.sum(2) - sum(others), *others[here:]]
        column = (interval - begin[:, None]).long()
        band = torch.zeros(len(centre), most + len(taps) - 1, dtype=torch.float64)
        for number, piece in enumerate(pieces):
            band.scatter_add_(1, column + number, piece)
        if boundary != "zero":
            # by what they sum to: 1 but for rounding, or the filter's share on the screen
            band /= band.sum(1, keepdim=True)
        texel = begin[:, None] + taps[0] + torch.arange(band.shape[1])
        kept = band != 0
        if self.wrap == "zeros":
            kept &= (texel >= 0) & (texel < self.texels)
        return kept.sum(1), wrapped(texel[kept], self.texels, self.wrap), band[kept]
