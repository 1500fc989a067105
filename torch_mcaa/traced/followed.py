"""f with its decisions known: an integrand as f is, that also tells where it decided alike."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from torch import Tensor

from torch_mcaa.integrand import Function, as_channels

if TYPE_CHECKING:
    from torch_mcaa.traced.program import Program

CODES = 1 << 24
"""So many codes: every one is a float32."""


@dataclass(frozen=True)
class Followed:
    """`function`, and all its decisions: the trace sees every jump of it."""

    function: Function
    program: Program

    def __call__(self, x: Tensor, y: Tensor) -> Any:
        return self.function(x, y)

    def coded(self, x: Tensor, y: Tensor) -> tuple[Any, ...]:
        """f's channels and one more, whole numbers from 0 to `CODES` - 1: equal where f has decided alike.

        Raises:
            McaaError: f takes other decisions than `program` says.
        """
        # pictures of functions that are not followed do not need the trace
        from torch_mcaa.traced.trace import Traced, changed_program
        from torch_mcaa.traced.visitors import Signatures

        seen = Signatures(x.device)
        traced = Traced(self.function, self.program, seen)
        returned = traced(x, y)
        if traced.changed is not None:
            raise changed_program(traced.changed)
        # in place: they are nobody else's
        codes = seen.signatures(len(x)).bitwise_right_shift_(40).bitwise_and_(CODES - 1)
        return (*as_channels(returned, x), codes)
