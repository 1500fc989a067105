"""What a block of samples contributes to the derivatives with respect to f's tensors, the filter's parameters and the places' parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torch_mcaa.estimators.base import Task
from torch_mcaa.filters import Filter
from torch_mcaa.grid import Cell
from torch_mcaa.patterns.lattice import Strip
from torch_mcaa.replay.adjoint import Adjoint
from torch_mcaa.replay.dependencies import Dependencies, check_reached
from torch_mcaa.replay.moved import Moved
from torch_mcaa.replay.samples import Samples
from torch_mcaa.traced.derivatives import derivatives

Parts = Sequence[Tensor | None]


@dataclass(frozen=True)
class Block:
    """Planes of the samples of some strips, with f's values there (its channels, with their graph) and how they are weighed.

    Attributes:
        col: float64 (planes, columns), row: float64 (strips, planes, 1); on the screen, in pixels.
        inside: bool as `row`, False for samples that count as 0; None if all count.
    """

    strips: slice
    planes: slice
    col: Tensor
    row: Tensor
    inside: Tensor | None
    values: Sequence[Tensor]

    def held(self) -> Tensor:
        """f's values as numbers, (C, strips, planes, columns), 0 where they count so."""
        values = torch.stack([value.detach() for value in self.values])
        return values if self.inside is None else values * self.inside


class OfInputs:
    """With respect to the tensors that f depends on: the adjoint of the splat is the coefficient of f's own derivative."""

    def __init__(self, inputs: Dependencies, samples: Samples, adjoint: Adjoint, grad: Tensor) -> None:
        self.inputs, self.samples, self.adjoint, self.grad = inputs, samples, adjoint, samples.padded(grad)

    def __call__(self, block: Block) -> Parts:
        live = [channel for channel, value in enumerate(block.values) if value.requires_grad]
        if not live:
            return [None] * len(self.inputs.tensors)
        values = [block.values[channel] for channel in live]
        check_reached(values, self.inputs)
        coefficient = self.adjoint(self.samples.band(self.grad, block.strips)[live], block.planes)
        if block.inside is not None:
            coefficient = coefficient * block.inside
        return derivatives(values, self.inputs.stand_ins, list(coefficient))


class OfFilter:
    """With respect to the filter's parameters, of which the weights alone depend on them.

    Weights that are divided by what they sum to on the screen have a derivative whose sum counts against the value; under "zero" they are
    multiplied by the integral of w there, which has one too.
    """

    def __init__(self, task: Task, samples: Samples, strip: Strip, grad: Tensor, value: Tensor) -> None:
        self.parameters, self.samples = task.filter.learned, samples
        with torch.enable_grad():
            self.adjoint = Adjoint(task.filter, strip, grad.dtype, grad.device)
            self.share = task.inside(Cell(0, 0, *grad.shape[1:])) if task.boundary == "zero" else None
        self.grad, self.level = samples.padded(grad), None
        if task.boundary != "extend":
            total = (grad * value).sum(0, keepdim=True)
            self.level = samples.padded(total if self.share is None else total / self.share.detach().to(total))

    def of_share(self, grad: Tensor, value: Tensor) -> Parts:
        """What the integral of w over the screen contributes, which no block knows of; grad: as given."""
        if self.share is None:
            return [None] * len(self.parameters)
        relative = (grad * value).sum(0) / self.share.detach()
        with torch.enable_grad():
            loss = (relative * self.share).sum()
        return torch.autograd.grad(loss, self.parameters)

    def __call__(self, block: Block) -> Parts:
        with torch.enable_grad():
            loss = (self.adjoint(self.samples.band(self.grad, block.strips), block.planes) * block.held()).sum()
            if self.level is not None:
                assert block.inside is not None
                loss = loss - (self.adjoint(self.samples.band(self.level, block.strips), block.planes) * block.inside).sum()
        # the weights' own graph is used again in the next block
        return torch.autograd.grad(loss, self.parameters, retain_graph=True)


class OfPlaces:
    """With respect to the parameters of where f is asked: see `Moved`.

    The weights are divided by what they sum to, so their derivative counts for the difference between a sample and the pixel's value.
    """

    def __init__(self, moved: Moved, filter: Filter, samples: Samples, strip: Strip, grad: Tensor, value: Tensor) -> None:
        self.moved, self.samples = moved, samples
        orders = ((0, 0), (1, 0), (0, 1))
        self.adjoints = [Adjoint(filter, strip, grad.dtype, grad.device, along) for along in orders]
        self.grad, self.level = samples.padded(grad), samples.padded((grad * value).sum(0, keepdim=True))

    def __call__(self, block: Block) -> Parts:
        grad, level = (self.samples.band(padded, block.strips) for padded in (self.grad, self.level))
        values = block.held()
        area, across, down = (
            ((adjoint(grad, block.planes) * values).sum(0) - adjoint(level, block.planes)[0]).to(torch.float64)
            for adjoint in self.adjoints
        )
        with torch.enable_grad():
            places = self.moved.held(block.col.expand(area.shape), block.row.expand(area.shape))
            col, row, size = self.moved.pulled(*places)
            loss = (across * col).sum() + (down * row).sum() + (area * size).sum()
        return torch.autograd.grad(loss, self.moved.parameters)
