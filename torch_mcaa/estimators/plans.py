"""What the blocks of a cell get for the evaluations there are, from what a pilot tells of them."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torch_mcaa.edges.pilot import Judged, Verdict
from torch_mcaa.estimators.base import dilated
from torch_mcaa.estimators.located.blocks import BLOCK, shape_of, sizes_of
from torch_mcaa.estimators.located.jump_corrector import STEPS, crossing
from torch_mcaa.estimators.located.jump_level import FEWEST_LINES, odd
from torch_mcaa.estimators.parts import lines_for
from torch_mcaa.grid import Cell

_ENOUGH_LINES = 5
_CALM_LINES = 7
"""Of quiet blocks, where others are sampled plainly and can use what these leave: hairlines are still met by many."""
_ALIKE = 0.6
"""The share of the most lines from which on quiet blocks have no more lines than those that jump."""
_SAFE = 0.95
"""Of what can be paid for by what is expected, what is planned."""
_DEAR = 15
"""Evaluations a pixel that a block may cost with three lines, or its share if that is more, before five lines elsewhere are worth more."""
_DEAREST = 2.5
"""A block that would cost so many times that is sampled plainly in any case."""
_SPARSE = 0.9
"""The share of the blocks that jump which have to be located if the number of lines is to be as large as can be paid for."""
_FOLLOWED = 0.5
_LINE, _LINE_STEP = 19.0, 4.0
"""Evaluations that a line across a thin piece takes in two shifts: so many, and for each halving of a bracket."""
_THIN = 0.7
"""The share of what a block's crossings cost from which on it is for thin pieces' sake."""


@dataclass(frozen=True)
class Plan:
    """What is done with rectangles of a cell: a lattice of `lines` points a pixel and its jumps located in `steps`, or, for 0, a plain one."""

    cells: list[Cell]
    lines: int
    steps: int
    cost: float


def plans_of(
    cell: Cell,
    judged: Judged,
    texture: Tensor,
    budget: int,
    plain: bool,
    second: int,
    unlike: int = 0,
    ample: int = 0,
    done: Tensor | None = None,
    fewest: int = FEWEST_LINES,
) -> list[Plan]:
    """Those for the blocks of a cell that are not `done`, the one of the most lines last: as many as `budget` evaluations are expected to pay for.

    With fewer halvings of each crossing's bracket where the blocks that jump could not have five lines otherwise, but as many as these leave
    room for. They may have up to `ample` evaluations a pixel if they need them for three lines. Those that would have less than `fewest` lines
    are sampled plainly.

    second: the samples of a second shift for a crossing, of each line; unlike: the lines that it has more.
    """
    pixels = sizes_of(cell)
    spp = budget / float(pixels.sum())
    most = lines_for(spp)
    quiet = _quiet(cell, judged.verdict) & ~texture if plain else judged.verdict != Verdict.JUMPS
    share = spp * pixels
    steps = STEPS[0]

    def beyond(cost: Tensor) -> Tensor:
        """What the lines take that a second shift has more, however many the first has."""
        return unlike / 2 * (cost - pixels)

    def planned(steps: int) -> tuple[Tensor, Tensor]:
        cost = _cost(steps, judged, pixels, second)
        return _lines(cost, _thin(steps, judged), judged, pixels, quiet, share - beyond(cost), most, plain, ample), cost

    lines, cost = planned(steps)
    for fewer in STEPS[1:]:
        busy = lines[judged.verdict == Verdict.JUMPS]
        if len(busy) == 0 or int(busy.min()) >= min(_ENOUGH_LINES, most):
            break
        steps = fewer
        lines, cost = planned(steps)
    for more in range(STEPS[0], steps, -1):
        same, dearer = planned(more)
        if torch.equal(same, lines):
            steps, cost = more, dearer
            break
    lines = torch.where(lines < fewest, 0, lines)
    if plain and fewest <= FEWEST_LINES:
        lines[_thin_too(lines, cost, share - beyond(cost), steps, judged, pixels)] = FEWEST_LINES
    labels = (lines if done is None else lines.masked_fill(done, -1)).tolist()
    rectangles, label = cell.rectangles(BLOCK, labels), torch.tensor(labels)
    return [
        Plan(
            [part for part, inside in rectangles if labels[inside[0]] == count],
            count,
            steps,
            float(((cost * count + beyond(cost) if count else share) * (label == count)).sum()),
        )
        for count in sorted({*labels} - {-1})
    ]


def _cost(steps: int, judged: Judged, pixels: Tensor, second: int) -> Tensor:
    """(blocks,): the evaluations that each block takes for each line a pixel, were its jumps located in so many halvings."""
    most = torch.maximum(*judged.crossings)
    # along an axis that sees little of the edges none are followed
    followed = sum((seen * (seen > _FOLLOWED * most) for seen in judged.crossings), torch.zeros_like(judged.told))
    thin, cost = _thin(steps, judged), crossing(steps, judged.told) * followed + second * most
    jumps, none = (judged.verdict == verdict for verdict in (Verdict.JUMPS, Verdict.NONE))
    return pixels + torch.where(jumps | none, thin, 0) + torch.where(jumps, cost, 0)


def _thin(steps: int, judged: Judged) -> Tensor:
    """(blocks,): what of that thin pieces take."""
    return (_LINE + _LINE_STEP * steps) * judged.lines


def _lines(
    cost: Tensor, thin: Tensor, judged: Judged, pixels: Tensor, quiet: Tensor, share: Tensor, most: int, plain: bool, ample: int
) -> Tensor:
    """How many lines a pixel (blocks,) int64 each block has, 0 where it is sampled plainly, for what each of them costs.

    Blocks without a candidate may hold a thin piece that the pilot missed: they have the most lines, and what they leave of their share
    goes to those that jump. These have all the same number of lines, and if it is not much smaller, so have the others: parts of
    different lattices know nothing of each other's thin pieces. Where what is dear are those, which reach into blocks whose samples met
    none of them, all have as many lines as all can pay for. Where that would be too few the dearest blocks are sampled plainly, and
    where these are many the others have three lines: what remains of the error is there.
    """
    jumps = judged.verdict == Verdict.JUMPS
    if not plain:
        count = max(FEWEST_LINES, min(most, int(share.sum() / cost.sum())))
        return torch.full_like(quiet, odd(count), dtype=torch.int64)
    share = torch.where(jumps, torch.maximum(share, torch.minimum(ample * pixels, FEWEST_LINES / _SAFE * cost)), share)
    dear = FEWEST_LINES * cost > share.clamp_min(_DEAR * pixels)
    busy = jumps & (FEWEST_LINES * cost <= _DEAREST * share.clamp_min(_DEAR * pixels))
    elsewhere, cost = float((cost - pixels)[quiet].sum()), torch.where(quiet, pixels, cost)
    while bool(busy.any()):
        both = _SAFE * float(share[busy | quiet].sum() / (cost[busy | quiet].sum() + elsewhere))
        alone = _SAFE * float((share[busy].sum() + (share - most * cost)[quiet].sum()) / cost[busy].sum())
        thinly = elsewhere + float(thin[busy].sum()) > _THIN * (elsewhere + float((cost - pixels)[busy].sum()))
        alike = thinly or both > _ALIKE * most
        count = min(most, int(both if alike else alone))
        if count >= min(_ENOUGH_LINES, most) or (count >= FEWEST_LINES and not bool((busy & dear).any())):
            few = int(busy.sum()) < _SPARSE * int(jumps.sum())
            count = FEWEST_LINES if few else odd(count)
            calm = count if alike and not few else most if bool((busy | quiet).all()) else min(most, _CALM_LINES)
            return torch.where(busy, count, torch.where(quiet, calm, 0))
        # for its size: a block that the screen cuts costs little even where it costs most a pixel
        busy[(cost / pixels * busy).argmax()] = False
    return torch.where(quiet, most if bool(quiet.all()) else min(most, _CALM_LINES), 0)


def _thin_too(lines: Tensor, cost: Tensor, share: Tensor, steps: int, judged: Judged, pixels: Tensor) -> Tensor:
    """Which blocks (blocks,) that have no `lines` are dear for thin pieces' sake, and can be paid for with what is left, the cheapest first.

    On three lines a thin piece errs by far less than any number of samples would, as edges with corners do not.
    """
    thin = _thin(steps, judged)
    dropped = (lines == 0) & (judged.verdict == Verdict.JUMPS) & (thin > _THIN * (cost - pixels))
    left = float(torch.where(lines > 0, share - cost * lines, share * dropped).sum())
    order = torch.argsort(torch.where(dropped, cost, torch.inf))
    paid = torch.zeros_like(dropped)
    paid[order] = (FEWEST_LINES * cost[order]).cumsum(0) <= _SAFE * left
    return paid & dropped


def _quiet(cell: Cell, verdict: Tensor) -> Tensor:
    """Blocks without candidates, but for those beside a block in which f is continuous or noise: that goes on into them."""
    size = shape_of(cell)
    other = (verdict == Verdict.CONTINUOUS) | (verdict == Verdict.NOISE)
    return (verdict == Verdict.NONE) & ~dilated(other.view(size), 1).flatten()
