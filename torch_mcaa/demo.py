"""`mcaa demo`: the built-in scenes as pictures, beside their standard error, the evaluations they took and what was used; and a chart."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor

from torch_mcaa.image_io import check_target, srgb_decode, write_picture
from torch_mcaa.render import render
from torch_mcaa.rendering import Rendering

_GAP = 8
_CHARTED = ("Auto()", "Shared(Lattice())", "Importance(Sobol())")
_CHART_SIDE = 64
_COLORS = ((0.0, 0.0, 0.0), (0.2, 0.45, 1.0), (0.2, 1.0, 0.9), (0.9, 0.25, 0.2), (1.0, 0.7, 0.2), (1.0, 1.0, 1.0), (0.7, 0.4, 1.0))
"""Of the models of `Auto`, in their order."""


def run_demo(folder: Path, size: tuple[int, int], spp: int, force: bool) -> None:
    """Render every scene of the gallery to `folder`, print a table of what it took, and chart the star, small and with few methods.

    Raises:
        McaaError: a folder that cannot be made or written, or pictures that are there already, without `force`.
    """
    from rich.console import Console
    from rich.table import Table

    from torch_mcaa.charting import chart
    from torch_mcaa.charting.methods import ESTIMATORS
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
    small = (min(size[0], _CHART_SIDE), min(size[1], _CHART_SIDE))
    chosen = {name: ESTIMATORS[name] for name in _CHARTED}
    chart({"star": gallery(small)["star"]}, small, folder=folder / "chart", estimators=chosen, seeds=1, force=force)
    Console().print(table)
    print(
        f"{len(scenes)} pictures in {folder.resolve()}: picture, standard error (white = the largest), "
        "evaluations a pixel (white = the most), and what was used: black a lattice, blue jumps located, cyan on a finer lattice, "
        "red more samples where there are no jumps to locate, orange where there are too many; error against cost in chart/chart.html"
    )


def side_by_side(picture: Rendering) -> Tensor:
    """(3, H, 4 W + gaps): the picture, its standard error and its evaluations, each scaled to its largest value, and `Rendering.model`."""
    image = torch.nan_to_num(picture.image)
    image = image / image.abs().max().clamp_min(1.0) if float(image.max()) > 4 else image
    stderr = picture.stderr.amax(0, keepdim=True).nan_to_num(posinf=0.0)
    spp = picture.spp[None].to(stderr.dtype)
    panels = [(image if len(image) == 3 else image[:1]).expand(3, -1, -1)]
    # the maps are shown as drawn, so they are taken through the curve that saving applies
    panels += [srgb_decode(_map(plane)).expand(3, -1, -1) for plane in (stderr, spp)]
    colors = torch.tensor(_COLORS, dtype=image.dtype)
    panels.append(srgb_decode(colors[picture.model.long().cpu() % len(colors)].movedim(-1, 0)))
    gap = torch.ones(3, image.shape[1], _GAP, dtype=image.dtype)
    return torch.cat([part for panel in panels for part in (gap, panel)][1:], 2)


def _map(plane: Tensor) -> Tensor:
    return plane / plane.max().clamp_min(torch.finfo(plane.dtype).tiny)
