"""Rank-1 lattices under a random shift: one unit square for a pixel by itself, strips of pixels for sharing."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from torch_mcaa import rng
from torch_mcaa.patterns.base import Pattern, check_count, check_points, grid
from torch_mcaa.patterns.lattice_search import best_generator, ranked_generators, reduced_basis
from torch_mcaa.patterns.lattice_table import STRIPS

# The squares of the three character sums, the larger of a pixel's and its neighbourhood's mean, over the variance of the lattice rule.
# Their sum alone is 3 times the variance on an edge across a dual vector (the sum over j >= 0 of 2 (j + 1/2)^-2 against that over j >= 1 of
# 2 j^-2) and on white noise, 7 times it on edges of all directions (n^-1.5 at a quarter of the points). 6.5 is measured: the 95 % interval
# then covers 0.93 to 1.0 of the pixels on edges, discs and lines under Gaussians of 0.35 to 1 px and the box (`benchmarks/accuracy.py`).
# Of noise it is 3.
CHARACTER_RATIO, NOISE_RATIO = 6.5, 3.0


@dataclass(frozen=True)
class Strip:
    """A lattice of `count` (odd) points in a strip 1 px wide and `period` px high that repeats over the screen.

    Attributes:
        x, y: float64 (count,) offsets in [0, 1) and [0, period) after the shift.
        basis: (2, 2) float64, the two shortest vectors between points, in pixels.
        characters: (3, count) of +-1: the non-trivial characters of the lattice modulo its double.
        parities: for each character, its sign's change (0 or 1) over one column and over one strip.
    """

    period: int
    x: np.ndarray
    y: np.ndarray
    basis: np.ndarray
    characters: np.ndarray
    parities: tuple[tuple[int, int], ...] = ((0, 1), (1, 0), (1, 1))

    @property
    def count(self) -> int:
        return len(self.x)

    def row_counts(self) -> np.ndarray:
        """(period,) points in each pixel of the strip."""
        return np.bincount(np.floor(self.y).astype(int).clip(0, self.period - 1), minlength=self.period)


@dataclass(frozen=True)
class Lattice(Pattern):
    """A rank-1 lattice with a uniform random shift (Cranley and Patterson, 1976; Sloan and Joe, 1994).

    Shared over the pixels it converges exponentially for f whose frequencies stay inside half its shortest dual vector, and as n^-0.75 on
    edges. Its weakness is a tone on a dual vector: constant on all its points. `Shared` watches for that with points off the lattice.
    """

    def count(self, n: int) -> int:
        check_count(n)
        return n - 1 + n % 2

    def points(
        self, n: int, rows: Tensor, cols: Tensor, *, seed: int, round: int, dtype: torch.dtype = torch.float32
    ) -> tuple[Tensor, Tensor]:
        check_points(self, n, rows, cols, dtype)
        generator = best_generator(n, 1)
        index = torch.arange(n, dtype=torch.float64, device=rows.device)[:, None, None]
        shift = [rng.uniform(seed, *grid(rows, cols), round, axis, dtype=torch.float64) for axis in (0, 1)]
        u, v = torch.remainder(index * generator, n) / n + shift[0], index / n + shift[1]
        below_one = 1 - torch.finfo(dtype).eps / 2
        return torch.frac(u).to(dtype).clamp_(max=below_one), torch.frac(v).to(dtype).clamp_(max=below_one)

    def variance(self, terms: Tensor, u: Tensor, v: Tensor) -> Tensor:
        """n / 2 times the weighted mean squared difference of neighbours along the two shortest vectors.

        Neighbours across the sides of the unit square weigh n^-0.5, those inside it 1. White noise is reported without bias, whatever the
        weights. Smooth f needs the first kind too: its periodic continuation jumps at the sides, and a weight of n^-0.5 on some n^0.5
        pairs keeps that share at the n^-2 of the true variance. The character sums that `Shared` uses need a function that is periodic.

        Measured for odd n from 21 to 131, 255, 257 and 301 (random half-planes, discs, quadratics, blobs and tones over the unit
        square): 1.2 to 12 times the true variance, least where the generator has a divisor in common with n; the 95 % interval covers at
        least 0.93 of the pixels. Fewer points can all fall on one side of an edge: on the worse of half-planes and discs it covers
        0.92 of the pixels at n = 15, 0.84 at n = 7 and 9, and 0.61 at n = 3.
        """
        n = terms.shape[0]
        if n < 3:
            return torch.full_like(terms[0], torch.inf)
        generator = best_generator(n, 1)
        dual = np.stack(reduced_basis(np.array([1.0, -float(generator)]), np.array([0.0, float(n)])))
        squares, total = torch.zeros_like(terms[0]), torch.zeros_like(terms[0])
        for step in np.linalg.inv(dual).T:
            # index i + k lies at `step` from index i, but for whole numbers
            k = round(float(step[1]) * n) % n
            inside = ((u.roll(-k, 0) - u - step[0]).abs() < 1e-6) & ((v.roll(-k, 0) - v - step[1]).abs() < 1e-6)
            weight = inside.to(terms.dtype).clamp_min_(n**-0.5)
            squares += ((terms.roll(-k, 0) - terms).square() * weight).sum(0)
            total += weight.sum(0)
        return squares / total * (n / 2)

    def period(self, spp: int) -> int:
        """Px: the height of the strip for `spp` evaluations a pixel."""
        return 1 if spp > max(STRIPS) else STRIPS[max(s for s in STRIPS if s <= spp)][0]

    def strip(
        self,
        spp: float,
        replicate: int,
        audited: bool,
        shift: tuple[float, float],
        lines: bool = False,
        mirrored: bool = False,
        sides: float | None = None,
        chosen: tuple[int, int, int] | None = None,
    ) -> Strip:
        """The strip for `spp` evaluations a pixel; other replicates have other generators, so no tone is on the dual vectors of all.

        With `audited` at least one evaluation of each strip is left over for a point off the lattice, but for spp = 1. With `lines` the
        period is 1, so that the points lie 1 px apart on lines along both axes, as many lines a pixel as points. The `mirrored` lattice has
        other dual vectors that are as long. With `sides` the shift is moved to where the lines lie halfway about that fraction of a pixel.
        With `chosen`, (period, count, generator), it is that one.
        """
        period, count, generator = chosen or STRIPS[max(s for s in STRIPS if s <= spp)]
        if chosen:
            mirrored = False
        elif replicate or not audited or lines or spp > max(STRIPS):
            period = 1 if lines or spp > max(STRIPS) else period
            count = math.floor(spp) * period - (1 if audited and spp > 1 else 0)
            count += count % 2 - 1
            ranked = ranked_generators(count, period)
            generator = ranked[replicate // 2 % len(ranked)][1]
        if (replicate + mirrored) % 2:
            generator = -generator % count
        if sides is not None:
            shift = tuple(sides + (np.floor(s * count) + 0.5) / count for s in shift)  # pyright: ignore[reportAssignmentType]
        index = np.arange(count)
        x, y = (generator * index % count) / count, period * index / count
        # k with g k_x + period k_y = 0 mod count, odd in the wanted places: k . p is an integer, its parity the character
        # a point that the shift moves out of the strip comes back in from the column or strip before, where the sign may be the other
        moved_x, moved_y = x + shift[0], y / period + shift[1]
        signs = []
        for a, b in Strip.parities:
            second = count * b if not a else (-generator % count)
            if a and second % 2 != b:
                second += count
            whole = (a * (generator * index % count) + second * index) // count
            signs.append(1 - 2 * ((whole + a * np.floor(moved_x).astype(int) + b * np.floor(moved_y).astype(int)) % 2))
        dual = np.stack(reduced_basis(np.array([1.0, -generator / period]), np.array([0.0, count / period])))
        return Strip(
            period,
            moved_x % 1.0,
            moved_y % 1.0 * period,
            np.linalg.inv(dual).T,
            np.array(signs),
        )
