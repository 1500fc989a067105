"""Which rule says what an operation decides."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from torch_mcaa.traced.bends import BENDS
from torch_mcaa.traced.decisions import ESCAPES, Arguments, Level, Rule, floating, in_place, made_like, name_of
from torch_mcaa.traced.inside import differentiated
from torch_mcaa.traced.nested import tensors_in
from torch_mcaa.traced.rules import RULES

_WHOLE = (torch.bool, torch.uint8, torch.int8, torch.int16, torch.int32, torch.int64)


def rule_of(function: Any, bends: bool = False) -> Rule | None:
    """The rule for a function that `__torch_function__` is given, None if it decides nothing; `bends`: those that bend f count."""
    if getattr(function, "__name__", "") in ESCAPES:
        return None
    name = name_of(function)
    return BENDS[name] if name in BENDS and (bends or differentiated()) else RULES.get(name)


def unruled(function: Any, args: Sequence[Any], kwargs: Arguments, result: Any) -> Level | None:
    """What an operation without a rule decided, if it makes whole numbers or bools of floating ones: where it changes, but no margin."""
    if isinstance(result, Tensor) and result.is_floating_point() and not in_place(function):
        # most operations, of which nothing more is asked
        return None
    codes = next((t for t in tensors_in(args[0] if in_place(function) else result) if t.dtype in _WHOLE), None)
    # a view shows the bits of a number, which change everywhere
    if codes is None or name_of(function) == "view" or made_like(function):
        return None
    return Level(codes, None) if any(map(floating, tensors_in((args, kwargs)))) else None
