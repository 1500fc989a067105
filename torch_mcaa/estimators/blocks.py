"""The blocks of a cell that are judged, corrected or given up as a whole."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_mcaa.edges.candidates import Segments
from torch_mcaa.grid import Cell

BLOCK = 32
"""Px: the side of a block."""


def blocks_of(cell: Cell, segments: Segments) -> Tensor:
    """The block of the cell (S,), counted row by row, that each segment begins in, or the one that is nearest."""
    x, y = (segments.low, segments.across) if segments.axis == 0 else (segments.across, segments.low)
    row = (y.floor().long() - cell.row).clamp(0, cell.height - 1) // BLOCK
    col = (x.floor().long() - cell.col).clamp(0, cell.width - 1) // BLOCK
    return row * -(-cell.width // BLOCK) + col


def blocks_in(cell: Cell, part: Cell) -> Tensor:
    """The numbers of the blocks of a cell that are those of a part of it, which begins with a block."""
    rows = torch.arange((part.row - cell.row) // BLOCK, -(-(part.row - cell.row + part.height) // BLOCK))
    cols = torch.arange((part.col - cell.col) // BLOCK, -(-(part.col - cell.col + part.width) // BLOCK))
    return (rows[:, None] * -(-cell.width // BLOCK) + cols).flatten()


def by_pixel(by_block: Tensor, cell: Cell) -> Tensor:
    """(h, w): what each pixel's block (rows, cols) of the cell has."""
    plane = by_block.repeat_interleave(BLOCK, 0).repeat_interleave(BLOCK, 1)
    return plane[: cell.height, : cell.width]
