"""The boundary term as a picture, which the layer sums over the pixels before anything is as large as that."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_mcaa.filters import Filter
from torch_mcaa.grid import Cell, Screen
from torch_mcaa.integrand import Function
from torch_mcaa.traced.boundary import LINES, elements, margins, splat
from torch_mcaa.traced.once import zero_with_gradient


def boundary_term(
    function: Function,
    screen: Screen,
    filter: Filter,
    seed: int,
    lines: int = LINES,
    *,
    closed: bool = False,
    dtype: torch.dtype = torch.float32,
) -> Tensor:
    """(C, H, W) float64: exactly 0, with the gradient that is to be added to that of the samples.

    Second derivatives through it raise McaaError.
    """
    cell = Cell(0, 0, screen.height, screen.width)
    met = elements(function, screen, cell, filter, seed, lines, closed=closed, dtype=dtype)
    picture = torch.zeros(len(met.jump), screen.height * screen.width, dtype=torch.float64, device=met.col.device)
    if len(met) == 0:
        return picture.view(-1, screen.height, screen.width)
    with torch.enable_grad():
        zero = zero_with_gradient(margins(function, screen, met)) * met.weight
        rows, cols, weights = splat(met, screen, filter)
        flat = rows * screen.width + cols
        amount = met.jump[:, :, None] * (zero[:, None] * weights)
        picture = picture.index_add(1, flat.flatten(), amount.flatten(1))
    return picture.view(-1, screen.height, screen.width)
