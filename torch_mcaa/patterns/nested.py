"""Lattices that contain a grid of one point a pixel: what such a grid was asked for serves them too.

The dual of such a lattice is a lattice of whole numbers, so there are few of each size, and all can be tried against what is known of f.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from torch_mcaa.patterns.lattice_search import reduced_basis

_AROUND = np.stack(np.meshgrid(np.arange(-1, 2), np.arange(-1, 2)), -1).reshape(-1, 2)


@dataclass(frozen=True, eq=False)
class Nested:
    """A lattice with the same points in every pixel, of which the first is the grid's.

    Attributes:
        x, y: float64 (count,) offsets in [0, 1) from the grid's point.
        dual: int64 (2, 2), its two shortest independent dual vectors, in cycles a pixel.
    """

    x: np.ndarray
    y: np.ndarray
    dual: np.ndarray

    @property
    def count(self) -> int:
        return len(self.x)

    @property
    def characters(self) -> np.ndarray:
        """int64 (3, 2): the signs of the lattice modulo its double are (-1)^(k . p) for p from the grid's point, with these k."""
        return np.stack([self.dual[0], self.dual[1], self.dual[0] + self.dual[1]])

    def finer(self) -> list[Nested]:
        """The three lattices of twice as many points that begin with its own."""
        basis, found = np.linalg.inv(self.dual).T, []
        for odd in ((1, 0), (0, 1), (1, 1)):
            half = np.array(odd) @ basis / 2
            x, y = (np.concatenate([places, _inside(places + step)]) for places, step in ((self.x, half[0]), (self.y, half[1])))
            # the dual vectors that have an even product with the new points
            a, b = self.dual
            kept = {(1, 0): (2 * a, b), (0, 1): (a, 2 * b), (1, 1): (a + b, a - b)}[odd]
            found.append(Nested(x, y, np.stack(reduced_basis(*kept))))
        return found


def _inside(places: np.ndarray) -> np.ndarray:
    """In [0, 1), where rounding leaves a whole number a little less."""
    return places.round(12) % 1.0


@cache
def nested(most: int) -> tuple[Nested, ...]:
    """All of them with up to `most` points a pixel, the smallest first."""
    found = []
    for count in range(1, most + 1):
        for wide in (d for d in range(1, count + 1) if count % d == 0):
            tall = count // wide
            y = np.repeat(np.arange(tall) / tall, wide)
            for slant in range(tall):
                x = _inside((np.tile(np.arange(wide), tall) - slant * y) / wide)
                found.append(Nested(x, y, np.stack(reduced_basis(np.array([wide, slant]), np.array([0, tall])))))
    return tuple(found)


def distances(lattices: Sequence[Nested], tones: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How far tones (T, 2), in cycles a pixel, lie from the dual vectors but 0 of each lattice, and from the odd halves of them, (lattices, T)."""
    dual = np.stack([lattice.dual for lattice in lattices]).astype(np.float64)
    return _nearest(dual, tones, lambda index: (index == 0).all(-1)), _nearest(
        dual / 2, tones, lambda index: (index % 2 == 0).all(-1)
    )


def _nearest(basis: np.ndarray, tones: np.ndarray, without: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    place = tones @ np.linalg.inv(basis)
    index = np.rint(place)[:, :, None] + _AROUND
    apart = np.linalg.norm((place[:, :, None] - index) @ basis[:, None], axis=-1)
    return np.where(without(index), np.inf, apart).min(-1)
