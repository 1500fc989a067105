"""What a peer is, what it returns, and whether it is installed."""

from __future__ import annotations

import importlib
import importlib.metadata
import importlib.util
from collections.abc import Callable
from dataclasses import dataclass

from torch import Tensor

from .cases import Case

STD, RADIUS = 0.5, 2.5
"""Pixels: the Gaussian of every peer and of ours, and where it is cut."""


@dataclass(frozen=True)
class Outcome:
    """What a method made of a case.

    Attributes:
        image: (H, W), or (P,) where only some pixels were computed.
        evaluations: of f, in all.
        pixels: (P,) int64, the indices row * W + column that were computed; None for all.
    """

    image: Tensor
    evaluations: int
    pixels: Tensor | None = None

    def rmse(self, case: Case) -> float:
        """Over the pixels of the case that are not flat."""
        if self.pixels is None:
            error = (self.image.double() - case.truth)[case.busy]
        else:
            error = self.image.double() - case.truth.flatten()[self.pixels]
        return float(error.square().mean().sqrt())

    def share(self, case: Case) -> float:
        """The part of the picture that was computed."""
        return 1.0 if self.pixels is None else len(self.pixels) / case.truth.numel()


Render = Callable[[Case, int, int], Outcome]
"""(case, evaluations a pixel, seed) -> outcome. What is asked for is rounded to what the method can do; `Outcome.evaluations` says what it did."""


@dataclass(frozen=True)
class Peer:
    """A method of others, in a file of this folder.

    Attributes:
        file, function: where it is.
        distribution: what it wants beyond PyTorch and numpy, or "".
        required: it has to be installed where the library is tested.
        budgets: evaluations a pixel that are tried.
        warms: it compiles anew for every budget, which is not timed.
        fits: whether it can draw a case at all.
    """

    name: str
    file: str
    distribution: str = ""
    required: bool = False
    function: str = "render"
    budgets: tuple[int, ...] = (4, 16, 64, 256)
    warms: bool = False
    fits: Callable[[Case], bool] = lambda case: True

    @property
    def installed(self) -> str | None:
        """Its version, or None."""
        if not self.distribution:
            return "PyTorch"
        try:
            return importlib.metadata.version(self.distribution)
        except importlib.metadata.PackageNotFoundError:
            return None

    def load(self) -> Render:
        return getattr(importlib.import_module(f".{self.file}", __package__), self.function)
