"""Which lattice suits an f of known frequencies: the smallest whose dual vectors these miss."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from torch import Tensor

from torch_mcaa.estimators.bandwidth import Bandwidth
from torch_mcaa.estimators.steepness import Steepness
from torch_mcaa.patterns.nested import Nested, distances, nested

_FIRST, _MOST = 16, 32
"""Points of the largest lattice that is tried, at first and in the end."""
_BEYOND = 1.1
"""How much higher than they seem f's frequencies may be for the lattice that checks."""
_GAIN = 4.0
"""What twice as many points divide the error by: that of a bend in f, or of a step of about a pixel."""


@dataclass(frozen=True)
class Suited:
    """A lattice and what it was chosen by: tones (T, 2), how far they have to be from its dual vectors and their halves (2, T).

    `length`, the shortest dual vector that is enough in any direction, in cycles a pixel; `steepest` as in `Steepness`.
    """

    lattice: Nested
    tones: np.ndarray
    margins: np.ndarray
    length: float
    steepest: Tensor

    def finer(self, excess: float) -> Suited | None:
        """With twice as many points, if that can end an error of `excess` times what is allowed before they are too many."""
        if excess > _GAIN ** math.floor(math.log2(_MOST / self.lattice.count)):
            return None
        finer = self.lattice.finer()
        spare = _spare(finer, self.tones, self.margins)
        return replace(self, lattice=finer[int(spare.argmax())], length=_BEYOND**2 * self.length)


def _spare(lattices: Sequence[Nested], tones: np.ndarray, margins: np.ndarray) -> np.ndarray:
    """(lattices,): how much further than asked the nearest of the tones is."""
    return (np.stack(distances(lattices, tones)) - margins[:, None]).min((0, 2))


def choose(bandwidth: Bandwidth, steep: Steepness, allowed: Tensor, smooth: Tensor) -> list[Suited | None]:
    """For each block the smallest `Nested` lattice that errs by no more than is `allowed` (C, blocks), and tells so itself.

    None where f is not `smooth` (blocks,), and where it would take more than two lattices of `Bandwidth.points`, which have to agree.
    """
    margins = bandwidth.margins(steep.std, allowed)
    plain = bandwidth.points(steep.frequency, steep.std, allowed).tolist()
    length = bandwidth.length(_BEYOND * steep.frequency, steep.std, allowed).amax(0).tolist()
    lattices, found = nested(_FIRST), []
    for block, tones in enumerate(steep.tones.transpose(0, 1)):
        apart = margins[:, :, block].repeat_interleave(tones.shape[1], 1).numpy()
        some = [each for each in lattices if each.count <= 2 * plain[block]]
        frequencies = tones.flatten(0, 1).numpy()
        fit = (_spare(some, frequencies, apart) >= 0) & bool(smooth[block])
        lattice = some[int(fit.argmax())]
        found.append(Suited(lattice, frequencies, apart, length[block], steep.steepest[block]) if fit.any() else None)
    return found
