"""The adjoint of the splat: what a gradient with respect to the pixels is worth at the samples.

The picture is linear in the samples, phi_h = sum_p K(p, h) f(p) with K(p, h) = w(r_p - c_h) / total_h, so that the derivative of a loss
with respect to f(p) is A(p) = sum_h K(p, h) dL/dphi_h. For a lattice K is the same in every strip.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor

from torch_mcaa.errors import McaaError
from torch_mcaa.estimators.base import Task
from torch_mcaa.estimators.lattice.lattice_weights import LatticeWeights
from torch_mcaa.filters import Filter, SeparableFilter
from torch_mcaa.grid import Cell
from torch_mcaa.patterns.lattice import Strip

_BAND = 128
_PLACES = 1 << 11
"""Places about which the pixels are taken together."""


def reach_of(filter: Filter) -> int:
    """How many pixels from its own a sample can matter in, each way.

    Raises:
        McaaError: a filter without end.
    """
    radius = max(filter.radius)
    if math.isinf(radius):
        raise McaaError(f"the layer needs a filter of finite radius for its gradient, got {filter}; take Lanczos(3)")
    return math.ceil(radius - 0.5)


class Adjoint:
    """A of a strip lattice under one filter; the weights are differentiable in the filter's parameters where grad mode is on.

    `along` = (1, 0) or (0, 1) takes the filter's derivative in x or y in its place: the gradient of A in the sample's position.
    """

    def __init__(
        self, filter: Filter, strip: Strip, dtype: torch.dtype, device: torch.device, along: tuple[int, int] = (0, 0)
    ) -> None:
        self.reach, self.period = reach_of(filter), strip.period
        taps = torch.arange(-self.reach, self.reach + 1, dtype=torch.float64)
        rows = torch.arange(-self.reach, self.period + self.reach, dtype=torch.float64)
        dx = torch.from_numpy(strip.x)[:, None] - taps - 0.5
        dy = torch.from_numpy(strip.y)[:, None] - rows - 0.5
        x, y = dx[:, None, :].expand(-1, len(rows), -1), dy[:, :, None].expand(-1, -1, len(taps))
        # a row's weights sum to 1 over the samples; rows a period apart have the same
        phase = (rows % self.period).to(torch.int64)
        total = torch.zeros(self.period, dtype=torch.float64).index_add(0, phase, filter(x, y).sum((0, 2)))[phase]
        if not bool((total != 0).all()):
            raise McaaError(
                f"no sample lies inside {filter} in some pixels, at {strip.count / strip.period:.2g} a pixel: raise spp, or take a wider filter"
            )

        def place(tensor: Tensor) -> Tensor:
            return tensor.to(device, dtype)

        self.dense = self.down = self.across = None
        if isinstance(filter, SeparableFilter):
            across, down = (
                _slope(filter.profile, d) if order else filter.profile(d) for d, order in zip((dx, dy), along, strict=True)
            )
            self.down, self.across = place(down / total), place(across.T[:, :, None])
        else:
            value = filter(x, y)
            if any(along):
                value = _slope(lambda d: filter(d, y) if along[0] else filter(x, d), x if along[0] else y)
            self.dense = place(value / total[:, None])[:, None]

    def __call__(self, rows: Tensor, planes: slice) -> Tensor:
        """A at some planes of the samples of whole strips, (C, strips, planes, columns).

        rows: (C, strips * period + 2 reach, columns + 2 reach), the gradient of the pixels from `reach` before the first sample's on.
        """
        width, taps = rows.shape[-1] - 2 * self.reach, 2 * self.reach + 1
        if self.dense is not None:
            return torch.nn.functional.conv2d(rows[:, None], self.dense[planes], stride=(self.period, 1)).transpose(1, 2)
        assert self.down is not None and self.across is not None
        summed = torch.matmul(self.down[planes], rows.unfold(1, self.period + 2 * self.reach, self.period).transpose(2, 3))
        out = summed[..., :width] * self.across[0, planes]
        for k in range(1, taps):
            out = out.addcmul_(summed[..., k : k + width], self.across[k, planes])
        return out


def at_places(filter: Filter, grad: Tensor, col: Tensor, row: Tensor) -> Tensor:
    """A at any places, for weights that need no norm: sum_h w(r_k - c_h) grad_h, float64 (C, N).

    grad: (C, H, W); col, row: float64 (N,) in screen pixels; pixels beyond the screen have a gradient of 0.
    """
    reach = reach_of(filter)
    beyond = 2 * reach + 1
    padded = torch.nn.functional.pad(grad.to(torch.float64), (beyond,) * 4)
    height, width = padded.shape[1:]
    offsets = torch.arange(-reach, reach + 1, device=col.device)[:, None]
    total = padded.new_empty(len(grad), len(col))
    for first in range(0, len(col), _PLACES):
        part = slice(first, first + _PLACES)
        x, y = col[part], row[part]
        near, beside = x.floor().long() + offsets, y.floor().long() + offsets
        weight = filter((x - near - 0.5)[None], (y - beside - 0.5)[:, None]).flatten(0, 1)
        across, down = (near + beyond).clamp(0, width - 1), (beside + beyond).clamp(0, height - 1)
        at = (down[:, None] * width + across).flatten()
        for channel, values in enumerate(padded):
            torch.sum(weight * values.view(-1).index_select(0, at).view(weight.shape), 0, out=total[channel, part])
    return total


def norm(task: Task, strip: Strip) -> Tensor | None:
    """(H, W): what a closed boundary divides the sum over the samples on the screen by, see `LatticeWeights`; None for nothing."""
    if task.boundary == "extend":
        return None
    weights, screen, bands = LatticeWeights(task, strip), task.screen, []
    for row in range(0, screen.height, _BAND):
        cell = Cell(row, 0, min(_BAND, screen.height - row), screen.width)
        band = weights.along_y(cell, weights.geometry(cell))[3]
        if band is None:
            return None
        bands.append(band)
    return torch.cat(bands).to(task.device, task.dtype)


def _slope(function: Callable[[Tensor], Tensor], d: Tensor) -> Tensor:
    """The derivative of an elementwise function."""
    with torch.enable_grad():
        place = d.detach().clone().requires_grad_()
        return torch.autograd.grad(function(place).sum(), place)[0]
