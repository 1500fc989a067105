"""The chart as one page that needs no network: charts, tables, and pictures to compare by wiping one over the other."""

from __future__ import annotations

import base64
import html
import json
import re
from collections.abc import Sequence
from importlib.resources import files

from torch_mcaa.charting.drawing import PANELS, power, single, svg_of
from torch_mcaa.charting.fit import Point
from torch_mcaa.charting.maps import BEYOND, DECADES, SIDE, scale
from torch_mcaa.charting.store import Store
from torch_mcaa.charting.style import GLYPHS, GROUND, INK, styles
from torch_mcaa.charting.truth import Truth

KINDS = ("picture", "error", "evaluations")


def page(points: Sequence[Point], store: Store, left_out: dict[str, str]) -> str:
    """The text of chart.html."""
    scenes = list(store.truths)
    settings = store.settings
    height, width = settings["size"]
    facts = (
        f"{width} × {height} pixels, {settings['filter']}, {settings['seeds']} seed(s); torch_mcaa {settings['torch_mcaa']}, "
        f"torch {settings['torch']}, {settings['threads']} thread(s), {settings['processor']}"
    )
    parts = [
        _scene(number, scene, [point for point in points if point.scene == scene], store) for number, scene in enumerate(scenes)
    ]
    omitted = "".join(f"<li>{html.escape(name)}: {html.escape(why)}</li>" for name, why in left_out.items())
    fields = {
        "TITLE": html.escape(", ".join(scenes)),
        "FACTS": html.escape(facts),
        "SCENES": "".join(parts),
        "OMITTED": f"<p>Left out:</p><ul>{omitted}</ul>" if omitted else "",
        "DATA": json.dumps({"scenes": [_pictures(scene, points, store) for scene in scenes]}).replace("<", "\\u003c"),
    }
    text = files("torch_mcaa.charting").joinpath("page.html").read_text(encoding="utf-8")
    # in one pass, so that nothing in a field is taken for another
    return re.sub(r"\{\{([A-Z]+)\}\}", lambda match: fields[match[1]], text)


def _scene(number: int, scene: str, points: Sequence[Point], store: Store) -> str:
    truth = store.truths[scene]
    panels = []
    for panel, (x, y) in PANELS.items():
        prefix = f"s{number}{panel[0]}"
        drawn = svg_of(single(panel, points, store, f"{prefix}-m"), "none").decode()
        panels.append(f"<figure>{_inlined(drawn, prefix, f'{scene}: {y} against {x}')}</figure>")
    return (
        f"<section><h2>{html.escape(scene)}</h2><p>Truth: {html.escape(truth.how)}. Its error, root mean square: {truth.typical:.1e}; "
        f"range of the values {truth.span:.3g}; {int(truth.busy.sum())} of {truth.busy.numel()} pixels are not flat.</p>"
        f'<div class="panels">{"".join(panels)}</div>{_table(number, points, truth)}{_wipe(number, points)}</section>'
    )


def _inlined(svg: str, prefix: str, label: str) -> str:
    """An SVG within the page: names of its own, its ink the page's, a label for those who do not see it."""
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = re.sub(r'(\bid="|url\(#|href="#)(?!s\d+[a-z]-m)', rf"\g<1>{prefix}-", svg)
    svg = svg.replace(INK, "currentColor").replace(GROUND, "var(--ground)").replace("xlink:href", "href")
    svg = re.sub(r'\s(width|height)="[\d.]+pt"', "", svg, count=2)
    svg = re.sub(r' xmlns(:xlink)?="[^"]*"', "", svg)
    return svg.replace("<svg", f'<svg role="img" aria-label="{html.escape(label)}"', 1)


def _error(point: Point, truth: Truth) -> str:
    """Nothing is claimed below the truth's own error."""
    return f"≤ {max(point.rmse, truth.typical):.1e}" if point.limit == "truth" else f"{'≤ ' if point.limit else ''}{point.rmse:.2e}"


def _table(number: int, points: Sequence[Point], truth: Truth) -> str:
    methods = list(dict.fromkeys(point.method for point in points))
    looks = styles(methods)
    heads = (
        *("method", "evaluations a pixel", "seconds", "error", "over the seeds", "over all pixels", "reported / true", "covered"),
        *("error ~ evaluations<sup>−p</sup>", "error ~ seconds<sup>−p</sup>"),
    )
    rows = []
    for index, method in enumerate(methods):
        point = [point for point in points if point.method == method][-1]
        look = looks[method]
        dash = {"-": "", "--": ' stroke-dasharray="7 3"', ":": ' stroke-dasharray="2 3"'}[look.dashes]
        color = look.color.replace(INK, "currentColor")
        swatch = (
            f'<svg class="swatch" viewBox="0 0 36 12" aria-hidden="true"><path d="M1 6H35" stroke="{color}" '
            f'stroke-width="{look.width:.1f}"{dash}/><text x="18" y="6" fill="{color}">{GLYPHS[look.marker]}</text></svg>'
        )
        cells = (
            *(f"{point.evaluations:.1f}", f"{point.seconds:.3g}", _error(point, truth)),
            *(("–", "–") if point.limit else (f"{point.rmse_low:.1e} to {point.rmse_high:.1e}", f"{point.rmse_all:.2e}")),
            "–" if point.ratio is None else f"{point.ratio:.2f}",
            "–" if point.coverage is None else f"{100 * point.coverage:.0f} %",
            power(point.per_evaluation, point.per_evaluation_error),
            power(point.per_second, point.per_second_error),
        )
        rows.append(
            f'<tr tabindex="0" data-scene="{number}" data-method="{index}"><th scope="row">{swatch} {html.escape(method)}</th>'
            f"{''.join(f'<td>{cell}</td>' for cell in cells)}</tr>"
        )
    return (
        f'<div class="wide"><table><caption>At the largest budget</caption><thead><tr>{"".join(f"<th scope=col>{head}</th>" for head in heads)}'
        f"</tr></thead><tbody>{''.join(rows)}</tbody></table></div>"
    )


def _wipe(number: int, points: Sequence[Point]) -> str:
    """Controls and frame; the script of the page fills them."""
    methods = list(dict.fromkeys(point.method for point in points))
    budgets = sorted({point.budget for point in points})
    left = next((i for i, method in enumerate(methods) if method.startswith("grid")), 0)

    def options(names: Sequence[object], chosen: int) -> str:
        return "".join(
            f'<option value="{i}"{" selected" if i == chosen else ""}>{html.escape(str(name))}</option>'
            for i, name in enumerate(names)
        )

    return f"""<div class="wipe" data-scene="{number}">
<div class="controls">
<label>left <select class="left">{options(methods, left)}</select></label>
<label>right <select class="right">{options(methods, 0)}</select></label>
<label>budget <select class="budget">{options(budgets, len(budgets) // 2)}</select></label>
<label>show <select class="kind">{options(("picture", "error", "evaluations in each pixel"), 0)}</select></label>
</div>
<div class="frame"><img class="under" alt=""><img class="over" alt=""><div class="seam"></div></div>
<input class="seam-at" type="range" min="0" max="1000" value="500" aria-label="where the left picture ends">
<p class="captions"><span class="left-said"></span><span class="right-said"></span></p>
<div class="scale" hidden><div class="ramp"></div><p class="captions"><span class="low"></span><span class="high"></span></p></div>
</div>"""


def _pictures(scene: str, points: Sequence[Point], store: Store) -> dict[str, object]:
    """What the script shows: for each method its budgets, each with the three pictures and what it came to."""
    mine = [point for point in points if point.scene == scene]
    methods: dict[str, list[dict[str, object]]] = {}
    for point in mine:
        images = [_data(store, scene, point, kind) for kind in KINDS]
        said = f"{point.method}: {point.evaluations:.1f} evaluations a pixel, {point.seconds:.3g} s, error {_error(point, store.truths[scene])}"
        methods.setdefault(point.method, []).append({"budget": point.budget, "images": images, "said": said})
    most = max(point.budget for point in mine)
    return {
        "methods": list(methods.values()),
        "budgets": sorted({point.budget for point in mine}),
        "scales": [
            None,
            {"colors": scale("magma"), "low": f"1e-{DECADES} of the range or less", "high": "the range of the values"},
            {"colors": scale("viridis"), "low": "1", "high": f"{BEYOND * most} or more"},
        ],
        "side": SIDE,
    }


def _data(store: Store, scene: str, point: Point, kind: str) -> str:
    content = (store.folder / store.picture_file(scene, point.method, point.budget, kind)).read_bytes()
    return f"data:image/png;base64,{base64.b64encode(content).decode()}"
