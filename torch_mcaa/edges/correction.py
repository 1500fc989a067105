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
        # of the pixels whose filters cover a place from its own; of the samples that one covers from its centre's
        self._pixels, self._samples = (torch.arange(1 - n, n, device=device)[:, None] for n in (self.halo, self.halo + 1))

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
            along, across, index = self.around(pixels, part.axis, part.place, part.across)
            weight, doubt = self._weights(part, along, across)
            weight /= norm
            size = part.jump.abs().amax(0).to(torch.float64)
            add_at(seen[0], index, (size * doubt).abs_().view(-1))
            # a part of a continuous step changes all over, and has its middle near its own
            width = torch.where(part.width > BRACKET, part.width / 3, part.width)
            doubt *= width / (math.sqrt(12) * norm)
            for channel, jump in enumerate(part.jump.to(torch.float64)):
                add_at(total[channel], index, (jump * weight).view(-1))
                add_at(spread[channel], index, (jump * doubt).square_().view(-1))
        return total[:, :-1], spread[:, :-1], seen[0, :-1]

    def density(self, pixels: Pixels, axis: int, along: Tensor, across: Tensor, size: Tensor) -> Tensor:
        """(P,): the sum of `size` times |w| at places on lines along `axis`: how much change they see."""
        total = self.zeros(pixels, 1)[0]
        some = self.reaching(pixels, axis, along, across)
        along, across, size = (pick(each, some) for each in (along, across, size))
        for at in slices(size):
            dx, dy, index = self.around(pixels, 0, *placed(axis, along[at], across[at]))
            if isinstance(self.filter, SeparableFilter):
                weight = outer(self.filter.profile(dy).abs() * size[at], self.filter.profile(dx).abs())
            else:
                weight = self.filter(dx[None], dy[:, None]).abs() * size[at]
            add_at(total, index, weight.view(-1))
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

    def around(self, pixels: Pixels, axis: int, along: Tensor, across: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """How far places (N,) on lines along `axis` are from the centres of the pixels around, along and across, (K, N) both.

        And where in the list these are: int64 (K K N,), rows, columns, places.
        """
        near, beside = (place.floor().long() + self._pixels for place in (along, across))
        cols, rows = placed(axis, near, beside)
        return along - near - 0.5, across - beside - 0.5, pixels.index(rows[:, None], cols[None]).view(-1)

    def _weights(self, crossings: Crossings, along: Tensor, across: Tensor) -> tuple[Tensor, Tensor]:
        """(K, K, N), rows and columns: (D - D_inf W) w and |w|, up to the sign of w across, so far from the pixels' centres (K, N)."""
        # the samples that reach a pixel lie at the same distances from every one
        points = crossings.phase - 0.5 + self._samples
        axis, filter = crossings.axis, self.filter
        if not isinstance(filter, SeparableFilter):
            dx, dy = placed(axis, along, across)
            return missed(filter, axis, along, across, points, 1.0), filter(dx[None], dy[:, None])
        weight = filter.profile(points)
        past = torch.zeros_like(along)
        for point, its in zip(points, weight, strict=True):
            past += its * (point > along)
        beyond = (1 - filter.profile_cdf(along)) * weight.sum(0) - past
        side, density = filter.profile(across), filter.profile(along).abs()
        return (outer(side, beyond), outer(side, density)) if axis == 0 else (outer(beyond, side), outer(density, side))


def slices(places: Tensor) -> Iterator[slice]:
    """Of places (N,): each adds to all the pixels around it, and of few at a time that can be held."""
    step = _AT_ONCE * width_of(places.device)
    return (slice(start, start + step) for start in range(0, len(places), step))


def outer(rows: Tensor, cols: Tensor) -> Tensor:
    """(K, K, N): the products of (K, N) and (K, N). Places come last, for sums over few numbers in the last axis are not vectorised."""
    return rows[:, None] * cols[None]
