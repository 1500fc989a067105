"""The chart as a picture: for each scene error against evaluations and against seconds, reported over true error, and the exponents."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal

from torch_mcaa.charting.fit import Point
from torch_mcaa.charting.store import Store
from torch_mcaa.charting.style import GROUND, INK, styles

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Panel = Literal["evaluations", "seconds", "ratio"]
PANELS: dict[Panel, tuple[str, str]] = {
    "evaluations": ("evaluations of f a pixel", "root mean square error"),
    "seconds": ("seconds", "root mean square error"),
    "ratio": ("evaluations of f a pixel", "reported / true error"),
}
_RC: dict[Any, Any] = {
    # the same file for the same figures
    "svg.hashsalt": "torch_mcaa",
    "font.family": ["DejaVu Sans"],
    "font.size": 9.0,
    "mathtext.fontset": "dejavusans",
    **dict.fromkeys(("text.color", "axes.edgecolor", "axes.labelcolor", "xtick.color", "ytick.color"), INK),
}


def whole(points: Sequence[Point], store: Store) -> Figure:
    """All scenes, a row each, with a legend that has the exponents beside it."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    scenes = list(store.truths)
    height = 3.6 * len(scenes) + 0.75
    with rc_context(_RC):
        figure = Figure(figsize=(16.5, height))
        top, bottom = 1 - 0.5 / height, 0.55 / height
        grid = figure.add_gridspec(
            len(scenes),
            4,
            width_ratios=(1, 1, 0.85, 1.3),
            left=0.045,
            right=0.995,
            top=top,
            bottom=bottom,
            hspace=0.42,
            wspace=0.24,
        )
        for row, scene in enumerate(scenes):
            mine = [point for point in points if point.scene == scene]
            for column, panel in enumerate(PANELS):
                axes = figure.add_subplot(grid[row, column])
                draw(axes, panel, mine, store)
                if column == 0:
                    axes.set_title(_title(scene, store), loc="left", fontsize=10.5, fontweight="bold", parse_math=False)
            _legend(figure.add_subplot(grid[row, 3]), mine)
    return figure


def single(panel: Panel, points: Sequence[Point], store: Store, prefix: str) -> Figure:
    """One panel of one scene; each method's line is a group named `prefix` and its number among the methods."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context(_RC):
        # the ground is the page's
        figure = Figure(figsize=(4.6, 3.9), facecolor="none")
        axes = figure.add_axes((0.16, 0.14, 0.82, 0.835), facecolor="none")
        draw(axes, panel, points, store, prefix)
    return figure


def draw(axes: Axes, panel: Panel, points: Sequence[Point], store: Store, prefix: str = "") -> None:
    """Draw one panel; points beyond what the truth or float32 can tell are hollow."""
    axes.set_xscale("log")
    axes.set_yscale("log")
    for axis, label in zip((axes.xaxis, axes.yaxis), PANELS[panel], strict=True):
        axis.set_label_text(label)
    axes.grid(True, which="major", color=INK, alpha=0.14, linewidth=0.6)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    methods = list(dict.fromkeys(point.method for point in points))
    looks = styles(methods)
    for number, method in enumerate(methods):
        line = [point for point in points if point.method == method]
        look = looks[method]
        if panel == "ratio":
            xs = [point.evaluations for point in line if point.ratio is not None]
            ys = [point.ratio for point in line if point.ratio is not None]
        else:
            xs = [point.evaluations if panel == "evaluations" else point.seconds for point in line]
            ys = [point.rmse for point in line]
        (drawn,) = axes.plot(xs, ys, color=look.color, linestyle=look.dashes, linewidth=look.width, zorder=2 + look.width)
        hollow = [panel != "ratio" and bool(point.limit) for point in line][: len(xs)]
        artists: list[Any] = [drawn]
        for empty in (False, True):
            these = [(x, y) for x, y, h in zip(xs, ys, hollow, strict=True) if h is empty]
            artists += axes.plot(
                *zip(*these, strict=True) if these else ([], []),
                linestyle="none",
                marker=look.marker,
                color=look.color,
                markerfacecolor=GROUND if empty else look.color,
                markersize=4 + look.width,
                zorder=3 + look.width,
            )
        if panel != "ratio":
            artists += _spread(axes, panel, line, look.color)
        for artist in artists:
            artist.set_gid(f"{prefix}{number}" if prefix else None)
    if panel == "ratio":
        axes.axhspan(0.5, 2.0, color=INK, alpha=0.07, linewidth=0)
        axes.axhline(1.0, color=INK, linewidth=0.8)
        low, high = axes.get_ylim()
        axes.set_ylim(min(low, 0.4), max(high, 2.5))
        if not any(point.ratio is not None for point in points):
            axes.text(0.5, 0.62, "no standard error to compare", transform=axes.transAxes, ha="center")
    elif points:
        _band(axes, store.truths[points[0].scene].typical, [point.rmse_low for point in points])
    _ticks(axes)


def _spread(axes: Axes, panel: Panel, line: Sequence[Point], color: str) -> list[Any]:
    """From the least to the largest over the seeds."""
    x = [point.evaluations if panel == "evaluations" else point.seconds for point in line]
    kept: list[Any] = [
        axes.vlines(x, [p.rmse_low for p in line], [p.rmse_high for p in line], color=color, linewidth=0.9, alpha=0.7)
    ]
    if panel == "seconds":
        kept.append(
            axes.hlines(
                [p.rmse for p in line],
                [p.seconds_low for p in line],
                [p.seconds_high for p in line],
                color=color,
                linewidth=0.9,
                alpha=0.7,
            )
        )
    return kept


def _band(axes: Axes, typical: float, errors: Sequence[float]) -> None:
    """What lies below the truth's own error, if the errors come near it."""
    positive = [error for error in errors if error > 0]
    low = min(positive, default=typical) / 2
    if typical < low / 10:
        return
    bottom = min(low, typical / 2)
    axes.axhspan(bottom / 10, typical, color=INK, alpha=0.12, linewidth=0)
    axes.set_ylim(bottom=bottom)
    axes.text(0.99, typical, "error of the truth", transform=axes.get_yaxis_transform(), ha="right", va="top", fontsize=7.5)


def _ticks(axes: Axes) -> None:
    """Numbers on the minor ticks too, where there are few decades; plain ones where they are small."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    for axis, (low, high) in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
        few = high / low < 200
        axis.set_major_locator(LogLocator(subs=(1, 2, 5) if few and high / low < 60 else (1, 3) if few else (1,), numticks=12))
        axis.set_major_formatter(
            FuncFormatter(lambda value, _: f"{value:.0e}".replace("e-0", "e-") if value < 1e-3 else f"{value:g}")
        )
        axis.set_minor_formatter(NullFormatter())


def _title(scene: str, store: Store) -> str:
    truth = store.truths[scene]
    height, width = store.settings["size"]
    return f"{_short(scene, 48)}, {width} x {height}, truth: {'closed form' if truth.kind == 'closed form' else 'reference, its error shaded'}"


def _legend(axes: Axes, points: Sequence[Point]) -> None:
    """A line a method: sample, name, exponents against evaluations and seconds."""
    axes.set_axis_off()
    axes.set(xlim=(0, 1), ylim=(0, 1))
    last = {point.method: point for point in points}
    looks = styles(list(last))
    step = 1 / (max(14, len(last)) + 1)
    axes.text(0.6, 1 + 0.75 * step, "p of error ~ cost$^{-p}$, cost in", va="center", fontsize=8)
    for x, text in ((0.6, "evaluations"), (0.82, "seconds")):
        axes.text(x, 1 - 0.15 * step, text, va="center", fontsize=8)
    for row, (method, point) in enumerate(last.items()):
        y, look = 1 - (row + 1) * step, looks[method]
        axes.plot([-0.1, -0.06, -0.02], [y] * 3, color=look.color, linestyle=look.dashes, linewidth=look.width, clip_on=False)
        axes.plot([-0.06], [y], color=look.color, marker=look.marker, markersize=4 + look.width, clip_on=False)
        axes.text(0.0, y, _short(method, 40), va="center", fontsize=8, parse_math=False)
        axes.text(0.6, y, power(point.per_evaluation, point.per_evaluation_error), va="center", fontsize=8)
        axes.text(0.82, y, power(point.per_second, point.per_second_error), va="center", fontsize=8)


def _short(name: str, most: int) -> str:
    return name if len(name) <= most else name[: most - 1] + "…"


def power(p: float | None, error: float | None) -> str:
    """An exponent with its standard error, "–" where there is none."""
    return "–" if p is None or error is None else f"{p:.2f} ± {error:.2f}"


def svg_of(figure: Figure, text: Literal["path", "none"] = "path") -> bytes:
    """An SVG that is the same for the same figure."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    buffer = io.BytesIO()
    with rc_context({**_RC, "svg.fonttype": text}):
        FigureCanvasSVG(figure).print_svg(buffer, metadata={"Date": None, "Creator": None})
    return buffer.getvalue()


def png_of(figure: Figure) -> bytes:
    """A PNG of 128 colours, a third of the size of all of them."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image

    buffer = io.BytesIO()
    figure.set_dpi(110)
    with rc_context(_RC):
        FigureCanvasAgg(figure).print_png(buffer, metadata={"Software": None})
    small = io.BytesIO()
    Image.open(buffer).convert("RGB").quantize(128).save(small, "png", optimize=True)
    return small.getvalue()
