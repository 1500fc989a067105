"""Steps for which autograd raises in the place of a slope of 0, called so that it does not."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from torch import Tensor
from torch.overrides import TorchFunctionMode

from torch_mcaa.traced.decisions import Arguments, in_place, name_of

_WITHOUT_DERIVATIVE = ("heaviside", "floor_divide", "floordiv", "rfloordiv")


def lacks_derivative(function: Any) -> bool:
    """Whether the function decides, and its slope, which is 0, is not known to autograd."""
    return name_of(function) in _WITHOUT_DERIVATIVE


def called(function: Any, args: Sequence[Any], kwargs: Arguments) -> Any:
    """function(*args, **kwargs), where it `lacks_derivative` without a graph to what it decides on."""
    if not lacks_derivative(function):
        return function(*args, **kwargs)
    plain, named = [_detached(a) for a in args], {name: _detached(a) for name, a in kwargs.items()}
    if in_place(function):
        # a copy of its values, so that the graph of what was there is left behind
        return args[0].copy_(function(plain[0].clone(), *plain[1:], **named))
    return function(*plain, **named)


def _detached(value: Any) -> Any:
    return value.detach() if isinstance(value, Tensor) else value


class Called(TorchFunctionMode):
    """While it is active, all functions are `called`."""

    def __torch_function__(self, func: Any, types: Any, args: Sequence[Any] = (), kwargs: Arguments | None = None) -> Any:
        return called(func, args, kwargs or {})
