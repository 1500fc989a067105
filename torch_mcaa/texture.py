"""A picture as an integrand: texels interpolated, wrapped at the border, scaled or seen in perspective."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from torch_mcaa.dense import dense, described
from torch_mcaa.errors import McaaError
from torch_mcaa.grid import Screen

Interpolation = Literal["nearest", "bilinear", "bicubic"]
Wrap = Literal["zeros", "border", "repeat", "mirror"]

_FULL_SCALE = {torch.uint8: 255, torch.uint16: 65535, torch.bool: 1, torch.float16: 1, torch.bfloat16: 1}
TAPS: dict[str, tuple[int, ...]] = {"nearest": (0,), "bilinear": (0, 1), "bicubic": (-1, 0, 1, 2)}
"""Texels read along one axis, counted from the last whose centre (nearest: left edge) is not beyond the point."""


class Texture:
    """The integrand f(x, y) = the texture's colour at (x, y), one tensor a channel.

    Texture coordinates (u, v) count texels: texel (row i, column j) covers [j, j+1] x [i, i+1], v down, its
    centre at (j + 1/2, i + 1/2). Without a transform the texture covers the screen once, x in [0, W_screen]
    to u in [0, W]: `on(size)` says which screen, and `render` calls it. While bound to no screen, x and y are
    u and v.

    "nearest" gives the texel that contains the point, "bilinear" interpolates between texel centres,
    "bicubic" is the cubic convolution of R. G. Keys (1981), "Cubic Convolution Interpolation for Digital
    Image Processing", with a = -1/2 (Catmull-Rom): it passes through the texels' values at their centres, and
    overshoots at edges. Where all texels are equal their value comes out exactly.

    With rows and columns along the screen's, `Auto()` filters it exactly, without a sample (`axes`).

    Beyond the border "zeros" has texels of 0, "border" the last texel, "repeat" the texture again, "mirror"
    the texture reflected at its outer edge, so that the last texel comes twice.

    Attributes:
        image: (C, H, W), float32 or float64: the texels, and the values' dtype; gradients reach it.
        transform: (3, 3) or None; gradients reach it too, but for "nearest", flat between its jumps.
        size: (height, width) of the screen that the texture covers, or None.
    """

    image: Tensor
    interpolation: Interpolation
    wrap: Wrap
    transform: Tensor | None
    size: tuple[int, int] | None

    def __init__(
        self,
        image: Tensor | np.ndarray,
        interpolation: Interpolation = "bilinear",
        wrap: Wrap = "border",
        *,
        transform: Tensor | ArrayLike | None = None,
        size: tuple[int, int] | None = None,
    ) -> None:
        """Wrap a picture.

        Args:
            image: (C, H, W) or (H, W). float32 and float64 tensors are kept, not copied; uint8 and uint16 are
                scaled to [0, 1], bool becomes 0 and 1, float16 and bfloat16 become float32.
            interpolation: "nearest", "bilinear" or "bicubic".
            wrap: "zeros", "border", "repeat" or "mirror".
            transform: 3 x 3 matrix M from the screen to the texture: (U, V, D) = M (x, y, 1) and (u, v) =
                (U / D, V / D), x and y in screen pixels, u and v in texels. It is the inverse of the matrix
                that lays the texture on the screen. Points with D <= 0 lie beyond the horizon and give 0: -M
                shows what M hides.
            size: (height, width) of the screen to cover, where it is not the one to be rendered on.

        Raises:
            McaaError: an image of another type, dtype or shape, or without texels; an unknown interpolation
                or wrap; a transform that is not 3 x 3, real, finite and invertible; a size that is not two
                positive integers; a transform and a size together.
        """
        if interpolation not in get_args(Interpolation):
            raise McaaError(f"interpolation must be one of {', '.join(TAPS)}; got {interpolation!r}")
        if wrap not in get_args(Wrap):
            raise McaaError(f"wrap must be one of {', '.join(get_args(Wrap))}; got {wrap!r}")
        if transform is not None and size is not None:
            raise McaaError(f"got a transform and size={size!r}; leave size out, put scale in transform")
        self.image = _as_image(image)
        self.interpolation = interpolation
        self.wrap = wrap
        self.transform = None if transform is None else _as_transform(transform)
        self.size = None if size is None else _as_size(size)

    def on(self, size: tuple[int, int]) -> Texture:
        """This texture covering a screen of (height, width) pixels; itself if it has a transform or a size.

        Raises:
            McaaError: a size that is not two positive integers.
        """
        screen = _as_size(size)
        if self.transform is not None or self.size is not None:
            return self
        bound = copy.copy(self)
        bound.size = screen
        return bound

    @property
    def axes(self) -> tuple[tuple[float, float], tuple[float, float]] | None:
        """((a, b), (c, d)) if u = a x + b and v = c y + d, exactly; None where a transform turns, shears or tilts."""
        if self.transform is None:
            if self.size is None:
                return (1.0, 0.0), (1.0, 0.0)
            return (self.image.shape[-1] / self.size[1], 0.0), (self.image.shape[-2] / self.size[0], 0.0)
        (a, across, b), (down, c, d), (*tilt, depth) = self.transform.detach().double().tolist()
        if any((across, down, *tilt)) or depth <= 0:
            return None
        return (a / depth, b / depth), (c / depth, d / depth)

    def __call__(self, x: Tensor, y: Tensor) -> tuple[Tensor, ...]:
        """C tensors of x's shape, in the image's dtype; NaN where a coordinate is not finite.

        Args:
            x, y: screen coordinates of one shape, float32 or float64.

        Raises:
            McaaError: the image and x are on two devices.
        """
        if x.device != self.image.device:
            there, here = self.image.device, x.device
            raise McaaError(f"the image is on {there}, x on {here}; use Texture(image.to('{here}'))")
        u, v, hidden = self._to_texture(x, y)
        height, width = self.image.shape[-2:]
        columns, across = self._axis(u, width)
        rows, down = self._axis(v, height)
        planes = self.image.reshape(len(self.image), -1).unbind(0)
        lines: list[list[Tensor]] = []
        for row, row_exists in rows:
            texels: list[list[Tensor]] = [[] for _ in planes]
            for column, column_exists in columns:
                index = (row * width + column).reshape(-1)
                exists = None if row_exists is None or column_exists is None else row_exists & column_exists
                for plane, taps in zip(planes, texels, strict=True):
                    texel = plane.index_select(0, index).reshape(x.shape)
                    taps.append(texel if exists is None else torch.where(exists, texel, 0.0))
            lines.append([_blend(taps, across) for taps in texels])
        values = [_blend(taps, down) for taps in zip(*lines, strict=True)]
        if self.interpolation == "nearest":
            finite = torch.isfinite(u) & torch.isfinite(v)
            values = [torch.where(finite, value, torch.nan) for value in values]
        return tuple(values if hidden is None else [torch.where(hidden, 0.0, value) for value in values])

    def _to_texture(self, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor, Tensor | None]:
        if self.transform is not None:
            matrix = self.transform.to(device=x.device, dtype=x.dtype).reshape(-1).unbind(0)
            across, down, depth = (a * x + b * y + c for a, b, c in (matrix[0:3], matrix[3:6], matrix[6:9]))
            hidden = depth <= 0
            depth = torch.where(hidden, 1.0, depth)
            return across / depth, down / depth, hidden
        if self.size is not None:
            # multiplied before it is divided, so that a texel's edge on a whole pixel stays exactly there
            return x * self.image.shape[-1] / self.size[1], y * self.image.shape[-2] / self.size[0], None
        return x, y, None

    def _axis(self, u: Tensor, n: int) -> tuple[list[tuple[Tensor, Tensor | None]], tuple[Tensor, ...]]:
        """Along an axis of n texels: taps (index; under "zeros" where it exists) and `_blend`'s weights."""
        start = u - origin(self.interpolation)
        first = torch.floor(start)
        weights = blending(self.interpolation, (start - first).to(self.image.dtype))
        taps: list[tuple[Tensor, Tensor | None]] = []
        for offset in TAPS[self.interpolation]:
            tap = first.detach() + offset
            exists = (tap >= 0) & (tap < n) if self.wrap == "zeros" else None
            taps.append((wrapped(tap, n, self.wrap), exists))
        return taps, weights


def origin(interpolation: Interpolation) -> float:
    """Where the first tap's own interval begins, in texels: at its left edge, or at its centre."""
    return 0.0 if interpolation == "nearest" else 0.5


def blending(interpolation: Interpolation, f: Tensor) -> tuple[Tensor, ...]:
    """The weights of all TAPS but that at 0, which has what they lack to 1; f in [0, 1]: how far beyond it the point lies, in texels."""
    if interpolation == "bilinear":
        return (f,)
    if interpolation == "bicubic":
        return f * (f * (1 - f / 2) - 0.5), f * (f * (2 - 1.5 * f) + 0.5), f * f * (f / 2 - 0.5)
    return ()


def wrapped(index: Tensor, n: int, wrap: Wrap) -> Tensor:
    """int64 indices in [0, n) of whole-numbered floats; 0 for NaN."""
    # wrapped as floats: as integers they would overflow far out
    if wrap == "repeat":
        index = torch.remainder(index, n)
    elif wrap == "mirror":
        index = torch.remainder(index, 2 * n)
        index = torch.minimum(index, 2 * n - 1 - index)
    # a compiled remainder is inexact where floats step by more than a texel: the clamp serves it too
    return index.clamp(0, n - 1).nan_to_num(0.0).long()


def _blend(taps: Sequence[Tensor], weights: tuple[Tensor, ...]) -> Tensor:
    """Σ weight · tap, where the tap at or before the point has the weight that the others lack to 1."""
    if len(taps) == 1:
        return taps[0]
    if len(taps) == 2:
        return torch.lerp(taps[0], taps[1], weights[0])
    before, here, after, beyond = taps
    value = here
    for tap, weight in zip((before, after, beyond), weights, strict=True):
        # differences, so that equal taps come out exactly
        value = torch.addcmul(value, tap - here, weight)
    return value


def _as_image(image: Tensor | np.ndarray) -> Tensor:
    got = described(image)
    if isinstance(image, np.ndarray) and image.dtype.kind in "bfu" and image.dtype.itemsize <= 8:
        # torch takes native byte order and positive strides only, and warns of read-only arrays
        image = torch.from_numpy(np.require(image, image.dtype.newbyteorder("="), ["C", "W"]))
    if not dense(image) or image.dtype not in (torch.float32, torch.float64, *_FULL_SCALE):
        raise McaaError(f"image must be a dense float, uint8, uint16 or bool tensor or array, got {got}; cast it")
    if image.ndim not in (2, 3) or image.numel() == 0:
        raise McaaError(f"image must be (C, H, W) or (H, W) and not empty, got {got}; permute or index it")
    if image.dtype in _FULL_SCALE:
        image = image.to(torch.float32) / _FULL_SCALE[image.dtype]
    return image[None] if image.ndim == 2 else image


def _as_transform(transform: Tensor | ArrayLike) -> Tensor:
    try:
        # copied, because torch warns of read-only arrays
        given = transform if isinstance(transform, Tensor) else torch.from_numpy(np.array(transform))
    except (TypeError, ValueError) as error:
        raise McaaError(f"transform must be numbers, got {transform!r} ({error}); pass floats") from error
    if not dense(given) or given.shape != (3, 3) or given.is_complex():
        raise McaaError(f"transform must be 3 x 3 and real, got {described(given)}; pass one such matrix")
    scaled = given.detach().double().cpu()
    # rows and columns brought to one size, so that units or a large translation do not look degenerate
    for dim in (1, 0):
        scaled = scaled / scaled.abs().amax(dim, keepdim=True)
    eps = torch.finfo(given.dtype if given.is_floating_point() else torch.float64).eps
    # a check inside an f that is traced loses no gradient
    with torch._C.DisableTorchFunction():
        determinant = float(torch.linalg.det(scaled).abs())
    # 16 eps: the rounding of such a determinant. NaN, of a zero row or a bad entry, fails every comparison
    if not determinant > 16 * eps:
        raise McaaError(f"transform must be finite and invertible, got {given.tolist()}; pass another matrix")
    return given


def _as_size(size: tuple[int, int]) -> tuple[int, int]:
    screen = Screen.of(size)
    return screen.height, screen.width
