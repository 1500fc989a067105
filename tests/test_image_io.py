from __future__ import annotations

import io
import math
import os
import stat
import struct
import subprocess
import sys
import types
import warnings
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st
from PIL import Image

import torch_mcaa.image_io as image_io
from torch_mcaa.errors import McaaError
from torch_mcaa.image_io import check_target, read_image, srgb_decode, srgb_encode, to_srgb8, write_picture
from torch_mcaa.image_io import write as write_module

NEEDS_EXR = "OpenEXR is not installed: pip install 'torch_mcaa[exr]'"
KINDS = [".png", ".exr", ".npz", ".npy", ".tif", ".tiff"]
FLOAT_KINDS = [kind for kind in KINDS if kind != ".png"]


def need(kind: str) -> None:
    if kind == ".exr":
        pytest.importorskip("OpenEXR", reason=NEEDS_EXR)


def encode(x: float) -> float:
    return 12.92 * x if x <= 0.0031308 else 1.055 * x ** (1 / 2.4) - 0.055


def decode(v: float) -> float:
    return v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4


def chunk(tag: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + tag + body + struct.pack(">I", zlib.crc32(tag + body))


def png_bytes(codes: np.ndarray[Any, Any], *, before: bytes = b"", size: tuple[int, int] | None = None) -> bytes:
    """(H, W, C) uint8 or uint16 as an unfiltered PNG, by the standard; `size` (W, H) overrides the header."""
    height, width, channels = codes.shape
    rows = np.ascontiguousarray(codes.astype(codes.dtype.newbyteorder(">"))).view(np.uint8).reshape(height, -1)
    head = struct.pack(">II", *(size or (width, height)))
    head += bytes([8 * codes.dtype.itemsize, {1: 0, 2: 4, 3: 2, 4: 6}[channels], 0, 0, 0])
    data = zlib.compress(b"".join(b"\0" + row.tobytes() for row in rows))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + before + chunk(b"IDAT", data) + chunk(b"IEND", b"")


def png_codes(path: Path) -> np.ndarray[Any, Any]:
    """A decoder written from the standard, so that no library judges itself; (H, W, C) uint8 or uint16."""
    data, at, body = path.read_bytes(), 8, b""
    width, height, depth, colour = struct.unpack(">IIBB", data[16:26])
    assert data[26:29] == b"\0\0\0"
    while at < len(data):
        length = int.from_bytes(data[at : at + 4], "big")
        tag, content = data[at + 4 : at + 8], data[at + 8 : at + 8 + length]
        assert zlib.crc32(tag + content) == int.from_bytes(data[at + 8 + length : at + 12 + length], "big")
        body += content if tag == b"IDAT" else b""
        at += 12 + length
    channels = {0: 1, 2: 3, 6: 4}[colour]
    step = channels * depth // 8
    raw, stride = zlib.decompress(body), step * width
    rows = [[0] * stride]
    for y in range(height):
        start = y * (stride + 1)
        kind, row, above = raw[start], list(raw[start + 1 : start + 1 + stride]), rows[-1]
        for x in range(stride):
            a, b, c = (row[x - step] if x >= step else 0), above[x], (above[x - step] if x >= step else 0)
            paeth = min((a, b, c), key=lambda value: abs(a + b - c - value))
            row[x] = (row[x] + (0, a, b, (a + b) // 2, paeth)[kind]) % 256
        rows.append(row)
    flat = np.array(rows[1:], dtype=np.uint8)
    return flat.view(f">u{depth // 8}").astype(f"u{depth // 8}").reshape(height, width, channels)


def picture(channels: int, height: int = 5, width: int = 7, seed: int = 0) -> torch.Tensor:
    return torch.rand(channels, height, width, generator=torch.Generator().manual_seed(seed))


# ---- the curve


@settings(deadline=None)
@given(st.floats(-2, 16))
@example(0.0031308)
@example(0.00313081)
@example(0.04045)
@example(0.040451)
def test_srgb_against_its_formula_and_back(x: float) -> None:
    linear = torch.tensor(x, dtype=torch.float64)
    encoded = srgb_encode(linear)
    # 1e-14: a few roundings of float64 at values up to 4.
    assert encoded.item() == pytest.approx(encode(x), rel=1e-14, abs=1e-300)
    assert srgb_decode(linear).item() == pytest.approx(decode(x), rel=1e-14, abs=1e-300)
    # The standard's pieces miss each other by 3.2e-8 in code, hence by 3.2e-8 / 12.92 = 2.5e-9 in light.
    near_joint = abs(x - 0.0031308) < 1e-8
    assert srgb_decode(encoded).item() == pytest.approx(x, rel=1e-13, abs=2.6e-9 if near_joint else 1e-300)


def test_srgb_fixed_points_types_and_gradient() -> None:
    for dtype in (torch.float32, torch.float64):
        ends = torch.tensor([0.0, 1.0], dtype=dtype)
        for curve in (srgb_encode, srgb_decode):
            assert curve(ends).dtype == dtype
            # 1.055 - 0.055 rounds to within one unit in the last place of 1.
            torch.testing.assert_close(curve(ends), ends, rtol=torch.finfo(dtype).eps, atol=0)
    assert srgb_encode(torch.tensor(float("nan"))).isnan()
    x = torch.tensor([-0.1, 0.0, 0.0031308, 0.5, 2.0], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(srgb_encode, (x[[0, 1, 3, 4]],))
    assert torch.autograd.gradcheck(srgb_decode, (x[[0, 1, 3, 4]],))


# ---- 8 and 16 bits


def test_every_8_bit_code_survives(tmp_path: Path) -> None:
    codes = np.arange(256, dtype=np.uint8).reshape(1, 16, 16)
    linear = torch.tensor([decode(k / 255) for k in range(256)]).reshape(1, 16, 16)
    write_picture(tmp_path / "a.png", image=linear)
    np.testing.assert_array_equal(png_codes(tmp_path / "a.png"), codes.reshape(16, 16, 1))
    assert torch.equal(read_image(tmp_path / "a.png"), linear)


def test_every_16_bit_code_survives(tmp_path: Path) -> None:
    linear = torch.tensor([decode(k / 65535) for k in range(65536)]).reshape(1, 256, 256)
    write_picture(tmp_path / "a.png", image=linear, bits=16)
    assert (tmp_path / "a.png").read_bytes()[24] == 16
    np.testing.assert_array_equal(png_codes(tmp_path / "a.png").ravel(), np.arange(65536))
    assert torch.equal(read_image(tmp_path / "a.png"), linear)


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("channels", [1, 3, 4])
def test_png_against_the_formula(tmp_path: Path, channels: int, bits: int) -> None:
    image, levels = picture(channels).double(), 2**bits - 1
    write_picture(tmp_path / "a.png", image=image, bits=bits)
    codes = png_codes(tmp_path / "a.png")
    assert codes.shape == (5, 7, channels) and codes.dtype.itemsize * 8 == bits
    for (i, j, c), code in np.ndenumerate(codes):
        value = image[c, i, j].item()
        assert code == round((value if c == 3 else encode(value)) * levels)  # round() is half to even, too
    back = read_image(tmp_path / "a.png")
    assert back.shape == image.shape and back.dtype == torch.float32 and back.is_contiguous()
    for (c, i, j), value in np.ndenumerate(back.numpy()):
        code = codes[i, j, c] / levels
        # 1e-7: one rounding to float32.
        assert value == pytest.approx(code if c == 3 else decode(code), rel=1e-7)


def test_16_bits_are_read_by_others_as_16_bits(tmp_path: Path) -> None:
    cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed; the decoder in this file has judged already")
    write_picture(tmp_path / "a.png", image=picture(3), bits=16)
    theirs = cv2.imread(str(tmp_path / "a.png"), cv2.IMREAD_UNCHANGED)[..., ::-1]
    np.testing.assert_array_equal(theirs, png_codes(tmp_path / "a.png"))


def test_8_bits_as_pillow_sees_them(tmp_path: Path) -> None:
    image = picture(4)
    write_picture(tmp_path / "a.png", image=image)
    with Image.open(tmp_path / "a.png") as theirs:
        assert theirs.mode == "RGBA"
        np.testing.assert_array_equal(np.asarray(theirs), to_srgb8(image))


def test_clipping_nan_and_half_to_even() -> None:
    colour = torch.tensor([math.nan, math.inf, -math.inf, -1.0, 7.5, 1.0, 0.0, 0.5, 0.18]).reshape(1, 3, 3)
    # 0.5 and 0.18: 255 * 0.735357 = 187.516, 255 * 0.461356 = 117.646
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # what a NaN becomes as an integer is left to the processor
        assert to_srgb8(colour).ravel().tolist() == [0, 255, 0, 0, 255, 255, 0, 188, 118]
    alpha = torch.zeros(4, 1, 5)
    alpha[3, 0] = torch.tensor([0.5 / 255, 1.5 / 255, 127.5 / 255, math.nan, 2.0])
    assert to_srgb8(alpha)[0, :, 3].tolist() == [0, 2, 128, 0, 255]


@pytest.mark.parametrize(
    "make",
    [
        lambda x: x.bool(),
        lambda x: x.double(),
        lambda x: x.half(),
        lambda x: x.bfloat16(),
        lambda x: x.clone().requires_grad_(),
        lambda x: x.numpy(),
        lambda x: x.numpy().astype(np.longdouble),
        lambda x: x.bool().numpy(),
        lambda x: x.permute(1, 2, 0).contiguous().permute(2, 0, 1),
        lambda x: x.numpy()[:, ::-1].copy()[:, ::-1],
        lambda x: np.asfortranarray(x.numpy()),
    ],
)
@pytest.mark.parametrize("kind", KINDS)
def test_types_and_memory_orders(tmp_path: Path, kind: str, make: Callable[[torch.Tensor], Any]) -> None:
    need(kind)
    image = (picture(3) > 0.5).float()  # 0 and 1 are the same in every type and on both curves
    assert 0 < image.mean() < 1
    write_picture(tmp_path / f"a{kind}", image=make(image))
    assert torch.equal(read_image(tmp_path / f"a{kind}"), image)


# ---- floats


@pytest.mark.parametrize("channels", [1, 2, 3, 4, 5, 12])
@pytest.mark.parametrize("kind", FLOAT_KINDS)
def test_floats_come_back_bit_for_bit(tmp_path: Path, kind: str, channels: int) -> None:
    need(kind)
    image = picture(channels) * 1e3 - 100
    image[0, 0, :4] = torch.tensor([math.nan, math.inf, -math.inf, 1e-42])
    write_picture(tmp_path / f"a{kind}", image=image, stderr=image + 1, spp=torch.full((5, 7), 16))
    back = read_image(tmp_path / f"a{kind}")
    assert back.dtype == torch.float32 and back.shape == image.shape
    torch.testing.assert_close(back, image, rtol=0, atol=0, equal_nan=True)


def layers(channels: int) -> dict[str, Any]:
    spp = torch.arange(35).reshape(5, 7)
    return {
        "image": picture(channels, seed=1),
        "stderr": picture(channels, seed=2),
        "spp": spp,
        "invalid": spp.int() % 2,
        "model": (spp % 3).to(torch.int8),
    }


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_exr_layers(tmp_path: Path, channels: int) -> None:
    OpenEXR = pytest.importorskip("OpenEXR", reason=NEEDS_EXR)
    given = layers(channels)
    write_picture(tmp_path / "a.exr", **given)
    found = OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True).channels()
    suffixes = {1: "Y", 2: "01", 3: "RGB", 4: "RGBA"}[channels]
    expected = {("image." if channels == 2 else "") + s: given["image"][c] for c, s in enumerate(suffixes)}
    expected |= {f"stderr.{s}": given["stderr"][c] for c, s in enumerate(suffixes)}
    expected |= {f"{name}.Y": given[name].float() for name in ("spp", "invalid", "model")}
    assert set(found) == set(expected)
    for name, plane in expected.items():
        assert found[name].pixels.dtype == np.float32
        np.testing.assert_array_equal(found[name].pixels, plane.numpy())


def test_exr_of_others(tmp_path: Path) -> None:
    OpenEXR = pytest.importorskip("OpenEXR", reason=NEEDS_EXR)
    path, planes = tmp_path / "a.exr", picture(3).numpy()
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}

    def write(channels: dict[str, Any], **more: Any) -> None:
        OpenEXR.File(header | more, channels).write(str(path))

    write({"Y": planes[0], "A": planes[1], "Z": planes[2]})
    assert torch.equal(read_image(path), torch.from_numpy(planes[[0, 0, 0, 1]]))
    write(
        {
            "R": planes[0].astype(np.float16),
            "G": planes[1].astype(np.float16),
            "B": planes[2].astype(np.float16),
        }
    )
    assert torch.equal(read_image(path), torch.from_numpy(planes).half().float())
    corners = {"dataWindow": (np.array([-3, 2], np.int32), np.array([3, 6], np.int32))}
    write({"Y": planes[0]}, **corners)
    assert torch.equal(read_image(path), torch.from_numpy(planes[:1]))
    path.write_bytes(path.read_bytes()[:-9])
    with pytest.raises(McaaError, match="damaged or truncated"):
        read_image(path)
    for channels in ({"Z": planes[0]}, {"Y": planes[0], "RY": planes[1], "BY": planes[2]}):
        write(channels)
        with pytest.raises(McaaError, match="channels"):
            read_image(path)


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_tiff_pages(tmp_path: Path, channels: int) -> None:
    import tifffile

    given = layers(channels)
    write_picture(tmp_path / "a.tif", **given)
    with tifffile.TiffFile(tmp_path / "a.tif") as file:
        assert [page.aspage().description for page in file.pages] == list(given)
        for page, (name, layer) in zip(file.pages, given.items(), strict=True):
            pixels = page.asarray()
            assert pixels.dtype == np.float32
            wanted = layer.movedim(0, -1) if name in ("image", "stderr") else layer
            np.testing.assert_array_equal(pixels.reshape(wanted.shape), wanted.float().numpy())
        rgb = {1: tifffile.PHOTOMETRIC.MINISBLACK, 2: tifffile.PHOTOMETRIC.MINISBLACK}
        assert file.pages.first.photometric == rgb.get(channels, tifffile.PHOTOMETRIC.RGB)


def test_npz_and_npy_hold_what_they_say(tmp_path: Path) -> None:
    given = layers(3)
    given["image"] = given["image"].double() / 3
    write_picture(tmp_path / "a.npz", **given)
    with np.load(tmp_path / "a.npz") as file:
        assert list(file) == list(given)
        for name, layer in given.items():
            wanted = (layer.movedim(0, -1) if layer.ndim == 3 else layer).numpy()
            assert file[name].dtype == wanted.dtype
            np.testing.assert_array_equal(file[name], wanted)
    write_picture(tmp_path / "a.npy", **given)
    np.testing.assert_array_equal(np.load(tmp_path / "a.npy"), given["image"].movedim(0, -1).numpy())


def test_layers_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    image, path = picture(3), tmp_path / "a.npz"
    refused: list[tuple[dict[str, Any], str]] = [
        ({"image": image[0]}, "shape"),
        ({"image": image[:, :0]}, "empty"),
        ({"image": image[:0]}, "empty"),
        ({"image": (image * 255).byte()}, "uint8"),
        ({"image": image.to(torch.complex64)}, "complex64"),
        ({"image": np.array([[["a"]]])}, "U1"),
        ({"image": image, "stderr": image[:1]}, "stderr"),
        ({"image": image, "spp": image}, "spp"),
        ({"image": image, "model": image[0, :, :3]}, "model"),
        ({"image": image, "invalid": image[0].to(torch.complex64)}, "invalid"),
        ({"image": image, "bits": 16}, "bits"),
    ]
    for arguments, match in refused:
        with pytest.raises(McaaError, match=match):
            write_picture(path, **arguments)
    for bits in (0, 12, 32):
        with pytest.raises(McaaError, match=str(bits)):
            write_picture(tmp_path / "a.png", image=image, bits=bits)
    for channels in (2, 5):
        with pytest.raises(McaaError, match=f"got {channels}; write .exr"):
            write_picture(tmp_path / "a.png", image=picture(channels))
        with pytest.raises(McaaError, match=f"got {channels}"):
            to_srgb8(picture(channels))
    assert list(tmp_path.iterdir()) == []


# ---- whole or not there


@pytest.mark.parametrize("old", [None, b"what lay there"])
@pytest.mark.parametrize("kind", KINDS)
def test_failed_rename_changes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str, old: bytes | None) -> None:
    need(kind)
    path = tmp_path / f"a{kind}"
    if old:
        path.write_bytes(old)

    def refuse(source: Path, target: Path) -> None:
        assert source.parent == target.parent and source.stat().st_size > 0
        raise OSError(18, "Invalid cross-device link")

    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(McaaError, match="cross-device"):
        write_picture(path, image=picture(3), force=True)
    monkeypatch.undo()
    assert [item.read_bytes() for item in tmp_path.iterdir()] == ([old] if old else [])


@pytest.mark.parametrize("failure", [OSError(28, "No space left on device"), KeyboardInterrupt(), ZeroDivisionError()])
def test_failed_encoder_changes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failure: BaseException) -> None:
    path = tmp_path / "a.npy"
    path.write_bytes(b"what lay there")

    def half(file: io.BufferedRandom, *_: Any) -> None:
        file.write(b"half a pic")
        raise failure

    monkeypatch.setitem(write_module._WRITERS, ".npy", half)
    with pytest.raises(McaaError if isinstance(failure, OSError) else type(failure)):
        write_picture(path, image=picture(3), force=True)
    assert [item.read_bytes() for item in tmp_path.iterdir()] == [b"what lay there"]


@pytest.mark.parametrize("size", [16, 64])  # a small file fails only when the encoder closes it
@pytest.mark.parametrize("kind", KINDS)
def test_full_disk_is_reported_by_every_encoder(tmp_path: Path, kind: str, size: int) -> None:
    resource = pytest.importorskip("resource", reason="no file size limits on this system")
    need(kind)
    path = tmp_path / f"a{kind}"
    path.write_bytes(b"what lay there")
    image = picture(3, size, size)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (500, hard))
    try:
        with pytest.raises(McaaError, match=r"cannot write .*nothing there was changed"):
            write_picture(path, image=image, force=True)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert [item.read_bytes() for item in tmp_path.iterdir()] == [b"what lay there"]


@pytest.mark.parametrize("kind", KINDS)
def test_force(tmp_path: Path, kind: str) -> None:
    need(kind)
    path, first, second = tmp_path / f"a{kind}", torch.zeros(3, 4, 4), torch.ones(3, 4, 4)
    write_picture(path, image=first)
    for refused in (lambda: write_picture(path, image=second), lambda: check_target(path)):
        with pytest.raises(McaaError, match=r"--force / force=True"):
            refused()
    assert torch.equal(read_image(path), first)
    assert check_target(path, force=True) == Path(os.path.realpath(path))
    write_picture(path, image=second, force=True)
    assert torch.equal(read_image(path), second)
    assert list(tmp_path.iterdir()) == [path]


def test_permissions_links_and_capitals(tmp_path: Path) -> None:
    plain, real, link = tmp_path / "plain", tmp_path / "real.png", tmp_path / "link.PNG"
    plain.touch()
    real.touch()
    link.symlink_to(real)
    write_picture(link, image=torch.ones(1, 2, 2), force=True)
    assert link.is_symlink() and read_image(real).shape == (1, 2, 2)
    assert stat.S_IMODE(real.stat().st_mode) == stat.S_IMODE(plain.stat().st_mode)


def test_targets_that_cannot_be(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "folder.png").mkdir()
    os.mkfifo(tmp_path / "pipe.png")
    refused = {
        "a.jpg": "unknown extension '.jpg'; use one of .png",
        "a": "unknown extension ''",
        ".png": "unknown extension",
        "missing/a.png": "No such file",
        "file/a.png": "Not a directory",
        "folder.png": "not a regular file",
        "pipe.png": "not a regular file",
        "x" * 300 + ".png": "too long",
        "a\0.png": "null",
    }
    before = sorted(tmp_path.iterdir())
    for name, match in refused.items():
        for attempt in (
            lambda name=name: check_target(tmp_path / name, force=True),
            lambda name=name: write_picture(tmp_path / name, image=picture(3), force=True),
        ):
            with pytest.raises(McaaError, match=match):
                attempt()
    assert sorted(tmp_path.iterdir()) == before


def test_folder_without_permission(tmp_path: Path) -> None:
    if os.geteuid() == 0:
        pytest.skip("root may write everywhere")
    tmp_path.chmod(0o555)
    with pytest.raises(McaaError, match="Permission denied"):
        check_target(tmp_path / "a.png")


def test_without_openexr_nothing_is_rendered_in_vain(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.exr").touch()
    old = types.ModuleType("OpenEXR")
    old.__dict__["__version__"] = "3.4.17"
    for module, match in ((None, r"pip install 'torch_mcaa\[exr\]'"), (old, "3.5 or later, got 3.4.17")):
        monkeypatch.setitem(sys.modules, "OpenEXR", module)
        for attempt in (lambda: check_target(tmp_path / "b.exr"), lambda: read_image(tmp_path / "a.exr")):
            with pytest.raises(McaaError, match=match):
                attempt()


# ---- reading what others wrote


def save(path: Path, picture: Image.Image, **options: Any) -> torch.Tensor:
    picture.save(path, **options)
    return read_image(path)


def test_common_formats(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    rgba = rng.integers(0, 256, (5, 7, 4), dtype=np.uint8)
    curve = np.array([decode(k / 255) for k in range(256)], dtype=np.float32)
    linear = torch.from_numpy(curve[rgba[..., :3]]).movedim(-1, 0)
    alpha = torch.from_numpy(rgba[..., 3:] / np.float32(255)).movedim(-1, 0)
    rgb, grey = Image.fromarray(rgba[..., :3].copy()), Image.fromarray(rgba[..., 0].copy())
    for name in ("a.png", "a.bmp", "a.ppm"):
        assert torch.equal(save(tmp_path / name, rgb), linear)
        assert torch.equal(save(tmp_path / name, grey), linear[:1])
    assert torch.equal(save(tmp_path / "a.png", Image.fromarray(rgba)), torch.cat((linear, alpha)))
    grey_alpha = save(tmp_path / "a.png", Image.fromarray(rgba[..., [0, 3]].copy()))
    assert torch.equal(grey_alpha, torch.cat((linear[[0, 0, 0]], alpha)))
    black_and_white = save(tmp_path / "a.png", Image.fromarray(rgba[..., 0] > 99))
    assert torch.equal(black_and_white, (linear[:1] > curve[99]).float())
    # A flat picture of one grey survives JPEG as it is.
    flat = Image.new("RGB", (16, 16), (77, 77, 77))
    assert torch.equal(save(tmp_path / "a.jpg", flat), torch.full((3, 16, 16), float(curve[77])))
    assert save(tmp_path / "a.jpg", flat.convert("L")).shape == (1, 16, 16)
    assert save(tmp_path / "a.jpg", flat.convert("CMYK")).shape == (3, 16, 16)
    (tmp_path / "content_decides.dat").write_bytes((tmp_path / "a.jpg").read_bytes())
    assert read_image(tmp_path / "content_decides.dat").shape == (3, 16, 16)


def test_palettes(tmp_path: Path) -> None:
    palette = Image.new("P", (2, 1))
    palette.putpalette([10, 20, 30, 200, 100, 50])
    palette.putpixel((1, 0), 1)
    expected = torch.tensor([[decode(v / 255) for v in pair] for pair in ((10, 200), (20, 100), (30, 50))])
    for name in ("a.png", "a.gif", "a.bmp"):
        assert torch.equal(save(tmp_path / name, palette), expected[:, None])
    keyed = save(tmp_path / "a.png", palette, transparency=1)
    assert torch.equal(keyed, torch.cat((expected[:, None], torch.tensor([[[1.0, 0.0]]]))))


def test_16_bits_of_others(tmp_path: Path) -> None:
    path, codes = tmp_path / "a.png", np.array([[[0, 1, 258], [40000, 65534, 65535]]], dtype=np.uint16)
    expected = torch.tensor([[[decode(v / 65535) for v in row]] for row in codes[0].T.tolist()])
    path.write_bytes(png_bytes(codes))
    assert torch.equal(read_image(path), expected)
    path.write_bytes(png_bytes(codes, before=chunk(b"tRNS", struct.pack(">3H", 0, 1, 258))))
    assert torch.equal(read_image(path), torch.cat((expected, torch.tensor([[[0.0, 1.0]]]))))
    path.write_bytes(png_bytes(codes[..., :1], before=chunk(b"tRNS", struct.pack(">H", 40000))))
    assert torch.equal(read_image(path), torch.cat((expected[[0, 0, 0]], torch.tensor([[[1.0, 0.0]]]))))
    path.write_bytes(png_bytes(codes[..., :2]))
    with pytest.raises(McaaError, match="save it as RGBA"):
        read_image(path)
    (tmp_path / "a.pgm").write_bytes(b"P5 2 1 65535\n" + codes[..., 2].astype(">u2").tobytes())
    assert torch.equal(read_image(tmp_path / "a.pgm"), expected[2:])
    (tmp_path / "a.pfm").write_bytes(b"Pf\n2 1\n-1.0\n" + np.array([0.5, 7], "<f4").tobytes())
    assert read_image(tmp_path / "a.pfm").tolist() == [[[0.5, 7.0]]]


def test_tiff_of_others(tmp_path: Path) -> None:
    import tifffile

    path, codes = tmp_path / "a.tif", np.array([[[0, 1, 258], [40000, 65534, 65535]]], dtype=np.uint16)
    expected = torch.tensor([[[decode(v / 65535) for v in row]] for row in codes[0].T.tolist()])
    tifffile.imwrite(path, codes, photometric="rgb", compression="zlib")
    assert torch.equal(read_image(path), expected)
    tifffile.imwrite(path, np.moveaxis(codes, -1, 0), photometric="rgb", planarconfig="separate")
    assert torch.equal(read_image(path), expected)
    tifffile.imwrite(path, np.array([[0, 51, 255]], np.uint8))
    assert torch.equal(read_image(path), torch.tensor([[[0.0, decode(0.2), 1.0]]]))
    for refused in (np.zeros((4, 4), np.int32), np.zeros((4, 4), np.complex64)):
        tifffile.imwrite(path, refused)
        with pytest.raises(McaaError, match="expected floats"):
            read_image(path)
    tifffile.imwrite(path, np.zeros((4, 4), np.uint8), photometric="miniswhite")
    with pytest.raises(McaaError, match="MINISWHITE"):
        read_image(path)


def test_arrays_of_others(tmp_path: Path) -> None:
    path = tmp_path / "a.npy"
    np.save(path, np.array([[1.5, math.nan]]))
    assert read_image(path).shape == (1, 1, 2)
    np.save(path, np.ones((2, 3, 5), bool))
    assert torch.equal(read_image(path), torch.ones(5, 2, 3))
    for refused in (
        np.zeros((2, 2), int),
        np.zeros(3),
        np.zeros((1, 1, 1, 1)),
        np.array([[None]]),
        np.zeros((0, 3)),
    ):
        np.save(path, refused)
        with pytest.raises(McaaError, match="cannot read"):
            read_image(path)
    np.savez(tmp_path / "a.npz", picture=np.zeros((2, 2)))
    with pytest.raises(McaaError, match=r"image\.npy"):
        read_image(tmp_path / "a.npz")


@pytest.mark.parametrize("kind", [".png", ".jpg", ".gif", ".bmp", ".ppm", ".webp", *FLOAT_KINDS])
def test_broken_files(tmp_path: Path, kind: str) -> None:
    need(kind)
    whole, broken = tmp_path / f"whole{kind}", tmp_path / f"broken{kind}"
    if kind in write_module._WRITERS:
        write_picture(whole, image=picture(3, 64, 64))
    else:
        Image.fromarray(to_srgb8(picture(3, 64, 64))).save(whole)
    assert read_image(whole).shape == (3, 64, 64)
    data = whole.read_bytes()
    for content in (
        b"",
        b"P",
        data[:4],
        data[:30],
        data[: len(data) // 2],
        b"just text\n" * 50,
        b"\0" * 5000,
    ):
        broken.write_bytes(content)
        with pytest.raises(McaaError, match="cannot read"):
            read_image(broken)
    for name in (f"missing{kind}", "."):
        with pytest.raises(McaaError, match=r"No such file|Is a directory"):
            read_image(tmp_path / name)


def test_truncated_16_bits(tmp_path: Path) -> None:
    write_picture(tmp_path / "a.png", image=picture(3, 32, 32), bits=16)
    data = (tmp_path / "a.png").read_bytes()
    (tmp_path / "a.png").write_bytes(data[: len(data) // 2])
    with pytest.raises(McaaError, match="cannot read"):
        read_image(tmp_path / "a.png")


# ---- sizes


@pytest.mark.parametrize("kind", KINDS)
def test_max_pixels_is_exact(tmp_path: Path, kind: str) -> None:
    need(kind)
    write_picture(tmp_path / f"a{kind}", image=torch.zeros(3, 5, 7))
    assert read_image(tmp_path / f"a{kind}", max_pixels=35).shape == (3, 5, 7)
    with pytest.raises(McaaError, match=r"7 x 5 pixels of \d channels exceed max_pixels = 34"):
        read_image(tmp_path / f"a{kind}", max_pixels=34)


def huge(kind: str, path: Path) -> bytes:
    """A small file whose header promises 2e5 by 2e5 pixels."""
    n = 200_000
    if kind in (".png", ".png16"):
        return png_bytes(np.zeros((1, 1, 3), np.uint8 if kind == ".png" else np.uint16), size=(n, n))
    if kind == ".bmp":
        return b"BM" + struct.pack("<IHHI", 54, 0, 0, 54) + struct.pack("<IiiHHIIiiII", 40, n, n, 1, 24, *[0] * 6)
    if kind == ".ppm":
        return b"P6 200000 200000 255\n"
    if kind == ".gif":
        frame = struct.pack("<4HB", 0, 0, 65535, 65535, 0) + b"\2\2\x4c\1\0"
        return b"GIF89a" + struct.pack("<2H3B", 65535, 65535, 0, 0, 0) + b"," + frame + b";"
    if kind in (".npy", ".npz"):
        array = io.BytesIO()
        np.lib.format.write_array_header_1_0(array, {"descr": "<f8", "fortran_order": False, "shape": (n, n, 3)})
        if kind == ".npy":
            return array.getvalue()
        outer = io.BytesIO()
        with zipfile.ZipFile(outer, "w") as archive:
            archive.writestr("image.npy", array.getvalue())
        return outer.getvalue()
    write_picture(path, image=torch.zeros(1, 1, 1))
    data = path.read_bytes()
    if kind == ".exr":
        at = data.index(b"dataWindow\0box2i\0") + len(b"dataWindow\0box2i\0") + 4
        return data[:at] + struct.pack("<4i", 0, 0, n - 1, n - 1) + data[at + 16 :]
    offset = int.from_bytes(data[4:8], "little")
    entries = offset + 2 + 12 * np.arange(int.from_bytes(data[offset : offset + 2], "little"))
    for entry in entries:  # tags 256 and 257: width and length, 4-byte integers
        if int.from_bytes(data[entry : entry + 2], "little") in (256, 257):
            data = data[: entry + 2] + struct.pack("<HII", 4, 1, n) + data[entry + 12 :]
    return data


@pytest.mark.parametrize("kind", [".png", ".png16", ".bmp", ".ppm", ".gif", ".npy", ".npz", ".exr", ".tif"])
def test_huge_headers_are_refused_before_decoding(tmp_path: Path, kind: str) -> None:
    need(kind)
    path = tmp_path / f"a{kind.removesuffix('16')}"
    path.write_bytes(huge(kind, path))
    # There are no pixels behind these headers: decoding would give another message, or no memory.
    with pytest.raises(McaaError, match=r"(200000 x 200000|65535 x 65535) pixels .* exceed max_pixels = 268435456"):
        read_image(path)


def test_pillows_own_limit_neither_warns_nor_refuses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_picture(tmp_path / "a.png", image=torch.zeros(3, 20, 20))
    for limit in (300, 100):  # Pillow warns above its limit and refuses above twice that
        monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", limit)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            assert read_image(tmp_path / "a.png").shape == (3, 20, 20)


def test_many_channels_count_as_pixels(tmp_path: Path) -> None:
    write_picture(tmp_path / "a.npy", image=torch.zeros(40, 2, 2))
    assert read_image(tmp_path / "a.npy", max_pixels=40).shape == (40, 2, 2)
    with pytest.raises(McaaError, match="max_pixels"):
        read_image(tmp_path / "a.npy", max_pixels=39)


def test_import_is_light() -> None:
    heavy = "{'PIL', 'tifffile', 'kornia_rs', 'kornia', 'skimage', 'imageio', 'OpenEXR'}"
    code = f"import sys, torch_mcaa.image_io; print(sorted({heavy} & set(sys.modules)))"
    root = Path(image_io.__file__).parents[2]
    done = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
