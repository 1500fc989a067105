"""Pictures from files, as linear light."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

import numpy as np
import torch
from torch import Tensor

from torch_mcaa.errors import McaaError
from torch_mcaa.image_io.exr import read_exr
from torch_mcaa.image_io.srgb import srgb_decode

Array = np.ndarray[Any, Any]
Check = Callable[[int, int, int], None]
# Not every format Pillow knows: its EPS reader, for one, runs another program.
_PILLOW = ("PNG", "JPEG", "BMP", "GIF", "PPM", "WEBP")


def read_image(path: str | os.PathLike[str], max_pixels: int = 2**28) -> Tensor:
    """Reads PNG, JPEG, BMP, GIF, PNM, WebP, EXR, TIFF, NPY or NPZ as linear float32 (C, H, W).

    Grey comes as C = 1, palettes as RGB, alpha as the 4th channel (straight, linear). Integers of 8 and 16
    bits are decoded from the sRGB curve; floats stay as they are. Arrays are (H, W) or (H, W, C), in an NPZ
    the one named `image`. EXR needs the extra `exr`. Pixels come as stored: colour profiles and EXIF
    rotations are not applied, an animation gives its first frame. More than `max_pixels` pixels, or 4 times
    as many numbers, are refused by the header, before anything is decoded. Raises McaaError for every file
    that cannot be read whole.
    """

    def check(height: int, width: int, channels: int) -> None:
        size = f"{width} x {height} pixels of {channels} channels"
        if min(height, width, channels) < 1:
            raise McaaError(f"cannot read {path}: it is empty, {size}; give at least one pixel")
        if height * width * max(4, channels) > 4 * max_pixels:
            raise McaaError(f"cannot read {path}: {size} exceed max_pixels = {max_pixels}; raise that limit")

    try:
        with open(path, "rb") as file:
            pixels = _READERS.get(Path(path).suffix.lower(), _read_pillow)(file, check)
    except (McaaError, MemoryError):
        raise
    except Exception as error:  # decoders raise anything: SyntaxError, struct.error, a bare Exception
        reason = (isinstance(error, OSError) and error.strerror) or str(error) or type(error).__name__
        reason = " ".join(reason.split())
        raise McaaError(f"cannot read {path}: {reason}; give a whole picture file") from error
    return torch.from_numpy(np.require(np.moveaxis(pixels, -1, 0), np.float32, ["C", "W"]))


def _linear(codes: Array) -> Array:
    levels = np.iinfo(codes.dtype).max
    curve = srgb_decode(torch.arange(levels + 1, dtype=torch.float64) / levels).float().numpy()
    codes = codes.reshape(*codes.shape[:2], -1)
    pixels = curve[codes]
    if codes.shape[2] in (2, 4):
        pixels[..., -1] = codes[..., -1] / np.float32(levels)
    return pixels[..., [0, 0, 0, 1]] if codes.shape[2] == 2 else pixels


def _read_pillow(file: IO[bytes], check: Check) -> Array:
    from PIL import Image

    # Image.open warns and refuses by a limit of its own, a module global; the limit here is max_pixels.
    Image.init()
    prefix = file.read(32)
    file.seek(0)
    for factory, accept in (Image.OPEN[name] for name in _PILLOW if name in Image.OPEN):
        if accept is not None and accept(prefix) is True:
            picture = factory(file, file.name)
            break
    else:
        raise ValueError("not a PNG, JPEG, BMP, GIF, PNM or WebP picture")
    check(picture.height, picture.width, 4)
    if picture.format == "PNG" and prefix[24] == 16:
        return _read_png16(file.name, prefix[25], picture.info.get("transparency"))
    if picture.mode == "F":
        return np.asarray(picture)[..., None]
    if picture.mode == "I":  # of these formats only PGM comes so, scaled to 16 bits
        return _linear(np.asarray(picture).astype(np.uint16))
    grey = "L" if picture.mode in ("1", "L") else "RGB"
    return _linear(np.asarray(picture.convert("RGBA" if picture.has_transparency_data else grey)))


def _read_png16(path: str, colour_type: int, transparent: int | tuple[int, ...] | None) -> Array:
    # Pillow would give 8 of the 16 bits of colour without a word.
    from kornia_rs import io

    if colour_type == 4:
        raise ValueError("16-bit grey with alpha has no decoder here, save it as RGBA")
    codes = np.asarray(io.read_image_png_u16(path, {0: "mono", 2: "rgb", 6: "rgba"}[colour_type]))
    if transparent is None:
        return _linear(codes)
    clear = (codes == np.asarray(transparent, dtype=np.uint16)).all(axis=-1, keepdims=True)
    colour = codes if colour_type == 2 else codes.repeat(3, axis=-1)
    return _linear(np.concatenate((colour, np.where(clear, 0, 65535).astype(np.uint16)), axis=-1))


def _read_tiff(file: IO[bytes], check: Check) -> Array:
    import tifffile

    with tifffile.TiffFile(file) as tiff:
        page = tiff.pages.first
        check(page.imagelength, page.imagewidth, page.samplesperpixel)
        if page.axes not in ("YX", "YXS", "SYX") or page.photometric not in (1, 2):
            raise ValueError(f"expected grey or RGB, got axes {page.axes}, photometric {page.photometric!r}")
        array = page.asarray()
    array = np.moveaxis(array, 0, -1) if page.axes == "SYX" else array.reshape(*array.shape[:2], -1)
    if array.dtype in (np.uint8, np.uint16) and array.shape[2] <= 4:
        return _linear(array)
    if array.dtype.kind != "f":
        raise ValueError(f"expected floats, or 8 or 16 bits, got {array.dtype} in {array.shape[2]} channels")
    return array


def _read_npy(file: IO[bytes], check: Check) -> Array:
    header = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    shape, _, dtype = header[np.lib.format.read_magic(file)](file)
    if len(shape) not in (2, 3) or dtype.kind not in "fb":
        raise ValueError(f"expected floats of shape (H, W) or (H, W, C), got {dtype} {shape}")
    check(shape[0], shape[1], shape[2] if len(shape) == 3 else 1)
    file.seek(0)
    return np.lib.format.read_array(file, allow_pickle=False).reshape(*shape[:2], -1)


def _read_npz(file: IO[bytes], check: Check) -> Array:
    with zipfile.ZipFile(file) as archive, archive.open("image.npy") as member:
        return _read_npy(member, check)


_READERS: dict[str, Callable[[IO[bytes], Check], Array]] = {
    ".exr": read_exr,
    ".tif": _read_tiff,
    ".tiff": _read_tiff,
    ".npz": _read_npz,
    ".npy": _read_npy,
}
