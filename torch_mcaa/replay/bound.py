"""f with the variables of Python that it reads held at what they are now.

A function of Python looks its variables up when it is called. The backward pass calls f again, when a loop may have gone on:
`for k in range(3): pictures.append(layer(lambda x, y: k * g(x, y)))` has one k, the last one, for all three.
"""

from __future__ import annotations

import contextlib
import dis
import functools
import inspect
from collections.abc import Callable
from types import CellType, CodeType, FunctionType
from typing import Any

_WRITES = {"STORE_GLOBAL", "DELETE_GLOBAL"}
_FREE_WRITES = {"STORE_DEREF", "DELETE_DEREF"}
_ANYTHING = {"globals", "eval", "exec", "__import__"}
"""Functions that may read or write any variable."""
_MODULE = ("__builtins__", "__name__", "__package__", "__spec__", "__file__")


def bound(f: Callable[..., Any]) -> Callable[..., Any]:
    """f, if it is a plain function, with its closure and globals as they are now, and so those of functions in them.

    What they hold is held, not copied: an object that is changed has changed. Of globals only functions of the same module are followed. f as
    it is, if it, or one of those, sets such a variable itself.
    """
    plain = _plain(f)
    try:
        return f if plain is None else _bound(plain, {})
    except _Writes:
        return f


class _Writes(Exception):
    """A function sets variables that others read."""


def _plain(value: object) -> FunctionType | None:
    """It, if it is a function of somebody else's than PyTorch's, whose wrappers know what they wrap by identity."""
    if isinstance(value, FunctionType) and value.__globals__.get("__name__", "").split(".")[0] != "torch":
        return value
    return None


def _bound(f: FunctionType, known: dict[int, FunctionType]) -> FunctionType:
    if id(f) in known:
        return known[id(f)]
    names = _read(f.__code__)
    variables = {name: f.__globals__[name] for name in (*_MODULE, *names) if name in f.__globals__}
    cells = tuple(CellType() for _ in f.__closure__ or ())
    twin = FunctionType(f.__code__, variables, f.__name__, f.__defaults__, cells)
    twin.__kwdefaults__, twin.__qualname__, twin.__module__ = f.__kwdefaults__, f.__qualname__, f.__module__
    twin.__dict__.update(f.__dict__)
    # before what it reads: it may read itself
    known[id(f)] = twin
    for name, value in variables.items():
        inner = _plain(value)
        if inner is not None and inner.__globals__ is f.__globals__:
            variables[name] = _bound(inner, known)
    for cell, of in zip(cells, f.__closure__ or (), strict=True):
        with contextlib.suppress(ValueError):
            # one that is not set yet stays so
            inner = _plain(of.cell_contents)
            cell.cell_contents = of.cell_contents if inner is None else _bound(inner, known)
    return twin


@functools.lru_cache(256)
def _read(code: CodeType) -> frozenset[str]:
    """The names by which code, and that of functions inside it, may read globals.

    Raises:
        _Writes: it may set one, or a variable of the functions around it.
    """
    names, ahead = set(), [(code, set(code.co_freevars))]
    while ahead:
        inner, outside = ahead.pop()
        names |= set(inner.co_names)
        for step in dis.get_instructions(inner):
            if step.opname in _WRITES or (step.opname in _FREE_WRITES and step.argval in outside):
                raise _Writes
        for constant in inner.co_consts:
            if inspect.iscode(constant):
                ahead.append((constant, outside & set(constant.co_freevars)))
    if names & _ANYTHING:
        raise _Writes
    return frozenset(names)
