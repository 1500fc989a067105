"""What known jumps correct in a sum over samples: for each, the integral beyond it less the samples beyond it."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torch_mcaa.edges.bisect import Crossings
from torch_mcaa.filters.base import SeparableFilter

_AT_ONCE = 1 << 14


class Window:
    """The pixels (row, col) + [0, height) x [0, width) onto which crossings are scattered.

    Attributes:
        reach: how many pixels off a place its own pixel's neighbours' filters may cover it.
        halo: how many pixels beyond the window samples are needed.
    """

    def __init__(self, row: int, col: int, height: int, width: int, filter: SeparableFilter, device: torch.device) -> None:
        self.row, self.col, self.height, self.width, self.filter = row, col, height, width, filter
        self.reach = math.ceil(filter.half_width + 0.5)
        self.halo = self.halo_of(filter)
        self.device = device
        self._margin = 2 * self.reach + 3
        self.offsets = torch.arange(-self.reach, self.reach + 1, device=device)

    @staticmethod
    def halo_of(filter: SeparableFilter) -> int:
        """How many pixels around another a filter needs samples in, and their neighbours on the lines."""
        return math.ceil(filter.half_width - 0.5) + 1

    def correction(self, crossings: Crossings, norm: float) -> tuple[Tensor, Tensor]:
        """(C, height, width): the correction for lines with samples 1 px apart whose weights sum to `norm`, and its variance from the brackets.

        A crossing at t on the line y with jump Δ adds Δ w(y - c_y) (D(t) - D_inf W(t)) / norm, where W(t) is the integral of w(x - c_x) over
        x > t, D(t) = W(t) less the samples' sum of the same, and D_inf = D(-inf). It is 0 beyond the filter's reach.
        """
        total, spread = self.planes(len(crossings.before)), self.planes(len(crossings.before))
        crossings = crossings.take(self.reaching(crossings.axis, crossings.place, crossings.across))
        for start in range(0, len(crossings), _AT_ONCE):
            part = crossings.take(torch.arange(start, min(start + _AT_ONCE, len(crossings)), device=self.device))
            along, across = part.place, part.across
            near, beside = along.floor().long()[:, None] + self.offsets, across.floor().long()[:, None] + self.offsets
            d, density = self._missed(along, part.phase, near)
            side = self.filter.profile(across[:, None] - beside - 0.5) / norm
            error = density * (part.width / math.sqrt(12))[:, None]
            if part.axis == 0:
                index, weight, doubt = self.index(beside, near), outer(side, d), outer(side, error)
            else:
                index, weight, doubt = self.index(near, beside), outer(d, side), outer(error, side)
            for channel, jump in enumerate(part.jump.to(torch.float64)):
                total[channel].view(-1).index_add_(0, index, (jump[:, None, None] * weight).view(-1))
                spread[channel].view(-1).index_add_(0, index, (jump[:, None, None] * doubt).square_().view(-1))
        return self.inside(total), self.inside(spread)

    def density(self, axis: int, along: Tensor, across: Tensor, size: Tensor) -> Tensor:
        """(height, width): the sum of `size` times |w| at places on lines along `axis`: how much change they see."""
        total = self.planes(1)
        some = self.reaching(axis, along, across)
        along, across, size = along[some], across[some], size[some]
        x, y = (along, across) if axis == 0 else (across, along)
        cols, rows = x.floor().long()[:, None] + self.offsets, y.floor().long()[:, None] + self.offsets
        across_x, across_y = (self.filter.profile(place[:, None] - pixel - 0.5).abs() for place, pixel in ((x, cols), (y, rows)))
        total.view(-1).index_add_(0, self.index(rows, cols), outer(across_y * size[:, None], across_x).view(-1))
        return self.inside(total)[0]

    def reaching(self, axis: int, along: Tensor, across: Tensor) -> Tensor:
        """The indices of places that may reach a pixel of the window."""
        x, y = (along, across) if axis == 0 else (across, along)
        margin = self._margin - self.reach - 1
        inside = (x > self.col - margin) & (x < self.col + self.width + margin)
        return (inside & (y > self.row - margin) & (y < self.row + self.height + margin)).nonzero()[:, 0]

    def planes(self, channels: int) -> Tensor:
        """(channels, h, w) zeros of the window and a margin, into which crossings are scattered."""
        shape = channels, self.height + 2 * self._margin, self.width + 2 * self._margin
        return torch.zeros(shape, dtype=torch.float64, device=self.device)

    def inside(self, planes: Tensor) -> Tensor:
        """What lies in the window."""
        return planes[:, self._margin : -self._margin, self._margin : -self._margin]

    def index(self, rows: Tensor, cols: Tensor) -> Tensor:
        """(N P P,) int64 the places in one of `planes` of the pixels (N, P) x (N, P)."""
        wide = self.width + 2 * self._margin
        rows, cols = rows - self.row + self._margin, cols - self.col + self._margin
        return (rows[:, :, None] * wide + cols[:, None, :]).view(-1)

    def _missed(self, t: Tensor, phase: Tensor, pixels: Tensor) -> tuple[Tensor, Tensor]:
        """(N, P): D - D_inf W at t for the pixels (N, P), and |w(t)|."""
        k = torch.arange(-self.reach - 1, self.reach + 2, device=self.device)
        offset = t[:, None] - pixels - 0.5
        # the samples that reach a pixel lie at the same distances from every one
        distances = phase[:, None] - 0.5 + k
        weight = self.filter.profile(distances)
        past = (weight[:, None] * (distances[:, None] > offset[..., None])).sum(-1)
        beyond = 1 - self.filter.profile_cdf(offset)
        return beyond * weight.sum(-1, keepdim=True) - past, self.filter.profile(offset).abs()


def outer(a: Tensor, b: Tensor) -> Tensor:
    return a[:, :, None] * b[:, None, :]
