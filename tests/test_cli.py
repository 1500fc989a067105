"""`mcaa` as it is typed: what it writes, and that everything wrong is one line, exit status 2 and nothing else."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

import torch_mcaa as mcaa
from torch_mcaa.cli import main
from torch_mcaa.errors import McaaError
from torch_mcaa.image_io import read_image, write_picture
from torch_mcaa.scene_file import load_function
from torch_mcaa.scenes import gallery

Run = Callable[..., tuple[int, str, str]]

SCENE = '''
"""A scene with neighbours, types and a class."""
from __future__ import annotations

import dataclasses
import time
import warnings

import torch

import palette


@dataclasses.dataclass
class Disc:
    radius: float

    def __call__(self, x, y):
        return (torch.hypot(x - 8, y - 6) < self.radius).float()


def disc(x, y):
    return palette.BRIGHT * (torch.hypot(x - 8, y - 6) < 4)


def colour(x, y):
    return x / 16, y / 12, torch.full_like(x, 0.5)


def late(x, y):
    import later

    return later.f(x, y)


def one_nan(x, y):
    return torch.where(x > 3, torch.nan, x)


def failing(x, y):
    raise RuntimeError("out of\\nideas")


def number(x, y):
    return 0.5


def interrupted(x, y):
    if (x > 560).any() or (y > 20).any():
        raise KeyboardInterrupt
    return disc(x, y)


def two(x, y):
    return x / 16, y / 12


def slow(x, y):
    time.sleep(0.01)
    return disc(x, y)


def random(x, y):
    warnings.warn("of the scene's own")
    return torch.rand_like(x)


lens = Disc(4.0)
radius = 3
'''


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with scenes and pictures, the current one."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scene.py").write_text(SCENE)
    (tmp_path / "palette.py").write_text("BRIGHT = 0.75\n")
    (tmp_path / "later.py").write_text("def f(x, y):\n    return x * 0\n")
    (tmp_path / "broken.py").write_text("def f(x, y:\n")
    (tmp_path / "raising.py").write_text("raise OSError('the data is\\nnot there')\n")
    (tmp_path / "leaving.py").write_text("import sys\nsys.exit(0)\n")
    (tmp_path / "empty.py").write_text("x = 1\n")
    (tmp_path / "binary.py").write_bytes(bytes(range(256)))
    texels = torch.rand(3, 6, 8, generator=torch.Generator().manual_seed(2))
    write_picture(tmp_path / "photo.png", image=texels)
    write_picture(tmp_path / "photo.npz", image=texels)
    Image.fromarray((texels[0].numpy() * 255).astype(np.uint8)).save(tmp_path / "photo.pgm")
    (tmp_path / "cut.png").write_bytes((tmp_path / "photo.png").read_bytes()[:90])
    (tmp_path / "noise.png").write_bytes(bytes(100))
    (tmp_path / "there.png").write_bytes(b"kept")
    (tmp_path / "afolder.png").mkdir()
    return tmp_path


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """`mcaa ...` in this process: (status, standard output, standard error)."""

    def run(*arguments: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["mcaa", *arguments])
        # the command leaves the scene's folder on the path, and its neighbours among the modules
        monkeypatch.setattr(sys, "path", list(sys.path))
        for name in ("palette", "later", "mcaa_scene"):
            monkeypatch.delitem(sys.modules, name, raising=False)
        capsys.readouterr()
        with pytest.raises(SystemExit) as end:
            main()
        out, err = capsys.readouterr()
        return int(end.value.code or 0), out, err

    return run


def files(folder: Path) -> dict[str, bytes | None]:
    found = (path for path in folder.rglob("*") if "__pycache__" not in path.parts)
    return {str(path.relative_to(folder)): None if path.is_dir() else path.read_bytes() for path in found}


# --- right things


@pytest.mark.parametrize("kind", [".png", ".npz", ".npy", ".tif"])
def test_render_writes_what_render_returns(kind: str, folder: Path, run: Run) -> None:
    status, out, err = run("render", "scene.py:colour", "--size", "16x12", "--spp", "5", "-o", f"out{kind}")
    assert (status, err) == (0, "")
    assert re.fullmatch(
        rf"out{kind}: 16 x 12, 5\.0 evaluations a pixel in \d+\.\d\d s, "
        r"standard error \d\.\de-\d\d \(root mean square\), stopped by spp\n",
        out,
    )
    picture = mcaa.render(lambda x, y: (x / 16, y / 12, torch.full_like(x, 0.5)), (12, 16), spp=5)
    # half a code of 8 bits, in linear light at most 1/112
    assert float((read_image(f"out{kind}") - picture.image).abs().max()) <= (1 / 112 if kind == ".png" else 0)


def test_render_exr(folder: Path, run: Run) -> None:
    pytest.importorskip("OpenEXR", reason="OpenEXR is not installed: pip install 'torch_mcaa[exr]'")
    assert run("render", "scene.py:disc", "--size", "16x12", "-o", "out.exr")[0] == 0
    picture = mcaa.render(lambda x, y: 0.75 * (torch.hypot(x - 8, y - 6) < 4), (12, 16))
    assert torch.equal(read_image("out.exr"), picture.image)


def test_every_option_reaches_render(folder: Path, run: Run) -> None:
    status, _, err = run(
        *("render", "scene.py:disc", "-o", "out.npz", "--size", "16X12", "--spp", "64", "--filter", "mitchell:0.2,0.4"),
        *("--estimator", "shared", "--tolerance", "0.03", "--seconds", "1e4", "--extent", "0,8,0,6", "--boundary", "zero"),
        *("--nonfinite", "ignore", "--seed", "18446744073709551615"),
    )
    assert (status, err) == (0, "")
    picture = mcaa.render(
        lambda x, y: 0.75 * (torch.hypot(x - 8, y - 6) < 4),
        (12, 16),
        spp=64,
        filter=mcaa.Mitchell(0.2, 0.4),
        estimator=mcaa.Shared(),
        tolerance=0.03,
        seconds=1e4,
        extent=(0, 8, 0, 6),
        boundary="zero",
        nonfinite="ignore",
        seed=2**64 - 1,
    )
    with np.load("out.npz") as saved:
        assert np.array_equal(saved["image"], picture.numpy())
        assert np.array_equal(saved["spp"], picture.spp.numpy())


@pytest.mark.parametrize("name", ["lens", "late"])
def test_scenes_with_classes_and_late_imports(name: str, folder: Path, run: Run) -> None:
    status, _, err = run("render", f"scene.py:{name}", "--size", "16x12", "-o", "out.png")
    assert (status, err) == (0, "")


def test_a_scene_in_another_folder_and_encoding(folder: Path, run: Run) -> None:
    (folder / "deep").mkdir()
    # saved by an editor that writes a byte order mark, and by one that writes Latin-1 and says so
    (folder / "deep" / "marked.py").write_bytes(b"\xef\xbb\xbfdef f(x, y):\n    return x * 0\n")
    (folder / "deep" / "latin.py").write_bytes("# coding: latin-1\n# ä\ndef f(x, y):\n    return x * 0\n".encode("latin-1"))
    for name in ("marked", "latin"):
        assert run("render", str(folder / "deep" / f"{name}.py:f"), "--size", "4x4", "-o", f"{name}.png")[0] == 0


def test_a_scene_named_like_a_module(folder: Path, run: Run) -> None:
    """`random.py` is a likely name for a scene, and a module that others import."""
    (folder / "random.py").write_text("def f(x, y):\n    return x * 0\n")
    assert run("render", "random.py:f", "--size", "4x4", "-o", "out.png")[0] == 0
    assert sys.modules.get("random") is not None
    assert hasattr(sys.modules["random"], "getrandbits")


@pytest.mark.parametrize("photo", ["photo.png", "photo.npz", "photo.pgm"])
def test_an_image_comes_at_its_own_size(photo: str, folder: Path, run: Run) -> None:
    status, out, err = run("render", photo, "-o", "out.npz", "--filter", "box", "--interpolation", "nearest")
    assert (status, err) == (0, "")
    assert out.startswith("out.npz: 8 x 6, ")
    # nearest texels under a box of a pixel: the image itself
    assert float((read_image("out.npz") - read_image(photo)).abs().max()) < 1e-6


def test_an_image_at_another_size_covers_the_screen_once(folder: Path, run: Run) -> None:
    arguments = ("--size", "16x12", "--filter", "box", "--interpolation", "nearest")
    assert run("render", "photo.png", "-o", "out.npz", *arguments)[0] == 0
    doubled = read_image("photo.png").repeat_interleave(2, 1).repeat_interleave(2, 2)
    assert float((read_image("out.npz") - doubled).abs().max()) < 1e-6


def test_transform_maps_the_screen_to_texels(folder: Path, run: Run) -> None:
    """(x, y) -> (x + 3, y + 2), over the edge into black."""
    arguments = ("--filter", "box", "--interpolation", "nearest", "--wrap", "zeros", "--transform", "1,0,3,0,1,2,0,0,1")
    assert run("render", "photo.png", "-o", "out.npz", *arguments)[0] == 0
    expected = torch.zeros(3, 6, 8)
    expected[:, :4, :5] = read_image("photo.png")[:, 2:, 3:]
    assert float((read_image("out.npz") - expected).abs().max()) < 1e-6


def test_force_and_bits(folder: Path, run: Run) -> None:
    status, _, err = run("render", "scene.py:disc", "--size", "16x12", "-o", "there.png", "--force", "--bits", "16")
    assert (status, err) == (0, "")
    picture = mcaa.render(lambda x, y: 0.75 * (torch.hypot(x - 8, y - 6) < 4), (12, 16))
    # half a code of 16 bits, in linear light at most 1/28000
    assert float((read_image("there.png") - picture.image.clamp(0, 1)).abs().max()) < 1 / 28000


def test_what_was_not_finite_is_said(folder: Path, run: Run) -> None:
    status, _, err = run("render", "scene.py:one_nan", "--size", "8x8", "-o", "out.npz", "--nonfinite", "ignore", "--spp", "4")
    assert status == 0
    with np.load("out.npz") as saved:
        assert err == f"{saved['invalid'].sum()} evaluations were not finite\n"
        assert saved["invalid"][:, 4:].sum() == saved["spp"][:, 4:].sum()


def test_ctrl_c_writes_what_there_is(folder: Path, run: Run) -> None:
    status, out, err = run("render", "scene.py:interrupted", "--size", "640x8", "-o", "out.npz")
    assert status == 130
    assert "stopped by interrupted" in out
    assert err.startswith("mcaa: interrupted")
    assert err.count("\n") == 1
    missing = read_image("out.npz").isnan()
    assert not bool(missing[..., :512].any()) and bool(missing[..., 512:].all())


def test_ctrl_c_before_there_is_a_pixel_writes_nothing(folder: Path, run: Run) -> None:
    status, out, err = run("render", "scene.py:interrupted", "--size", "8x40", "-o", "out.npz")
    assert (status, out) == (130, "") and err == "mcaa: interrupted, before there was anything to write\n"
    assert not Path("out.npz").exists()


def test_channels_that_the_file_cannot_hold_are_told_before_the_work(folder: Path, run: Run) -> None:
    # whose pixels would take an hour
    status, _, err = run("render", "scene.py:two", "--size", "60000x60000", "-o", "out.png")
    assert status == 2 and "got 2; write .exr" in err and not Path("out.png").exists()


def test_fractions_as_the_help_writes_them(folder: Path, run: Run) -> None:
    assert run("render", "scene.py:disc", "--size", "8x8", "--filter", "mitchell:1/3,1/3", "-o", "out.npz")[0] == 0
    status, _, err = run("render", "scene.py:disc", "--size", "8x8", "--filter", "mitchell:1/3,1/0", "-o", "no.npz")
    assert status == 2 and "received '1/0'" in err


def test_scenes_of_one_name_in_two_folders(folder: Path, run: Run) -> None:
    """Each with a neighbour of the same name, too."""
    for number, name in enumerate(("one", "other")):
        Path(name).mkdir()
        Path(name, "scene.py").write_text("from helper import level\n\ndef f(x, y):\n    return x * 0 + level + (x > 4)\n")
        Path(name, "helper.py").write_text(f"level = {number}\n")
    options = ("--size", "8x8", "--budgets", "4", "--seeds", "1")
    status, _, err = run("chart", "one/scene.py:f", "other/scene.py:f", *options, "-o", "made")
    assert status == 0, err
    truths = json.loads(Path("made", "results.json").read_text())["settings"]["scenes"]
    assert list(truths) == ["one/scene.py:f", "other/scene.py:f"] and len(set(truths.values())) == 2
    levels = [load_function(f"{name}/scene.py:f")(torch.zeros(1), torch.zeros(1)).item() for name in ("one", "other")]
    assert levels == [0, 1] and "helper" not in sys.modules
    status, _, err = run("chart", "one/scene.py:f", "one/scene.py:f", *options, "-o", "twice")
    assert status == 2 and "each scene is charted once" in err


def test_no_time_writes_nothing(folder: Path, run: Run) -> None:
    status, _, err = run("render", "scene.py:disc", "--size", "8x8", "--seconds", "1e-9", "-o", "out.png")
    assert status == 2 and "no pixel had a sample" in err
    assert not Path("out.png").exists()


def test_time_that_does_not_last_is_said(folder: Path, run: Run) -> None:
    status, out, err = run("render", "scene.py:slow", "--size", "512x512", "--seconds", "0.05", "-o", "out.npz")
    assert status == 0 and "stopped by seconds" in out
    missing = int(read_image("out.npz").isnan().sum())
    assert 0 < missing < 512 * 512 and err.startswith(f"mcaa: the time was up before {missing} of 262144 pixels had a sample")


def test_warnings_are_said_in_a_line(folder: Path, run: Run) -> None:
    with pytest.warns(UserWarning, match="of the scene's own"):
        status, _, err = run("render", "scene.py:random", "--size", "32x32", "-o", "out.npz")
    assert status == 0 and err.startswith("mcaa: f is random") and err.count("\n") == 1


def test_version(folder: Path, run: Run) -> None:
    assert run("--version") == (0, f"{mcaa.__version__}\n", "")


def test_demo(folder: Path, run: Run) -> None:
    status, out, err = run("demo", "--size", "20x16", "--spp", "4", "-o", "pictures/demo")
    assert (status, err) == (0, "")
    names = sorted(gallery((16, 20)))
    pictures = sorted((folder / "pictures" / "demo").glob("*.png"))
    assert [path.stem for path in pictures] == names
    assert (folder / "pictures" / "demo" / "chart" / "chart.html").is_file()
    assert all(name in out for name in names)
    assert f"{len(names)} pictures in" in out
    for path in pictures:
        image = read_image(path)
        assert image.shape == (3, 16, 4 * 20 + 24)
    before = files(folder)
    status, _, err = run("demo", "--size", "20x16", "--spp", "4", "-o", "pictures/demo")
    assert status == 2
    assert "it exists" in err
    assert files(folder) == before
    assert run("demo", "--size", "20x16", "--spp", "4", "-o", "pictures/demo", "--force")[0] == 0


@pytest.mark.parametrize("size", ["1x1", "7x1", "3x2"])
def test_demo_of_any_size(size: str, folder: Path, run: Run) -> None:
    assert run("demo", "--size", size, "--spp", "2", "-o", "demo")[0] == 0


# --- wrong things

SIZED = ("--size", "8x8")
WRONG: dict[str, tuple[tuple[str, ...], str]] = {
    "no such file": (("render", "nowhere.py:f", "-o", "new.png"), "no file 'nowhere.py'"),
    "no name": (("render", "scene.py", "-o", "new.png"), "written file.py:function"),
    "an empty name": (("render", "scene.py:", "-o", "new.png"), "written file.py:function"),
    "no file in it": (("render", ":f", "-o", "new.png"), "written file.py:function"),
    "a folder": (("render", "afolder.png/:f", "-o", "new.png"), "no file"),
    "no such function": (("render", "scene.py:sphere", "-o", "new.png"), "no 'sphere'; it has disc, colour, late"),
    "no functions": (("render", "empty.py:f", "-o", "new.png"), "no 'f'; it has no functions"),
    "not a function": (("render", "scene.py:radius", "-o", "new.png"), "'radius' in scene.py is int, not a function"),
    "a syntax error": (("render", "broken.py:f", "-o", "new.png"), "broken.py cannot be read as Python: .*line 1"),
    "not even text": (("render", "binary.py:f", "-o", "new.png"), "binary.py cannot be read as Python"),
    "raising on import": (("render", "raising.py:f", "-o", "new.png"), "raised OSError when it was loaded: the data is not there"),
    "leaving on import": (("render", "leaving.py:f", "-o", "new.png"), "raised SystemExit when it was loaded"),
    "nan": (("render", "scene.py:one_nan", *SIZED, "-o", "new.png"), "f returned nan at x = .*nonfinite='ignore'"),
    "f raises": (("render", "scene.py:failing", *SIZED, "-o", "new.png"), "f raised RuntimeError: out of ideas"),
    "f returns a number": (("render", "scene.py:number", *SIZED, "-o", "new.png"), "got float 0.5"),
    "a class as f": (("render", "scene.py:Disc", *SIZED, "-o", "new.png"), "got the class Disc"),
    "size nonsense": (("render", "scene.py:disc", "--size", "big", "-o", "new.png"), "WIDTHxHEIGHT.*'big'"),
    "size 0x5": (("render", "scene.py:disc", "--size", "0x5", "-o", "new.png"), "WIDTHxHEIGHT.*above 0"),
    "size 5x0": (("render", "scene.py:disc", "--size", "5x0", "-o", "new.png"), "WIDTHxHEIGHT.*above 0"),
    "size -5x5": (("render", "scene.py:disc", "--size=-5x5", "-o", "new.png"), "WIDTHxHEIGHT"),
    "size 5x5x5": (("render", "scene.py:disc", "--size", "5x5x5", "-o", "new.png"), "WIDTHxHEIGHT"),
    "size 5.5x5": (("render", "scene.py:disc", "--size", "5.5x5", "-o", "new.png"), "WIDTHxHEIGHT"),
    "size with a superscript": (("render", "scene.py:disc", "--size", "²x5", "-o", "new.png"), "WIDTHxHEIGHT"),
    "size missing a side": (("render", "scene.py:disc", "--size", "512", "-o", "new.png"), "WIDTHxHEIGHT"),
    "unknown filter": (("render", "scene.py:disc", "--filter", "bos", "-o", "new.png"), "'bos'.*box, tent, gaussian"),
    "a filter's argument": (("render", "scene.py:disc", "--filter", "gaussian:wide", "-o", "new.png"), "'wide'"),
    "a filter out of range": (("render", "scene.py:disc", "--filter", "gaussian:-1", "-o", "new.png"), "Gaussian.*-1"),
    "a filter over the plane": (("render", "scene.py:disc", "--filter", "sinc", "-o", "new.png"), "boundary='zero'"),
    "unknown estimator": (
        ("render", "scene.py:disc", "--estimator", "best", "-o", "new.png"),
        "'best'.*auto, shared, jump-corrected",
    ),
    "unknown boundary": (("render", "scene.py:disc", *SIZED, "--boundary", "wrap", "-o", "new.png"), "got 'wrap'"),
    "unknown nonfinite": (("render", "scene.py:disc", *SIZED, "--nonfinite", "warn", "-o", "new.png"), "got 'warn'"),
    "spp 0": (("render", "scene.py:disc", *SIZED, "--spp", "0", "-o", "new.png"), "spp .*got 0"),
    "tolerance 0": (("render", "scene.py:disc", *SIZED, "--tolerance", "0", "-o", "new.png"), "tolerance must be above 0"),
    "tolerance nan": (("render", "scene.py:disc", *SIZED, "--tolerance", "nan", "-o", "new.png"), "tolerance .*nan"),
    "seconds -1": (("render", "scene.py:disc", *SIZED, "--seconds", "-1", "-o", "new.png"), "seconds must be above 0"),
    "seed -1": (("render", "scene.py:disc", *SIZED, "--seed", "-1", "-o", "new.png"), "seed .*got -1"),
    "extent of three": (
        ("render", "scene.py:disc", *SIZED, "--extent", "0,1,2", "-o", "new.png"),
        "--extent takes 4 numbers.*got 3",
    ),
    "extent nonsense": (("render", "scene.py:disc", *SIZED, "--extent", "a,b,c,d", "-o", "new.png"), "--extent takes 4 numbers"),
    "extent without width": (("render", "scene.py:disc", *SIZED, "--extent", "1,1,0,1", "-o", "new.png"), "x0 != x1"),
    "bits 7": (("render", "scene.py:disc", "--size", "4000x4000", "--bits", "7", "-o", "new.png"), "bits must be 8 or 16.*got 7"),
    "bits of a float format": (
        ("render", "scene.py:disc", "--size", "4000x4000", "--bits", "8", "-o", "new.npz"),
        "bits .*png only",
    ),
    "a target that cannot be, before any work": (("render", "scene.py:failing", "-o", "there.png"), "it exists"),
    "an existing target": (("render", "scene.py:disc", "-o", "there.png"), "it exists.*--force"),
    "a target in no folder": (("render", "scene.py:disc", "-o", "nowhere/new.png"), "cannot write nowhere/new.png"),
    "a target that is a folder": (("render", "scene.py:disc", "-o", "afolder.png", "--force"), "not a regular file"),
    "a target of no kind": (("render", "scene.py:disc", "-o", "new.jpg"), "unknown extension '.jpg'"),
    "a target without extension": (("render", "scene.py:disc", "-o", "new"), "unknown extension ''"),
    "no such image": (("render", "nowhere.png", "-o", "new.png"), "cannot read nowhere.png: No such file"),
    "an image that is a folder": (("render", "afolder.png", "-o", "new.png"), "cannot read afolder.png"),
    "a truncated image": (("render", "cut.png", "-o", "new.png"), "cannot read cut.png"),
    "not an image": (("render", "noise.png", "-o", "new.png"), "cannot read noise.png: not a PNG"),
    "a transform of 8": (("render", "photo.png", "--transform", "1,0,0,0,1,0,0,0", "-o", "new.png"), "takes 9 numbers.*got 8"),
    "a singular transform": (("render", "photo.png", "--transform", "1,2,3,2,4,6,0,0,1", "-o", "new.png"), "invertible"),
    "a transform of nan": (("render", "photo.png", "--transform", "nan,0,0,0,1,0,0,0,1", "-o", "new.png"), "finite"),
    "a transform of a function": (
        ("render", "scene.py:disc", "--transform", "1,0,0,0,1,0,0,0,1", "-o", "new.png"),
        "is for image files",
    ),
    "unknown interpolation": (
        ("render", "photo.png", "--interpolation", "cubic", "-o", "new.png"),
        "nearest, bilinear, bicubic.*'cubic'",
    ),
    "unknown wrap": (("render", "photo.png", "--wrap", "tile", "-o", "new.png"), "zeros, border, repeat, mirror.*'tile'"),
    "demo of size 0x5": (("demo", "--size", "0x5", "-o", "new"), "0"),
    "demo of size nonsense": (("demo", "--size", "big", "-o", "new"), "WIDTHxHEIGHT"),
    "demo of spp 0": (("demo", "--size", "8x8", "--spp", "0", "-o", "new"), "spp .*got 0"),
    "demo into a file": (("demo", "--size", "8x8", "-o", "there.png"), "folder there.png cannot be made"),
    "demo under a file": (("demo", "--size", "8x8", "-o", "there.png/new"), "cannot be made: Not a directory"),
}


@pytest.mark.parametrize("what", WRONG)
def test_wrong_things_are_one_line(what: str, folder: Path, run: Run) -> None:
    arguments, said = WRONG[what]
    before = files(folder)
    status, out, err = run(*arguments)
    assert status == 2
    assert out == ""
    assert re.fullmatch(r"mcaa: [^\n]+\n", err), err
    assert re.search(said, err), err
    assert "Traceback" not in err
    assert files(folder) == before


def test_too_many_channels_for_the_format(folder: Path, run: Run) -> None:
    (folder / "two.py").write_text("def f(x, y):\n    return x, y\n")
    before = files(folder)
    status, out, err = run("render", "two.py:f", *SIZED, "-o", "new.png")
    assert (status, out) == (2, "")
    assert re.fullmatch(r"mcaa: 8 and 16 bits hold 1, 3 .* channels, got 2; write .*\n", err), err
    assert files(folder) == before


@pytest.mark.skipif(os.geteuid() == 0 if hasattr(os, "geteuid") else True, reason="root may write everywhere")
def test_a_folder_without_permission(folder: Path, run: Run) -> None:
    (folder / "locked").mkdir(mode=0o500)
    for arguments in (("render", "scene.py:disc", "-o", "locked/new.png"), ("demo", "--size", "8x8", "-o", "locked/new")):
        status, out, err = run(*arguments)
        assert (status, out) == (2, "")
        assert re.fullmatch(r"mcaa: .*Permission denied.*\n", err)


USAGE: dict[str, tuple[tuple[str, ...], str]] = {
    "no output": (("render", "scene.py:disc"), "Missing option '--output'"),
    "no scene": (("render", "-o", "new.png"), "Missing argument"),
    "unknown option": (("render", "scene.py:disc", "-o", "new.png", "--samples", "4"), "No such option.*--samples"),
    "unknown command": (("paint",), "No such command 'paint'"),
    "spp of words": (("render", "scene.py:disc", "-o", "new.png", "--spp", "many"), "Invalid value for '--spp'"),
    "spp of fractions": (("render", "scene.py:disc", "-o", "new.png", "--spp", "2.5"), "Invalid value for '--spp'"),
    "tolerance of words": (("render", "scene.py:disc", "-o", "new.png", "--tolerance", "low"), "Invalid value for '--tolerance'"),
}


@pytest.mark.parametrize("what", USAGE)
def test_usage_errors_show_the_usage(what: str, folder: Path, run: Run) -> None:
    arguments, said = USAGE[what]
    before = files(folder)
    status, out, err = run(*arguments)
    assert (status, out) == (2, "")
    assert "Usage: " in err
    assert re.search(said, " ".join(err.replace("│", " ").split())), err
    assert "Traceback" not in err
    assert files(folder) == before


def test_help(run: Run) -> None:
    for arguments in (("--help",), ("render", "--help"), ("demo", "--help"), ("chart", "--help")):
        status, out, err = run(*arguments)
        assert (status, err) == (0, "")
        assert "Usage" in out
    status, out, err = run()
    assert "Usage" in out + err
    assert status in (0, 2)


def test_load_function(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.delitem(sys.modules, "palette", raising=False)
    f = load_function("scene.py:disc")
    assert f(torch.tensor([8.0]), torch.tensor([6.0])).tolist() == [0.75]
    with pytest.raises(McaaError, match="no file"):
        load_function("nowhere.py:f")


def test_status_and_line_of_a_real_process(folder: Path) -> None:
    command = [sys.executable, "-c", "from torch_mcaa.cli import main; main()", "render", "scene.py:sphere", "-o", "new.png"]
    where = os.pathsep.join(path for path in sys.path if path)
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, env={**os.environ, "PYTHONPATH": where})
    assert done.returncode == 2
    assert done.stdout == ""
    assert re.fullmatch(r"mcaa: scene\.py has no 'sphere'; it has .*\n", done.stderr)
    assert not (folder / "new.png").exists()
