"""What `render` returns."""

from __future__ import annotations

import math
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from torch_mcaa.errors import McaaError
from torch_mcaa.grid import Cell

Stopped = Literal["spp", "tolerance", "seconds", "interrupted"]


@dataclass(frozen=True, eq=False)
class Rendering:
    """An anti-aliased picture with the standard error of every pixel.

    Attributes:
        image: (C, H, W) estimate of the pixel values (1). NaN where an interrupted or timed run has nothing.
        stderr: (C, H, W) standard error of `image`; never 0 by ignorance, +inf where `image` is NaN or f was found to have no second moment.
        spp: (H, W) int32 evaluations of f spent on each pixel.
        invalid: (H, W) int32 how many of them were NaN or infinite.
        model: (H, W) uint8, what was used in each pixel: an index into `models`.
        models: the names of what was used.
        evaluations: every point f was called on, margins included.
        seconds: wall time.
        stopped: what ended the work.
        bias: why the mean of `image` over seeds may differ from (1), a line a reason; empty when it is unbiased.
        predicted_variance: (C, H, W) the variance of `image` that theory gives, (10) or (12), its second moments estimated from the same
            points; what independent points would have. None for shared points, for which no formula gives one.
        ess: (H, W) float32 effective sample size of the weights w / w'; None for shared points.
        pareto_k: (C, H, W) float32 tail index of the weighted values, NaN where too few points tell; from 1/2 on there is no second
            moment, and `stderr` is +inf about the peaks of such pixels. None for shared points.
        predicted_optimum: what an `allocation` promised for its last round: (15), (20) the variance common to all pixels under
            `EqualVariance`, the sum of the variances under `Neyman`; None without.
        floors: the cells of the screen with what `unseen` has in them, (C, 1, 1) or (C, h, w); empty where it is not told apart.
    """

    image: Tensor
    stderr: Tensor
    spp: Tensor
    invalid: Tensor
    model: Tensor
    models: tuple[str, ...]
    evaluations: int
    seconds: float
    stopped: Stopped
    bias: tuple[str, ...] = ()
    predicted_variance: Tensor | None = None
    ess: Tensor | None = None
    pareto_k: Tensor | None = None
    predicted_optimum: float | None = None
    floors: tuple[tuple[Cell, Tensor], ...] = ()

    @property
    def unseen(self) -> Tensor:
        """(C, H, W) the part of `stderr`, in quadrature, that stands for features which no sample met; 0 where it is not told apart.

        A hundredth of the range of values, of a constant of its magnitude, over the samples a pixel, cell by cell. A tolerance does not count it.
        """
        plane = torch.zeros_like(self.stderr)
        for cell, floor in self.floors:
            plane[:, *cell.window] = floor
        return plane

    def interval(self, level: float = 0.95) -> tuple[Tensor, Tensor]:
        """The (C, H, W) ends of the confidence interval of each pixel: image -+ z stderr, with z the normal quantile of `level`.

        Raises:
            McaaError: a level outside (0, 1).
        """
        if not isinstance(level, Real) or not 0 < level < 1:
            raise McaaError(f"level must lie between 0 and 1, got {level!r}; 0.95 is usual")
        z = math.sqrt(2) * float(torch.erfinv(torch.tensor(level, dtype=torch.float64)))
        return self.image - z * self.stderr, self.image + z * self.stderr

    def numpy(self) -> np.ndarray:
        """The image as (H, W, C)."""
        return self.image.detach().cpu().permute(1, 2, 0).numpy()

    def save(self, path: str | Path, *, bits: int | None = None, force: bool = True) -> None:
        """Write the picture: PNG (sRGB, `bits` 8 or 16), EXR with all layers, NPZ, NPY or TIFF, by the name's ending.

        The file appears under its name only when it is complete.

        Raises:
            McaaError: an ending that is not known, a folder that cannot be written, a number of channels the format has no place for,
                or, with force=False, a file that is already there.
        """
        from torch_mcaa.image_io import write_picture

        write_picture(
            path, image=self.image, stderr=self.stderr, spp=self.spp, invalid=self.invalid, model=self.model, bits=bits, force=force
        )

    def _repr_png_(self) -> bytes | None:
        import io

        from PIL import Image

        from torch_mcaa.image_io import to_srgb8

        if self.image.shape[0] not in (1, 3, 4):
            return None
        pixels = to_srgb8(self.image)
        buffer = io.BytesIO()
        Image.fromarray(pixels[..., 0] if pixels.shape[-1] == 1 else pixels).save(buffer, "png")
        return buffer.getvalue()
