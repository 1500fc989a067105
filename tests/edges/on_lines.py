"""What the tests of this folder share: a lattice in every pixel of a screen, and an f that counts what it is asked."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

import torch_mcaa as mcaa
from torch_mcaa.edges.bisect import Crossings
from torch_mcaa.edges.candidates import Segments
from torch_mcaa.edges.correction import Window
from torch_mcaa.edges.ends import ends
from torch_mcaa.edges.lines import Everywhere, Lines, Samples, Scattered, norm, summed
from torch_mcaa.edges.pixels import Pixels
from torch_mcaa.filters import Filter, SeparableFilter

FINEST = 1.1 * 2.0**-14
"""Px: 14 halvings, the most that the estimators ask for."""


class Ask:
    """f(x, y), one plane (N,) or several (C, N), at float64 places; `count` evaluations so far, at `places`."""

    def __init__(self, f: Callable[[Tensor, Tensor], Tensor]) -> None:
        self.f, self.count = f, 0
        self.places: list[tuple[Tensor, Tensor]] = []

    def __call__(self, x: Tensor, y: Tensor) -> Tensor:
        assert x.dtype == y.dtype == torch.float64
        assert x.shape == y.shape and x.ndim == 1
        self.count += len(x)
        self.places.append((x, y))
        values = self.f(x, y)
        return values[None] if values.ndim == 1 else values


def step(inside: Tensor) -> Tensor:
    return inside.to(torch.float64)


def sampled(
    f: Callable[[Tensor, Tensor], Tensor] | Ask,
    lines: int = 5,
    rows: int = 12,
    cols: int = 12,
    row: int = 0,
    col: int = 0,
    shift: tuple[float, float] = (0.3217, 0.7113),
    number: int = 0,
) -> Everywhere:
    """Every pixel of [row, row + rows) x [col, col + cols) sampled by a lattice of `lines` (odd) points."""
    strip = mcaa.Lattice().strip(lines, number, False, shift, lines=True)
    x, y = torch.from_numpy(strip.x), torch.from_numpy(strip.y)
    ask = f if isinstance(f, Ask) else Ask(f)
    shape = rows, lines, cols
    at_row, at_col = torch.arange(row, row + rows)[:, None, None], torch.arange(col, col + cols)
    places = (x[:, None] + at_col).expand(shape).flatten(), (y[:, None] + at_row).expand(shape).flatten()
    return Everywhere(x, y, number, row, col, ask(*places).unflatten(1, shape))


def scatter(samples: Everywhere, asked: Tensor | None = None) -> Scattered:
    """The same samples pixel by pixel, those of `asked`, bool (R, Q), alone if it is given."""
    planes = samples.values.transpose(2, 3)
    asked = torch.ones(planes.shape[1:3], dtype=torch.bool) if asked is None else asked
    slot = torch.full(asked.shape, -1)
    slot[asked] = torch.arange(int(asked.sum()))
    return Scattered(samples.x, samples.y, samples.number, samples.row, samples.col, planes[:, asked], slot)


def weighed(samples: Scattered, filter: Filter, rows: Tensor, cols: Tensor, reach: int) -> Tensor:
    """(C, N) float64: the samples' weighted means."""
    return summed(samples, filter, rows, cols, reach) / norm(samples, filter, reach)


def segments(
    low: list[float],
    before: list[float],
    after: list[float],
    *,
    axis: int = 0,
    across: list[float] | None = None,
    share: float = 0.2,
    length: float = 1.0,
) -> Segments:
    """Segments of one channel by hand, each on a line of its own."""
    count = len(low)
    start = torch.tensor(low, dtype=torch.float64)
    values = torch.tensor([before, after], dtype=torch.float64)[:, None]
    index = torch.arange(count)
    return Segments(
        axis,
        index.to(torch.float64) if across is None else torch.tensor(across, dtype=torch.float64),
        start,
        start + length,
        values[0],
        values[1],
        share * (values[1] - values[0]).abs(),
        start % 1,
        torch.stack([index, index, index], 1),
        torch.zeros(count, dtype=torch.bool),
        torch.zeros(count, dtype=torch.int64),
        torch.zeros(count, dtype=torch.float64),
    )


def crossings(
    axis: int, across: Tensor, place: Tensor, jump: Tensor, samples: Samples, before: Tensor | None = None, width: float = 0.0
) -> Crossings:
    """Known jumps, `jump` (C, N), at `place` on lines of `samples`."""
    lines, phases = (samples.y, samples.x) if axis == 0 else (samples.x, samples.y)
    line = (across[:, None] % 1 - lines).abs().argmin(1)
    start = torch.zeros_like(jump) if before is None else before
    return Crossings(
        axis, across, place, torch.full_like(place, width), start, start + jump, phases[line], torch.arange(len(place))
    )


def all_lines(samples: Everywhere, axis: int) -> Tensor:
    """The coordinates of every line along `axis` in the samples' pixels, in order."""
    lines, first, count = (
        (samples.y, samples.row, samples.values.shape[1]) if axis == 0 else (samples.x, samples.col, samples.values.shape[3])
    )
    return torch.sort((torch.arange(first, first + count)[:, None] + lines).flatten()).values


class View:
    """All the pixels of a rectangle, and what is scattered onto them as planes."""

    def __init__(self, row: int, col: int, height: int, width: int, filter: SeparableFilter) -> None:
        self.window, self.shape = Window(filter, torch.device("cpu")), (height, width)
        self.pixels = Pixels(row, col, torch.ones(height, width, dtype=torch.bool), self.window.margin)

    def correction(self, some: Crossings, norm: float) -> tuple[Tensor, Tensor]:
        """(C, h, w): the correction and its variance."""
        total, spread, _ = self.window.correction(self.pixels, some, norm)
        return total.unflatten(1, self.shape), spread.unflatten(1, self.shape)

    def density(self, axis: int, along: Tensor, across: Tensor, size: Tensor) -> Tensor:
        return self.window.density(self.pixels, axis, along, across, size).view(self.shape)

    def ends(self, some: Crossings, lines: Lines) -> Tensor:
        return ends(self.window, self.pixels, some, lines).unflatten(1, self.shape)
