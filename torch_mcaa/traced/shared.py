"""Edges that lie on one another: the first decision has the jump of both, which is right as long as they move together."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import torch
from torch import Tensor

from torch_mcaa import rng
from torch_mcaa.traced.asked import Asked
from torch_mcaa.traced.derivatives import derivatives
from torch_mcaa.traced.visitors import Margins

_STREAM = 0x5A4ED
_SEVERAL, _PART = 8, 0.05
"""Elements that belong to a crossing of two edges."""
_LOOKED = 64
"""Elements by which it is judged how two edges move."""
_ALONG = 0.99
"""The cosine between the normals of one edge."""
_APART = 0.1
"""Of their sum, the difference of two velocities that are not one."""


def shared(asked: Asked, at: Tensor, cause: Tensor, branch: Tensor, rival: Tensor, inputs: Sequence[Tensor]) -> list[str]:
    """Sentences about pairs of decisions, or of lanes of one, that have one edge which the `inputs` move apart.

    Args:
        at: (2, N) columns and rows of elements; cause, branch: (N,), (N, 3); rival: (4, N), as in `Causes`.
    """
    said = []
    pairs, number, counts = torch.unique(torch.stack([cause, rival[0]]), dim=1, return_inverse=True, return_counts=True)
    for pair, ((first, second), count) in enumerate(zip(pairs.T.tolist(), counts.tolist(), strict=True)):
        if second < 0 or count <= max(_SEVERAL, _PART * int((cause == first).sum())):
            continue
        some = (number == pair).nonzero()[:, 0]
        some = some[:: -(-len(some) // _LOOKED)]
        own, other = (cause[some], branch[some]), (rival[0, some], rival[1:, some].T)
        if _apart(asked, at[:, some], own, other, inputs):
            one, two = asked.program.sites[first], asked.program.sites[second]
            whose = "in another of the numbers it compares" if first == second else f"where {one.name} ({one.where}) has one"
            said.append(
                f"{two.where}: {two.name} has its edge {whose}, and other numbers move it: those of the first get the gradient of both; start "
                "them a thousandth of a pixel apart"
            )
    return said


def _apart(asked: Asked, at: Tensor, own: tuple[Tensor, Tensor], other: tuple[Tensor, Tensor], inputs: Sequence[Tensor]) -> bool:
    """Whether the edges of two lists of causes with their branches, at the same places, are moved in different ways."""
    with torch.enable_grad():
        col, row = at.clone().requires_grad_()
        totals = [asked.run(col, row, partial(Margins, *one, True))[1].total for one in (own, other)]
        slopes = [torch.autograd.grad(t.sum(), (col, row), retain_graph=True, allow_unused=True) for t in totals if t.requires_grad]
    if len(slopes) < 2:
        return False
    one, two = (torch.stack([torch.zeros_like(col) if s is None else s for s in slope]) for slope in slopes)
    cosine = (one * two).sum(0) / (one.norm(dim=0) * two.norm(dim=0))
    along = cosine.abs() > _ALONG
    if 2 * int(along.sum()) < len(along):
        return False
    # without symmetry: what moves a whole outline has a mean of 0 over it
    weight = along * rng.uniform(0, _STREAM, torch.arange(len(along)), dtype=torch.float64).to(at.device)
    velocities = []
    for total, slope, sign in zip(totals, (one, two), (torch.ones_like(cosine), cosine.sign()), strict=True):
        share = torch.where(along, weight * sign / slope.norm(dim=0), 0.0)
        found = derivatives((total,), inputs, (share,))
        velocities.append(
            torch.cat([torch.zeros_like(i).flatten() if g is None else g.flatten() for g, i in zip(found, inputs, strict=True)])
        )
    first, second = velocities
    return bool((first - second).norm() > _APART * (first.norm() + second.norm()))
