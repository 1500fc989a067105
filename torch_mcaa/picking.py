"""Taking some of many along the last axis, several times faster than indexing does."""

from __future__ import annotations

import torch
from torch import Tensor


def numbers(index: Tensor) -> Tensor:
    """Integers (N,): those at which a bool index is true, or the index itself."""
    return index.nonzero()[:, 0] if index.dtype == torch.bool else index


def pick(values: Tensor, index: Tensor) -> Tensor:
    """values[..., index] for integers (N,)."""
    # index_select goes through more than one row number by number
    return values.index_select(0, index) if values.dim() == 1 else values.gather(-1, index.expand(*values.shape[:-1], -1))
