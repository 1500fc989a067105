"""Ramps so narrow that next to no sample meets them: to a derivative they are jumps, though f decides nothing there.

A clamp or a sigmoid of a large multiple has all its slope where it changes, and none where samples lie. The gradient is right on average, of a
sum that is 0 nearly always.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from torch_mcaa.estimators.base import Task
from torch_mcaa.traced.asked import Asked
from torch_mcaa.traced.audit import STEPS, narrow
from torch_mcaa.traced.pieces import HALVED, Pieces, pieces
from torch_mcaa.traced.program import Program
from torch_mcaa.traced.visitors import Signatures

_FEWEST, _LOOKED, _FOLLOWED, _DIFFERENTIATED = 1 << 8, 1 << 14, 64, 8
_SPIKE, _BESIDE, _WITHIN = 16, 4, 1 / 32
"""A derivative that is so many times what it is on either side, so many widths of a ramp off that no sample meets; and where it is looked for, in
parts of that."""


def steep(task: Task, program: Program, tensors: Sequence[Tensor], spp: int) -> str:
    """A sentence about a place where f changes as by a jump to `spp` samples a pixel, no decision is seen, and one of the tensors moves that.

    Empty if none is found.
    """
    screen = task.screen
    asked = Asked(task.integrand.function, screen, program.all_moving(), task.dtype, task.device, None)
    found = pieces(asked, task.seed, max(_FEWEST, min(_LOOKED, screen.width * screen.height // 4)), _FOLLOWED)
    halvings = max(HALVED, narrow(spp))
    if found is None:
        return ""
    for _ in range(halvings - HALVED):
        if not len(found):
            return ""
        found = found.halved(asked, 1)
        found = found.take(found.left() > 0.5)
    found = found.take(found.stands_out())
    if not len(found):
        return ""
    found = found.take(found.alone(asked))
    last = found.halved(asked, STEPS - halvings)
    sheer = last.left() > 0.5
    for k, place in enumerate(sheer.tolist()[:_DIFFERENTIATED]):
        one = last.take(torch.tensor([k], device=task.device))
        if place or _moves(asked, one, _BESIDE / 2**halvings, tensors):
            at = one.at(one.high)
            col, row, x, y = (float(t) for t in (*at, screen.x_of(at[0]), screen.y_of(at[1])))
            jump = float(one.change[one.channel(one.change), 0])
            return (
                f"f changes by {jump:.3g} within 1/{2**halvings} px at column {col:.3f}, row {row:.3f} (x = {x:.6g}, "
                f"y = {y:.6g}), where it is not seen to decide: next to no sample meets that, so that the gradient of what moves it is "
                "missing, or noise; let f decide, as by g > 0 in the place of a ramp across g = 0, or say where it jumps by level_set(g)"
            )
    return ""


def _moves(asked: Asked, piece: Pieces, beside: float, tensors: Sequence[Tensor]) -> bool:
    """Whether f's derivative by one of the tensors is there where the piece, one, ends in being halved, and not `beside` that, as at a bend."""
    # a bend is where halving ends: of a ramp that is one end of it, and which side of that a place is on is chance
    near = piece.high + beside * torch.tensor([-1, -_WITHIN, 0, _WITHIN, 1], dtype=torch.float64, device=asked.device)[:, None]
    share = near.clamp(0, 1)
    col, row = piece.at(share)
    with torch.enable_grad():
        values, _ = asked.run(col.flatten(), row.flatten(), lambda: Signatures(asked.device))
        channel = int(piece.channel(piece.change))
        if not values.requires_grad:
            return False
        slopes = [torch.autograd.grad(value, tensors, retain_graph=True, allow_unused=True) for value in values[channel]]
    left, *inside, right = (
        torch.cat([g.detach().flatten().abs().double() for g in s if g is not None] or [share[0]]) for s in slopes
    )
    return bool((torch.stack(inside).amax(0) > _SPIKE * torch.maximum(left, right)).any())
