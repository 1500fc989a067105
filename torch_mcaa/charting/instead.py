"""What one would use instead: a k x k grid in every pixel, filtered by kornia, by strided convolutions or by PyTorch's own resampling."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor
from torch.nn import functional

from torch_mcaa.charting.methods import Method, Shot, asked, side
from torch_mcaa.charting.subject import Subject
from torch_mcaa.errors import McaaError
from torch_mcaa.filters.base import SeparableFilter

Way = Literal["blur", "stride", "resize"]
NAMES: dict[Way, str] = {
    "blur": "grid, kornia's blur, every k-th",
    "stride": "grid, strided convolutions",
    "resize": "grid, interpolate(antialias=True)",
}


@dataclass(frozen=True)
class Grid(Method):
    """A grid of k x k evaluations in every pixel, f asked beyond the screen as far as the filter reaches.

    * "blur": a sample on every pixel's centre, `kornia.filters.filter2d_separable` with the filter's own profile (for a Gaussian this is
      `gaussian_blur2d`), and every k-th value.
    * "stride": the same filter at the places that are kept only: two separable strided convolutions.
    * "resize": `torch.nn.functional.interpolate(mode="bilinear", antialias=True)`, whose filter is the tent of 1 px, whatever was asked for.
    """

    way: Way

    @property
    def name(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        return NAMES[self.way]

    def spent(self, budget: int) -> int | None:
        k = side(budget)
        return None if k is None else k * k

    def run(self, subject: Subject, budget: int, seed: int) -> Shot:
        k = side(budget)
        assert k is not None
        image, evaluations = {"blur": _blur, "stride": _stride, "resize": _resize}[self.way](subject, k)
        return Shot(image, None, None, torch.full(subject.size, k * k, dtype=torch.int32), evaluations)


def _blur(subject: Subject, k: int) -> tuple[Tensor, int]:
    from kornia.filters import filter2d_separable

    reach = _reach(subject)
    rows, cols = (0.5 + torch.arange(-reach * k, (n - 1 + reach) * k + 1, dtype=torch.float64) / k for n in subject.size)
    values, count = asked(subject, cols, rows)
    kernel = _kernel(subject, torch.arange(-reach * k, reach * k + 1, dtype=torch.float64) / k)[None]
    blurred = filter2d_separable(values[None], kernel, kernel, padding="valid")[0]
    return blurred[:, ::k, ::k].contiguous(), count


def _stride(subject: Subject, k: int) -> tuple[Tensor, int]:
    reach = _reach(subject)
    values, count = _cells(subject, k, reach)
    kernel = _kernel(subject, (torch.arange((2 * reach + 1) * k, dtype=torch.float64) + 0.5) / k - reach - 0.5)
    along = functional.conv2d(values[:, None], kernel.view(1, 1, 1, -1), stride=(1, k))
    return functional.conv2d(along, kernel.view(1, 1, -1, 1), stride=(k, 1))[:, 0], count


def _resize(subject: Subject, k: int) -> tuple[Tensor, int]:
    values, count = _cells(subject, k, 1)
    height, width = subject.size
    image = functional.interpolate(values[None], size=(height + 2, width + 2), mode="bilinear", antialias=True)
    return image[0, :, 1:-1, 1:-1].contiguous(), count


def _cells(subject: Subject, k: int, reach: int) -> tuple[Tensor, int]:
    """f at the centres of the k x k sub-pixels of the screen and of `reach` pixels around it."""
    rows, cols = ((torch.arange((n + 2 * reach) * k, dtype=torch.float64) + 0.5) / k - reach for n in subject.size)
    return asked(subject, cols, rows)


def _kernel(subject: Subject, places: Tensor) -> Tensor:
    assert isinstance(subject.filter, SeparableFilter)
    kernel = subject.filter.profile(places)
    return (kernel / kernel.sum()).float()


def _reach(subject: Subject) -> int:
    if not isinstance(subject.filter, SeparableFilter):
        raise McaaError(
            f"the grids filter along each axis, got {subject.filter!r}, which is not separable; leave it out of the chart"
        )
    return math.ceil(max(subject.filter.radius))
