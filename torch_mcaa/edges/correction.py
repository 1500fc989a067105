"""What known jumps correct in a sum over samples: for each, the integral beyond it less the samples beyond it."""

from __future__ import annotations

import math
from collections.abc import Iterator

import torch
from torch import Tensor

from torch_mcaa.edges.bisect import BRACKET, Crossings, placed
from torch_mcaa.edges.missed import missed
from torch_mcaa.edges.pixels import Pixels
from torch_mcaa.filters.base import Filter, SeparableFilter
from torch_mcaa.integrand import width_of
from torch_mcaa.picking import pick
from torch_mcaa.sums import add_at

_AT_ONCE = 1 << 11


class Window:
    """Pixels onto which crossings are scattered.

    Attributes:
        reach: how many pixels off a place its own pixel's neighbours' filters may cover it.
        halo: how many pixels beyond a pixel samples are needed.
        margin: what the `Pixels` have to have.
    """

    def __init__(self, filter: Filter, device: torch.device) -> None:
        self.filter, self.device = filter, device
        self.reach, self.halo = math.ceil(max(filter.radius) + 0.5), self.halo_of(filter)
        self.margin = 2 * self.reach + 3
        self.offsets = torch.arange(-self.reach, self.reach + 1, device=device)

    @staticmethod
    def halo_of(filter: Filter) -> int:
        """How many pixels around another a filter needs samples in, and their neighbours on the lines."""
        return math.ceil(max(filter.radius) - 0.5) + 1

    def correction(self, pixels: Pixels, crossings: Crossings, norm: float) -> tuple[Tensor, Tensor, Tensor]:
        """(C, P): the correction for lines with samples 1 px apart whose weights sum to `norm`, and its variance from the brackets.

        And the `density` (P,) of the crossings.

        A crossing at t on the line y with jump Δ adds Δ w(y - c_y) (D(t) - D_inf W(t)) / norm, where W(t) is the integral of w(x - c_x) over
        x > t, D(t) = W(t) less the samples' sum of the same, and D_inf = D(-inf). It is 0 beyond the filter's reach.
        """
        channels = len(crossings.before)
        total, spread, seen = (self.zeros(pixels, count) for count in (channels, channels, 1))
        crossings = crossings.take(self.reaching(pixels, crossings.axis, crossings.place, crossings.across))
        for at in slices(crossings.place):
            part = crossings.take(at)
            along, across = part.place, part.across
            near, beside = along.floor().long()[:, None] + self.offsets, across.floor().long()[:, None] + self.offsets
            index = pair(pixels, beside, near) if part.axis == 0 else pair(pixels, near, beside)
            weight, doubt = self._weights(part, along[:, None] - near - 0.5, across[:, None] - beside - 0.5)
            weight /= norm
            size = part.jump.abs().amax(0).to(torch.float64)
            add_at(seen[0], index, (size[:, None, None] * doubt).abs_().view(-1))
            # a part of a continuous step changes all over, and has its middle near its own
            width = torch.where(part.width > BRACKET, part.width / 3, part.width)
            doubt *= (width / (math.sqrt(12) * norm))[:, None, None]
            for channel, jump in enumerate(part.jump.to(torch.float64)):
                add_at(total[channel], index, (jump[:, None, None] * weight).view(-1))
                add_at(spread[channel], index, (jump[:, None, None] * doubt).square_().view(-1))
        return total[:, :-1], spread[:, :-1], seen[0, :-1]

    def density(self, pixels: Pixels, axis: int, along: Tensor, across: Tensor, size: Tensor) -> Tensor:
        """(P,): the sum of `size` times |w| at places on lines along `axis`: how much change they see."""
        total = self.zeros(pixels, 1)[0]
        some = self.reaching(pixels, axis, along, across)
        along, across, size = (pick(each, some) for each in (along, across, size))
        places = placed(axis, along, across)
        for at in slices(size):
            x, y = (place[at] for place in places)
            cols, rows = x.floor().long()[:, None] + self.offsets, y.floor().long()[:, None] + self.offsets
            dx, dy = x[:, None] - cols - 0.5, y[:, None] - rows - 0.5
            if isinstance(self.filter, SeparableFilter):
                weight = outer(self.filter.profile(dy).abs() * size[at, None], self.filter.profile(dx).abs())
            else:
                weight = self.filter(dx[:, None], dy[:, :, None]).abs() * size[at, None, None]
            add_at(total, pair(pixels, rows, cols), weight.view(-1))
        return total[:-1]

    def reaching(self, pixels: Pixels, axis: int, along: Tensor, across: Tensor) -> Tensor:
        """The indices of places that may reach a pixel of the rectangle."""
        x, y = placed(axis, along, across)
        margin = self.margin - self.reach - 1
        inside = (x > pixels.col - margin) & (x < pixels.col + pixels.width + margin)
        return (inside & (y > pixels.row - margin) & (y < pixels.row + pixels.height + margin)).nonzero()[:, 0]

    def zeros(self, pixels: Pixels, channels: int) -> Tensor:
        """(channels, P + 1), the last for what lies in none of the pixels."""
        return torch.zeros(channels, len(pixels) + 1, dtype=torch.float64, device=self.device)

    def _weights(self, crossings: Crossings, along: Tensor, across: Tensor) -> tuple[Tensor, Tensor]:
        """(N, K, K), rows and columns: (D - D_inf W) w and |w|, up to the sign of w across, at crossings so far from the pixels' centres (N, K)."""
        # the samples that reach a pixel lie at the same distances from every one
        points = crossings.phase[:, None] - 0.5 + torch.arange(-self.reach - 1, self.reach + 2, device=self.device)
        axis, filter = crossings.axis, self.filter
        if not isinstance(filter, SeparableFilter):
            dx, dy = (along[:, None], across[:, :, None]) if axis == 0 else (across[:, None], along[:, :, None])
            return missed(filter, axis, along, across, points, 1.0), filter(dx, dy)
        weight = filter.profile(points)
        past = (weight[:, None] * (points[:, None] > along[..., None])).sum(-1)
        beyond = (1 - filter.profile_cdf(along)) * weight.sum(-1, keepdim=True) - past
        side, density = filter.profile(across), filter.profile(along).abs()
        return (outer(side, beyond), outer(side, density)) if axis == 0 else (outer(beyond, side), outer(density, side))


def slices(places: Tensor) -> Iterator[slice]:
    """Of places (N,): each adds to all the pixels around it, and of few at a time that can be held."""
    step = _AT_ONCE * width_of(places.device)
    return (slice(start, start + step) for start in range(0, len(places), step))


def pair(pixels: Pixels, rows: Tensor, cols: Tensor) -> Tensor:
    """(N K K,) int64 where in the list the pixels (N, K) x (N, K) of the screen are."""
    return pixels.index(rows[:, :, None], cols[:, None, :]).view(-1)


def outer(a: Tensor, b: Tensor) -> Tensor:
    return a[:, :, None] * b[:, None, :]
