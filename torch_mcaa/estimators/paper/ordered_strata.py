"""Stratification by order (section 10 of Halton's paper): strata cut where the values, put in order, jump."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torch_mcaa.estimators.paper.pixelwise import Drawn, Pixels, Sequential, combined
from torch_mcaa.estimators.paper.stratified import stratified
from torch_mcaa.estimators.rectangles import cut, even
from torch_mcaa.patterns import Independent

_FIRST = 4
"""One part in so many of the evaluations is the first round."""
_MOST = 128
"""Rectangles a pixel: more points than twice as many share them."""


@dataclass(frozen=True, repr=False)
class OrderedStrata(Sequential):
    """Sort (C, x, y) in each pixel, find the axis that C is correlated with, split where it jumps, sample, repeat.

    The strata are rectangles in the unit square of the filter's inverse cumulative distribution, where every point has a weight of the
    same modulus. The first round has a grid of them. For each later one the square is cut anew from all points met so far: again
    and again the rectangle with the largest measure times standard deviation, across the axis with which the values correlate most, at the point that
    leaves least of that product. Points on a border count on both sides, so what lies between the last of one colour and the first of the
    next becomes a rectangle of its own. Then two fresh points are drawn in each rectangle, one in either half.

    Unbiased, since a round's strata depend on earlier rounds alone. The two points of a stratum give its variance, too large by what its halves
    differ. "fixed" weighs the rounds by their evaluations to the power 3/2, "pooled" by their evaluations, "discard_pilot" keeps the last alone.

    Attributes:
        rounds: how many, 2 or more. Two measure best at 64 evaluations: on edges a third of the variance of independent importance sampling,
            on axis edges a sixth; three have half of it, and three times as much on hairlines that the first round missed.
    """

    def draw(self, pixels: Pixels, n: int) -> Drawn:
        first, later = max(2, n // _FIRST), self.rounds - 1
        sizes = [first, *((n - first) // later + (k < (n - first) % later) for k in range(later))]
        boxes = even(first // 2, len(pixels), pixels.rows.device)
        met: list[tuple[Tensor, Tensor, Tensor]] = []
        rounds = []
        for inner, size in enumerate(sizes):
            if met:
                xs, ys, terms = zip(*met, strict=True)
                boxes = cut(torch.cat(xs), torch.cat(ys), torch.cat(terms, 1), min(_MOST, max(1, size // 2)))
            stratum = torch.arange(size, device=pixels.rows.device)[:, None].expand(-1, len(pixels)) % boxes.shape[1]
            x, y = _points(pixels, boxes, size, inner)
            dx, dy, weight = pixels.task.filter.sample(x, y)
            values, valid = pixels.evaluate(dx, dy)
            met.append((x, y, values * weight))
            each = torch.bincount(stratum[:, 0], minlength=boxes.shape[1]).to(torch.float64)[:, None]
            measure = (boxes[1] - boxes[0]) * (boxes[3] - boxes[2])
            coefficient = weight * (measure / each).gather(0, stratum)
            rounds.append(stratified(values, coefficient, valid, stratum))
        power = 1.0 if self.combine == "pooled" else 1.5
        weights = [0.0 if self.combine == "discard_pilot" and k < later else size**power for k, size in enumerate(sizes)]
        return combined(rounds, weights)


def _points(pixels: Pixels, boxes: Tensor, size: int, inner: int) -> tuple[Tensor, Tensor]:
    """x, y (size, P): points of the rectangles in turn, two points of one lying in its halves along its longer side."""
    index, count = torch.arange(size, device=boxes.device)[:, None], boxes.shape[1]
    low_x, high_x, low_y, high_y = (side[index[:, 0] % count] for side in boxes)
    u, v = pixels.points(Independent(), size, inner)
    half = index // count % 2
    paired, wide = index + count * (1 - 2 * half) < size, high_x - low_x >= high_y - low_y
    u, v = torch.where(paired & wide, (u + half) / 2, u), torch.where(paired & ~wide, (v + half) / 2, v)
    return low_x + u * (high_x - low_x), low_y + v * (high_y - low_y)
