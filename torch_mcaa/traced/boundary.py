"""The boundary term: what automatic differentiation of samples leaves out where f jumps.

    d/dθ ∫ f w dr = ∫ (d/dθ f) w dr + ∮ Δf w (d/dθ g) / |∇g| dl

over the edges g = 0, across which f changes by Δf from g < 0 to g > 0 (Reynolds' transport theorem; T.-M. Li et al. 2018, "Differentiable
Monte Carlo Ray Tracing through Edge Sampling"). n lines a pixel along either axis meet the edges: an element dl is met with density
n |n_x| dl by those along x, n |n_y| dl by those along y.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import torch
from torch import Tensor

from torch_mcaa.filters.base import Filter
from torch_mcaa.grid import Cell, Screen
from torch_mcaa.integrand import Function
from torch_mcaa.traced.asked import Asked, Tally
from torch_mcaa.traced.crowded import FINE, crowded, finely
from torch_mcaa.traced.once import zero_with_gradient
from torch_mcaa.traced.program import Program, probe
from torch_mcaa.traced.refine import Changes, on_some_lines, refined, worthwhile
from torch_mcaa.traced.scan import scan, share
from torch_mcaa.traced.shared import shared
from torch_mcaa.traced.visitors import Margins

LINES = 3
"""Lines a pixel along either axis, by default."""
_FLAT = 1e-12
"""A change that is none, in magnitudes of f there."""
_FEWEST = 256
"""At least so many segments, and four a pixel, are followed."""
_CUT = 8
"""Of the segments that may be followed, one in so many may be cut finely in their place."""
_SOME = 1 << 13
"""Segments that are followed together."""
_FLAT_MARGIN = (
    "decides by something that has no derivative by x and y (detached, computed where no gradient follows, or inside the operation); its part "
    "of the gradient is left out"
)
_LEAP = "decides by something that jumps there, before any decision that the trace saw; its part of the gradient is left out"


@dataclass(frozen=True)
class Elements:
    """Edge elements that the lines met, N of them, without a graph.

    Attributes:
        col, row: (N,) float64 screen pixels.
        jump: (C, N) float64, f where the margin is positive less f where it is negative, everything that follows the decision included.
        weight: (N,) float64, what w and the margin's derivative are to be multiplied by: of a line along x g_x^2 / (n p (|g_x|^3 + |g_y|^3)),
            derivatives per screen pixel, p the probability with which it was met.
        cause: (N,) int64, the number of the decision whose margin crosses zero; branch: (N, 3) its lane and the codes on either side.
        at: (2, N) float64 column and row, in the same bracket, where the margin is to be differentiated.
        program: f's decisions; precision: the dtype in which f was asked.
        problems: sentences about elements that had to be left out, or count for another edge too, each with a line of the user's code.
    """

    col: Tensor
    row: Tensor
    jump: Tensor
    weight: Tensor
    cause: Tensor
    branch: Tensor
    at: Tensor
    program: Program
    precision: torch.dtype
    problems: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.col)


@torch.no_grad()
def elements(
    function: Function,
    screen: Screen,
    cell: Cell,
    filter: Filter,
    seed: int,
    lines: int = LINES,
    *,
    closed: bool = False,
    program: Program | None = None,
    fixed: bool = False,
    dtype: torch.dtype = torch.float32,
    device: torch.device | None = None,
    tally: Tally | None = None,
    inputs: Sequence[Tensor] = (),
) -> Elements:
    """The edge elements of one cell.

    Those of all cells of a screen are the same however it is cut into cells, unless f decides so often that some are left out at
    random, for which the others count more. A cell at the border of the screen has the elements beyond it too, as far as the filter reaches,
    unless the screen is `closed`: then f is not asked there. Small cells cost time, large ones only as much memory as they have edges.

    Args:
        seed, lines: what the lines lie by, and how many a pixel there are along either axis.
        program: what `probe` says of f, if it has been asked before.
        fixed: meet the edges too that depend on no tensor that wants a gradient. Where all are such, f is not asked otherwise.
        dtype: the picture's; f is asked in float64, or in this where it refuses.
        tally: told of every place that f is asked at.
        inputs: what is to be differentiated by: of edges that lie on one another and that these move apart it is said.

    Raises:
        McaaError: f breaks its contract, or takes other decisions in one call than in another.
    """
    device = torch.device("cpu") if device is None else device
    program = program or probe(function, screen, dtype, device)
    if fixed:
        program = program.all_moving()
    asked = Asked(function, screen, program, dtype, device, tally)
    if not program.moves:
        none = torch.zeros(0, dtype=torch.float64, device=device)
        whole = none.long()
        return Elements(
            none, none, none.expand(program.channels, 0), none, whole, whole.expand(3, 0).T, none.expand(2, 0), program, dtype, ()
        )
    asked.hold_to_rounding(cell, seed)
    cols = _span(cell.col, cell.width, screen.width, filter.radius[0], closed)
    rows = _span(cell.row, cell.height, screen.height, filter.radius[1], closed)
    most = _FEWEST + 4 * max(1, lines // LINES) * (cols[1] - cols[0]) * (rows[1] - rows[0])
    found = worthwhile(asked, scan(asked, cols, rows, lines, seed, closed), most, seed)
    blocks = crowded(asked, found.brackets.take(found.brackets.own), lines, seed, closed)
    scans = [(found, most, 1.0)]
    if len(blocks.numbers):
        every = found.brackets
        scans = [(found.take(~blocks.hold(every.axis, every.low, every.across)), most, 1.0)]
        fine = finely(asked, blocks, cols, rows, max(_FEWEST, most // _CUT), seed, closed)
        scans += [] if fine is None else [(worthwhile(asked, fine, most // 2, seed), most // 2, 1 / FINE)]
    # what is known of a change while it is looked for is five times as much as of an element
    parts = [
        _weighed(refined(asked, part, max(1, many * len(part.cause) // max(1, len(found.cause))), seed), lines, length)
        for found, many, length in scans
        for part in on_some_lines(found, many, seed).by_lines(_SOME)
    ]
    jump, at, rival = (torch.cat([part[k] for part in parts], 1) for k in (2, 6, 9))
    col, row, weight, cause, branch, flat, leap = (torch.cat([part[k] for part in parts]) for k in (0, 1, 3, 4, 5, 7, 8))
    problems = [f"{program.sites[k].where}: {program.sites[k].name} {_FLAT_MARGIN}" for k in flat.unique().tolist()]
    problems += [f"{program.sites[k].where}: {program.sites[k].name} {_LEAP}" for k in leap.unique().tolist()]
    if inputs:
        problems += shared(asked, at, cause, branch, rival, inputs)
    return Elements(col, row, jump, weight, cause, branch, at, program, asked.precision, tuple(problems))


def _span(first: int, size: int, whole: int, reach: float, closed: bool) -> tuple[int, int]:
    """The pixels along one axis that a cell answers for: at the border of an open screen those beyond that the filter reaches too."""
    beyond = 0 if closed else math.ceil(max(0.0, reach - 0.5))
    return first - beyond * (first == 0), first + size + beyond * (first + size == whole)


def _weighed(changes: Changes, lines: int, length: float) -> tuple[Tensor, ...]:
    """What `Elements` holds of the changes, which segments of so many px met."""
    brackets = changes.brackets
    order = torch.argsort(brackets.low)
    changes = changes.take(order[torch.argsort(brackets.line[order], stable=True)])
    brackets, (before, after) = changes.brackets, changes.margin
    ratio = (before / (before - after)).nan_to_num(0.5).clamp(0, 1)
    place = brackets.low + ratio * (brackets.high - brackets.low)
    probability = share(brackets.line, place, brackets.before, brackets.after, length)
    # the nearer end, unless the margin is on a plateau there, or too flat to be differentiated
    steep = changes.slope.abs().sum(0)
    high = (after.abs() < before.abs()).long()
    high = torch.where(steep.gather(0, high[None])[0] > _FLAT * steep.amax(0), high, 1 - high)
    slope = changes.slope.gather(1, high.expand(2, 1, -1))[:, 0].abs()
    # an edge is met by both axes: of |g_x|^3 and |g_y|^3 each has its share, so that lines nearly along it hardly count (Veach and Guibas
    # 1995, the power heuristic); scaled, so that no cube under- or overflows
    most = slope.amax(0)
    size = most * (slope / most).pow(3).sum(0) / (changes.along(slope) / most).square()
    step = changes.values[:, 1] - changes.values[:, 0]
    changed = brackets.own & (changes.cause >= 0) & (step.abs() > _FLAT * changes.values.abs().amax(1)).any(0)
    flat, leap = changed & (changes.flat | (before == after)), changed & changes.leap
    some = (changed & ~flat & ~leap & size.isfinite()).nonzero()[:, 0]
    # a margin that jumps with an edge that stays where it is stays there too
    flat, leap = flat & ~changes.behind, leap & ~changes.behind
    col, row = brackets.places(place)
    at = torch.stack(brackets.places(torch.where(high > 0, brackets.high, brackets.low)))
    weight = 1 / (probability * brackets.chance * lines * size)
    return (
        col[some],
        row[some],
        (step * torch.sign(after - before))[:, some],
        weight[some],
        changes.cause[some],
        changes.branch[some],
        at[:, some],
        changes.cause[flat],
        changes.cause[leap],
        changes.rival[:, some],
    )


def margins(function: Function, screen: Screen, elements: Elements) -> Tensor:
    """(N,) float64: the margins at the elements, with a graph to everything that they depend on."""
    asked = Asked(function, screen, elements.program, elements.precision, elements.col.device, None)
    asked.precision = elements.precision
    found = []
    for start in range(0, len(elements), asked.at_once):
        part = slice(start, start + asked.at_once)
        cause, branch = elements.cause[part], elements.branch[part]
        with torch.enable_grad():
            _, seen = asked.run(elements.at[0, part], elements.at[1, part], partial(Margins, cause, branch, True))
        found.append(seen.total)
    return torch.cat(found) if found else elements.col.new_zeros(0)


def surrogate(function: Function, screen: Screen, elements: Elements, coefficient: Tensor) -> Tensor:
    """A scalar, 0, whose backward is that of the sum over the elements of coefficient (N,) times margin: the boundary term's.

    Its second derivatives raise McaaError.
    """
    with torch.enable_grad():
        return (coefficient.to(torch.float64) * zero_with_gradient(margins(function, screen, elements))).sum()


def splat(elements: Elements, screen: Screen, filter: Filter) -> tuple[Tensor, Tensor, Tensor]:
    """(N, P) rows and columns of the pixels around each element, and w there, 0 beyond the screen."""
    reach = [int(min(r, whole) + 0.5) + 1 for r, whole in zip(filter.radius, (screen.width, screen.height), strict=True)]
    over, down = (torch.arange(-r, r + 1, device=elements.col.device) for r in reach)
    cols = (elements.col.floor().long()[:, None, None] + over).expand(-1, len(down), -1).flatten(1)
    rows = (elements.row.floor().long()[:, None, None] + down[:, None]).expand(-1, -1, len(over)).flatten(1)
    inside = (cols >= 0) & (cols < screen.width) & (rows >= 0) & (rows < screen.height)
    weight = filter(elements.col[:, None] - cols - 0.5, elements.row[:, None] - rows - 0.5)
    return rows.clamp(0, screen.height - 1), cols.clamp(0, screen.width - 1), weight * inside
