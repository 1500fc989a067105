"""What the jumps of f contribute to the derivatives as they move: the boundary term, met by lines along both axes."""

from __future__ import annotations

from collections.abc import Iterator

from torch import Tensor

from torch_mcaa.errors import warn
from torch_mcaa.estimators.base import Task
from torch_mcaa.integrand import Function
from torch_mcaa.replay.adjoint import at_places
from torch_mcaa.replay.dependencies import Dependencies, check_reached
from torch_mcaa.traced.boundary import LINES, elements, surrogate
from torch_mcaa.traced.derivatives import derivatives
from torch_mcaa.traced.program import Program

_SAMPLES = 64
"""Evaluations a pixel of which `LINES` lines take a fifth."""
_CELL, _SEGMENTS = 256, 2**18
"""Cells are as large as this, unless they would have more pixels of lines."""


class OfJumps:
    """With respect to the tensors that f depends on.

    The lines are some for each so many samples a pixel, and their evaluations count: `evaluations` has how many there were.
    """

    def __init__(self, task: Task, function: Function, program: Program, inputs: Dependencies, spp: int) -> None:
        self.task, self.function, self.program, self.inputs = task, function, program, inputs
        self.lines = max(1, LINES * spp // _SAMPLES)
        self.evaluations = 0

    def parts(self, grad: Tensor) -> Iterator[tuple[Tensor | None, ...]]:
        """The derivatives, for the gradient (C, H, W) of the pixels, cell by cell.

        Warns (`McaaWarning`) of edges that had to be left out.
        """
        task, function = self.task, self.function
        problems: dict[str, None] = {}
        side = _CELL
        while side > 32 and side * side * self.lines > _SEGMENTS:
            side //= 2
        for cell in task.screen.cells(side, side):
            met = elements(
                function,
                task.screen,
                cell,
                task.filter,
                task.seed,
                self.lines,
                closed=task.boundary != "extend",
                program=self.program,
                dtype=task.dtype,
                device=task.device,
                tally=self._counted,
                inputs=self.inputs.stand_ins,
            )
            problems |= dict.fromkeys(met.problems)
            if not len(met):
                continue
            coefficient = met.weight * (at_places(task.filter, grad, met.col, met.row) * met.jump).sum(0)
            term = surrogate(function, task.screen, met, coefficient)
            if term.requires_grad:
                check_reached([term], self.inputs)
                yield derivatives((term,), self.inputs.stand_ins)
        for problem in problems:
            warn(problem)

    def _counted(self, col: Tensor, row: Tensor) -> None:
        self.evaluations += len(col)
