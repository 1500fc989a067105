"""Shared estimates from a pattern that differs from pixel to pixel: every point is weighed for each pixel it serves."""

from __future__ import annotations

import math

import numpy as np
import torch

from torch_mcaa.estimators.base import Estimate, Round, Task, pooled, settled, unseen
from torch_mcaa.estimators.lattice.poles import Poles
from torch_mcaa.estimators.points import evaluate_points
from torch_mcaa.grid import Cell
from torch_mcaa.patterns import Pattern


class SharedPointsRound(Round):
    """phi = m + sum of w (f - m) / n, with m the |w|-weighted mean of f.

    For w >= 0 that is the self-normalised sum w f / sum w; a constant comes out exact for every w, and nothing is divided by a sum of
    weights of both signs, which can be near 0.
    """

    def __init__(self, task: Task, pattern: Pattern, count: int, number: int) -> None:
        self.task, self.pattern, self.count, self.number = task, pattern, count, number
        self.per_pixel = float(count)
        self.reach = math.ceil(max(task.filter.radius) - 0.5)

    def points(self, cell: Cell) -> int:
        return self.count * cell.height * cell.width

    def estimate(self, cell: Cell) -> Estimate:
        task, reach = self.task, self.reach
        rows = torch.arange(cell.row - reach, cell.row + cell.height + reach, device=task.device)
        cols = torch.arange(cell.col - reach, cell.col + cell.width + reach, device=task.device)
        u, v = self.pattern.points(self.count, rows, cols, seed=task.seed, round=self.number, dtype=torch.float64)
        col, row = cols + u, rows[:, None] + v
        values, inside, bad = evaluate_points(task, cell, col, row)
        poles = Poles(task, cell, self.count, np.arange(self.count))
        for channel, value in enumerate(values):
            poles.add(channel, value.movedim(1, 0))
        heavy = poles.heavy(lambda i, j, channel: (values[channel, j, i], row[j, i], col[j, i]))
        counted = (inside if task.boundary == "renormalize" else torch.ones_like(inside)).to(task.dtype)
        kept = torch.ones_like(counted) if bad is None else (~bad).to(task.dtype)
        # the last of the places in float64 would be 1 in float32, in no cell of a net
        below_one = 1 - torch.finfo(task.dtype).eps / 2
        u, v = (place.to(task.dtype).clamp_(max=below_one) for place in (u, v))

        def taps():
            for dy in range(2 * reach + 1):
                for dx in range(2 * reach + 1):
                    window = (slice(None), slice(dy, dy + cell.height), slice(dx, dx + cell.width))
                    # the source pixel lies at dx - reach from this one
                    weight = task.filter(u[window] + (dx - reach - 0.5), v[window] + (dy - reach - 0.5)) * counted[window]
                    yield window, weight

        sums = values.new_zeros(len(values), cell.height, cell.width)
        full, total, everything, magnitude = torch.zeros(4, cell.height, cell.width, dtype=task.dtype, device=task.device)
        mean = torch.zeros_like(sums)
        for window, weight in taps():
            full += weight.sum(0)
            everything += weight.abs().sum(0)
            weight = weight * kept[window]
            inner = values[(slice(None), *window)]
            sums += (weight * inner).sum(1)
            mean += (weight.abs() * inner).sum(1)
            total += weight.sum(0)
            magnitude += weight.abs().sum(0)
        mean = mean / magnitude
        # the share of the weights that is left where samples were not finite
        share = magnitude / everything
        norm = (full if task.boundary == "renormalize" else torch.full_like(total, float(self.count))) * share
        value = mean + (sums - mean * total) / norm
        variance = torch.zeros_like(value)
        for window, weight in taps():
            for channel in range(len(values)):
                terms = weight * kept[window] * (values[channel][window] - value[channel]) / norm
                variance[channel] += self.pattern.variance(terms, u[window], v[window])
        invalid = torch.zeros(cell.height, cell.width, dtype=torch.int32, device=task.device)
        if bad is not None:
            own = (slice(reach, reach + cell.height), slice(reach, reach + cell.width))
            invalid = bad.sum(0, dtype=torch.int32)[own]
            if task.integrand.nonfinite == "propagate":
                value = torch.where(share > 1 - 1e-5, value, torch.nan)
        points = torch.full((cell.height, cell.width), self.count, dtype=torch.int32, device=task.device)
        variance = settled(pooled(variance), value, unseen(value, self.count))
        if heavy is not None:
            variance.masked_fill_(heavy, torch.inf)
        return Estimate(value, variance, points, invalid, heavy=None if heavy is None else heavy.any(0))
