"""The thin pieces of a cell on shift after shift of a lattice: followed where that can be paid for, and else left to sampling."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_mcaa.edges.bisect import Crossings
from torch_mcaa.edges.correction import Window
from torch_mcaa.edges.lines import Lines
from torch_mcaa.edges.pieces import Numbered
from torch_mcaa.edges.thin import beside, complete, thin_pieces, unfollowed
from torch_mcaa.estimators.base import dilated
from torch_mcaa.estimators.located.blocks import by_block, by_pixel, pixels_of, shape_of
from torch_mcaa.estimators.located.counted import Counted, Spent

_FIRST = 0.5
"""The share of what is left that a first shift may spend on what it follows."""
THINNEST = 2.0**-12
"""Px: how exactly the ends of thin pieces have to be known to be followed from line to line."""
_TIMES, _WALK = 3.0, 0.05
"""What following them may take: so many times what is expected, and a share of what bisection took. Of detail on every scale no piece goes
on as the last lines foretell, and to look for it takes far more; hairlines take up to three times what is expected."""
_ATTEMPTS, _DEAREST = 3, 0.25
"""How often they are tried to be followed, each time without the blocks that took half of it if these are at most such a share of all."""


class ThinPieces:
    """Those that the shifts of a lattice meet in the cell that f is asked in.

    Attributes:
        lost: bool (h, w), the blocks in which some that were met had to be left to sampling, and others that are; hits: bool (h, w), where
            samples hit those.
        unpaid: what to follow them would have taken where there were too few evaluations for it.
    """

    def __init__(self, ask: Counted, window: Window) -> None:
        self.ask, self.cell, self.reach = ask, ask.cell, window.reach + 1
        self.lost, self.hits = (torch.zeros_like(ask.invalid, dtype=torch.bool) for _ in range(2))
        self.unpaid = 0.0
        # what following them took along either axis on the last shift: chance decides how many of them samples hit
        self._took = [0, 0]

    def completed(
        self, crossings: list[Crossings], lines: Lines, used: list[Tensor], seed: int, finest: float, bisection: int, foretold: bool
    ) -> list[Crossings]:
        """The crossings along either axis with the pieces followed, or without those that samples hit, whose blocks are lost.

        used: bool (h, w), the pixels that need the crossings along each axis. bisection: what that took. foretold: by an earlier shift.
        """
        parts = [self._along(c, lines, u, seed, finest, _WALK * bisection, foretold) for c, u in zip(crossings, used, strict=True)]
        every = [found for found, _ in parts]
        for (_, hit), others in zip(parts, every[::-1], strict=True):
            # what the lines of one axis cannot follow those of the other may have
            self._lose(hit.take(~beside(hit, others, Numbered(lines, others.axis))))
        return every

    def _along(
        self, crossings: Crossings, lines: Lines, used: Tensor, seed: int, finest: float, walk: float, foretold: bool
    ) -> tuple[Crossings, Crossings]:
        """The crossings with thin pieces followed, and none; or, where that takes more than a share of what is left, or goes astray, those
        without the pieces that samples hit, and those.
        """
        none = crossings.take(slice(0))
        if not thin_pieces(crossings, lines):
            return crossings, none
        origin, share = (self.cell.row - self.reach, self.cell.col - self.reach), share_of(foretold)
        attempts = _ATTEMPTS
        while True:
            wanted = widened(used & ~self.lost, self.reach)
            without, hit, cost = unfollowed(crossings, lines, wanted, origin, foretold)
            if cost > share * self.ask.left:
                self.unpaid += cost
                return without, hit
            before, points = self.ask.left, self.ask.points.clone()
            limit = (_TIMES * max(cost, self._took[crossings.axis]) + walk) / max(1, before)
            try:
                with self.ask.keeping(1 - min(share, limit)):
                    crossings = complete(self.ask, crossings, lines, wanted, origin, finest, seed)
                self._took[crossings.axis] = before - self.ask.left
                return crossings, none
            except Spent:
                attempts -= 1
                if not attempts or not self._without_dearest(self.ask.points - points):
                    return without, hit

    def _without_dearest(self, points: Tensor) -> bool:
        """Leave to sampling the blocks that took more than half of the evaluations `points` (h, w), if they are few of those that took any."""
        took = by_block(points, self.cell)
        order = torch.argsort(took, descending=True)
        total = took[order].cumsum(0)
        few = 1 + int((total < total[-1] / 2).count_nonzero())
        if few > _DEAREST * int(took.count_nonzero()):
            return False
        dear = torch.zeros_like(took, dtype=torch.bool)
        dear[order[:few]] = True
        self.lost = self.lost | by_pixel(dear.view(shape_of(self.cell)), self.cell)
        return True

    def _lose(self, hit: Crossings) -> None:
        """Leave the blocks with crossings to sampling."""
        if len(hit) == 0:
            return
        hits = torch.zeros_like(self.lost)
        hits[pixels_of(self.cell, hit.axis, hit.place, hit.across)] = True
        self.hits = self.hits | hits
        self.lost = self.lost | by_pixel((by_block(hits, self.cell) > 0).view(shape_of(self.cell)), self.cell)


def share_of(foretold: bool) -> float:
    """Of what is left, what a shift may spend on what it follows: all of it where an earlier one has foretold that."""
    return 1.0 if foretold else _FIRST


def widened(wanted: Tensor, by: int) -> Tensor:
    """The pixels up to so many off those `wanted` (h, w), and as many more on every side."""
    return dilated(torch.nn.functional.pad(wanted, (by,) * 4), by)
