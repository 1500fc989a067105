"""Derivatives of what f returned."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.utils.checkpoint import CheckpointError

from torch_mcaa.errors import McaaError


def derivatives(
    outputs: Sequence[Tensor], inputs: Sequence[Tensor], weights: Sequence[Tensor] | None = None
) -> tuple[Tensor | None, ...]:
    """Of the sum of the outputs, or of their products with `weights`, by each input; None for one that is not reached.

    Raises:
        McaaError: f changes in place what its own derivative needs, or uses an operation whose derivative PyTorch does not have.
    """
    try:
        return torch.autograd.grad(outputs, inputs, weights, allow_unused=True)
    except CheckpointError as error:
        raise McaaError(
            "f uses torch.utils.checkpoint inside, which asks parts of it again without the layer's knowledge; leave it out: the layer keeps no "
            "more of f than a block of samples needs"
        ) from error
    except RuntimeError as error:
        if "is not implemented" in str(error) or "no autograd formula was registered" in str(error):
            raise McaaError(f"f uses an operation that PyTorch cannot differentiate: {error}; give it detached tensors") from error
        if "inplace" not in str(error):
            raise
        raise McaaError(
            f"f changes a tensor in place whose value its derivative needs: {error}; write r = r - p in the place of r -= p"
        ) from error
