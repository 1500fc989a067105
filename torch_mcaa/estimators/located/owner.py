"""Which part of a cell has the segments that are seen from several."""

from __future__ import annotations

import torch

from torch_mcaa.edges.candidates import Segments
from torch_mcaa.estimators.lattice.lattice_weights import Geometry
from torch_mcaa.grid import Cell


class Owner:
    """Which of several rectangles, sampled in and around, has the segments that begin in a pixel: the one it is of, or the first that reaches it."""

    def __init__(self, rectangles: list[Cell], at: list[Geometry], device: torch.device) -> None:
        self.row, self.col = min(a.strip for a in at), min(a.col for a in at)
        shape = max(a.strip + a.strips for a in at) - self.row, max(a.col + a.cols for a in at) - self.col
        self.alone = len(rectangles) == 1
        if self.alone:
            return
        self.number = torch.full(shape, -1, device=device)
        areas = [Cell(a.strip, a.col, a.strips, a.cols) for a in at]
        for index, area in [*reversed([*enumerate(areas)]), *enumerate(rectangles)]:
            self.number[area.within(Cell(self.row, self.col, *shape))] = index

    def those_of(self, number: int, segments: Segments) -> Segments:
        if self.alone:
            return segments
        return segments.take(self.number[segments.key[:, 1] - self.row, segments.key[:, 2] - self.col] == number)
