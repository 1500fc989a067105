"""What a decision is, and the names and arguments of the operations that take some.

Only the position of a margin's zero and its slope's direction count: any increasing function of a margin serves as well.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from torch import Tensor


@dataclass(frozen=True)
class Level:
    """An operation that changes where a margin crosses zero.

    codes: what it decided, integers or bool of any shape; margin: a function that gives the margin, of a shape that expands to theirs, None
        where no rule says what crosses zero.
    """

    codes: Tensor
    margin: Callable[[], Tensor] | None


@dataclass(frozen=True)
class Choice:
    """An operation that chooses among the `values` along `dim`; where it goes from i to j, values[j] - values[i] crosses zero.

    codes: the indices chosen, of `values`' shape but for `dim`, which may be missing.
    """

    codes: Tensor
    values: Tensor
    dim: int


Decision = Level | Choice
Arguments = dict[str, Any]
Rule = Callable[[Sequence[Any], Arguments, Any], Decision | None]


def name_of(function: Any) -> str:
    """The name that rules go by: `lt` for torch.lt, Tensor.lt, Tensor.lt_, Tensor.__lt__, torch.ops.aten.lt.Scalar."""
    return _ruled_name(getattr(function, "__name__", ""))


@functools.cache
def _ruled_name(name: str) -> str:
    name = name.split(".")[0].removeprefix("special_")
    if name.startswith("__") and name.endswith("__"):
        return name[2:-2].removeprefix("i") if name[2:-2] in _IN_PLACE else name[2:-2]
    return name.strip("_")


ESCAPES = ("item", "tolist", "numpy", "__array__", "__bool__", "__float__", "__int__", "__index__", "__complex__", "__dlpack__")
"""Functions through which values leave PyTorch, where neither the trace nor a gradient follows."""


def in_place(function: Any) -> bool:
    """Whether the function changes its first argument."""
    return _changing(getattr(function, "__name__", ""))


@functools.cache
def _changing(name: str) -> bool:
    name = name.split(".")[0]
    return name in _CHANGING or (name.endswith("_") and not name.endswith("__"))


_IN_PLACE = ("iadd", "isub", "imul", "idiv", "itruediv", "ifloordiv", "imod", "ipow", "iand", "ior", "ixor", "ilshift", "irshift")
_CHANGING = frozenset(("__setitem__", *(f"__{name}__" for name in _IN_PLACE)))


def made_like(function: Any) -> bool:
    """Whether of the function's first argument nothing but the type and the shape matter, as of x in x.new_tensor(3.0)."""
    name = getattr(function, "__name__", "")
    return name.startswith("new_") or name.endswith("_like")


def floating(value: Any) -> bool:
    """Whether it is a tensor of floating point numbers."""
    return isinstance(value, Tensor) and value.is_floating_point()


def argument(args: Sequence[Any], kwargs: Arguments, place: int, *names: str, default: Any = None) -> Any:
    """The one at a place, or of one of the names."""
    for name in names:
        if name in kwargs:
            return kwargs[name]
    return args[place] if place < len(args) else default
