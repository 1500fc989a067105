"""Slopes that f's values do not have, as of a straight-through estimator: they would count beside the edges of f's decisions."""

from __future__ import annotations

import torch

from torch_mcaa.errors import McaaError
from torch_mcaa.estimators.base import Task
from torch_mcaa.traced.asked import Asked
from torch_mcaa.traced.derivatives import derivatives
from torch_mcaa.traced.program import Program
from torch_mcaa.traced.visitors import Signatures

_STREAM, _PLACES, _SURE = 0x57E, 256, 4
"""How many places are looked at, and how many have to tell."""
_CHANGE = 0.02
"""What f should change by on either side, in magnitudes of it: more than half precision rounds."""
_FAR = 1 / 16
"""Of the screen, the farthest that a place is looked around."""


@torch.no_grad()
def straight_through(task: Task, program: Program) -> str:
    """A sentence if f has slopes at places of which the values on either side say that it has none; empty if not."""
    screen = task.screen
    asked = Asked(task.integrand.function, screen, program, task.dtype, task.device, None)
    col, row = (t.requires_grad_() for t in screen.whole.places(_PLACES, task.seed, _STREAM, device=task.device))
    with torch.enable_grad():
        values, _ = asked.run(col, row, lambda: Signatures(task.device))
        if not values.requires_grad:
            return ""
        try:
            across, down = (torch.zeros_like(col) if s is None else s for s in derivatives((values.sum(),), (col, row)))
        except McaaError:
            # of an operation that no gradient of a tensor's passes none will be asked
            return ""
    slope = torch.hypot(across, down)
    far = _CHANGE * values.abs().amax() / slope
    told = (far < _FAR * max(screen.height, screen.width)).nonzero()[:, 0]
    for way in (1, -1):
        off = way * far[told] / slope[told]
        cols, rows = col[told] + off * across[told], row[told] + off * down[told]
        # a closed screen has nothing beyond
        within = (cols >= 0) & (cols < screen.width) & (rows >= 0) & (rows < screen.height)
        told = told[within]
        beside, _ = asked.values(cols[within], rows[within])
        told = told[(beside == values[:, told]).all(0)]
    if len(told) < _SURE:
        return ""
    where = f"column {float(col[told[0]]):.3f}, row {float(row[told[0]]):.3f}"
    return (
        f"f has a slope at {where} where its values have none, as a straight-through estimator has: that counts beside f's edges, whose part "
        "is added here; let f decide without it, or use discontinuities=False, which has it alone"
    )
