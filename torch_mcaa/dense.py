"""What a tensor is, to those who need its values one by one, and to those who must say what they got in its place."""

from __future__ import annotations

from typing import TypeGuard

import numpy as np
import torch
from torch import Tensor


def dense(value: object) -> TypeGuard[Tensor]:
    """Whether it is a tensor whose values lie in memory one by one: none that is nested, sparse or on meta."""
    return isinstance(value, Tensor) and not value.is_nested and value.layout == torch.strided and value.device.type != "meta"


def pictures(value: object) -> TypeGuard[Tensor]:
    """Whether it is a dense tensor of floating point numbers that is not empty."""
    return dense(value) and value.is_floating_point() and value.numel() > 0


def described(value: object) -> str:
    """A few words for a message."""
    if isinstance(value, Tensor):
        if value.is_nested:
            return "a nested tensor"
        kind = "" if value.layout == torch.strided else f" and layout {value.layout}"
        place = " on meta, where there are no values" if value.device.type == "meta" else ""
        return f"a tensor of shape {tuple(value.shape)} and dtype {value.dtype}{kind}{place}"
    if isinstance(value, np.ndarray):
        return f"a numpy array of shape {value.shape} and dtype {value.dtype}"
    if isinstance(value, (tuple, list)):
        return f"a {type(value).__name__} of {len(value)}"
    return f"{type(value).__name__} {value!r}"[:120]
