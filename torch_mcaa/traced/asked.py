"""f at places of the screen, with what it decided there."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import torch
from torch import Tensor

from torch_mcaa.errors import McaaError
from torch_mcaa.grid import Cell, Screen
from torch_mcaa.integrand import Function, Integrand, width_of
from torch_mcaa.traced.program import Program
from torch_mcaa.traced.trace import Lanes, Site, Traced, changed_program
from torch_mcaa.traced.visitors import Signatures

_AT_ONCE = 12 * 256 * 8
"""Points of one call on a CPU."""
_ROUNDED, _COMPARED, _SURE = 0x20D1, 64, 2
"""How many places are compared, and how many have to differ: one may lie on an edge."""
Tally = Callable[[Tensor, Tensor], None]
"""Told the columns and rows (N,) of every place that f is asked at."""
V = TypeVar("V", bound=Callable[[int, Lanes, Site], None])


class Asked:
    """f, traced, at float64 screen columns and rows.

    Edges are located in float64, so that places between float32 numbers are told apart; an f that takes `dtype` alone, such as a network,
    gets that from the first time on that it refuses.
    """

    def __init__(
        self, function: Function, screen: Screen, program: Program, dtype: torch.dtype, device: torch.device, tally: Tally | None
    ) -> None:
        self.screen, self.program, self.dtype, self.device, self.tally = screen, program, dtype, device, tally
        self.function = function
        self.precision = torch.float64
        self.coarse = screen.coordinate_dtype(screen.whole, dtype)
        self.channels = 1

    def hold_to_rounding(self, cell: Cell, seed: int) -> None:
        """Ask f in the picture's dtype alone from now on if rounding makes another f of it, as of one that hashes: if in float64 it decides
        otherwise at a few of some random places of the cell.
        """
        if self.coarse == self.precision:
            return
        col, row = cell.places(_COMPARED, seed, _ROUNDED, device=self.device)
        decided = [self.run(col, row, lambda: Signatures(self.device), coarse)[1].signatures(_COMPARED) for coarse in (False, True)]
        if int((decided[0] != decided[1]).count_nonzero()) >= _SURE:
            self.precision = self.coarse

    @property
    def at_once(self) -> int:
        """Points of one call."""
        return _AT_ONCE * width_of(self.device)

    def signatures(self, col: Tensor, row: Tensor) -> Tensor:
        """(N,) int64."""
        return self.values(col, row)[1]

    def values(self, col: Tensor, row: Tensor) -> tuple[Tensor, Tensor]:
        """f's values (C, N) in float64, and the signatures (N,) int64."""
        if len(col) == 0:
            return torch.zeros(self.channels, 0, dtype=torch.float64, device=self.device), col.to(torch.int64)
        found = []
        for c, r in zip(col.split(self.at_once), row.split(self.at_once), strict=True):
            values, seen = self.run(c, r, lambda: Signatures(self.device))
            found.append((values, seen.signatures(len(c))))
        return torch.cat([v for v, _ in found], 1), torch.cat([s for _, s in found])

    def run(self, col: Tensor, row: Tensor, visitor: Callable[[], V], coarse: bool = False) -> tuple[Tensor, V]:
        """f's values (C, N) in float64 and what the visitor has seen, in one call of f: in the picture's dtype where `coarse` will do.

        Raises:
            McaaError: f breaks its contract, or takes other decisions than `program` says.
        """
        if self.tally is not None:
            self.tally(col.detach(), row.detach())
        x, y = self.screen.x_of(col), self.screen.y_of(row)
        if coarse:
            return self._once(x, y, visitor, self.coarse)
        try:
            return self._once(x, y, visitor, self.precision)
        except McaaError as error:
            # what f raised itself is chained
            if self.precision == self.dtype or error.__cause__ is None:
                raise
            before, self.precision = self.precision, self.dtype
            try:
                return self._once(x, y, visitor, self.precision)
            except McaaError:
                self.precision = before
                raise error from error.__cause__

    def _once(self, x: Tensor, y: Tensor, visitor: Callable[[], V], dtype: torch.dtype) -> tuple[Tensor, V]:
        seen = visitor()
        traced = Traced(self.function, self.program, seen)
        values = Integrand(traced, torch.float64)(x.to(self.device, dtype), y.to(self.device, dtype))
        if traced.changed is not None:
            raise changed_program(traced.changed)
        self.channels = len(values)
        return torch.stack(values), seen
