"""OpenEXR files, by the package OpenEXR (the extra `exr`)."""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable
from types import ModuleType
from typing import IO, Any

import numpy as np

from torch_mcaa.errors import McaaError

_COLOUR = {1: "Y", 3: "RGB", 4: "RGBA"}


def openexr() -> ModuleType:
    """The package, or McaaError with what to install."""
    try:
        module = importlib.import_module("OpenEXR")
    except ImportError as error:
        raise McaaError("EXR files need the package OpenEXR: pip install 'torch_mcaa[exr]'") from error
    # Older ones only write by file name, and then report success on a full disk.
    if tuple(int(part) for part in module.__version__.split(".")[:2]) < (3, 5):
        found = module.__version__
        raise McaaError(f"EXR files need OpenEXR 3.5 or later, got {found}: pip install -U 'torch_mcaa[exr]'")
    return module


def write_exr(file: IO[bytes], layers: dict[str, np.ndarray[Any, Any]], _: int) -> None:
    """`layers` (C, H, W) or (H, W) as float32 channels, named as the table of `image_io` says."""
    exr = openexr()
    channels: dict[str, np.ndarray[Any, Any]] = {}
    for name, layer in layers.items():
        planes = layer.reshape(-1, *layer.shape[-2:])
        prefix = "" if name == "image" and len(planes) in _COLOUR else f"{name}."
        suffixes = _COLOUR.get(len(planes)) or [str(index) for index in range(len(planes))]
        for suffix, plane in zip(suffixes, planes, strict=True):
            # In any other memory order OpenEXR writes scrambled pixels.
            channels[prefix + suffix] = np.ascontiguousarray(plane, dtype=np.float32)
    exr.File({"compression": exr.ZIP_COMPRESSION, "type": exr.scanlineimage}, channels).write(file)


def read_exr(file: IO[bytes], check: Callable[[int, int, int], None]) -> np.ndarray[Any, Any]:
    """Data window of the first part, (H, W, C): RGBA, RGB, Y and A, Y or image.0 ..., the first there is."""
    exr = openexr()
    header = exr.File(file, separate_channels=True, header_only=True).header()
    names = [channel.name for channel in header["channels"]]
    (left, top), (right, bottom) = ((int(x), int(y)) for x, y in header["dataWindow"])
    check(bottom - top + 1, right - left + 1, len(names))
    numbered = [name for name in names if re.fullmatch(r"image\.\d+", name)]
    numbered.sort(key=lambda name: int(name.removeprefix("image.")))
    choices = ("RGBA", "RGB", "YYYA", "Y", numbered)
    chosen = next((choice for choice in choices if choice and set(choice) <= set(names)), None)
    if chosen is None or {"RY", "BY"} & set(names):
        raise ValueError(f"expected channels R, G, B or Y, without chroma, got {', '.join(names)}")
    file.seek(0)
    picture = exr.File(file, separate_channels=True)
    if not picture.parts:
        raise ValueError("damaged or truncated pixels")
    channels = picture.channels()
    return np.stack([channels[name].pixels for name in chosen], axis=-1)
