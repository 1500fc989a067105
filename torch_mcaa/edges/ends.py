"""Where edges that lie along the lines end: there the integrals along neighbouring lines jump, which the sum over the lines misses.

Crossings correct every line's integral L(y) = ∫ f(x, y) w(x - c_x) dx; the mean over k lines a pixel is then good to the extent that L is
smooth. An edge along the lines makes it jump, by as much of the edge as the filter covers. The lines along the other axis cross that edge, and
each crossing stands for 1/k px of it: what the sum over the lines misses there is known as a sample's is, with the lines in the place of
the samples.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torch_mcaa.edges.bisect import Crossings
from torch_mcaa.edges.correction import Window, outer, slices
from torch_mcaa.edges.lines import Lines, norm
from torch_mcaa.edges.missed import missed
from torch_mcaa.edges.pieces import SAME, Numbered, place_of
from torch_mcaa.edges.pixels import Pixels
from torch_mcaa.filters.base import SeparableFilter
from torch_mcaa.picking import pick
from torch_mcaa.sums import add_at

_FLAT = 0.1
"""The slope below which an edge lies along lines. Steeper ones cross them often enough for L to be smooth."""


def ends(window: Window, pixels: Pixels, crossings: Crossings, lines: Lines) -> Tensor:
    """(C, P): what sums over the lines along the one axis miss, from `crossings` on the lines along the other."""
    total = window.zeros(pixels, len(crossings.before))
    part = crossings.take(_flat(crossings, lines))
    part = part.take(window.reaching(pixels, part.axis, part.place, part.across))
    filter = window.filter
    across = lines.y if crossings.axis == 1 else lines.x
    # the lines lie at the same distances from every pixel's centre
    line = torch.sort(
        (across[:, None] + torch.arange(-window.reach - 1, window.reach + 2, device=window.device) - 0.5).flatten()
    ).values
    scale = norm(lines, filter, window.halo)
    for at in slices(part.place):
        some = part.take(at)
        offset, side, index = window.around(pixels, some.axis, some.place, some.across)
        if isinstance(filter, SeparableFilter):
            weight = filter.profile(line) / lines.count
            beyond = torch.cat([weight.flip(0).cumsum(0).flip(0), weight.new_zeros(1)])
            lacking = (1 - filter.profile_cdf(offset)) * beyond[0] - beyond[torch.searchsorted(line, offset, right=True)]
            profile = filter.profile(side)
            weights = outer(lacking, profile) if some.axis == 1 else outer(profile, lacking)
        else:
            weights = missed(filter, some.axis, offset, side, line[:, None], 1 / lines.count)
        weights /= scale
        for channel, jump in enumerate(some.jump.to(torch.float64)):
            add_at(total[channel], index, (jump * weights).view(-1))
    return total[:, :-1]


def _flat(crossings: Crossings, lines: Lines) -> Tensor:
    """The indices of crossings whose edge goes on to a neighbouring line with hardly any change of place."""
    grid = Numbered(lines, crossings.axis)
    line = grid.number(crossings.across)
    order = torch.argsort(place_of(line, crossings.place))
    places, lines_of, where = (pick(each, order) for each in (place_of(line, crossings.place), line, crossings.place))
    jump, jumps = pick(crossings.jump, order), crossings.jump
    flat = torch.zeros_like(line, dtype=torch.bool)
    size = crossings.jump.abs().amax(0)
    for step in (1, -1):
        target = place_of(line + step, crossings.place)
        after = torch.searchsorted(places, target)
        for index in (after, after - 1):
            one = index.clamp(0, max(0, len(order) - 1))
            alike = (pick(jump, one) - jumps).abs().amax(0) <= SAME * size
            flat |= (pick(lines_of, one) == line + step) & ((pick(where, one) - crossings.place).abs() * grid.count < _FLAT) & alike
    return flat.nonzero()[:, 0]
