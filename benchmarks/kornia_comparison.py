"""Warps and resizing against kornia, `interpolate` and scikit-image: error, time, and a picture side by side.

`python benchmarks/kornia_comparison.py [FILE]` writes the picture. The images are those that scikit-image's own package contains. The truth
is what 1,024 samples a pixel give under the same filter for warps; for resizing, where each has a filter of its own, it is the exact mean over
each pixel, the filter of "area", and ours is shown with `Box()`, too; ours samples nothing there.
"""

from __future__ import annotations

import argparse
import statistics
import time
import warnings
from collections.abc import Callable

import kornia
import numpy as np
import skimage.data
import skimage.transform
import torch
from torch import Tensor

import torch_mcaa as mcaa

IMAGES = ("astronaut", "brick", "chelsea")


def image(name: str) -> Tensor:
    """(1, C, H, W) float32 of an image that scikit-image brings."""
    pixels = np.atleast_3d(getattr(skimage.data, name)())
    return torch.from_numpy(np.moveaxis(pixels, -1, 0) / 255.0).float()[None]


def timed(make: Callable[[], Tensor], rounds: int) -> tuple[Tensor, float]:
    """The result and the median milliseconds."""
    result, seconds = make(), []
    for _ in range(rounds):
        begin = time.perf_counter()
        make()
        seconds.append(time.perf_counter() - begin)
    return result, statistics.median(seconds) * 1e3


def plane(height: int, width: int) -> Tensor:
    """A homography (1, 3, 3) that lays an image of this size down as a floor, on 240 x 320 pixels."""
    corners = torch.tensor([[[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]]])
    laid = torch.tensor([[[110.0, 4.0], [210.0, 4.0], [330.0, 236.0], [-10.0, 236.0]]])
    return kornia.geometry.get_perspective_transform(corners, laid)


def means(image: Tensor, pixels: int) -> Tensor:
    """Of so many equal parts of each row: differences of its cumulative sums, which are linear inside a texel."""
    sums = torch.nn.functional.pad(image.cumsum(-1), (1, 0))
    places = torch.linspace(0, image.shape[-1], pixels + 1, dtype=torch.float64)
    before = places.floor().long().clamp(max=image.shape[-1] - 1)
    return torch.lerp(sums[..., before], sums[..., before + 1], places - before).diff() * pixels / image.shape[-1]


def rms(a: Tensor, b: Tensor) -> float:
    return float((a - b).square().mean().sqrt())


def warps(rounds: int) -> list[Tensor]:
    """The table of warps; the pictures of the first image by kornia and by us, and their truth."""
    size, shown = (240, 320), []
    print("| warp of | kornia | ours, 16 a pixel | ours, 64 | kornia, ms | ours, 16, ms |\n|---|---|---|---|---|---|")
    for name in IMAGES:
        src = image(name)
        M = plane(*src.shape[-2:])
        truth = mcaa.warp_perspective(src, M, size, padding_mode="border", spp=1024, seed=9)
        theirs, their_time = timed(
            lambda src=src, M=M: kornia.geometry.warp_perspective(src, M, size, padding_mode="border"), rounds
        )
        ours, our_time = timed(lambda src=src, M=M: mcaa.warp_perspective(src, M, size, padding_mode="border"), rounds)
        more = mcaa.warp_perspective(src, M, size, padding_mode="border", spp=64)
        print(
            f"| {name} | {rms(theirs, truth):.2g} | {rms(ours, truth):.2g} | {rms(more, truth):.2g} | {their_time:.1f} | {our_time:.0f} |"
        )
        if not shown:
            shown = [theirs, ours, truth]
    return shown


def resizing(rounds: int) -> list[Tensor]:
    """The table of resizing; the pictures of the brick wall."""
    size, shown = (60, 60), []
    print("\n| resized to 60 x 60 | error of the mean over each pixel | ms |\n|---|---|---|")
    for name in ("brick", "astronaut"):
        src = image(name)
        array = np.moveaxis(src[0].numpy(), 0, -1)
        truth = means(means(src.double(), size[1]).mT, size[0]).mT

        def by_skimage(array: np.ndarray = array) -> Tensor:
            resized = skimage.transform.resize(array, size, anti_aliasing=True, order=1)
            return torch.from_numpy(np.moveaxis(np.asarray(resized), -1, 0)).float()[None]

        ways: dict[str, Callable[[], Tensor]] = {
            "kornia.resize": lambda src=src: kornia.geometry.resize(src, size),
            "kornia.resize(antialias=True)": lambda src=src: kornia.geometry.resize(src, size, antialias=True),
            "interpolate(antialias=True)": lambda src=src: torch.nn.functional.interpolate(
                src, size, mode="bilinear", antialias=True
            ),
            "skimage.resize(anti_aliasing=True)": by_skimage,
            "ours, Gaussian(0.5)": lambda src=src: mcaa.resize(src, size),
            "ours, Box()": lambda src=src: mcaa.resize(src, size, "area"),
            "ours, Box(), sampled, 16 a pixel": lambda src=src: mcaa.resize(src, size, "area", estimator=mcaa.Shared()),
        }
        for way, make in ways.items():
            found, milliseconds = timed(make, rounds)
            print(f"| {name}, {way} | {rms(found, truth):.2g} | {milliseconds:.1f} |")
            if name == "astronaut":
                shown.append(found)
    return shown


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", nargs="?", default="kornia_comparison.png")
    parser.add_argument("--rounds", type=int, default=5)
    arguments = parser.parse_args()
    print(f"torch {torch.__version__}, kornia {kornia.__version__}, {torch.get_num_threads()} threads; root mean square errors\n")
    warped = torch.cat(warps(arguments.rounds), -1)[0]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        small = resizing(arguments.rounds)
    row = torch.cat([torch.nn.functional.interpolate(s, (192, 192), mode="nearest") for s in small[:5]], -1)[0]
    row = row.expand(3, -1, -1)
    sheet = torch.cat([warped, torch.nn.functional.pad(row, (0, warped.shape[-1] - row.shape[-1]))], -2)
    from PIL import Image

    Image.fromarray((sheet.clamp(0, 1) * 255).round().byte().permute(1, 2, 0).numpy()).save(arguments.file)
    print(
        f"\n{arguments.file}: above, the warped astronaut by kornia, ours at 16 samples, the truth; below, resized by kornia, kornia with "
        "antialias, interpolate, scikit-image, ours"
    )


if __name__ == "__main__":
    main()
