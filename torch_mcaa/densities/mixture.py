"""Mixtures of densities, and the choice of one of K cells by a uniform number that stays uniform inside it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Real

import torch
from torch import Tensor

from torch_mcaa.densities.base import Density
from torch_mcaa.errors import McaaError


@dataclass(frozen=True, init=False)
class Mixture(Density):
    """Σ weights_k · components_k: a component is chosen by u, and u is stretched to [0, 1) within it.

    So the strata of u stay strata within each component. The weights, equal by default, are normalised to sum 1.
    Raises McaaError where there is no component, or one that is not a Density, and for weights that are not positive
    finite numbers, one a component.
    """

    components: tuple[Density, ...]
    weights: tuple[float, ...]

    def __init__(self, components: Sequence[Density], weights: Sequence[float] | None = None) -> None:
        mend = "pass densities such as [Normal(0.3), FilterDensity(Gaussian(0.5))]"
        if not isinstance(components, (tuple, list)) or not components:
            raise McaaError(f"Mixture: components must be a list or tuple of at least one Density; received {components!r}: {mend}")
        for component in components:
            if not isinstance(component, Density):
                raise McaaError(f"Mixture: every component must be a Density; received {component!r}: {mend}")
        if weights is None:
            weights = [1.0] * len(components)
        mend = "pass one positive number a component, or none for equal weights"
        if not isinstance(weights, (tuple, list)) or len(weights) != len(components):
            raise McaaError(f"Mixture: weights must be a list or tuple of {len(components)}; received {weights!r}: {mend}")
        for weight in weights:
            if not isinstance(weight, Real) or isinstance(weight, bool) or not 0 < float(weight) < math.inf:
                raise McaaError(f"Mixture: weights must be positive finite numbers; received {weight!r}: {mend}")
        # Divided by the largest first, lest the sum overflow.
        parts = [float(weight) / float(max(weights)) for weight in weights]
        total = math.fsum(parts)
        object.__setattr__(self, "components", tuple(components))
        object.__setattr__(self, "weights", tuple(part / total for part in parts))

    @property
    def radius(self) -> tuple[float, float]:
        """The largest of the components' half-widths; between them the density may be 0, which `covers` looks for."""
        rx, ry = zip(*(component.radius for component in self.components), strict=True)
        return max(rx), max(ry)

    def sample(self, u: Tensor, v: Tensor) -> tuple[Tensor, Tensor]:
        u, v = torch.broadcast_tensors(u, v)
        weights = torch.tensor(self.weights, dtype=torch.float64, device=u.device)
        index, inner = (part.reshape(u.shape) for part in choose(weights, u.reshape(-1)))
        dx, dy = torch.empty_like(inner), torch.empty_like(inner)
        for k, component in enumerate(self.components):
            own = index == k
            dx[own], dy[own] = component.sample(inner[own], v[own])
        return dx, dy

    def pdf(self, dx: Tensor, dy: Tensor) -> Tensor:
        parts = [weight * part.pdf(dx, dy) for weight, part in zip(self.weights, self.components, strict=True)]
        return torch.stack(parts).sum(0)


def choose(weights: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
    """Choose among K cells by u, and stretch u to [0, 1) within its cell.

    weights: (K, *S) float64, nonnegative, of sum 1 over dim 0. u: (n, *S) in [0, 1).
    Returns the cell (n, *S) int64, never one of weight 0, and the position in it (n, *S) in [0, 1), of u's dtype.
    Both grow with u. A sum of the weights a little off 1 is made good.
    """
    cell, inside = invert(running_sums(weights, 0), torch.zeros_like(u, dtype=torch.int64), len(weights), u)
    return cell, inside.to(u.dtype).clamp_max(1 - torch.finfo(u.dtype).eps / 2)


def running_sums(masses: Tensor, dim: int) -> Tensor:
    """The sums of the first 0, 1, ... K of the K entries along `dim`, which grows to K + 1.

    Added one by one: a parallel scan, as torch.cumsum is on some devices, rounds so that an entry of 0 may get a share.
    """
    sums = [torch.zeros_like(masses.select(dim, 0))]
    for part in masses.unbind(dim):
        sums.append(sums[-1] + part)
    return torch.stack(sums, dim)


def invert(sums: Tensor, first: Tensor, count: int, u: Tensor) -> tuple[Tensor, Tensor]:
    """Invert the cumulative sums of `count` cells, those of sums[first .. first + count], at u times the last of them.

    sums: (L, *S) float64, which holds one or more tables end to end; first: (n, *S) int64; u: (n, *S).
    Returns the cell (n, *S), 0 .. count - 1 and of mass > 0, and the position in it in [0, 1], in float64.
    """
    # Flat, and steps by addition: gather and where take two and five times as long.
    flat, width = sums.flatten(), sums[0].numel()
    at = (first * width + torch.arange(width, device=u.device).reshape(sums.shape[1:])).flatten()
    last = at + count * width
    total = flat.index_select(0, last)
    # Strictly below the last sum: then the cell found has a right end above the target, so mass, whatever rounds.
    target = torch.minimum(u.flatten() * total, torch.nextafter(total, torch.zeros_like(total)))
    cell = torch.zeros_like(at)
    for bit in reversed(range((count - 1).bit_length())):
        ahead = torch.minimum(at + width * 2**bit, last)
        right = flat.index_select(0, ahead) <= target
        at, cell = at.add(right, alpha=width * 2**bit), cell.add(right, alpha=2**bit)
    below = flat.index_select(0, at)
    inside = (target - below) / (flat.index_select(0, at + width) - below)
    return cell.reshape(u.shape), inside.reshape(u.shape)
