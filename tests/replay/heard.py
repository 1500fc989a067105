"""What a layer warns of."""

from __future__ import annotations

import warnings
from typing import Any

import torch_mcaa as mcaa


def said(f: Any, size: tuple[int, int] = (32, 32), **arguments: Any) -> list[str]:
    """The warnings of a layer's first call."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        mcaa.Supersampler(size, estimator=mcaa.Shared(), **arguments)(f)
    return [str(w.message) for w in caught]
