"""What a built-in scene is: an integrand whose pixel values are known."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping

import torch
from torch import Tensor

from torch_mcaa.errors import McaaError
from torch_mcaa.filters.base import Filter
from torch_mcaa.filters.box import Box
from torch_mcaa.filters.gaussian import Gaussian

REACH = 8.5
"""Standard deviations beyond which a Gaussian is taken as 0 in a closed form (tails of 1e-17)."""

ClosedForm = Callable[[Tensor, Tensor, float], Tensor]
"""(cx, cy, size of the filter) -> filtered value; the size is the std of a Gaussian, the width of a Box."""


class Scene(ABC):
    """An integrand f(x, y) in pixel units, y down, with its pixel values under some filters."""

    @abstractmethod
    def __call__(self, x: Tensor, y: Tensor) -> Tensor | tuple[Tensor, ...]:
        """f at points x, y of one shape and floating dtype; returns the same, or a tuple of one a channel."""

    @abstractmethod
    def _closed_forms(self) -> Mapping[type[Filter], ClosedForm]:
        """The closed form by class of filter, for `Gaussian`, `Box`, both or neither."""

    def exact(self, cx: Tensor, cy: Tensor, filter: Filter) -> Tensor:
        """The values φ = ∫ f(r) w(r − c) dr of the pixels centred on (cx, cy), in float64.

        cx, cy: pixel centres in pixels (j + ½, i + ½), of shapes that broadcast; converted to float64.
        Returns their broadcast shape, or (C, *shape) for a scene of several channels.

        Under `Gaussian` this is the integral with the Gaussian that nothing cuts off. The filter itself is
        cut at `radius` and renormalised along each axis; at 5 std that leaves out 5.7e-7 of the weight an
        axis, so the values differ by at most 1.2e-6 of the range of f (for `Quadratic`, whose range has no
        end, by 1.5e-5 std² (xx + yy)).

        Raises McaaError where the scene has no closed form under this filter, or the Gaussian is cut within 5 std.
        """
        forms = self._closed_forms()
        kind = type(filter)
        if kind not in forms or not isinstance(filter, Gaussian | Box):
            known = " and ".join(form.__name__ for form in forms) or "no filter"
            raise McaaError(
                f"{type(self).__name__} has a closed form under {known}, got {filter!r}: "
                "compare with a rendering of many samples instead"
            )
        size = filter.width if isinstance(filter, Box) else filter.std
        if isinstance(filter, Gaussian) and filter.half_width < 5 * size * (1 - 1e-9):
            raise McaaError(
                f"the closed form needs a Gaussian that reaches at least 5 std = {5 * size:g} px, "
                f"got {filter!r}: give the filter a larger radius"
            )
        cx, cy = torch.broadcast_tensors(cx.double(), cy.double())
        return forms[kind](cx, cy, size)


def require_positive(owner: object, **values: float) -> None:
    """Raise McaaError for the first of the values that is not a finite number above 0."""
    for name, value in values.items():
        if not (math.isfinite(value) and value > 0):
            raise McaaError(f"{type(owner).__name__}: {name} must be a finite number above 0, got {value}: give one")
