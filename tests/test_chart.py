"""`chart`: its figures recomputed, its truths, what it goes on from, its files, and that everything wrong is one error and no file."""

from __future__ import annotations

import base64
import csv
import json
import math
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

import torch_mcaa as mcaa
from torch_mcaa.charting import Chart, measure
from torch_mcaa.charting import truth as truths
from torch_mcaa.charting.fit import Cell, exponent, summary
from torch_mcaa.charting.instead import Grid
from torch_mcaa.charting.methods import plan
from torch_mcaa.charting.subject import Subject
from torch_mcaa.charting.truth import closed_form, reference
from torch_mcaa.cli import main
from torch_mcaa.errors import McaaError
from torch_mcaa.image_io import read_image
from torch_mcaa.scenes import Disc, Sinusoid

SIZE = (20, 24)
DISC = Disc(11.3, 9.6, 6.2)
CHOSEN = {"Shared()": mcaa.Shared(), "Importance()": mcaa.Importance()}
FILTER = mcaa.Gaussian(0.5, radius=4.0)


def ring(x: Tensor, y: Tensor) -> Tensor:
    """The disc without a closed form."""
    return DISC(x, y)


def made(folder: Path, f: Any = DISC, **changed: Any) -> Chart:
    settings: dict[str, Any] = {"filter": FILTER, "estimators": CHOSEN, "budgets": (4, 9), "seeds": 2, "progress": False}
    return mcaa.chart(f, SIZE, folder=folder, **{**settings, **changed})


def files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def values(chart: Chart) -> list[tuple[object, ...]]:
    """All of the cells but the times."""
    return sorted(
        (c.scene, c.method, c.budget, c.seed, c.evaluations, c.rmse, c.rmse_all, c.reported, c.coverage) for c in chart.cells
    )


@pytest.fixture(scope="module")
def disc(tmp_path_factory: pytest.TempPathFactory) -> Chart:
    return made(tmp_path_factory.mktemp("chart") / "new" / "folder")


# --- figures


def test_figures_are_those_of_the_pictures(disc: Chart) -> None:
    cx, cy = torch.arange(24, dtype=torch.float64) + 0.5, torch.arange(20, dtype=torch.float64) + 0.5
    exact = DISC.exact(cx[None], cy[:, None], FILTER)
    around = torch.nn.functional.pad(exact[None, None], (1,) * 4, mode="replicate")[0, 0].unfold(0, 3, 1).unfold(1, 3, 1)
    busy = around.amax((-2, -1)) - around.amin((-2, -1)) > 1e-2 * (exact.max() - exact.min())
    for name, estimator in CHOSEN.items():
        point = next(p for p in disc.points if (p.method, p.budget) == (name, 9))
        squares, reported, all_of_it, hits = [], [], [], []
        for seed in (0, 1):
            picture = mcaa.render(DISC, SIZE, filter=FILTER, estimator=estimator, spp=9, seed=seed)
            error = picture.image[0].double() - exact
            squares.append(error[busy].square().mean())
            all_of_it.append(error.square().mean())
            stderr = picture.stderr[0].double()[busy]
            reported.append((stderr.square() - picture.unseen[0].double()[busy].square()).mean())
            hits.append((error[busy].abs() <= 1.96 * stderr).double().mean())
            evaluations = picture.evaluations / 480
        rmse, seen, rmse_all = (math.sqrt(sum(map(float, part)) / 2) for part in (squares, reported, all_of_it))
        assert point.rmse == pytest.approx(rmse, rel=1e-9)
        assert point.rmse_all == pytest.approx(rmse_all, rel=1e-9)
        assert point.reported == pytest.approx(seen, rel=1e-9)
        assert point.ratio == pytest.approx(seen / rmse, rel=1e-9)
        assert point.coverage == pytest.approx(float(sum(hits)) / 2)
        assert point.evaluations == pytest.approx(evaluations)
        assert point.rmse_low <= point.rmse <= point.rmse_high
        assert 0 < point.seconds_low <= point.seconds <= point.seconds_high


def test_exponents() -> None:
    costs = [4.0, 8.0, 16.0, 32.0]
    found = exponent(costs, [3 * c**-1.5 for c in costs])
    assert found is not None
    assert found == pytest.approx((1.5, 0.0), abs=1e-7)
    # y = -x + (d, -d, -d, d) on equal steps of log 2: the slope stays, the residuals are d
    off = 0.1
    found = exponent(costs, [c**-1 * math.exp(s * off) for c, s in zip(costs, (1, -1, -1, 1), strict=True)])
    assert found == pytest.approx((1.0, math.sqrt(4 * off**2 / 2 / (5 * math.log(2) ** 2))))
    assert exponent(costs[:2], [1.0, 0.5]) is None
    assert exponent([4.0, 7.9, 5.0], [1.0, 0.5, 0.2]) is None


@pytest.mark.parametrize(("truth", "limits"), [(0.0, ["", "", "", "float32"]), (6e-3, ["", "", "truth", "truth"])])
def test_errors_that_cannot_be_told_are_left_out_of_the_fit(truth: float, limits: list[str]) -> None:
    errors = [0.1, 0.05, 0.01, 1e-7]
    cells = [Cell("s", "m", 4 * 2**i, 0, 4.0 * 2**i, 1.0 * 2**i, e, e, e, e, 1.0) for i, e in enumerate(errors)]
    points = summary(cells, {"s": (truth, 1.0)}, ["m"])
    assert [point.limit for point in points] == limits
    assert [point.ratio is None for point in points] == [bool(limit) for limit in limits]
    fitted = exponent([4.0, 8.0, 16.0], errors[:3]) if truth == 0 else None
    assert {point.per_evaluation for point in points} == {fitted and fitted[0]}


# --- truths


def test_a_closed_form_is_the_truth(disc: Chart) -> None:
    held = json.loads((disc.folder / "results.json").read_text())
    assert held["truths"]["Disc"]["kind"] == "closed form"
    assert held["truths"]["Disc"]["error"] < 1e-11
    # the tails that 5 standard deviations cut off: 1.15e-6
    found = closed_form(Subject.of("disc", DISC, SIZE, mcaa.Gaussian(0.5), None))
    assert found is not None
    assert found.typical == pytest.approx(2 * math.erfc(5 / math.sqrt(2)))
    assert closed_form(Subject.of("disc", DISC, SIZE, mcaa.Mitchell(), None)) is None
    assert closed_form(Subject.of("disc", DISC, SIZE, FILTER, (0, 12, 0, 10))) is None
    assert closed_form(Subject.of("ring", ring, SIZE, FILTER, None)) is None


def test_a_reference_is_within_its_own_error() -> None:
    subject = Subject.of("ring", ring, SIZE, FILTER, None)
    exact = closed_form(Subject.of("disc", DISC, SIZE, FILTER, None))
    found = reference(subject, 16)
    assert exact is not None
    assert found.kind == "reference"
    # a seed; the error of two shifts is told to a factor, and is not to be too small
    off = float((found.value - exact.value)[exact.busy].square().mean().sqrt())
    assert off / found.typical < 1.5
    assert 0 < found.typical < 1e-3


def test_where_estimates_disagree_the_unbiased_one_stands_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = truths._estimate
    plain: list[Tensor] = []

    def spoiled(subject: Any, estimator: Any, *rest: Any) -> tuple[Tensor, Tensor]:
        value, error = whole(subject, estimator, *rest)
        if not isinstance(estimator, mcaa.Importance):
            value[:, :16, :16] += 0.1
            return value, torch.full_like(error, 1e-6)
        plain.append(value)
        return value, error

    monkeypatch.setattr(truths, "_estimate", spoiled)
    found = reference(Subject.of("ring", ring, SIZE, FILTER, None), 16)
    assert torch.equal(found.value[:, :16, :16], plain[0][:, :16, :16])
    assert not torch.equal(found.value[:, :16, 16:], plain[0][:, :16, 16:])


def test_a_reference_is_shaded_and_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = made(tmp_path, ring)
    assert json.loads((tmp_path / "results.json").read_text())["truths"]["ring"]["kind"] == "reference"
    monkeypatch.setattr(measure, "reference", lambda *_: pytest.fail("estimated twice"))
    assert made(tmp_path, ring).points == first.points


# --- going on


def test_a_chart_goes_on_where_it_was_interrupted(tmp_path: Path, disc: Chart, monkeypatch: pytest.MonkeyPatch) -> None:
    told = 0

    def stop(_: float) -> None:
        nonlocal told
        told += 1
        if told == 8:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        made(tmp_path, progress=stop)
    kept = json.loads((tmp_path / "results.json").read_text())
    assert not kept["complete"]
    # the first was told of the truth
    assert len(kept["cells"]) == 7
    assert sorted(path.name for path in tmp_path.iterdir()) == ["measured", "results.json"]

    ran: list[tuple[str, int, int]] = []
    timed = measure._timed

    def counted(method: Any, subject: Any, budget: int, seed: int) -> Any:
        ran.append((method.name, budget, seed))
        return timed(method, subject, budget, seed)

    monkeypatch.setattr(measure, "_timed", counted)
    again = made(tmp_path)
    before = [(cell["method"], cell["budget"], cell["seed"]) for cell in kept["cells"]]
    assert len(ran) == len(again.cells) - 7
    assert not set(ran) & set(before)
    assert [vars(cell) for cell in again.cells[:7]] == kept["cells"]
    assert values(again) == values(disc)
    ran.clear()
    done = files(tmp_path)
    assert made(tmp_path).points == again.points
    assert ran == []
    # drawn anew, and the same to the byte
    assert files(tmp_path) == done


def test_ctrl_c_within_f_keeps_the_cells_before(tmp_path: Path) -> None:
    left = [10**9]

    def f(x: Tensor, y: Tensor) -> Tensor:
        left[0] -= x.numel()
        if left[0] < 0:
            raise KeyboardInterrupt
        return (x > 7.3).to(x.dtype)

    f.exact = lambda cx, cy, w: w.profile_cdf(cx - 7.3) + 0 * cy  # pyright: ignore[reportFunctionMemberAccess]
    whole = made(tmp_path / "whole", f)
    left[0] = 120_000
    with pytest.raises(KeyboardInterrupt):
        made(tmp_path / "part", f)
    kept = json.loads((tmp_path / "part" / "results.json").read_text())["cells"]
    assert 0 < len(kept) < len(whole.cells)
    left[0] = 10**9
    assert values(made(tmp_path / "part", f)) == values(whole)


@pytest.mark.parametrize(
    "changed",
    [
        {"f": Disc(11.3, 9.6, 6.3)},
        {"budgets": (4, 16)},
        {"seeds": 3},
        {"filter": mcaa.Box()},
        {"estimators": {"Shared()": mcaa.Shared(mcaa.Sobol()), "Importance()": mcaa.Importance()}},
    ],
)
def test_another_scene_or_setting_is_another_chart(changed: dict[str, Any], disc: Chart) -> None:
    before = files(disc.folder)
    changed = {"f": DISC, **changed}
    f = {"Disc": changed.pop("f")}
    with pytest.raises(McaaError, match=r"holds another chart .*name another folder, or --force"):
        made(disc.folder, f, **changed)
    assert files(disc.folder) == before


def test_force_measures_anew(tmp_path: Path, disc: Chart) -> None:
    made(tmp_path, ring)

    def stop(done: float) -> None:
        if done > 0.4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        made(tmp_path, force=True, progress=stop)
    # nothing that was drawn of the other one beside new results
    assert sorted(path.name for path in tmp_path.iterdir()) == ["measured", "results.json"]
    forced = made(tmp_path)
    assert values(forced) == values(disc)
    assert (tmp_path / "results.csv").read_text().count("ring") == 0


# --- files


def test_csv_and_json_hold_the_points(disc: Chart) -> None:
    with open(disc.folder / "results.csv", newline="") as file:
        lines = list(csv.DictReader(file))
    held = json.loads((disc.folder / "results.json").read_text())
    assert held["complete"]
    assert len(lines) == len(held["summary"]) == len(disc.points) == 2 * 2 + 3 * 2
    for line, point, kept in zip(lines, disc.points, held["summary"], strict=True):
        assert kept == vars(point)
        for name, value in vars(point).items():
            assert line[name] == ("" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value))
    assert {"torch", "threads", "device", "processor"} <= set(held["settings"])
    assert str(disc.folder) not in json.dumps(held)


def test_pictures_of_the_chart(disc: Chart) -> None:
    assert read_image(disc.folder / "chart.png").shape[0] >= 3
    svg = (disc.folder / "chart.svg").read_text()
    assert svg.rstrip().endswith("</svg>")
    assert "dc:date" not in svg
    maps = sorted(path.name for path in (disc.folder / "measured" / "disc").iterdir())
    assert len(maps) == 3 * len(disc.points)
    shown = read_image(disc.folder / "measured" / "disc" / "shared-9-picture.png")
    picture = mcaa.render(DISC, SIZE, filter=FILTER, estimator=mcaa.Shared(), spp=9)
    assert float((shown - picture.image.clamp(0, 1)).abs().max()) <= 1 / 112


def test_the_page_asks_for_nothing(disc: Chart) -> None:
    page = (disc.folder / "chart.html").read_text()
    assert "{{" not in page
    markup = re.sub(r"<script.*?</script>", "", page, flags=re.DOTALL)
    references = re.findall(r"""(?:src|href|data|action|srcset)\s*=\s*["']?([^"'\s>]+)""", markup) + re.findall(
        r"url\(([^)]*)\)", markup
    )
    assert references
    assert all(reference.startswith(("#", "data:")) for reference in references)
    assert not re.search(r"https?://|@import|fetch\(|XMLHttpRequest", page)
    names = re.findall(r'\sid="([^"]+)"', page)
    drawn = [name for name in names if not re.fullmatch(r"s\d+[a-z]-m\d+", name)]
    assert len(set(drawn)) == len(drawn)


BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None)
SCRIPT = """<script>
const set = (name, value, event) => { const e = document.querySelector(name); e.value = value; e.dispatchEvent(new Event(event)); };
set(".seam-at", 250, "input"); set(".kind", 1, "change"); set(".left", 2, "change"); set(".budget", 0, "change");
document.querySelector("tr[data-method='1']").focus();
</script>"""


@pytest.mark.skipif(BROWSER is None, reason="no Chromium or Chrome on the path to try the page in")
def test_the_page_in_a_browser(disc: Chart, tmp_path: Path) -> None:
    page = (disc.folder / "chart.html").read_text().replace("</body>", f"{SCRIPT}</body>")
    (tmp_path / "page.html").write_text(page)
    command = [str(BROWSER), "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}"]
    command += ["--virtual-time-budget=2000", "--dump-dom", (tmp_path / "page.html").as_uri()]
    dom = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120).stdout
    over = re.search(r'<img class="over"[^>]*>', dom)
    assert over is not None
    assert "inset(0px 75% 0px 0px)" in over[0]
    assert "alt=\"left: grid, kornia's blur" in over[0] or "left: grid, kornia" in over[0]
    # the error of the grid at the smallest budget
    error = (disc.folder / "measured" / "disc" / "grid--kornia-s-blur--every-k-th-4-error.png").read_bytes()
    assert base64.b64encode(error).decode() in over[0]
    assert re.search(r'<div class="scale">', dom)
    dimmed = re.findall(r'<g id="s0[a-z]-m(\d+)" class="dim"', dom)
    assert dimmed
    assert "1" not in dimmed


# --- what one would use instead


def test_budgets_of_one_grid_are_run_once() -> None:
    assert plan([Grid("blur")], (2, 4, 8, 16, 32)) == {Grid("blur").name: [4, 16, 32]}


@pytest.mark.parametrize("way", ["blur", "stride"])
def test_grids_filter_with_the_filter(way: Any) -> None:
    tone = Sinusoid(0.11, 0.07, 0.3)
    subject = Subject.of("tone", tone, SIZE, FILTER, None)
    exact = closed_form(subject)
    shot = Grid(way).run(subject, 64, 0)
    assert exact is not None
    assert float((shot.image - exact.value).abs().max()) < 1e-6
    assert shot.evaluations >= 64 * 480
    # of an extent the same, in other units
    half = Subject.of("tone", Sinusoid(0.22, 0.14, 0.3), SIZE, FILTER, (0, 12, 0, 10))
    assert float((Grid(way).run(half, 64, 0).image - exact.value).abs().max()) < 1e-5


def test_interpolate_is_a_tent() -> None:
    subject = Subject.of("tone", Sinusoid(0.11, 0.0, 0.3), SIZE, mcaa.Tent(), None)
    cx = torch.arange(24, dtype=torch.float64) + 0.5
    response = (math.sin(math.pi * 0.11) / (math.pi * 0.11)) ** 2
    tent = 0.5 + 0.5 * response * torch.cos(2 * math.pi * 0.11 * cx + 0.3)
    # a sum over 2 x 8 points for the integral
    assert float((Grid("resize").run(subject, 64, 0).image[0] - tent).abs().max()) < 2e-3


def test_what_a_method_cannot_do_is_left_out(tmp_path: Path) -> None:
    chart = made(
        tmp_path,
        estimators={"Crude()": mcaa.Crude(), "Shared()": mcaa.Shared(), "Optimal": mcaa.AdaptiveImportance()},
        budgets=(4,),
    )
    assert "biased" in chart.left_out["Crude()"]
    assert "needs more than 4" in chart.left_out["Optimal"]
    assert "Left out" in (tmp_path / "chart.html").read_text()
    with pytest.raises(McaaError, match="no method can make this chart"):
        made(tmp_path / "none", estimators={"Crude()": mcaa.Crude()}, budgets=(3,))
    assert not (tmp_path / "none").exists()


# --- wrong things

Function = Callable[[Tensor, Tensor], Any]


def failing(x: Tensor, y: Tensor) -> Tensor:
    raise RuntimeError("out of ideas")


def one_nan(x: Tensor, y: Tensor) -> Tensor:
    return torch.where(x > 3, torch.nan, x)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"f": failing}, "f raised RuntimeError: out of ideas"),
        ({"f": one_nan}, "f returned nan at x = "),
        ({"f": lambda x, y: 0.5}, "f must return a tensor"),
        ({"f": 3}, "f must be a function"),
        ({"f": {}}, "at least one"),
        ({"f": {"a b": DISC, "a-b": DISC}}, "must differ.*rename one"),
        ({"f": {1: DISC}}, r"the names \[1\]; name them with strings"),
        ({"estimators": {"Auto": "auto"}}, "estimators must map names to estimators"),
        ({"estimators": {"A()": mcaa.Auto(), "a": mcaa.Shared()}}, "must differ.*rename one"),
        ({"budgets": (4, 4)}, r"budgets must be increasing integers above 0, got \(4, 4\)"),
        ({"budgets": (16, 4)}, "budgets must be increasing"),
        ({"budgets": (0, 4)}, "budgets must be increasing"),
        ({"budgets": ()}, "budgets must be increasing"),
        ({"budgets": 4}, "budgets must be increasing"),
        ({"budgets": (4, 10**6)}, "the grids hold all evaluations at once"),
        ({"seeds": 0}, "seeds must be an integer of at least 1, got 0"),
        ({"filter": "box"}, "filter must be a filter"),
        ({"extent": (0, 0, 0, 1)}, "extent must be finite"),
    ],
)
def test_wrong_things_leave_nothing(changed: dict[str, Any], said: str, tmp_path: Path) -> None:
    with pytest.raises(McaaError, match=said):
        made(tmp_path / "new", **{"f": DISC, **changed})
    assert not (tmp_path / "new").exists()


def test_a_closed_form_that_fails(tmp_path: Path) -> None:
    def f(x: Tensor, y: Tensor) -> Tensor:
        return x

    f.exact = lambda cx, cy, w: torch.zeros(3)  # pyright: ignore[reportFunctionMemberAccess]
    with pytest.raises(McaaError, match=r"f\.exact\(cx, cy, filter\) must return 1 channels .*raised RuntimeError.*mend it"):
        made(tmp_path / "new", f)
    assert not (tmp_path / "new").exists()


def test_a_closed_form_of_one_number(tmp_path: Path) -> None:
    def f(x: Tensor, y: Tensor) -> Tensor:
        return torch.full_like(x, 0.25)

    f.exact = lambda cx, cy, w: 0.25  # pyright: ignore[reportFunctionMemberAccess]
    chart = made(tmp_path, f, estimators={"Shared()": mcaa.Shared()}, budgets=(4,), seeds=1)
    assert all(point.rmse < 1e-6 for point in chart.points)


def test_a_folder_that_is_no_path() -> None:
    with pytest.raises(McaaError, match="folder must be a path, got 3"):
        mcaa.chart(ring, (4, 4), folder=3)  # pyright: ignore[reportArgumentType]


def test_names_that_matplotlib_would_take_for_formulas(tmp_path: Path) -> None:
    name = "$\\foo{$ " + 60 * "long"
    chart = made(tmp_path, {name: DISC}, estimators={"$\\bar{$": mcaa.Shared()}, budgets=(4,), seeds=1)
    assert chart.points[0].scene == name and (tmp_path / "chart.png").is_file()


def test_a_size_of_nothing(tmp_path: Path) -> None:
    with pytest.raises(McaaError, match="at least one pixel"):
        mcaa.chart(ring, (0, 4), folder=tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_folders_that_cannot_be_used(tmp_path: Path, disc: Chart) -> None:
    (tmp_path / "file").write_text("kept")
    with pytest.raises(McaaError, match="cannot be written: .*not a folder; name another"):
        made(tmp_path / "file" / "new")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "chart.svg").write_text("mine")
    with pytest.raises(McaaError, match=r"has chart\.svg and no results\.json"):
        made(tmp_path / "mine")
    (tmp_path / "cut").mkdir()
    (tmp_path / "cut" / "results.json").write_bytes((disc.folder / "results.json").read_bytes()[:200])
    with pytest.raises(McaaError, match="cannot be read as a chart"):
        made(tmp_path / "cut")
    assert files(tmp_path).keys() == {"file", "mine/chart.svg", "cut/results.json"}
    assert (tmp_path / "mine" / "chart.svg").read_text() == "mine"


def test_three_channels(tmp_path: Path) -> None:
    def f(x: Tensor, y: Tensor) -> tuple[Tensor, ...]:
        return x / 24, y / 20, (x > 9.4).to(x.dtype)

    chart = made(tmp_path, f, estimators={"Shared()": mcaa.Shared()}, budgets=(4,), seeds=1)
    assert read_image(tmp_path / "measured" / "f" / "shared-4-picture.png").shape == (3, *SIZE)
    assert all(0 < point.rmse < 0.1 for point in chart.points)


# --- the command


def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    monkeypatch.setattr(sys, "argv", ["mcaa", "chart", *arguments])
    monkeypatch.setattr(sys, "path", list(sys.path))
    with pytest.raises(SystemExit) as end:
        main()
    return int(end.value.code or 0), *capsys.readouterr()


def test_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    Path("scene.py").write_text("def f(x, y):\n    return (x + 0.3 * y < 9.1).float()\n")
    where = ("--size", "12x16", "--budgets", "4,9", "--seeds", "1", "--filter", "box", "--extent", "0,24,0,32", "-o", "out")
    status, out, err = run(monkeypatch, capsys, "scene.py:f", *where)
    assert status == 0
    assert re.fullmatch(r"out/chart\.html: \d+ runs of 14 methods; beside it .*\n", out)
    assert err == ""
    held = json.loads(Path("out/results.json").read_text())
    assert (
        held["settings"] | {"size": [16, 12], "filter": "Box(width=1.0)", "extent": [0, 24, 0, 32], "budgets": [4, 9], "seeds": 1}
        == (held["settings"])
    )
    assert list(held["truths"]) == ["scene.py:f"]
    # a changed file is another chart
    Path("scene.py").write_text("def f(x, y):\n    return (x + 0.3 * y < 9.2).float()\n")
    status, out, err = run(monkeypatch, capsys, "scene.py:f", *where)
    assert (status, out) == (2, "")
    assert re.fullmatch(r"mcaa: out holds another chart [^\n]*\n", err)


def test_the_command_interrupted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    timed = measure._timed
    monkeypatch.setattr(measure, "_timed", lambda *a: exec("raise KeyboardInterrupt") if a[3] else timed(*a))
    where = ("star", "blob", "--size", "8x8", "--budgets", "4", "--seeds", "2", "-o", "out")
    status, out, err = run(monkeypatch, capsys, *where)
    assert (status, out) == (130, "")
    assert err == "mcaa: interrupted: what was measured is in out, and the same command goes on from there\n"
    monkeypatch.undo()
    monkeypatch.chdir(tmp_path)
    assert run(monkeypatch, capsys, *where)[0] == 0


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("starr",), r"no scene is named 'starr'; write file.py:function, or one of .*star, "),
        (("nowhere.py:f",), "there is no file 'nowhere.py'"),
        (("star", "--size", "0x4"), "whole numbers above 0"),
        (("star", "--budgets", "4,few"), "--budgets takes whole numbers"),
        (("star", "--budgets", "4,2"), "increasing"),
        (("star", "--filter", "bax"), "no filter is named"),
    ],
)
def test_wrong_commands(
    arguments: tuple[str, ...], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    status, out, err = run(monkeypatch, capsys, *arguments)
    assert (status, out) == (2, "")
    assert re.fullmatch(r"mcaa: [^\n]+\n", err)
    assert re.search(said, err)
    assert not list(tmp_path.iterdir())


def test_drawing_changes_no_settings_and_needs_no_pyplot(tmp_path: Path) -> None:
    program = f"""
import sys, matplotlib
before = matplotlib.rcParams.copy()
import torch_mcaa as mcaa
mcaa.chart(lambda x, y: (x < 3.3).float(), (6, 6), folder={str(tmp_path)!r}, estimators={{"Shared()": mcaa.Shared()}}, budgets=(4,), seeds=1)
assert matplotlib.rcParams.copy() == before
assert "matplotlib.pyplot" not in sys.modules
"""
    subprocess.run(
        [sys.executable, "-W", "error", "-c", program], check=True, env={"PYTHONPATH": ":".join(sys.path), "HOME": str(tmp_path)}
    )


def test_the_readme_quotes_the_lines_of_its_chart() -> None:
    """`4.4e-3 in 0.089 s (line 62)`: error and seconds are those of line 62 of docs/chart.csv."""
    root = Path(__file__).parents[1]
    readme = (root / "README.md").read_text(encoding="utf-8")
    with open(root / "docs" / "chart.csv", newline="", encoding="utf-8") as file:
        lines = [{}, *csv.DictReader(file)]
    quoted = re.findall(r"(\d\.\de-\d+) in (\d[\d.]*) s \(line (\d+)\)", readme)
    assert len(quoted) >= 4
    for error, seconds, number in quoted:
        line = lines[int(number) - 1]
        assert f"{float(line['rmse']):.1e}".replace("e-0", "e-") == error
        assert f"{float(line['seconds']):.2g}" == seconds
