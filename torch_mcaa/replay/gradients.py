"""The derivative of a loss with respect to all that a picture depends on, from its derivative with respect to the pixels.

The samples are evaluated again, block by block, so that memory does not grow with their number: each block gives its part and goes.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass

import torch
from torch import Tensor

from torch_mcaa.errors import warn
from torch_mcaa.estimators.base import Task
from torch_mcaa.grid import Cell
from torch_mcaa.integrand import Function
from torch_mcaa.patterns.lattice import Strip
from torch_mcaa.replay.adjoint import Adjoint, norm, reach_of
from torch_mcaa.replay.dependencies import Dependencies
from torch_mcaa.replay.jumps import OfJumps
from torch_mcaa.replay.moved import Moved
from torch_mcaa.replay.samples import Samples, strip_of
from torch_mcaa.replay.terms import Block, OfFilter, OfInputs, OfPlaces, Parts
from torch_mcaa.replay.unchanged import Noted
from torch_mcaa.traced.program import Program
from torch_mcaa.traced.steps import Called


@dataclass(frozen=True)
class Replay:
    """What the backward pass asks.

    Attributes:
        task: f, without the parameters in `moved`, on the screen; its seed is that of the backward's points.
        spp: evaluations a pixel, those on lines that look for jumps included.
        program: the decisions of f, if its jumps count; deciding: f as these are taken, without autocast.
        inputs: what f depends on.
        moved: the parameters of where f is asked.
        noted: what f was in the forward pass.
    """

    task: Task
    spp: int
    program: Program | None
    deciding: Function
    inputs: Dependencies
    moved: Moved
    noted: Noted

    @property
    def parameters(self) -> tuple[Tensor, ...]:
        """All that gradients are given for, in their order."""
        return (*self.inputs.tensors, *self.task.filter.learned, *self.moved.parameters)

    def gradients(self, grad: Tensor, value: Tensor) -> list[Tensor | None]:
        """The derivatives with respect to `parameters`; None where there is none.

        grad: (C, H, W), with respect to the picture; value: (C, H, W), the picture.

        Raises:
            McaaError: f raised, is not what it was in the forward pass, or uses tensors it had not used before.
        """
        task, filter, moved = self.task, self.task.filter, self.moved
        self.noted.check(task.integrand.function)
        grad = grad.detach().to(task.device, task.dtype)
        totals: list[Tensor | None] = [None] * len(self.parameters)

        def add(parts: Parts) -> None:
            for index, part in enumerate(parts):
                if part is not None:
                    # sums over many blocks want more than half precision
                    part, total = part.to(torch.promote_types(part.dtype, torch.float32)), totals[index]
                    totals[index] = part if total is None else total + part

        spp = self.spp
        if self.program is not None:
            jumps = OfJumps(task, self.deciding, self.program, self.inputs, spp)
            for parts in jumps.parts(self._normed(grad, strip_of(task, spp))):
                add(parts)
            spp = max(-(-spp // 2), spp - -(-jumps.evaluations // (task.screen.height * task.screen.width)))
        strip = strip_of(task, spp)
        samples = Samples(task, strip, reach_of(filter))
        given, grad = grad, self._normed(grad, strip)
        terms: list[Callable[[Block], Parts]] = []
        if self.inputs.tensors:
            terms.append(OfInputs(self.inputs, samples, Adjoint(filter, strip, task.dtype, task.device), grad))
        if filter.learned:
            of_filter = OfFilter(task, samples, strip, grad, value)
            add([*[None] * len(self.inputs.tensors), *of_filter.of_share(given, value)])
            terms.append(of_filter)
        if moved.parameters:
            terms.append(OfPlaces(moved, filter, samples, strip, grad, value))
        for strips, planes in samples.blocks():
            block = self._block(samples, strips, planes)
            add([part for term in terms for part in term(block)])
        count = len(self.inputs.tensors)
        if count and all(total is None for total in totals[:count]):
            warn(
                "no gradient reaches what f uses: its values have no slope, and no jump that moves was met where f was seen to decide; "
                "check_discontinuities(f, size) finds jumps that no decision explains"
            )
        if self.program is not None and self.program.moves:
            # an edge that moves where no pixel is has a gradient of 0
            of_inputs = zip(self.inputs.tensors, totals[:count], strict=True)
            totals[:count] = [torch.zeros_like(tensor) if total is None else total for tensor, total in of_inputs]
        return totals

    def _normed(self, grad: Tensor, strip: Strip) -> Tensor:
        divisor = norm(self.task, strip)
        return grad if divisor is None else grad / divisor

    def _block(self, samples: Samples, strips: slice, planes: slice) -> Block:
        task = self.task
        col, row, inside = samples.places(strips, planes)
        rows = int(row.min()), int(row.max())
        asked = task.screen.coordinate_dtype(Cell(rows[0], samples.col, rows[1] - rows[0] + 1, samples.cols), task.dtype)
        x, y = task.screen.x_of(col).to(asked), task.screen.y_of(row).to(asked)
        with torch.enable_grad(), Called() if self.inputs.steps else nullcontext():
            values = task.integrand(x.expand(len(row), *col.shape), y)
        return Block(strips, planes, col, row, inside, values)
