"""`mcaa demo`: the built-in scenes as pictures, beside their standard error and the evaluations they took."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor

from torch_mcaa.image_io import check_target, srgb_decode, write_picture
from torch_mcaa.render import render
from torch_mcaa.rendering import Rendering

_GAP = 8


def run_demo(folder: Path, size: tuple[int, int], spp: int, force: bool) -> None:
    """Render every scene of the gallery to `folder` and print a table of what it took.

    Raises:
        McaaError: a folder that cannot be made or written, or pictures that are there already, without `force`.
    """
    from rich.console import Console
    from rich.table import Table

    from torch_mcaa.errors import McaaError
    from torch_mcaa.scenes import gallery

    scenes = gallery(size)
    # refuses a wrong spp before anything is made
    render(next(iter(scenes.values())), (1, 1), spp=spp)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise McaaError(f"the folder {folder} cannot be made: {error.strerror}; name another with --output") from error
    for name in scenes:
        check_target(folder / f"{name}.png", force=force)
    table = Table("scene", "evaluations a pixel", "standard error", "seconds", title="rms standard error over the picture")
    for name, scene in scenes.items():
        picture = render(scene, size, spp=spp)
        write_picture(folder / f"{name}.png", image=side_by_side(picture), force=force)
        table.add_row(
            name,
            f"{float(picture.spp.double().mean()):.1f}",
            f"{float(picture.stderr.square().mean().sqrt()):.1e}",
            f"{picture.seconds:.2f}",
        )
    Console().print(table)
    print(
        f"{len(scenes)} pictures in {folder.resolve()}: picture, standard error (white = the largest), "
        "evaluations a pixel (white = the most)"
    )


def side_by_side(picture: Rendering) -> Tensor:
    """(3, H, 3 W + gaps): the picture, its standard error and its evaluations, each map scaled to its largest value."""
    image = torch.nan_to_num(picture.image)
    image = image / image.abs().max().clamp_min(1.0) if float(image.max()) > 4 else image
    stderr = picture.stderr.amax(0, keepdim=True).nan_to_num(posinf=0.0)
    spp = picture.spp[None].to(stderr.dtype)
    panels = [(image if len(image) == 3 else image[:1]).expand(3, -1, -1)]
    # the maps are shown as drawn, so they are taken through the curve that saving applies
    panels += [srgb_decode(_map(plane)).expand(3, -1, -1) for plane in (stderr, spp)]
    gap = torch.ones(3, image.shape[1], _GAP, dtype=image.dtype)
    return torch.cat([panels[0], gap, panels[1], gap, panels[2]], 2)


def _map(plane: Tensor) -> Tensor:
    return plane / plane.max().clamp_min(torch.finfo(plane.dtype).tiny)
