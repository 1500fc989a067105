"""The unit square cut into rectangles where the values met so far, put in order, jump; many pixels at once."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_mcaa.patterns.jittered import strata

_NARROWEST = 1e-6
"""No rectangle is cut off that is less than this part of another."""


def even(count: int, pixels: int, device: torch.device) -> Tensor:
    """(4, M, P): low x, high x, low y, high y of at most `count` equal rectangles."""
    rows, columns = strata(max(1, count))
    row, column = (torch.arange(m, dtype=torch.float64, device=device) for m in (rows, columns))
    low_y, low_x = (each.flatten() for each in torch.meshgrid(row / rows, column / columns, indexing="ij"))
    sides = torch.stack([low_x, low_x + 1 / columns, low_y, low_y + 1 / rows])
    return sides[..., None].expand(-1, -1, pixels)


def cut(x: Tensor, y: Tensor, values: Tensor, count: int) -> Tensor:
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
