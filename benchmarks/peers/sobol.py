"""The first two coordinates of the Sobol' sequence, as 32 bits in reversed order."""

from __future__ import annotations

import numpy as np


def reversed_bits(count: int) -> tuple[np.ndarray, np.ndarray]:
    """uint32: the index itself, which is the van der Corput sequence reversed, and the second coordinate (primitive polynomial x + 1)."""
    index = np.arange(count, dtype=np.uint32)
    second, direction = np.zeros(count, np.uint32), np.uint32(1)
    for bit in range(32):
        second ^= np.where(index >> np.uint32(bit) & np.uint32(1), direction, np.uint32(0))
        direction = direction ^ (direction << np.uint32(1))
    return index, second
