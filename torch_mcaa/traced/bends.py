"""The operations that switch without a jump, and whose derivatives jump: decisions of an f that takes derivatives."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor

from torch_mcaa.traced.decisions import Arguments, Choice, Decision, Level, Rule, argument, floating
from torch_mcaa.traced.rules import indices


def _bend(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
    return Level(args[0] > 0, lambda: args[0]) if floating(args[0]) else None


def _larger(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
    """Of two tensors; along an axis it is the one that is chosen."""
    a, b = args[0], argument(args, kwargs, 1, "other", "dim")
    if floating(a) and floating(b):
        return Level(a > b, lambda: a - b)
    return indices(1, None)(args, kwargs, result) if not isinstance(result, Tensor) else None


def _extreme(chosen: Callable[..., Tensor]) -> Rule:
    """The largest or the smallest along an axis, which one is `chosen`."""

    def rule(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
        values, dim = args[0], argument(args, kwargs, 1, "dim", "axis")
        if not floating(values) or not isinstance(dim, int):
            return None
        return Choice(chosen(values.detach(), dim, keepdim=True), values, dim % values.ndim)

    return rule


def _clamped(low: float | None = None, high: float | None = None) -> Rule:
    """Two bends, at the limits that are given, or these."""

    def rule(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
        a = args[0]
        limits = (
            argument(args, kwargs, place, *names, default=default)
            for place, names, default in ((1, ("min", "min_val"), low), (2, ("max", "max_val"), high))
        )
        ends = [limit for limit in limits if limit is not None]
        if not floating(a) or not ends:
            return None

        def margin() -> Tensor:
            margins = torch.stack([a - end for end in ends])
            return margins.gather(0, margins.detach().abs().argmin(0, keepdim=True))[0]

        return Level(torch.stack([a > end for end in ends]).sum(0), margin)

    return rule


BENDS: dict[str, Rule] = {
    **dict.fromkeys(("abs", "absolute", "relu", "leaky_relu", "prelu", "elu"), _bend),
    **dict.fromkeys(("maximum", "minimum", "fmax", "fmin", "max", "min"), _larger),
    "amax": _extreme(torch.argmax),
    "amin": _extreme(torch.argmin),
    **dict.fromkeys(("clamp", "clip"), _clamped()),
    "clamp_min": lambda args, kwargs, result: _clamped()([args[0], argument(args, kwargs, 1, "min")], {}, result),
    "clamp_max": lambda args, kwargs, result: _clamped()([args[0], None, argument(args, kwargs, 1, "max")], {}, result),
    "hardtanh": _clamped(-1.0, 1.0),
    "relu6": _clamped(0.0, 6.0),
}
