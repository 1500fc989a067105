"""The command line: `mcaa demo`, `mcaa render`, `mcaa chart`."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from torch_mcaa.errors import McaaError, McaaWarning
from torch_mcaa.scene_file import load_function

app = typer.Typer(add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False, help=__doc__)

_IMAGES = {
    ".png",
    ".jpg",
    ".jpeg",
    ".tif",
    ".tiff",
    ".exr",
    ".npy",
    ".npz",
    ".bmp",
    ".webp",
    ".gif",
    ".pbm",
    ".pgm",
    ".ppm",
    ".pnm",
}


def main() -> None:
    """Run the command line; an error of ours is one line on the standard error and exit status 2."""
    try:
        app()
    except McaaError as error:
        print(f"mcaa: {' '.join(str(error).split())}", file=sys.stderr)
        sys.exit(2)


def _version(wanted: bool) -> None:
    if wanted:
        import torch_mcaa

        print(torch_mcaa.__version__)
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[bool, typer.Option("--version", callback=_version, is_eager=True, help="print the version")] = False,
) -> None:
    pass


@app.command()
def demo(
    output: Annotated[Path, typer.Option("--output", "-o", help="the folder for the pictures")] = Path("mcaa-demo"),
    size: Annotated[str, typer.Option(help="WIDTHxHEIGHT of each picture")] = "256x256",
    spp: Annotated[int, typer.Option(help="evaluations a pixel, at most")] = 16,
    force: Annotated[bool, typer.Option("--force", help="write over pictures that are there")] = False,
) -> None:
    """Render the built-in scenes: picture, standard error and evaluations per pixel side by side."""
    from torch_mcaa.demo import run_demo

    run_demo(output, _size(size), spp, force)


@app.command()
def render(
    scene: Annotated[str, typer.Argument(help="scene.py:f, or an image file, which covers the screen once")],
    output: Annotated[Path, typer.Option("--output", "-o", help=".png, .exr, .tiff, .npz or .npy")],
    size: Annotated[str | None, typer.Option(help="WIDTHxHEIGHT in pixels; of an image, its own by default, else 512x512")] = None,
    spp: Annotated[int, typer.Option(help="evaluations a pixel, at most")] = 16,
    filter: Annotated[str, typer.Option(help="box, tent, gaussian:0.5, mitchell:1/3,1/3, lanczos:3, ...")] = "gaussian:0.5",
    estimator: Annotated[
        str,
        typer.Option(
            help="auto, shared, jump-corrected, importance, crude, stratified, adaptive-importance, control-variate or ordered-strata"
        ),
    ] = "auto",
    tolerance: Annotated[float | None, typer.Option(help="absolute error to work for")] = None,
    seconds: Annotated[float | None, typer.Option(help="wall time after which to stop")] = None,
    extent: Annotated[str | None, typer.Option(help="x0,x1,y0,y1 in the scene's coordinates")] = None,
    boundary: Annotated[str, typer.Option(help="extend, zero or renormalize")] = "extend",
    nonfinite: Annotated[str, typer.Option(help="raise, ignore or propagate")] = "raise",
    seed: Annotated[int, typer.Option()] = 0,
    bits: Annotated[int | None, typer.Option(help="8 or 16, of a PNG")] = None,
    transform: Annotated[
        str | None, typer.Option(help="9 numbers a,b,c,... row by row: screen pixels to texels of an image")
    ] = None,
    interpolation: Annotated[str | None, typer.Option(help="nearest, bilinear (the default) or bicubic, of an image")] = None,
    wrap: Annotated[str | None, typer.Option(help="zeros, border (the default), repeat or mirror, of an image")] = None,
    force: Annotated[bool, typer.Option("--force", help="write over a file that is there")] = False,
) -> None:
    """Render a user's function, or an image through a transform, to a file."""
    import torch

    from torch_mcaa import render as _render
    from torch_mcaa.filters import parse_filter
    from torch_mcaa.image_io import check_channels, check_target
    from torch_mcaa.integrand import Integrand

    check_target(output, force=force)
    if bits is not None and (bits not in (8, 16) or output.suffix.lower() != ".png"):
        raise McaaError(f"--bits must be 8 or 16, and is for .png only; got {bits} for {output}")
    w = parse_filter(filter)
    chosen = _estimator(estimator)
    if _is_image(scene):
        f, natural = _texture(scene, transform, interpolation, wrap)
        shape = natural if size is None else _size(size)
        check_channels(output, len(f.image))
    else:
        for option, given in (("transform", transform), ("interpolation", interpolation), ("wrap", wrap)):
            if given is not None:
                raise McaaError(f"--{option} is for image files, and {scene!r} is a function; do that to x and y in it")
        f, shape = load_function(scene), _size(size or "512x512")
        if output.suffix.lower() == ".png" and not isinstance(f, type):
            check_channels(output, len(Integrand(f, nonfinite="propagate")(torch.zeros(1), torch.zeros(1))))
    with warnings.catch_warnings(record=True) as said:
        # whatever filters ask for: a line each, below
        warnings.simplefilter("always", McaaWarning)
        picture = _render(
            f,
            shape,
            filter=w,
            estimator=chosen,
            spp=spp,
            tolerance=tolerance,
            seconds=seconds,
            extent=None if extent is None else _numbers(extent, 4, "--extent"),  # pyright: ignore[reportArgumentType]
            boundary=boundary,  # pyright: ignore[reportArgumentType]
            nonfinite=nonfinite,  # pyright: ignore[reportArgumentType]
            seed=seed,
        )
    if picture.stopped in ("seconds", "interrupted") and not bool(picture.spp.any()) and bool(picture.image.isnan().all()):
        if picture.stopped == "interrupted":
            print("mcaa: interrupted, before there was anything to write", file=sys.stderr)
            sys.exit(130)
        raise McaaError(f"no pixel had a sample when the time was up, and nothing is written; give more than --seconds {seconds:g}")
    picture.save(output, bits=bits, force=force)
    error = picture.stderr[picture.stderr.isfinite()]
    typical = float(error.square().mean().sqrt()) if error.numel() else float("nan")
    print(
        f"{output}: {shape[1]} x {shape[0]}, {float(picture.spp.double().mean()):.1f} evaluations a pixel "
        f"in {picture.seconds:.2f} s, standard error {typical:.1e} (root mean square), stopped by {picture.stopped}"
    )
    if int(picture.invalid.sum()):
        print(f"{int(picture.invalid.sum())} evaluations were not finite", file=sys.stderr)
    for each in said:
        if issubclass(each.category, McaaWarning):
            print(f"mcaa: {each.message}", file=sys.stderr)
        else:
            warnings.showwarning(each.message, each.category, each.filename, each.lineno)
    if picture.stopped == "interrupted":
        sys.exit(130)


@app.command()
def chart(
    scenes: Annotated[
        list[str],
        typer.Argument(
            help="scene.py:f, or the name of a built-in scene such as star or disc, of which mcaa demo draws all; one or more"
        ),
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="the folder for the chart")] = Path("mcaa-chart"),
    size: Annotated[str, typer.Option(help="WIDTHxHEIGHT in pixels")] = "256x256",
    budgets: Annotated[str, typer.Option(help="evaluations a pixel, increasing")] = "4,8,16,32,64",
    seeds: Annotated[int, typer.Option(help="how often each is measured")] = 3,
    filter: Annotated[str, typer.Option(help="as of render; gaussian:0.5,4 is cut late, for errors under 1e-6")] = "gaussian:0.5",
    extent: Annotated[str | None, typer.Option(help="x0,x1,y0,y1 in the scene's coordinates")] = None,
    force: Annotated[bool, typer.Option("--force", help="write over another chart")] = False,
) -> None:
    """Chart error against time and evaluations for every estimator, and for what one would use instead.

    Run again with the same settings, it goes on where it was interrupted.
    """
    from torch_mcaa.charting import chart as _chart
    from torch_mcaa.filters import parse_filter

    shape = _size(size)
    named = [_scene(scene, shape) for scene in scenes]
    names = [name for name, _ in named]
    # files of one name are told apart by their folders
    functions = {name if names.count(name) == 1 else place: function for place, (name, function) in zip(scenes, named, strict=True)}
    if len(functions) < len(scenes):
        raise McaaError(f"each scene is charted once, got {', '.join(scenes)}")
    try:
        made = _chart(
            functions,
            shape,
            folder=output,
            filter=parse_filter(filter),
            extent=None if extent is None else _numbers(extent, 4, "--extent"),  # pyright: ignore[reportArgumentType]
            budgets=_integers(budgets, "--budgets"),
            seeds=seeds,
            force=force,
        )
    except KeyboardInterrupt:
        print(f"mcaa: interrupted: what was measured is in {output}, and the same command goes on from there", file=sys.stderr)
        sys.exit(130)
    for name, why in made.left_out.items():
        print(f"left out: {name}: {why}", file=sys.stderr)
    print(
        f"{made.folder / 'chart.html'}: {len(made.cells)} runs of {len(made.settings['methods'])} methods; beside it chart.svg, .png and results.csv"
    )


def _scene(place: str, size: tuple[int, int]) -> tuple[str, Callable[..., Any]]:
    """A scene's name and function: built in, or `file.py:function`."""
    from torch_mcaa.scenes import gallery

    known = gallery(size)
    if place in known:
        return place, known[place]
    if ":" not in place:
        raise McaaError(f"no scene is named {place!r}; write file.py:function, or one of {', '.join(known)}")
    return Path(place).name, load_function(place)


def _is_image(scene: str) -> bool:
    return Path(scene).suffix.lower() in _IMAGES


def _texture(path: str, transform: str | None, interpolation: str | None, wrap: str | None) -> tuple[Any, tuple[int, int]]:
    import torch

    from torch_mcaa.image_io import read_image
    from torch_mcaa.texture import Texture

    image = read_image(path)
    matrix = None
    if transform is not None:
        matrix = torch.tensor(_numbers(transform, 9, "--transform"), dtype=torch.float64).reshape(3, 3)
    texture = Texture(image, interpolation or "bilinear", wrap or "border", transform=matrix)  # pyright: ignore[reportArgumentType]
    return texture, (image.shape[1], image.shape[2])


def _estimator(name: str) -> Any:
    import torch_mcaa as mcaa

    known = {
        "auto": mcaa.Auto,
        "shared": mcaa.Shared,
        "jump-corrected": mcaa.JumpCorrected,
        "importance": mcaa.Importance,
        "crude": mcaa.Crude,
        "stratified": mcaa.Stratified,
        "adaptive-importance": mcaa.AdaptiveImportance,
        "control-variate": mcaa.ControlVariate,
        "ordered-strata": mcaa.OrderedStrata,
    }
    if name not in known:
        raise McaaError(f"unknown estimator {name!r}; choose from {', '.join(known)}")
    return known[name]()


def _size(text: str) -> tuple[int, int]:
    width, _, height = text.lower().partition("x")
    if not (width.isdecimal() and height.isdecimal() and int(width) and int(height)):
        raise McaaError(f"a size is written WIDTHxHEIGHT in whole numbers above 0, for instance 1920x1080, got {text!r}")
    return int(height), int(width)


def _numbers(text: str, count: int, option: str) -> tuple[float, ...]:
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError as error:
        raise McaaError(f"{option} takes {count} numbers separated by commas, got {text!r}") from error
    if len(numbers) != count:
        raise McaaError(f"{option} takes {count} numbers separated by commas, got {len(numbers)}: {text!r}")
    return numbers


def _integers(text: str, option: str) -> tuple[int, ...]:
    parts = text.split(",")
    if not all(part.strip().isdecimal() for part in parts):
        raise McaaError(f"{option} takes whole numbers separated by commas, got {text!r}")
    return tuple(int(part) for part in parts)
