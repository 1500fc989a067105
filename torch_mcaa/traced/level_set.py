"""Jumps that f declares."""

from __future__ import annotations

from torch import Tensor
from torch.overrides import handle_torch_function, has_torch_function_unary

from torch_mcaa.dense import described
from torch_mcaa.errors import McaaError
from torch_mcaa.traced.decisions import floating


def level_set(g: Tensor) -> Tensor:
    """Declare, inside f, that f may jump where g crosses zero: for jumps in code that PyTorch does not show, such as a kernel or numpy.

    Comparisons, `floor`, `argmin` and the like need no declaration. What is returned may be used or not.

    >>> import torch
    >>> level_set(torch.tensor([-0.5, 2.0]))
    tensor([False,  True])

    Args:
        g: floating point, of the points' shape, differentiable in x, y and the parameters that move the jump.

    Returns:
        g > 0, a bool tensor.

    Raises:
        McaaError: g is no floating point tensor.
    """
    if not floating(g):
        raise McaaError(
            f"level_set takes a floating point tensor of the points' shape, got {described(g)}; pass what crosses zero at the jump"
        )
    if has_torch_function_unary(g):
        return handle_torch_function(level_set, (g,), g)
    return g > 0
