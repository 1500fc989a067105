"""Stratification by order (section 10 of Halton's paper): strata cut where the values, put in order, jump."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torch_mcaa.errors import McaaError
from torch_mcaa.estimators.base import Task
from torch_mcaa.estimators.pixelwise import ROUNDS, Drawn, Pixels, Pixelwise
from torch_mcaa.estimators.stratified import joined, stratified
from torch_mcaa.patterns import Independent
from torch_mcaa.patterns.jittered import strata

_FIRST = 4
"""One part in so many of the evaluations is the first round."""
_NARROWEST = 1e-6
"""No stratum is cut off that is less than this part of another."""


@dataclass(frozen=True, repr=False)
class OrderedStrata(Pixelwise):
    """Sort (C, x, y) in each pixel, find the axis that C is correlated with, split where it jumps, sample, repeat.

    The strata are rectangles in the unit square of the filter's inverse cumulative distribution, where every point has a weight of the
    same modulus. The first round has a grid of them. For each later one the square is cut anew from all points met so far: again
    and again the rectangle with the largest measure times standard deviation, across the axis with which the values correlate most, at the point that
    leaves least of that product. Points on a border count on both sides, so what lies between the last of one colour and the first of the
    next becomes a rectangle of its own. Then two fresh points are drawn in each rectangle.

    Unbiased, since a round's strata depend on earlier rounds alone; the two points of a stratum give its variance without bias. "fixed" weighs
    the rounds by their evaluations to the power 3/2, "pooled" by their evaluations, "discard_pilot" keeps the last alone.

    Attributes:
        rounds: how many, 2 or more.
    """

    rounds: int = 2

    def __post_init__(self) -> None:
        super().__post_init__()
        if isinstance(self.rounds, bool) or not isinstance(self.rounds, int) or not 2 <= self.rounds <= ROUNDS:
            raise McaaError(f"rounds must be an integer from 2 to {ROUNDS}, got {self.rounds!r}")

    @property
    def fewest(self) -> int:
        return 2 * self.rounds

    def check(self, task: Task) -> None:
        super().check(task)
        _ = task.filter.absolute_integral

    def draw(self, pixels: Pixels, n: int) -> Drawn:
        first = max(2, n // _FIRST)
        later = self.rounds - 1
        sizes = [first, *((n - first) // later + (k < (n - first) % later) for k in range(later))]
        boxes = _grid(first // 2, len(pixels), pixels.rows.device)
        xs, ys, terms = [], [], []
        result, spent = None, 0
        for inner, size in enumerate(sizes):
            stratum = (torch.arange(size, device=pixels.rows.device) % boxes.shape[1])[:, None].expand(-1, len(pixels))
            low_x, high_x, low_y, high_y = (side.gather(0, stratum) for side in boxes)
            u, v = pixels.points(Independent(), size, inner)
            # the two points of a rectangle lie in its halves
            half = (torch.arange(size, device=u.device) // boxes.shape[1] % 2)[:, None]
            paired = (torch.arange(size, device=u.device) + boxes.shape[1] * (1 - 2 * half[:, 0]) < size)[:, None]
            wide = high_x - low_x >= high_y - low_y
            u, v = torch.where(paired & wide, (u + half) / 2, u), torch.where(paired & ~wide, (v + half) / 2, v)
            x, y = low_x + u * (high_x - low_x), low_y + v * (high_y - low_y)
            dx, dy, weight = pixels.task.filter.sample(x, y)
            values, valid = pixels.evaluate(dx, dy)
            each = torch.bincount(stratum[:, 0], minlength=boxes.shape[1]).to(torch.float64)[:, None]
            measure = (boxes[1] - boxes[0]) * (boxes[3] - boxes[2])
            coefficient = weight * (measure / each).gather(0, stratum)
            drawn = stratified(values * coefficient, coefficient, valid, stratum)
            xs, ys, terms = [*xs, x], [*ys, y], [*terms, values * weight]
            if inner + 1 < len(sizes):
                boxes = _cut(torch.cat(xs), torch.cat(ys), torch.cat(terms, 1), max(1, sizes[inner + 1] // 2))
            power = 1.0 if self.combine == "pooled" else 1.5
            share = size**power / (spent + size**power)
            spent += size**power
            result = drawn if result is None else joined(result, drawn, self.combine, share, drawn.predicted)
        assert result is not None
        return result


def _grid(count: int, pixels: int, device: torch.device) -> Tensor:
    """(4, M, P): low x, high x, low y, high y of at most `count` equal rectangles."""
    rows, columns = strata(max(1, count))
    row, column = (torch.arange(m, dtype=torch.float64, device=device) for m in (rows, columns))
    low_y, low_x = (each.flatten() for each in torch.meshgrid(row / rows, column / columns, indexing="ij"))
    sides = torch.stack([low_x, low_x + 1 / columns, low_y, low_y + 1 / rows])
    return sides[..., None].expand(-1, -1, pixels)


def _cut(x: Tensor, y: Tensor, values: Tensor, count: int) -> Tensor:
    """(4, count, P): the rectangles that the points x, y (n, P) with their values (C, n, P) suggest, largest product first."""
    device, pixels = x.device, x.shape[1]
    orders = [place.argsort(dim=0, stable=True) for place in (x, y)]
    places = torch.stack([place.gather(0, order) for place, order in zip((x, y), orders, strict=True)])
    others = torch.stack([place.gather(0, order) for place, order in zip((y, x), orders, strict=True)])
    sorted_values = torch.stack([values.gather(1, order.expand_as(values)) for order in orders])
    # centred, so that the sums of squares below are no differences of large numbers
    sorted_values = sorted_values - values.mean(1, keepdim=True)
    # what a few points that look flat may hide: one more, somewhere in the pixel's range; where there is no range areas decide
    hidden = (values.amax(1) - values.amin(1)).square().sum(0) / 4
    hidden = torch.where(hidden > 0, hidden, 1)

    boxes = torch.zeros(4, count, pixels, dtype=x.dtype, device=device)
    boxes[1, 0], boxes[3, 0] = 1, 1
    products = torch.full((count, pixels), -1.0, dtype=x.dtype, device=device)
    products[0] = 1
    every = torch.arange(pixels, device=device)
    for made in range(1, count):
        chosen = products.argmax(0)
        box = boxes[:, chosen, every]
        axis = _axis(places[0], others[0], sorted_values[0], box)
        along, across, colour = places[axis, :, every].T, others[axis, :, every].T, sorted_values[axis, :, :, every].movedim(0, -1)
        low, high = torch.where(axis == 0, box[0], box[2]), torch.where(axis == 0, box[1], box[3])
        near, far = torch.where(axis == 0, box[2], box[0]), torch.where(axis == 0, box[3], box[1])
        inside = ((along >= low) & (along <= high) & (across >= near) & (across <= far)).to(x.dtype)
        number = inside.cumsum(0)
        sums, squares = (colour * inside).cumsum(1), (colour.square().sum(0) * inside).cumsum(0)
        left = _deviation(number, sums, squares, hidden)
        right = _deviation(
            number[-1] - number + inside,
            sums[:, -1:] - sums + colour * inside,
            squares[-1] - squares + colour.square().sum(0) * inside,
            hidden,
        )
        part = (along - low) / (high - low)
        usable = (inside > 0) & (part > _NARROWEST) & (part < 1 - _NARROWEST)
        best = torch.where(usable, part * left + (1 - part) * right, torch.inf).min(0)
        found = torch.isfinite(best.values)
        # with no point inside, in the middle
        at = torch.where(found, along.gather(0, best.indices[None])[0], (low + high) / 2)
        whole = _deviation(number[-1], sums[:, -1], squares[-1], hidden)
        deviations = [torch.where(found, side.gather(0, best.indices[None])[0], whole) for side in (left, right)]
        first, second = box.clone(), box.clone()
        first[1], first[3] = torch.where(axis == 0, at, box[1]), torch.where(axis == 0, box[3], at)
        second[0], second[2] = torch.where(axis == 0, at, box[0]), torch.where(axis == 0, box[2], at)
        boxes[:, chosen, every], boxes[:, made] = first, second
        area = far - near
        products[chosen, every], products[made] = area * (at - low) * deviations[0], area * (high - at) * deviations[1]
    order = products.argsort(dim=0, descending=True, stable=True)
    return boxes.gather(1, order.expand_as(boxes))


def _axis(x: Tensor, y: Tensor, values: Tensor, box: Tensor) -> Tensor:
    """(P,): 0 where the values inside the box correlate more with x, 1 where with y; the longer side where they cannot tell."""
    inside = ((x >= box[0]) & (x <= box[1]) & (y >= box[2]) & (y <= box[3])).to(x.dtype)
    number = inside.sum(0).clamp_min(1)
    centred = (values - ((values * inside).sum(1) / number)[:, None]) * inside
    strengths = []
    for place in (x, y):
        offset = (place - (place * inside).sum(0) / number) * inside
        strengths.append((centred * offset).sum(1).square().sum(0) / offset.square().sum(0))
    longer = box[3] - box[2] > box[1] - box[0]
    told = torch.isfinite(strengths[0]) & torch.isfinite(strengths[1]) & (strengths[0] != strengths[1])
    return torch.where(told, strengths[1] > strengths[0], longer).to(torch.int64)


def _deviation(number: Tensor, sums: Tensor, squares: Tensor, hidden: Tensor) -> Tensor:
    """Standard deviation over the channels together, of `number` points with these sums; with none, what may be hidden."""
    count = number.clamp_min(1)
    variance = (squares - sums.square().sum(0) / count).clamp_min(0) / count
    return (variance + hidden / (number + 1).square()).sqrt()
