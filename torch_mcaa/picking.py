"""Taking some of many along the last axis, several times faster than indexing does."""

from __future__ import annotations

import torch
from torch import Tensor


def numbers(index: Tensor) -> Tensor:
    """Integers (N,): those at which a bool index is true, or the index itself."""
    return index.nonzero()[:, 0] if index.dtype == torch.bool else index


def pick(values: Tensor, index: Tensor) -> Tensor:
    """values[..., index] for integers (N,)."""
    return values.index_select(-1, index)
