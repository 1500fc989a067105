"""The samples of a shared lattice over the whole screen, in blocks of f's size, each sample once."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor

from torch_mcaa.estimators.base import Task
from torch_mcaa.estimators.lattice.shared_lattice import LatticeRound
from torch_mcaa.integrand import BLOCK, width_of
from torch_mcaa.patterns.lattice import Strip

_TAPED = 4
"""Blocks of samples of which another device than a CPU keeps a tape at a time: a network's is some thousand numbers a point."""


def strip_of(task: Task, spp: int) -> Strip:
    """The lattice that `Shared(Lattice())` has for `spp` evaluations a pixel: the finest whose points are under the cap."""
    whole = task.screen.whole
    asked = spp
    while True:
        lattice = LatticeRound(task, asked, 0)
        if asked == 1 or lattice.points(whole) <= spp * whole.height * whole.width:
            return lattice.strip
        asked -= 1


class Samples:
    """Where the samples lie that matter on the screen, `reach` pixels beyond it too unless the boundary closes it."""

    def __init__(self, task: Task, strip: Strip, reach: int) -> None:
        self.task, self.strip, self.reach = task, strip, reach
        margin = reach if task.boundary == "extend" else 0
        self.first, last = -margin // strip.period, -(-(task.screen.height + margin) // strip.period)
        self.strips, self.col, self.cols = last - self.first, -margin, task.screen.width + 2 * margin

    def padded(self, grad: Tensor) -> Tensor:
        """(C, H, W) with zeros around, so that `band` finds all pixels that samples reach."""
        screen, reach = self.task.screen, self.reach
        left, top = reach - self.col, reach - self.first * self.strip.period
        right = self.col + self.cols + reach - screen.width
        bottom = (self.first + self.strips) * self.strip.period + reach - screen.height
        return torch.nn.functional.pad(grad, (left, right, top, bottom))

    def band(self, padded: Tensor, strips: slice) -> Tensor:
        """The rows of pixels that the samples of some strips reach."""
        period = self.strip.period
        return padded[:, strips.start * period : strips.stop * period + 2 * self.reach]

    def blocks(self) -> Iterator[tuple[slice, slice]]:
        """Strips and planes of samples whose tape is kept at a time."""
        count, block = self.strip.count, BLOCK * min(width_of(self.task.device), _TAPED)
        # as equal parts as can be, so that no number of samples makes larger blocks than another
        planes = -(-count // -(-count * self.cols // block))
        strips = max(1, block // (self.cols * planes))
        for strip in range(0, self.strips, strips):
            for plane in range(0, count, planes):
                yield slice(strip, min(strip + strips, self.strips)), slice(plane, min(plane + planes, count))

    def places(self, strips: slice, planes: slice) -> tuple[Tensor, Tensor, Tensor | None]:
        """float64 screen columns (planes, columns) and rows (strips, planes, 1) of samples, and which rows lie on a screen that closes."""
        device = self.task.device
        number = torch.arange(self.first + strips.start, self.first + strips.stop, dtype=torch.float64)
        row = number[:, None] * self.strip.period + torch.from_numpy(self.strip.y[planes])
        col = torch.arange(self.col, self.col + self.cols, dtype=torch.float64) + torch.from_numpy(self.strip.x[planes])[:, None]
        col, row = col.to(device), row[:, :, None].to(device)
        if self.task.boundary == "extend":
            return col, row, None
        inside = (row >= 0) & (row < self.task.screen.height)
        return col, row.clamp(0, self.task.screen.height * (1 - 2.0**-50)), inside
