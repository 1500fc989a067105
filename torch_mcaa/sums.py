"""Sums whose bits are the same each time."""

from __future__ import annotations

import torch
from torch import Tensor


def add_at(total: Tensor, index: Tensor, values: Tensor) -> Tensor:
    """total[..., index] += values (..., N), in place, for integers (N,) of which any may be equal: the values of each in one order.

    On a GPU `index_add_` and `bincount` add in whatever order threads come, and `index_put_` sorts.
    """
    if total.device.type == "cpu":
        return total.index_add_(-1, index, values)
    if total.dim() == 1:
        return total.index_put_((index,), values, accumulate=True)
    for row, some in zip(total, values, strict=True):
        add_at(row, index, some)
    return total


def add_rows(total: Tensor, index: Tensor, values: Tensor) -> Tensor:
    """total[..., index[i, p], p] += values[..., i, p] as `add_at`, for a contiguous total (..., S, P), index (n, P) and values (..., n, P)."""
    columns = total.shape[-1]
    flat = (index * columns + torch.arange(columns, device=index.device)).flatten()
    add_at(total.view(*total.shape[:-2], -1), flat, values.flatten(-2))
    return total
