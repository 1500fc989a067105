"""Telling how far the work is: a bar on a terminal once it takes long, or a function of the user's."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

from torch_mcaa.errors import McaaError

Report = Callable[[float], object]
_PATIENCE = 1.0


class Progress:
    """`update(fraction)` in [0, 1]; `close` takes the bar away.

    `wanted` is None (a bar when the standard error is a terminal and the work takes over a second), True, False, or a function that is
    called with the fraction done; `doing` is written before the bar.
    """

    def __init__(self, wanted: Report | bool | None, doing: str = "rendering") -> None:
        if not (wanted is None or isinstance(wanted, bool) or callable(wanted)):
            raise McaaError(f"progress must be True, False, None or a function of the fraction done, got {wanted!r}")
        self._report = wanted if callable(wanted) else None
        self._shown = wanted is True or (wanted is None and sys.stderr.isatty())
        self._doing = doing
        self._start = time.perf_counter()
        self._told = 0.0
        self._bar: Any = None
        self._task: Any = None

    def update(self, fraction: float) -> None:
        """Tell a fraction; it is passed on when it is more than the one before."""
        if fraction <= self._told:
            return
        self._told = fraction
        if self._report is not None:
            self._report(fraction)
        if self._shown and (self._bar is not None or time.perf_counter() - self._start > _PATIENCE):
            if self._bar is None:
                from rich.console import Console
                from rich.progress import Progress as Bar

                self._bar = Bar(console=Console(stderr=True), transient=True)
                self._task = self._bar.add_task(self._doing, total=1.0)
                self._bar.start()
            self._bar.update(self._task, completed=fraction)

    def close(self) -> None:
        if self._bar is not None:
            self._bar.stop()
