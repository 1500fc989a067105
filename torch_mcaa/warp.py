"""`warp_perspective`, `warp_affine` and `resize`: kornia's arguments and shapes, without aliasing where a picture gets smaller.

kornia reads the source once for each output pixel. Here each output pixel is an integral over the source under a filter of the
output's pixels, so that what is smaller than a pixel is averaged, not missed. Pixel centres have whole coordinates, as in kornia.
"""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor

from torch_mcaa.compiling import uncompiled
from torch_mcaa.dense import dense, described, pictures
from torch_mcaa.errors import McaaError, warn
from torch_mcaa.estimators import Auto, Estimator, Shared
from torch_mcaa.filters import Box, Filter, Gaussian
from torch_mcaa.grid import Screen
from torch_mcaa.replay.adjoint import reach_of
from torch_mcaa.replay.moved import hides
from torch_mcaa.supersampler import Supersampler
from torch_mcaa.texture import Interpolation, Texture, Wrap

Padding = Literal["zeros", "border", "reflection", "fill"]
_MODES: dict[str, Interpolation] = {"nearest": "nearest", "bilinear": "bilinear", "bicubic": "bicubic"}
_RESIZE: dict[str, Interpolation] = {**_MODES, "nearest-exact": "nearest", "area": "nearest"}


@uncompiled
def warp_perspective(
    src: Tensor,
    M: Tensor,
    dsize: tuple[int, int],
    mode: Literal["bilinear", "nearest", "bicubic"] = "bilinear",
    padding_mode: Padding = "zeros",
    align_corners: bool = True,
    fill_value: Tensor | None = None,
    *,
    filter: Filter | None = None,
    estimator: Estimator | None = None,
    spp: int = 16,
    seed: int = 0,
) -> Tensor:
    """Warp pictures by homographies, as `kornia.geometry.transform.warp_perspective`, with gradients for the pictures and the homographies.

    Args:
        src: (B, C, H, W), floating.
        M: (B, 3, 3), or (1, 3, 3) for all; from source to destination, in pixels.
        dsize: (height, width) of the result.
        mode: how the source is interpolated between its pixels.
        padding_mode: what lies beyond the source's border.
        align_corners: reflection is about the centres of the last pixels if True, about their outer edges if False; it changes nothing else.
        fill_value: under "fill", a tensor that broadcasts to (B, C, h, w), or (C,).
        filter: by default Gaussian(0.5), in pixels of the result.
        estimator: by default Auto() where M moves, scales and mirrors alone and the filter separates, which samples nothing and is exact;
            else Shared(), which is linear in the picture.
        spp, seed: as in `render`.

    Returns:
        (B, C, h, w), of src's dtype. A horizon on the result is told with a `McaaWarning`; beyond it there is 0.

    Raises:
        McaaError: an argument that cannot be used, among them an M that is not invertible.
    """
    _check_maps(M, 3)
    _check(src, M, padding_mode, align_corners)
    layer = _layer(dsize, filter, spp, seed)
    if fill_value is not None:
        _check_fill(fill_value, (max(len(src), len(M)), src.shape[1], *dsize))
    interpolation = _looked_up(mode, _MODES, "mode")
    if padding_mode == "fill":
        # a channel of ones tells how much of each pixel is the source's
        src = torch.cat([src, torch.ones_like(src[:, :1])], 1)
    parts = []
    for number in range(len(M)):
        pictures = src if len(M) == 1 else src[number : number + 1]
        texture = _texture(pictures.flatten(0, 1), _to_source(M[number], layer.size), interpolation, padding_mode, align_corners)
        assert texture.transform is not None
        if hides(texture.transform, Screen.of(dsize), reach_of(layer.filter)):
            warn(f"the horizon of M[{number}] lies on the result or within the filter's reach of it; what lies beyond it is 0")
        parts.append(_of(layer, texture, estimator, src).unflatten(0, pictures.shape[:2]))
    found = torch.cat(parts)
    if padding_mode == "fill":
        fill = torch.zeros(()) if fill_value is None else fill_value
        fill = fill.to(found)[:, None, None] if fill.ndim == 1 else fill.to(found)
        found = found[:, :-1] + (1 - found[:, -1:]) * fill
    return found


def _check_maps(M: object, rows: int) -> None:
    """Raises McaaError for what is no batch of matrices of so many rows and 3 columns."""
    if not (dense(M) and M.ndim == 3 and M.shape[-2:] == (rows, 3)):
        raise McaaError(f"M must be a dense tensor (B, {rows}, 3), got {described(M)}; for one matrix pass M[None]")


def _check_fill(fill_value: object, shape: tuple[int, ...]) -> None:
    """Raises McaaError for one that is no colour of pictures of this shape."""
    if dense(fill_value) and not fill_value.is_complex():
        given = tuple(fill_value.shape)
        if given in ((), (1,), shape[1:2]) or (len(given) == 4 and all(a in (1, b) for a, b in zip(given, shape, strict=True))):
            return
    raise McaaError(
        f"fill_value must be a tensor ({shape[1]},), a number for each channel, or one that broadcasts to {shape}, got {described(fill_value)}; "
        "wrap it in torch.tensor"
    )


def warp_affine(
    src: Tensor,
    M: Tensor,
    dsize: tuple[int, int],
    mode: Literal["bilinear", "nearest", "bicubic"] = "bilinear",
    padding_mode: Padding = "zeros",
    align_corners: bool = True,
    fill_value: Tensor | None = None,
    *,
    filter: Filter | None = None,
    estimator: Estimator | None = None,
    spp: int = 16,
    seed: int = 0,
) -> Tensor:
    """Warp pictures by affine maps, as `kornia.geometry.transform.warp_affine`; see `warp_perspective`.

    Args:
        M: (B, 2, 3), or (1, 2, 3) for all; from source to destination, in pixels.

    Raises:
        McaaError: as `warp_perspective`.
    """
    _check_maps(M, 2)
    last = torch.tensor([0.0, 0.0, 1.0]).to(M).expand(len(M), 1, 3)
    return warp_perspective(
        src,
        torch.cat([M, last], 1),
        dsize,
        mode,
        padding_mode,
        align_corners,
        fill_value,
        filter=filter,
        estimator=estimator,
        spp=spp,
        seed=seed,
    )


@uncompiled
def resize(
    input: Tensor,
    size: int | tuple[int, int],
    interpolation: Literal["nearest", "nearest-exact", "bilinear", "bicubic", "area"] = "bilinear",
    align_corners: bool | None = None,
    side: Literal["short", "long", "vert", "horz"] = "short",
    antialias: bool = True,
    *,
    filter: Filter | None = None,
    estimator: Estimator | None = None,
    spp: int = 16,
    seed: int = 0,
) -> Tensor:
    """Resize pictures, as `kornia.geometry.transform.resize`.

    Args:
        input: (..., H, W), floating.
        size: (height, width), or an integer for the `side`, the other side in proportion.
        interpolation: between the source's pixels; "area" is the mean over each output pixel, whose filter is Box().
        align_corners: the centres of the corners' pixels stay where they are if True, their outer corners if False or None.
        antialias: is taken for kornia's sake and changes nothing: the result is always filtered.
        filter: by default Gaussian(0.5), in pixels of the result.
        estimator: by default as in `warp_perspective`.
        spp, seed: as in `render`.

    Returns:
        (..., h, w), of the input's dtype.

    Raises:
        McaaError: an argument that cannot be used.
    """
    if not pictures(input) or input.ndim < 2:
        raise McaaError(
            f"input must be a dense floating tensor (..., H, W) that is not empty, got {described(input)}; of bytes pass input / 255"
        )
    if not isinstance(antialias, bool) or not (align_corners is None or isinstance(align_corners, bool)):
        raise McaaError(
            f"align_corners must be True, False or None, and antialias True or False, got {align_corners!r} and {antialias!r}"
        )
    if not isinstance(size, int | tuple | list):
        raise McaaError(f"size must be an integer or two integers (height, width), got {size!r}")
    height, width = input.shape[-2:]
    if isinstance(size, int):
        size = _of_side(size, width / height, side)
    kind = _looked_up(interpolation, _RESIZE, "interpolation")
    layer = _layer(size, Box() if interpolation == "area" and filter is None else filter, spp, seed)
    image, transform = input.reshape(-1, height, width), None
    if align_corners:
        # one texel is the same everywhere
        steps = [max(1, given - 1) / max(1, wanted - 1) for given, wanted in zip((height, width), size, strict=True)]
        transform = torch.tensor(
            [[steps[1], 0, 0.5 - steps[1] / 2], [0, steps[0], 0.5 - steps[0] / 2], [0, 0, 1]], dtype=torch.float64
        )
    found = _of(layer, Texture(image, kind, "border", transform=transform), estimator, input)
    return found.reshape(*input.shape[:-2], *found.shape[-2:])


def _of_side(length: int, aspect: float, side: str) -> tuple[int, int]:
    """The size whose `side` is `length`, of pictures `aspect` times as wide as high."""
    if side not in ("short", "long", "vert", "horz"):
        raise McaaError(f"side must be 'short', 'long', 'vert' or 'horz', got {side!r}")
    vertical = side == "vert" or (side == "short" and aspect >= 1) or (side == "long" and aspect < 1)
    return (length, int(length * aspect)) if vertical else (int(length / aspect), length)


def _to_source(matrix: Tensor, size: tuple[int, int]) -> Tensor:
    """From places of the result to those of the source, both with pixel centres at halves."""
    scaled = matrix.detach().double()
    # a homography is one whatever its matrix is multiplied by
    scaled = scaled / scaled.abs().amax()
    if not float(torch.linalg.det(scaled).abs()) > 0:
        raise McaaError(f"M must be finite and invertible, got {matrix.tolist()}")
    half = torch.tensor([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]], dtype=torch.float64, device=matrix.device)
    back = half @ torch.linalg.inv(matrix.double()) @ torch.linalg.inv(half)
    # M and -M are one homography; a texture has what lies on one side of its horizon, here the side of the result's middle
    middle = torch.tensor([size[1] / 2, size[0] / 2, 1.0], dtype=torch.float64, device=matrix.device)
    return -back if float((back.detach() @ middle)[2]) < 0 else back


def _texture(image: Tensor, transform: Tensor, interpolation: Interpolation, padding: str, align_corners: bool) -> Texture:
    wraps: dict[str, Wrap] = {"zeros": "zeros", "fill": "zeros", "border": "border", "reflection": "mirror"}
    wrap = wraps[padding]
    if padding == "reflection" and align_corners:
        # reflected about the centres of the last pixels: those come once
        for dim in (-1, -2):
            inner = image.narrow(dim, 1, max(0, image.shape[dim] - 2))
            image = torch.cat([image, inner.flip(dim)], dim)
        wrap = "repeat"
    return Texture(image, interpolation, wrap, transform=transform)


def _layer(dsize: object, filter: Filter | None, spp: int, seed: int) -> Supersampler:
    screen = Screen.of(dsize)
    return Supersampler(
        (screen.height, screen.width),
        filter=Gaussian(0.5) if filter is None else filter,
        spp=spp,
        seed=seed,
        redraw=False,
    )


def _of(layer: Supersampler, texture: Texture, estimator: Estimator | None, like: Tensor) -> Tensor:
    summed = texture.axes is not None and layer.filter.separable
    layer.estimator = estimator or (Auto() if summed else Shared())
    return layer.to(texture.image.device, texture.image.dtype)(texture).to(like.dtype)


def _check(src: object, M: Tensor, padding_mode: str, align_corners: object) -> None:
    if not pictures(src) or src.ndim != 4:
        raise McaaError(
            f"src must be a dense floating tensor (B, C, H, W) that is not empty, got {described(src)}; of bytes pass src / 255, "
            "of one picture src[None]"
        )
    if len(M) not in (1, len(src)):
        raise McaaError(f"src has {len(src)} pictures and M {len(M)} maps; give one map for each, or one for all")
    if not isinstance(align_corners, bool):
        raise McaaError(f"align_corners must be True or False, got {align_corners!r}")
    if M.is_complex():
        raise McaaError(f"M must be real, got {described(M)}")
    if M.device != src.device:
        raise McaaError(f"src is on {src.device}, M on {M.device}; move one")
    if padding_mode not in ("zeros", "border", "reflection", "fill"):
        raise McaaError(f"padding_mode must be 'zeros', 'border', 'reflection' or 'fill', got {padding_mode!r}")


def _looked_up(name: str, known: dict[str, Interpolation], argument: str) -> Interpolation:
    if not isinstance(name, str) or name not in known:
        raise McaaError(f"{argument} must be one of {', '.join(known)}, got {name!r}")
    return known[name]
