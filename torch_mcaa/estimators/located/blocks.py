"""The blocks of a cell that are judged, corrected or given up as a whole."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from torch_mcaa.edges.bisect import placed
from torch_mcaa.edges.candidates import Segments
from torch_mcaa.estimators.base import dilated
from torch_mcaa.estimators.lattice.audit import tile_means
from torch_mcaa.grid import Cell

BLOCK = 32
"""Px: the side of a block."""


def shape_of(cell: Cell) -> tuple[int, int]:
    """How many blocks a cell has down and across, those included that it cuts."""
    return -(-cell.height // BLOCK), -(-cell.width // BLOCK)


def rectangles_of(cell: Cell) -> Tensor:
    """(blocks, 4) int64: the row, column, height and width of each block of a cell, on the screen and row by row."""
    rows, cols = torch.arange(0, cell.height, BLOCK), torch.arange(0, cell.width, BLOCK)
    heights, widths = (cell.height - rows).clamp_max(BLOCK), (cell.width - cols).clamp_max(BLOCK)
    shape = len(rows), len(cols)
    planes = ((cell.row + rows)[:, None], cell.col + cols, heights[:, None], widths)
    return torch.stack([plane.expand(shape) for plane in planes], -1).flatten(0, 1)


def sizes_of(cell: Cell) -> Tensor:
    """(blocks,) float64: the pixels of each block of a cell."""
    return rectangles_of(cell)[:, 2:].prod(1).to(torch.float64)


def by_block(plane: Tensor, cell: Cell) -> Tensor:
    """(blocks,) float64: the sums of a plane (h, w) of a cell over each block."""
    return tile_means(plane.to(torch.float64), BLOCK, BLOCK).flatten() * sizes_of(cell).to(plane.device)


def blocks_of(cell: Cell, segments: Segments) -> Tensor:
    """The block of the cell (S,), counted row by row, that each segment begins in, or the one that is nearest."""
    return blocks_at(cell, *pixels_of(cell, segments.axis, segments.low, segments.across))


def blocks_at(cell: Cell, row: Tensor, col: Tensor) -> Tensor:
    """The blocks (N,) that pixels of the cell lie in."""
    return row // BLOCK * shape_of(cell)[1] + col // BLOCK


def pixels_of(cell: Cell, axis: int, along: Tensor, across: Tensor) -> tuple[Tensor, Tensor]:
    """The row and the column (N,) in the cell of the pixel that each place on lines along `axis` lies in, or of the one that is nearest."""
    x, y = placed(axis, along, across)
    return (y.floor().long() - cell.row).clamp(0, cell.height - 1), (x.floor().long() - cell.col).clamp(0, cell.width - 1)


def deciding(cell: Cell, found: Sequence[Segments]) -> Tensor:
    """bool (blocks,): those in which, or beside which, f is seen to decide."""
    size = shape_of(cell)
    some = torch.zeros(size[0] * size[1], dtype=torch.bool, device=found[0].low.device)
    for segments in found:
        some[blocks_of(cell, segments.take(segments.decided > 0))] = True
    return dilated(some.view(size), 1).flatten()


def told(cell: Cell, segments: Segments, deciding: Tensor) -> Segments:
    """The segments without those where values alone stand out in such blocks: there it is known where f jumps, and the rest is its pattern."""
    return segments.take((segments.decided > 0) | ~deciding[blocks_of(cell, segments)])


def blocks_in(cell: Cell, part: Cell) -> Tensor:
    """The numbers of the blocks of a cell that are those of a part of it, which begins with a block."""
    rows = torch.arange((part.row - cell.row) // BLOCK, -(-(part.row - cell.row + part.height) // BLOCK))
    cols = torch.arange((part.col - cell.col) // BLOCK, -(-(part.col - cell.col + part.width) // BLOCK))
    return (rows[:, None] * shape_of(cell)[1] + cols).flatten()


def by_pixel(by_block: Tensor, cell: Cell) -> Tensor:
    """(..., h, w): what each pixel's block (..., rows, cols) of the cell has."""
    plane = by_block.repeat_interleave(BLOCK, -2).repeat_interleave(BLOCK, -1)
    return plane[..., : cell.height, : cell.width]
