"""Pictures of a `Texture` whose rows and columns are the screen's: its texels times integrals in x and in y, and no samples.

Such a texture is a sum of texels times products b_k(x) b_l(y) of piecewise polynomials, and a filter that separates integrates each factor
by itself: the picture (1) is W_y texels W_x^T, where W holds the integrals of profile(t - c_i) b_k(t).
"""

from __future__ import annotations

import math
from functools import cached_property

import torch
from torch import Tensor

from torch_mcaa.estimators.base import Estimate, Round, Task
from torch_mcaa.estimators.texel_weights import Axis, Weights
from torch_mcaa.filters import SeparableFilter
from torch_mcaa.grid import Cell
from torch_mcaa.texture import Texture

SIDE = 256
"""Px: the side of a cell."""
_BAND = 2**20
"""Numbers of the texture that are held at once."""
_ACCURACY = 2.0**-46
"""Of the weights, in parts of 1."""


class Texels:
    """The linear map from the texels of a task's texture to its picture, cell by cell."""

    def __init__(self, task: Task, texture: Texture, axes: tuple[Axis, Axis]) -> None:
        self.task, self.texture, self.axes = task, texture, axes
        self._kept: dict[tuple[int, int, int], tuple[slice, Weights]] = {}

    @classmethod
    def of(cls, task: Task) -> Texels | None:
        """That map; None where f is not a texture, or has to be sampled, as `axes_of` tells."""
        texture, axes = task.integrand.function, task.once(axes_of)
        return cls(task, texture, axes) if isinstance(texture, Texture) and axes is not None else None

    @cached_property
    def _largest(self) -> Tensor:
        """(C, 1, 1) the largest modulus of each channel's texels."""
        image = self.texture.image.detach()
        return torch.maximum(image.amax((1, 2), True), -image.amin((1, 2), True)).to(torch.float64)

    def values(self, cell: Cell) -> tuple[Tensor, Tensor]:
        """(C, h, w) float64, and what it could be at most: the moduli of the weights, of 1 in all at least, times the largest texel."""
        (cols, across), (rows, down) = self._weights(cell)
        image = self.texture.image.detach()
        channels, height, width = len(image), rows.stop - rows.start, cols.stop - cols.start
        summed = torch.empty(width, channels * cell.height, dtype=torch.float64, device=image.device)
        for part in self._bands(cols, channels * height):
            lines = image[:, rows, part].permute(1, 0, 2).to(torch.float64, memory_format=torch.contiguous_format)
            found = down.times(lines.reshape(height, -1)).view(cell.height, channels, -1)
            summed[part.start - cols.start : part.stop - cols.start] = found.permute(2, 1, 0).reshape(-1, channels * cell.height)
        value = across.times(summed).view(cell.width, channels, cell.height).permute(1, 2, 0)
        # weights that are small are known no better than others
        return value, self._largest * down.sizes().clamp_min(1)[:, None] * across.sizes().clamp_min(1)

    def gradient(self, grad: Tensor) -> Tensor:
        """With respect to the texels, in the image's dtype, from (C, H, W) with respect to the picture."""
        image = self.texture.image
        total, channels = torch.zeros_like(image), len(image)
        for cell in self.task.screen.cells(SIDE, SIDE):
            (cols, across), (rows, down) = self._weights(cell)
            height, width = rows.stop - rows.start, cols.stop - cols.start
            lines = grad[(slice(None), *cell.window)].permute(2, 0, 1).to(torch.float64, memory_format=torch.contiguous_format)
            summed = across.transposed(width).times(lines.reshape(cell.width, -1)).view(width, channels, cell.height)
            down = down.transposed(height)
            for part in self._bands(cols, channels * height):
                inside = summed[part.start - cols.start : part.stop - cols.start].permute(2, 1, 0).reshape(cell.height, -1)
                total[:, rows, part] += down.times(inside).view(height, channels, -1).permute(1, 0, 2).to(total)
        return total

    def _weights(self, cell: Cell) -> list[tuple[slice, Weights]]:
        """Along x and along y: the texels that a cell's pixels see, and what they weigh, counted from the first."""
        found = []
        for number, (first, count) in enumerate(((cell.col, cell.width), (cell.row, cell.height))):
            key = number, first, count
            if key not in self._kept:
                assert isinstance(self.task.filter, SeparableFilter)
                start, place, value = self.axes[number].weights(self.task.filter, self.task.boundary, first, count)
                seen = slice(int(place.min()), int(place.max()) + 1) if len(place) else slice(0, 0)
                self._kept[key] = seen, Weights(*(t.to(self.task.device) for t in (start, place - seen.start, value)))
            found.append(self._kept[key])
        return found

    @staticmethod
    def _bands(cols: slice, numbers: int) -> list[slice]:
        """Columns of texels with that many numbers each, some at a time."""
        step = max(1, _BAND // max(1, numbers))
        return [slice(col, min(col + step, cols.stop)) for col in range(cols.start, cols.stop, step)]


def axes_of(task: Task) -> tuple[Axis, Axis] | None:
    """The axes along x and y of a texture that need not be sampled.

    None for other functions, under a transform that turns, shears or tilts, where a texel is not finite, under a filter that does not
    separate or does not end, and for what has no end where too many texels are under the filter.
    """
    texture, filter, screen = task.integrand.function, task.filter, task.screen
    # a subclass may have another __call__
    if not isinstance(texture, Texture) or type(texture) is not Texture:
        return None
    if not isinstance(filter, SeparableFilter) or math.isinf(filter.half_width):
        return None
    image, axes = texture.image.detach(), texture.axes
    if axes is None or image.device != task.device:
        return None
    # the sum is a cheap test that may cry wolf, on overflow
    if not math.isfinite(image.sum().item()) and not bool(image.isfinite().all()):
        return None
    placed = []
    sides = zip(axes, screen.extent[::2], screen.pixel_size, (screen.width, screen.height), image.shape[:0:-1], strict=True)
    for (scale, shift), start, size, pixels, texels in sides:
        axis = Axis(scale * size, scale * start + shift, pixels, texels, texture.interpolation, texture.wrap)
        if not axis.fits(filter):
            return None
        placed.append(axis)
    return placed[0], placed[1]


class TexelsRound(Round):
    """The picture itself: another round would be the same."""

    per_pixel = 0.0

    def __init__(self, texels: Texels, model: int) -> None:
        self.texels, self.model = texels, model

    def points(self, cell: Cell) -> int:
        return 0

    def estimate(self, cell: Cell) -> Estimate:
        dtype = self.texels.task.dtype
        exact, size = self.texels.values(cell)
        value = exact.to(dtype)
        # half a last place of the value, and what the weights are short of
        error = torch.finfo(dtype).eps / 2 * value.abs() + _ACCURACY * size.to(dtype)
        none = torch.zeros(cell.height, cell.width, dtype=torch.int32, device=value.device)
        model = torch.full_like(none, self.model, dtype=torch.uint8)
        return Estimate(value, error.square().clamp_min(torch.finfo(dtype).tiny), none, none.clone(), model=model)
