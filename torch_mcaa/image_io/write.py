"""Pictures to files that are whole or not there."""

from __future__ import annotations

import io
import os
import secrets
import stat
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

import numpy as np
import torch
from torch import Tensor

from torch_mcaa.errors import McaaError
from torch_mcaa.image_io.exr import openexr, write_exr
from torch_mcaa.image_io.srgb import srgb_encode

Array = np.ndarray[Any, Any]


def to_srgb8(image: Tensor | Array) -> Array:
    """Linear (C, H, W), C in 1, 3, 4, to (H, W, C) uint8 on the sRGB curve (alpha linear).

    Clipped to 0..1, NaN as 0, rounded half to even after encoding. Raises McaaError for other shapes.
    """
    return _quantised(_layer("image", image, None), 8)


def check_target(path: str | os.PathLike[str], force: bool = False) -> Path:
    """Raises McaaError where `write_picture` could not put a picture; returns the path, links resolved.

    Made to be called before the work begins: it checks the extension and its library, tries the folder by
    making and removing a file, and refuses an existing file without `force`.
    """
    if not isinstance(path, (str, os.PathLike)):
        raise McaaError(f"a picture is written to a path, got {path!r}; pass a name such as 'picture.png'")
    kind = Path(path).suffix.lower()
    if kind not in _WRITERS:
        raise McaaError(f"cannot write {path}: unknown extension {kind!r}; use one of {', '.join(_WRITERS)}")
    if kind == ".exr":
        openexr()
    try:
        target = Path(os.path.realpath(path))
        probe = _temporary(target, ".tmp")
        probe.touch(exist_ok=False)
        probe.unlink()
        try:
            mode = target.stat().st_mode
        except FileNotFoundError:
            return target
    except (OSError, ValueError) as error:
        mend = "name a file in an existing folder that you may write to"
        raise McaaError(f"cannot write {path}: {_reason(error)}; {mend}") from error
    if not stat.S_ISREG(mode):
        raise McaaError(f"cannot write {path}: what lies there is not a regular file; choose another name")
    if not force:
        raise McaaError(f"cannot write {path}: it exists; choose another name, or --force / force=True")
    return target


def write_picture(
    path: str | os.PathLike[str],
    *,
    image: Tensor | Array,
    stderr: Tensor | Array | None = None,
    spp: Tensor | Array | None = None,
    invalid: Tensor | Array | None = None,
    model: Tensor | Array | None = None,
    force: bool = False,
    bits: int | None = None,
) -> None:
    """Writes `image` (C, H, W), linear floats, and of the other layers what the format holds.

    The table of `image_io` says what that is. `stderr` has the shape of `image`; `spp`, `invalid` and `model`
    are (H, W). `bits` is 8 (default) or 16, for PNG only. The file appears under its name once it is whole,
    by a rename inside its folder; a failure leaves what lay there. Raises McaaError for what `check_target`
    refuses, for layers of a wrong shape or type, and for what the disk or the encoder refuses.
    """
    target = check_target(path, force)
    kind = Path(path).suffix.lower()
    if bits not in (None, 8, 16) or (bits is not None and kind != ".png"):
        raise McaaError(f"bits must be 8 or 16 for .png, None for other formats; got {bits!r} for {path}")
    layers = {"image": _layer("image", image, None)}
    shape = layers["image"].shape
    for name, value in (("stderr", stderr), ("spp", spp), ("invalid", invalid), ("model", model)):
        if value is not None:
            layers[name] = _layer(name, value, shape if name == "stderr" else shape[1:])
    temporary = _temporary(target, kind)
    try:
        with _File(io.FileIO(temporary, "x+")) as file:
            _WRITERS[kind](file, layers, bits or 8)
        with open(temporary, "r+b") as written:
            os.fsync(written.fileno())
        os.replace(temporary, target)
    except (OSError, RuntimeError) as error:
        raise McaaError(f"cannot write {path}: {_reason(error)}; nothing there was changed") from error
    finally:
        temporary.unlink(missing_ok=True)


class _File(io.BufferedRandom):
    """Hides its descriptor: given one, NumPy loses the error of a last block that finds the disk full."""

    def fileno(self) -> int:
        raise io.UnsupportedOperation("fileno")


def _reason(error: Exception) -> str:
    return (isinstance(error, OSError) and error.strerror) or str(error) or type(error).__name__


def _temporary(target: Path, kind: str) -> Path:
    return target.with_name(f".{secrets.token_hex(8)}{kind}")


def _layer(name: str, value: Tensor | Array, shape: tuple[int, ...] | None) -> Array:
    if isinstance(value, Tensor):
        value = value.detach().cpu()
        value = (value.float() if value.dtype in (torch.bfloat16, torch.float16) else value).numpy()
    array = np.asarray(value)
    if (array.ndim != 3 or 0 in array.shape) if shape is None else array.shape != shape:
        expected = "(C, H, W) and not empty" if shape is None else f"{shape}, to fit image"
        raise McaaError(f"{name} must have the shape {expected}; got {array.shape}")
    light = name in ("image", "stderr")
    if array.dtype.kind not in ("fb" if light else "fbiu"):
        expected = "linear floats or booleans; divide integers by their white" if light else "real numbers"
        raise McaaError(f"{name} must be {expected}; got {array.dtype}")
    if light and array.dtype != np.float64:
        array = array.astype(np.float64 if array.dtype.itemsize > 8 else np.float32, copy=False)
    return array


def check_channels(path: str | os.PathLike[str], channels: int) -> None:
    """Raises McaaError where a file of this name cannot hold so many channels. Made to be called before the work begins."""
    if Path(path).suffix.lower() == ".png":
        _check_quantised(channels)


def _check_quantised(channels: int) -> None:
    if channels not in (1, 3, 4):
        raise McaaError(f"8 and 16 bits hold 1, 3 (RGB) or 4 (RGBA) channels, got {channels}; write .exr, .tif or .npz")


def _quantised(image: Array, bits: int) -> Array:
    _check_quantised(len(image))
    values = np.where(np.isnan(image), 0, image).clip(0, 1)
    values[:3] = srgb_encode(torch.from_numpy(values[:3])).numpy()
    codes = np.rint(values * (2**bits - 1)).astype(np.uint8 if bits == 8 else np.uint16)
    return np.ascontiguousarray(np.moveaxis(codes, 0, -1))


def _last(layer: Array) -> Array:
    return np.moveaxis(layer, 0, -1) if layer.ndim == 3 else layer


def _write_png(file: IO[bytes], layers: dict[str, Array], bits: int) -> None:
    # Pillow, and with it imageio and scikit-image, writes no 16-bit colour; kornia brings this encoder.
    from kornia_rs import io as codec

    codes = _quantised(layers["image"], bits)
    write = codec.write_image_png_u8 if bits == 8 else codec.write_image_png_u16
    try:
        write(str(file.name), codes, {1: "mono", 3: "rgb", 4: "rgba"}[codes.shape[2]])
    except Exception as error:  # a bare Exception is what it raises
        raise OSError(str(error)) from error


def _write_tiff(file: IO[bytes], layers: dict[str, Array], _: int) -> None:
    import tifffile

    big = 4 * sum(layer.size for layer in layers.values()) > 2**32 - 2**24
    with tifffile.TiffWriter(file, bigtiff=big) as tiff:
        for name, layer in layers.items():
            samples = layer.shape[0] if layer.ndim == 3 else 1
            pixels = _last(layer) if samples > 1 else layer.reshape(layer.shape[-2:])
            extra = {1: None, 3: None, 4: ("unassalpha",)}.get(samples, ("unspecified",) * (samples - 1))
            tiff.write(
                np.ascontiguousarray(pixels, dtype=np.float32),
                photometric="rgb" if samples in (3, 4) else "minisblack",
                planarconfig="contig" if samples > 1 else None,
                extrasamples=extra,
                description=name,
                metadata=None,
            )


def _write_npz(file: IO[bytes], layers: dict[str, Array], _: int) -> None:
    named: dict[str, Any] = {name: _last(layer) for name, layer in layers.items()}
    np.savez(file, **named)


def _write_npy(file: IO[bytes], layers: dict[str, Array], _: int) -> None:
    np.save(file, _last(layers["image"]))


_WRITERS: dict[str, Callable[[IO[bytes], dict[str, Array], int], None]] = {
    ".png": _write_png,
    ".exr": write_exr,
    ".tif": _write_tiff,
    ".tiff": _write_tiff,
    ".npz": _write_npz,
    ".npy": _write_npy,
}
