"""The derivative of a loss with respect to all that a picture depends on, from its derivative with respect to the pixels.

The samples are evaluated again, block by block, so that memory does not grow with their number: each block gives its part and goes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from torch_mcaa.estimators.base import Task
from torch_mcaa.grid import Cell
from torch_mcaa.replay.adjoint import Adjoint, norm, reach_of
from torch_mcaa.replay.dependencies import Dependencies
from torch_mcaa.replay.moved import Moved
from torch_mcaa.replay.samples import Samples, strip_of
from torch_mcaa.replay.terms import Block, OfFilter, OfInputs, OfPlaces, Parts


@dataclass(frozen=True)
class Replay:
    """What the backward pass asks.

    Attributes:
        task: f, without the parameters in `moved`, on the screen; its seed is that of the backward's points.
        spp: evaluations a pixel.
        inputs: what f depends on.
        moved: the parameters of where f is asked.
    """

    task: Task
    spp: int
    inputs: Dependencies
    moved: Moved

    @property
    def parameters(self) -> tuple[Tensor, ...]:
        """All that gradients are given for, in their order."""
        return (*self.inputs.tensors, *self.task.filter.learned, *self.moved.parameters)

    def gradients(self, grad: Tensor, value: Tensor) -> list[Tensor | None]:
        """The derivatives with respect to `parameters`; None where there is none.

        grad: (C, H, W), with respect to the picture; value: (C, H, W), the picture.

        Raises:
            McaaError: f raised, or uses tensors it had not used before.
        """
        task, filter, moved = self.task, self.task.filter, self.moved
        strip = strip_of(task, self.spp)
        samples = Samples(task, strip, reach_of(filter))
        grad = grad.detach().to(task.device, task.dtype)
        renormalized = task.boundary == "renormalize"
        if renormalized:
            grad = grad / norm(task, strip)
        terms: list[Callable[[Block], Parts]] = []
        if self.inputs.tensors:
            terms.append(OfInputs(self.inputs, samples, Adjoint(filter, strip, task.dtype, task.device), grad))
        if filter.learned:
            terms.append(OfFilter(filter, samples, strip, grad, value, renormalized))
        if moved.parameters:
            terms.append(OfPlaces(moved, filter, samples, strip, grad, value))
        totals: list[Tensor | None] = [None] * len(self.parameters)
        for strips, planes in samples.blocks():
            block = self._block(samples, strips, planes)
            for index, part in enumerate(part for term in terms for part in term(block)):
                if part is not None:
                    # sums over many blocks want more than half precision
                    part, total = part.to(torch.promote_types(part.dtype, torch.float32)), totals[index]
                    totals[index] = part if total is None else total + part
        return totals

    def _block(self, samples: Samples, strips: slice, planes: slice) -> Block:
        task = self.task
        col, row, inside = samples.places(strips, planes)
        rows = int(row.min()), int(row.max())
        asked = task.screen.coordinate_dtype(Cell(rows[0], samples.col, rows[1] - rows[0] + 1, samples.cols), task.dtype)
        x, y = task.screen.x_of(col).to(asked), task.screen.y_of(row).to(asked)
        with torch.enable_grad():
            values = task.integrand(x.expand(len(row), *col.shape), y)
        return Block(strips, planes, col, row, inside, values)
