"""The fixed weights of a shared lattice: w at the differences between samples and pixel centres, normalised, laid out for matrix products.

Along x a sample of column c + k weighs profile(k + x - 1/2) in column c, whatever c is. Along y the weights of a block of output rows form
one banded matrix over the samples of the strips that reach it. A filter that does not separate is a sum of such products, one for each k.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from torch_mcaa.estimators.base import Task
from torch_mcaa.filters import Filter, SeparableFilter
from torch_mcaa.grid import Cell
from torch_mcaa.patterns.lattice import Strip

_BLOCK_ROWS = 14


@dataclass(frozen=True)
class Geometry:
    """Where a cell's samples lie, and how its rows are cut into blocks.

    The samples are strips [strip, strip + strips) and columns [col, col + cols). Block b has the rows [b R, (b + 1) R) of the cell, with
    R = block_strips * period, and the strips [b block_strips, b block_strips + depth), counted from `strip - lead`.
    """

    strip: int
    strips: int
    col: int
    cols: int
    lead: int
    blocks: int
    depth: int

    @property
    def points(self) -> int:
        """Samples in one plane: one for each strip and column."""
        return self.strips * self.cols


def reach_of(filter: Filter) -> int:
    """How many pixels beyond its own a filter that ends has samples in."""
    # k + x - 1/2 with x in [0, 1) reaches |d| < radius for |k| <= ceil(radius - 1/2)
    return math.ceil(max(filter.radius) - 0.5)


class LatticeWeights:
    """The weights of one strip lattice under one task's filter and boundary; with `absolute` those of |w| in its place."""

    def __init__(self, task: Task, strip: Strip, absolute: bool = False) -> None:
        self.task, self.strip, self.absolute = task, strip, absolute
        screen, radius = task.screen, max(task.filter.radius)
        self.bounded = math.isfinite(radius)
        self.reach = reach_of(task.filter) if self.bounded else max(screen.height, screen.width)
        taps = torch.arange(-self.reach, self.reach + 1, dtype=torch.float64)
        # (terms, taps, count) factors along x, and what the factors along y depend on x by
        self.x_places = taps[:, None] + torch.from_numpy(strip.x) - 0.5
        if isinstance(task.filter, SeparableFilter):
            self.along_x = self._sign(task.filter.profile(self.x_places))[None]
        else:
            self.along_x = torch.eye(len(taps), dtype=torch.float64)[:, :, None].expand(-1, -1, strip.count)
        self.block_strips = max(1, _BLOCK_ROWS // strip.period)

    def geometry(self, cell: Cell) -> Geometry:
        reach, period, screen = self.reach, self.strip.period, self.task.screen
        top, bottom = cell.row - reach, cell.row + cell.height + reach
        left, right = cell.col - reach, cell.col + cell.width + reach
        first = top // period
        if self.task.boundary != "extend":
            top, bottom, left, right = max(top, 0), min(bottom, screen.height), max(left, 0), min(right, screen.width)
        depth = self.block_strips + (cell.row - first * period + reach - 1) // period + 1
        blocks = -(-cell.height // (self.block_strips * period))
        return Geometry(
            top // period, -(-bottom // period) - top // period, left, right - left, top // period - first, blocks, depth
        )

    def along_y(self, cell: Cell, at: Geometry) -> tuple[Tensor, Tensor, Tensor, Tensor | None]:
        """Weights (terms, B, R, depth, count), signs (3, depth) of the characters' changes over the strips, the response, and the norm.

        B is 1 where all blocks have the same weights, else `at.blocks`. A pixel's weights sum to 1 over the samples on and off the
        screen. Under boundary="renormalize" the norm (h, w) is what they sum to over the samples on it, and under "zero" that over the exact
        integral of w there, so that a constant loses what it should; else, and where that is not known, it is None. The response
        (3, B or 1, R, w or 1) has the three character sums of f = 1, of the f = 1 on the screen alone if that is what a constant is.
        """
        period, height = self.strip.period, self.task.screen.height
        first = at.strip - at.lead
        phase = cell.row - first * period
        rows = torch.arange(self.block_strips * period, dtype=torch.float64) + phase + 0.5
        strips = torch.arange(at.depth, dtype=torch.float64)
        places = strips[:, None] * period + torch.from_numpy(self.strip.y)
        weight = self._terms_along_y(places - rows[:, None, None])
        if self.bounded:
            total = torch.einsum("trsi,ti->r", weight, self.along_x.sum(1))[:, None, None]
        else:
            total = self.strip.count / period
        weight = (weight / total)[:, None]
        signs = torch.stack([1.0 - 2.0 * b * (strips % 2) for _, b in self.strip.parities])
        everywhere = self._response(weight, signs, [self._taps_of(b)[..., None] for b in (False, True)])
        if self.task.boundary == "extend":
            return weight, signs, everywhere, None
        starts = (first + torch.arange(at.blocks) * self.block_strips) * period
        absolute = places + starts[:, None, None]
        weight = weight * ((absolute >= 0) & (absolute < height))[:, None]
        inside = self.task.inside(cell) if self.task.boundary == "zero" and self.bounded and not self.absolute else None
        if self.task.boundary == "zero" and inside is None:
            return weight, signs, everywhere, None
        norm = torch.einsum("tbri,tic->brc", weight.sum(3), self._x_sums(cell, at))
        response = self._response(weight, signs, [self._x_sums(cell, at, b) for b in (False, True)])
        # rows beyond the screen have no weights
        response = torch.where(norm == 0, 0, response / norm)
        norm = norm.flatten(0, 1)[: cell.height]
        if inside is not None:
            inside = inside.to(norm.device)
            norm = torch.where(inside == 0, 1, norm / inside)
        return weight, signs, response, norm

    def _response(self, weight: Tensor, signs: Tensor, taps: list[Tensor]) -> Tensor:
        """(3, B, R, width or 1) for what the factors along x sum to, (terms, count, width or 1), as they are and in turns of sign."""
        characters = torch.from_numpy(self.strip.characters).to(torch.float64)
        return torch.stack(
            [
                torch.einsum("tbrsi,s,i,tic->brc", weight, signs[j], characters[j], taps[a])
                for j, (a, _) in enumerate(self.strip.parities)
            ]
        )

    def _taps_of(self, alternate: bool) -> Tensor:
        """(terms, count): what the factors along x sum to, with `alternate` those of odd k subtracted."""
        k = torch.arange(-self.reach, self.reach + 1)[:, None]
        return (self.along_x * (1 - 2 * (k % 2) * alternate)).sum(1)

    def _terms_along_y(self, d: Tensor) -> Tensor:
        """(terms, rows, strips, count): the factors along y at the differences d (rows, strips, count)."""
        filter = self.task.filter
        if isinstance(filter, SeparableFilter):
            return self._sign(filter.profile(d))[None]
        value = filter(self.x_places[:, None, None, :].expand(-1, *d.shape), d[None].expand(len(self.x_places), *d.shape))
        return self._sign(value)

    def _sign(self, weight: Tensor) -> Tensor:
        return weight.abs() if self.absolute else weight

    def _x_sums(self, cell: Cell, at: Geometry, alternate: bool = False) -> Tensor:
        """(terms, count, width): what the factors along x of the samples that exist sum to, as `_taps_of`."""
        sums = torch.zeros(len(self.along_x), cell.width, self.strip.count, dtype=torch.float64)
        for k in range(-self.reach, self.reach + 1):
            low, high = max(0, at.col - cell.col - k), min(cell.width, at.col + at.cols - cell.col - k)
            if low < high:
                sums[:, low:high] += self.along_x[:, None, k + self.reach] * (-1 if alternate and k % 2 else 1)
        return sums.transpose(1, 2)
