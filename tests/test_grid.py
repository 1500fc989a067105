"""The screen: (21)-(24) of Halton's paper, cells, and how finely far pixels are sampled."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from torch import Tensor

import torch_mcaa as mcaa
from torch_mcaa.errors import McaaError
from torch_mcaa.grid import Cell, Screen

EXTENTS = [None, (0.0, 3.0, 0.0, 2.0), (-2.0, 1.0, -1.0, 1.0), (1.0, -2.0, 5.0, 4.0), (1e6, 1e6 + 7, -1e-3, 1e-3)]


@pytest.mark.parametrize("extent", EXTENTS)
def test_coordinates_are_those_of_the_paper(extent: tuple[float, float, float, float] | None) -> None:
    """(22): pixel h covers L (h, h + 1) / N from the extent's first corner; (23): its centre. Within two roundings."""
    screen = Screen.of((4, 7), extent)
    x0, x1, y0, y1 = extent or (0.0, 7.0, 0.0, 4.0)
    for h in range(8):
        near = pytest.approx(x0 + (x1 - x0) / 7 * h, rel=4e-16, abs=1e-15)
        assert screen.x_of(torch.tensor(h, dtype=torch.float64)).item() == near
    for h in range(5):
        near = pytest.approx(y0 + (y1 - y0) / 4 * h, rel=4e-16, abs=1e-15)
        assert screen.y_of(torch.tensor(h, dtype=torch.float64)).item() == near
    cx, cy = screen.centres()
    assert cx.shape == (7,)
    assert cy.shape == (4,)
    assert cx.dtype == cy.dtype == torch.float64
    for h in range(7):
        assert cx[h].item() == pytest.approx(x0 + (x1 - x0) / 7 * (h + 0.5), rel=4e-16, abs=1e-15)
    for h in range(4):
        assert cy[h].item() == pytest.approx(y0 + (y1 - y0) / 4 * (h + 0.5), rel=4e-16, abs=1e-15)


def test_default_extent_is_pixels() -> None:
    cx, cy = Screen.of((2, 3)).centres()
    assert cx.tolist() == [0.5, 1.5, 2.5]
    assert cy.tolist() == [0.5, 1.5]
    assert Screen.of((2, 3)).extent == (0.0, 3.0, 0.0, 2.0)


def test_reversed_extent_runs_backwards() -> None:
    screen = Screen.of((2, 4), (4, 0, 2, 0))
    assert screen.pixel_size == (-1.0, -1.0)
    cx, cy = screen.centres()
    assert cx.tolist() == [3.5, 2.5, 1.5, 0.5]
    assert cy.tolist() == [1.5, 0.5]


@pytest.mark.parametrize("extent", EXTENTS[1:])
def test_strata_centres_are_those_of_the_paper(extent: tuple[float, float, float, float]) -> None:
    """(24): the centres of m strata of a pixel are the centres of the pixels of a screen with m times as many."""
    m, coarse, fine = 3, Screen.of((2, 5), extent), Screen.of((6, 15), extent)
    h, j = torch.arange(5, dtype=torch.float64)[:, None], torch.arange(m, dtype=torch.float64)
    torch.testing.assert_close(coarse.x_of(h + (j + 0.5) / m).flatten(), fine.centres()[0], rtol=1e-15, atol=1e-15)


def test_centres_of_a_cell_are_those_of_the_screen() -> None:
    screen = Screen.of((9, 11), (-1, 1, 3, 2))
    cx, cy = screen.centres()
    cell = Cell(2, 5, 4, 3)
    rows, cols = cell.window
    assert torch.equal(screen.centres(cell)[0], cx[cols])
    assert torch.equal(screen.centres(cell)[1], cy[rows])


sides = st.integers(1, 200)


@settings(deadline=None)
@given(sides, sides, st.integers(1, 300), st.integers(1, 300))
def test_cells_cover_the_screen_exactly_once(height: int, width: int, cell_height: int, cell_width: int) -> None:
    painted = np.zeros((height, width), dtype=int)
    for cell in Screen.of((height, width)).cells(cell_height, cell_width):
        assert painted[cell.window].shape == (cell.height, cell.width)
        assert 1 <= cell.height <= cell_height
        assert 1 <= cell.width <= cell_width
        painted[cell.window] += 1
    assert (painted == 1).all()


@pytest.mark.parametrize(("x0", "dtype"), [(2.0**14 - 17, torch.float32), (2.0**14 - 16, torch.float64)])
@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("sign", [1, -1])
def test_float64_from_where_float32_steps_by_more(x0: float, dtype: torch.dtype, axis: int, sign: int) -> None:
    """From 2^14 on float32 steps by 2^-9; the cell of 8 pixels has a margin of 8, so its far corner lies at x0 + 16."""
    sides = [(0.0, 8.0), (0.0, 8.0)]
    sides[axis] = (sign * x0, sign * (x0 + 8))
    screen = Screen.of((8, 8), (*sides[0], *sides[1]))
    assert screen.coordinate_dtype(Cell(0, 0, 8, 8), torch.float32) == dtype
    assert screen.coordinate_dtype(Cell(0, 0, 8, 8), torch.float64) == torch.float64


def test_coordinate_dtype_is_chosen_by_the_cell() -> None:
    screen = Screen.of((64, 40000))
    assert screen.coordinate_dtype(Cell(0, 0, 64, 64), torch.float32) == torch.float32
    assert screen.coordinate_dtype(Cell(0, 39936, 64, 64), torch.float32) == torch.float64


@settings(deadline=None)
@given(st.floats(-1e12, 1e12), st.floats(1e-45, 1e40) | st.floats(1e-6, 1e6), st.integers(1, 300), st.integers(0, 2**31))
def test_float32_is_taken_only_where_it_is_fine_enough(x0: float, length: float, width: int, seed: int) -> None:
    assume(x0 + length != x0)
    screen = Screen.of((1, width), (x0, x0 + length, 0, 1))
    pixel = abs(screen.pixel_size[0])
    cell = Cell(0, 0, 1, width)
    corners = screen.x_of(torch.tensor([-width, 2.0 * width], dtype=torch.float64))
    largest = float(corners.abs().max())
    if screen.coordinate_dtype(cell, torch.float32) == torch.float32:
        at = -width + 3 * width * torch.rand(200, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))
        x = screen.x_of(at)
        # rounding is half a step, plus the float64 rounding of x itself
        assert float((x.float().double() - x).abs().max()) <= pixel * 2.0**-11 * (1 + 1e-9)
    else:
        # y is never the reason
        step = math.inf if largest > torch.finfo(torch.float32).max else float(np.spacing(np.float32(largest)))
        assert step > 2.0**-10 * pixel


@pytest.mark.parametrize(
    "estimator", [mcaa.Auto(), mcaa.JumpCorrected(), mcaa.Shared(), mcaa.Shared(mcaa.Sobol()), mcaa.Importance()], ids=repr
)
def test_a_far_pixel_is_sampled_as_finely_as_the_first(estimator: mcaa.Auto, monkeypatch: pytest.MonkeyPatch) -> None:
    """At 10^6 float32 steps by 1/16 px: f would see 16 offsets. What it sees are the near points moved, to float32's rounding near 0.

    32 evaluations a pixel: samples on lines 1 px apart have only as many offsets as there are lines, and 16 would tell nothing.
    What is asked in float32 and in float64, to compare them, is left out: far off all is float64.
    """
    monkeypatch.setattr("torch_mcaa.estimators.piloted.hold_to_rounding", lambda *arguments: None)
    seen: list[tuple[Tensor, Tensor]] = []

    def f(x: Tensor, y: Tensor) -> Tensor:
        seen.append((x.double().flatten(), y.double().flatten()))
        return x * 0

    points = []
    for origin in (0.0, 1e6):
        seen.clear()
        mcaa.render(f, (64, 64), extent=(origin, origin + 64, origin, origin + 64), estimator=estimator, spp=32)
        points.append([torch.cat(axis) - origin for axis in zip(*seen)])
    for near, far in zip(*points):
        assert far.unique().numel() >= near.unique().numel() > 1000
        # half of float32's step at 64 and beyond, and float64's at 10^6
        assert float((near - far).abs().max()) <= 2.0**-18 + 1e-9


BAD_SIZES = [
    ((0, 5), "height 0"),
    ((5, 0), "width 0"),
    ((-3, 5), "height -3"),
    ((2.5, 3), "integers"),
    ((2.0, 3.0), "integers"),
    ((True, 3), "integers"),
    (("4", "5"), "integers"),
    ((4,), "two integers"),
    ((3, 4, 4), "two integers"),
    (4, "two integers"),
    ("512x512", "two integers"),
    (None, "two integers"),
]


@pytest.mark.parametrize(("size", "said"), BAD_SIZES, ids=repr)
def test_bad_sizes(size: object, said: str) -> None:
    with pytest.raises(McaaError, match=said):
        Screen.of(size)


@pytest.mark.parametrize("size", [(2, 3), [2, 3], torch.Size((2, 3)), (np.int64(2), np.int32(3))], ids=repr)
def test_sizes_of_every_kind_of_integer(size: object) -> None:
    screen = Screen.of(size)
    assert (screen.height, screen.width) == (2, 3)
    assert type(screen.height) is type(screen.width) is int


BAD_EXTENTS = [
    ((0, 1, 2), "four numbers"),
    ((0, 1, 0, 1, 2), "four numbers"),
    (5, "four numbers"),
    ("abcd", "four numbers"),
    ((0, None, 0, 1), "four numbers"),
    ((1j, 1, 0, 1), "four numbers"),
    ((0, 0, 0, 1), "x0 != x1"),
    ((0, 1, 3, 3), "y0 != y1"),
    ((0, math.nan, 0, 1), "finite"),
    ((0, 1, -math.inf, 1), "finite"),
    ((-1e308, 1e308, 0, 1), "finite"),
    ((0, 5e-324, 0, 1), "finite"),
]


@pytest.mark.parametrize(("extent", "said"), BAD_EXTENTS, ids=repr)
def test_bad_extents(extent: object, said: str) -> None:
    with pytest.raises(McaaError, match=said):
        Screen.of((4, 5), extent)


@pytest.mark.parametrize("scale", [1e-42, 1e39])
def test_extents_that_float32_cannot_hold(scale: float) -> None:
    """f(x) = x / scale must not meet infinities or steps, in a float32 picture either: pixel j of a ramp is (j + 1/2) / 8."""
    picture = mcaa.render(lambda x, y: x.double() / scale, (8, 8), extent=(0, scale, 0, scale))
    exact = (torch.arange(8) + 0.5) / 8
    assert float((picture.image[0] - exact).abs().max()) < 2e-3


def test_centres_of_sub_pixels() -> None:
    """(24): b = L / (N m) (m h + j + 1/2), here with L = (6, 4), N = (3, 2), m = (2, 3)."""
    x, y = Screen.of((2, 3), (0.0, 6.0, 0.0, 4.0)).centres(strata=(2, 3))
    assert x.tolist() == [6 / (3 * 2) * (2 * h + j + 0.5) for h in range(3) for j in range(2)]
    torch.testing.assert_close(
        y, torch.tensor([4 / (2 * 3) * (3 * h + j + 0.5) for h in range(2) for j in range(3)], dtype=torch.float64)
    )
    inner = Screen.of((2, 3), (0.0, 6.0, 0.0, 4.0)).centres(Cell(1, 2, 1, 1), strata=(2, 3))
    assert torch.equal(inner[0], x[4:])
    assert torch.equal(inner[1], y[3:])


def test_cells_grow_and_overlap() -> None:
    cell = Cell(2, 3, 4, 5)
    assert cell.grown(2) == Cell(0, 1, 8, 9)
    assert cell.grown(3).overlap(Cell(0, 0, 7, 20)) == Cell(0, 0, 7, 11)
    assert cell.grown(1).overlap(cell) == cell == cell.overlap(cell.grown(1))
