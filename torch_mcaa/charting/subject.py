"""What is charted: a function on a screen under a filter, and a digest by which a changed one is known."""

from __future__ import annotations

import hashlib
import linecache
from dataclasses import dataclass

import torch
from torch import Tensor

from torch_mcaa.arguments import task_of
from torch_mcaa.estimators import Task
from torch_mcaa.filters import Filter
from torch_mcaa.grid import Screen
from torch_mcaa.integrand import Function

_PROBES = 2**15


@dataclass(frozen=True)
class Subject:
    """One scene of a chart.

    Attributes:
        name: as the chart calls it.
        f: as the user gave it.
        size: (height, width).
        extent: what the screen covers in f's coordinates, or None for pixels.
        digest: of f's source and of its values at fixed places; equal for equal functions.
        channels: that f returns.
    """

    name: str
    f: Function
    size: tuple[int, int]
    filter: Filter
    extent: tuple[float, float, float, float] | None
    digest: str
    channels: int

    @classmethod
    def of(cls, name: str, f: Function, size: tuple[int, int], filter: Filter, extent: tuple[float, ...] | None) -> Subject:
        """Ask f at fixed places of the screen.

        Raises:
            McaaError: a size, filter or extent that cannot be used, or an f that breaks its contract there.
        """
        task = _task(f, size, filter, extent, torch.float32)
        places = torch.rand(2, _PROBES, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
        x, y = task.screen.x_of(places[0] * task.screen.width), task.screen.y_of(places[1] * task.screen.height)
        values, again = (_values(task, x.float(), y.float()) for _ in range(2))
        digest = hashlib.sha256(_source(f).encode())
        # a random f is known by its source alone
        if torch.equal(values, again):
            digest.update(values.numpy().tobytes())
        screen = (task.screen.height, task.screen.width)
        return cls(name, f, screen, filter, None if extent is None else task.screen.extent, digest.hexdigest(), len(values))

    def task(self, dtype: torch.dtype = torch.float32) -> Task:
        """The task of the arguments of `render`, with a count of evaluations of its own."""
        return _task(self.f, self.size, self.filter, self.extent, dtype)


def _task(f: Function, size: object, filter: Filter, extent: tuple[float, ...] | None, dtype: torch.dtype) -> Task:
    return task_of(f, Screen.of(size, extent), filter, "extend", "raise", 0, dtype, None, extent is None)


def _values(task: Task, x: Tensor, y: Tensor) -> Tensor:
    with torch.no_grad():
        return torch.stack(task.integrand(x, y))


def _source(f: Function) -> str:
    """The text of the file that f is from, empty where there is none; data classes show what they hold, too."""
    held = repr(f) if hasattr(f, "__dataclass_fields__") else ""
    code = getattr(f, "__code__", None) or getattr(type(f).__call__, "__code__", None)
    if code is None:
        return held
    linecache.checkcache(code.co_filename)
    return held + "".join(linecache.getlines(code.co_filename))
