"""Is f in the backward pass what it was in the forward pass?

Compared is what f returns at a few places, and the margin of every decision on the way: a disc whose radius has changed has other margins
everywhere, though it may have the same values at most places.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from torch_mcaa.errors import McaaError
from torch_mcaa.integrand import Function, Integrand
from torch_mcaa.traced.decisions import Choice, Decision
from torch_mcaa.traced.trace import Watch, eagerly

_SAME = 1e-5
"""Of the largest number: sums of another order, as some devices have at each call, differ by less."""


@dataclass(frozen=True)
class Noted:
    """What there was.

    Attributes:
        x, y: (N,) where f was asked; found: what it gave there, None if it gave something else when it was asked twice.
        parameters: tensors that say where f is asked and how samples are weighed; values: copies of them.
    """

    x: Tensor
    y: Tensor
    found: list[Tensor] | None
    parameters: Sequence[Tensor]
    values: list[Tensor]

    @classmethod
    def now(cls, f: Function, x: Tensor, y: Tensor, parameters: Sequence[Tensor]) -> Noted:
        """parameters: few, and small."""
        found = _asked(f, x, y)
        # a function that is random has been told so
        some = found if _same(found, _asked(f, x, y)) else None
        return cls(x, y, some, parameters, [p.detach().clone() for p in parameters])

    def check(self, f: Function) -> None:
        """Raises:
        McaaError: something is not what it was.
        """
        if not _same(self.values, [p.detach() for p in self.parameters]):
            raise _changed("a parameter of the filter, the extent or the transform")
        if self.found is not None and not _same(self.found, _asked(f, self.x, self.y)):
            raise _changed("f, or something that it reads,")


def _changed(what: str) -> McaaError:
    return McaaError(
        f"{what} changed between the forward and the backward pass, which asks f again: its gradient would be that of something else; call "
        "backward() before the change, and let f read tensors and numbers that stay, as by lambda x, y, k=k: ... (torch.func.functional_call "
        "puts parameters back when it returns: call it inside f)"
    )


@torch.no_grad()
def _asked(f: Function, x: Tensor, y: Tensor) -> list[Tensor]:
    margins: list[Tensor] = []

    def visit(number: int, decision: Decision, func: Any) -> None:
        margin = decision.values if isinstance(decision, Choice) else decision.margin and decision.margin()
        margins.append((decision.codes if margin is None else margin).detach().clone())

    def watched(x: Tensor, y: Tensor) -> Any:
        with eagerly(), Watch(visit):
            return f(x, y)

    return [*Integrand(watched, torch.float64, "propagate")(x, y), *margins]


def _same(before: Sequence[Tensor], after: Sequence[Tensor]) -> bool:
    return len(before) == len(after) and all(map(_equal, before, after))


def _equal(a: Tensor, b: Tensor) -> bool:
    if a.shape != b.shape or a.dtype != b.dtype:
        return False
    if torch.equal(a, b):
        return True
    size = a.abs().nan_to_num(0, 0, 0).amax() if a.numel() else 0.0
    return bool(torch.isclose(a, b, rtol=0, atol=float(_SAME * size), equal_nan=True).all())
