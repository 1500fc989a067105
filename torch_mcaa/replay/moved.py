"""Parameters of where f is asked, with the derivative moved onto the filter.

The value of a pixel is an integral of f(X_t r) w(r - c_h) over the screen, X_t a map with parameters t: the extent, or the transform of a
texture. In coordinates s = X_t r, which f alone is asked in, it is the integral of f(s) w(X_t^-1 s - c_h) |det D X_t^-1(s)|, where f no
longer depends on t, so that neither its slope nor its jumps matter: the points s stay where they are, and their places on the screen
and their weights move.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torch_mcaa.errors import McaaError
from torch_mcaa.filters import Filter, SeparableFilter
from torch_mcaa.grid import Screen

_STEP = 0.01
"""What w may have at its sides, in parts of what it has in the middle, if its slope is to stand for all of its change."""


def is_continuous(filter: Filter) -> bool:
    """Whether w goes to 0 at its sides, as far as can be told: for one that does not separate, half way along them."""
    radius = torch.tensor(filter.radius, dtype=torch.float64)
    zero = torch.zeros((), dtype=torch.float64)
    if isinstance(filter, SeparableFilter):
        middle, side = filter.profile(torch.stack([zero, radius[0]])).abs().tolist()
        return side < _STEP * middle
    middle, right, down = filter(torch.stack([zero, radius[0], zero]), torch.stack([zero, zero, radius[1]])).abs().tolist()
    return max(right, down) < _STEP * middle


@dataclass(frozen=True)
class Moved:
    """Where on the screen places of f lie, as a function of the parameters.

    Attributes:
        screen: the screen at the parameters' present values.
        extent: (4,) the extent that has parameters, or None.
        transform: (3, 3) from f's coordinates to those of a texture, if it has parameters, or None.
    """

    screen: Screen
    extent: Tensor | None
    transform: Tensor | None

    @property
    def parameters(self) -> tuple[Tensor, ...]:
        return tuple(t for t in (self.extent, self.transform) if t is not None)

    def check(self, boundary: str, reach: int) -> None:
        """Refuse what has more than a derivative of w to it.

        Raises:
            McaaError: a boundary other than "extend", since the screen's border moves too; a horizon on the screen or within the filter's reach.
        """
        if boundary != "extend":
            raise McaaError(
                f"gradients with respect to an extent or a transform need boundary='extend', got {boundary!r}: f's end at the border of "
                "the screen would move with them"
            )
        if self.transform is not None and hides(self.transform, self.screen, reach):
            raise McaaError(
                "the transform's horizon lies on the screen or within the filter's reach of it, where its gradient has no bound; got "
                f"{self.transform.detach().tolist()}: take a smaller part of the plane, or pass transform.detach()"
            )

    def held(self, col: Tensor, row: Tensor) -> tuple[Tensor, Tensor]:
        """The places s of float64 screen columns and rows."""
        x, y = self.screen.x_of(col), self.screen.y_of(row)
        return (x, y) if self.transform is None else _projected(self.transform.detach().to(x), x, y)[:2]

    def pulled(self, u: Tensor, v: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Screen column and row of places s, and the logarithm of what an area there is on the screen, up to a constant."""
        x, y = u, v
        area = torch.zeros((), dtype=torch.float64, device=u.device)
        if self.transform is not None:
            inverse = torch.linalg.inv(self.transform.to(u))
            x, y, depth = _projected(inverse, u, v)
            area = torch.linalg.det(inverse).abs().log() - 3 * depth.abs().log()
        if self.extent is None:
            (x0, _, y0, _), (wide, high) = self.screen.extent, self.screen.pixel_size
            return (x - x0) / wide, (y - y0) / high, area
        x0, x1, y0, y1 = self.extent.to(u)
        area = area - ((x1 - x0) * (y1 - y0)).abs().log()
        return (x - x0) * (self.screen.width / (x1 - x0)), (y - y0) * (self.screen.height / (y1 - y0)), area


def hides(transform: Tensor, screen: Screen, reach: int) -> bool:
    """Whether a point of the screen, or up to `reach` pixels off it, lies at or beyond the horizon of a 3 x 3 transform of f's coordinates."""
    col = torch.tensor([-reach, screen.width + reach] * 2, dtype=torch.float64)
    row = torch.tensor([-reach] * 2 + [screen.height + reach] * 2, dtype=torch.float64)
    depth = _projected(transform.detach().to(col), screen.x_of(col), screen.y_of(row))[2]
    return bool((depth <= 0).any())


def _projected(matrix: Tensor, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """(U / D, V / D, D) with (U, V, D) = matrix (x, y, 1)."""
    across, down, depth = (a * x + b * y + c for a, b, c in matrix)
    return across / depth, down / depth, depth
