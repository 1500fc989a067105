"""`torch.compile` for code of a user's: within a time limit, and said to be refused where it fails."""

from __future__ import annotations

import ctypes
import functools
import threading
from collections.abc import Callable
from types import FunctionType
from typing import Any, ParamSpec, TypeVar

import torch

LIMIT = 90.0
"""Seconds that one compilation may take. A cold start of the compiler is 20 to 35 of them; a loop of f's that is unrolled may never end."""


P = ParamSpec("P")
R = TypeVar("R")


def uncompiled(function: Callable[P, R]) -> Callable[P, R]:
    """The function, which a user's own `torch.compile` does not look into: it would take the library's code for the user's."""

    @functools.wraps(function)
    def called(*args: P.args, **kwargs: P.kwargs) -> R:
        if torch.compiler.is_compiling():
            eager: Any = torch.compiler.disable(function)
            return eager(*args, **kwargs)
        return function(*args, **kwargs)

    return called


class NotCompiled(Exception):
    """Why there is no compiled code: what the compiler says, in one line."""


class _Stop(BaseException):
    """Raised inside a compilation that takes too long; no handler of exceptions on the way catches it."""


class Compiled:
    """`function` in one graph of static shapes, compiled at the first call.

    Args:
        function: a function of tensors, a closure or not, that does not change its arguments.
        limit: seconds.
    """

    def __init__(self, function: FunctionType, limit: float = LIMIT) -> None:
        # the compiler keeps its results by code object, of which closures over different f share one, and refuses the ninth
        own = FunctionType(
            function.__code__.replace(), function.__globals__, function.__name__, function.__defaults__, function.__closure__
        )
        self._call = torch.compile(own, fullgraph=True, dynamic=False)
        self._limit: float | None = limit

    def __call__(self, *tensors: Any) -> Any:
        """The function's result, without a tape.

        Raises:
            NotCompiled: it cannot be compiled, or not within the limit, or f raised.
        """
        try:
            if self._limit is None:
                return self._call(*tensors)
            found = _within(self._limit, lambda: self._call(*tensors))
        except Exception as error:
            raise NotCompiled(_line(error)) from error
        self._limit = None
        return found


def _line(error: Exception) -> str:
    """What an error says: its first line, and the next where that one only announces it."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()] or [type(error).__name__]
    return " ".join(lines[:2]) if lines[0].endswith(":") else lines[0]


def _within(seconds: float, work: Callable[[], Any]) -> Any:
    """What `work` returns or raises; where it takes longer, it is stopped at its next step of Python."""
    found: list[Any] = []
    failed: list[BaseException] = []

    def run() -> None:
        try:
            with torch.no_grad():
                found.append(work())
        except BaseException as error:
            failed.append(error)

    thread = threading.Thread(target=run, name="compilation", daemon=True)
    thread.start()
    try:
        thread.join(seconds)
    finally:
        if thread.is_alive():
            ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread.ident or 0), ctypes.py_object(_Stop))
    if failed:
        raise failed[0]
    if not found:
        raise TimeoutError(f"it took longer than {seconds:g} s")
    return found[0]
