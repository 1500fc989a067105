"""What a pattern of points is."""

from __future__ import annotations

from abc import ABC, abstractmethod

import torch
from torch import Tensor

from torch_mcaa import rng
from torch_mcaa.errors import McaaError

__all__ = ["Pattern"]


class Pattern(ABC):
    """Points in [0, 1)**2 for every pixel, by random access: (seed, pixel, round, index) -> (u, v), no state.

    Each pixel and each round is randomised by itself, and each point alone is uniform, so the mean of a
    function over the points is unbiased.
    """

    @abstractmethod
    def count(self, n: int) -> int:
        """The largest number of points <= n that the pattern can have. Raises McaaError for n < 1."""

    @abstractmethod
    def points(
        self, n: int, rows: Tensor, cols: Tensor, *, seed: int, round: int, dtype: torch.dtype = torch.float32
    ) -> tuple[Tensor, Tensor]:
        """u, v, each (n, R, C) of `dtype` (float32 or float64) in [0, 1).

        rows, cols: integer tensors of pixel coordinates, in any order, negative ones too: (R,) and (C,) for all pixels of a grid, or both
        (R, C) for R C pixels of any kind. seed: int in [0, 2**64). round: int, a new randomisation for each. Raises McaaError where n
        is not `count(n)` or an argument cannot be used.
        """

    @abstractmethod
    def variance(self, terms: Tensor, u: Tensor, v: Tensor) -> Tensor:
        """The estimated variance (R, C) of the sum over dim 0 of `terms` (n, R, C), as calibrated for the pattern.

        u, v: (n, R, C), the points that the terms came from, in the order of `points`. +inf for n = 1, where
        nothing can be known. 0 where all terms of a pixel are equal: a pixel alone cannot tell a flat f from
        an edge that fell between its points, so the caller pools over neighbours and keeps a floor.
        """


def check_count(n: int) -> None:
    if n < 1:
        raise McaaError(f"a pattern needs n >= 1 points, received n = {n}: ask for at least one")


def check_points(pattern: Pattern, n: int, rows: Tensor, cols: Tensor, dtype: torch.dtype) -> None:
    if pattern.count(n) != n:
        raise McaaError(f"{pattern} has no set of {n} points: ask for count({n}) = {pattern.count(n)}")
    if not (rows.dim() == cols.dim() == 1 or (rows.dim() == 2 and rows.shape == cols.shape)):
        shapes = f"{tuple(rows.shape)} and {tuple(cols.shape)}"
        raise McaaError(f"rows and cols must have shapes (R,) and (C,), or one shape (R, C), received {shapes}: flatten them")
    if dtype not in (torch.float32, torch.float64):
        raise McaaError(f"dtype must be torch.float32 or torch.float64, received {dtype}: convert after")


def grid(rows: Tensor, cols: Tensor) -> tuple[Tensor, Tensor]:
    """Row and column of each pixel, of shapes that broadcast to (R, C), from either form of a pattern's arguments."""
    return (rows[:, None], cols[None, :]) if rows.dim() == 1 else (rows, cols)


def jitter(stream: int, n: int, rows: Tensor, cols: Tensor, seed: int, round: int, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    """Two independent uniform numbers a point, each (n, R, C). `stream`: a key of the pattern's own."""
    index = torch.arange(n, device=rows.device)[:, None, None]
    u, v = (rng.uniform(seed, stream, axis, round, *grid(rows, cols), index, dtype=dtype) for axis in (0, 1))
    return u, v


def independent_variance(terms: Tensor) -> Tensor:
    """n / (n - 1) sum (t - mean)**2: the variance of a sum of n independent terms; +inf for n = 1."""
    n = terms.shape[0]
    if n == 1:
        return torch.full_like(terms[0], torch.inf)
    return (terms - terms.mean(0)).square_().sum(0).mul_(n / (n - 1))


def skewness_factor(terms: Tensor) -> Tensor:
    """1 + 3/2 g**2 / n, g the skewness of n independent terms along dim 0: what makes the interval about a skewed mean long enough.

    A mean that lies low has a small variance with it, so the normal interval is missed above it (Johnson 1978). Binomials of n p (1 - p) >= 5 are
    then covered .93 or more of the time at n = 64, by s**2 / n .91; symmetric terms are left alone. The factor is measured.
    """
    deviation = terms - terms.mean(0)
    squares = deviation.square().sum(0)
    cubes = (deviation.square() * deviation).sum(0).square()
    return 1 + (1.5 * cubes / squares**3).nan_to_num(nan=0.0, posinf=0.0)


def clamp_below_one(u: Tensor) -> Tensor:
    """In place. A sum such as 3 + (1 - 2**-24) rounds up in float32: a quarter of it would be 1."""
    return u.clamp_(max=1 - torch.finfo(u.dtype).eps / 2)
