"""Whether code runs inside a transform of torch.func."""

from __future__ import annotations

from typing import Any

import torch

functorch: Any = torch._C._functorch  # pyright: ignore[reportAttributeAccessIssue]


def transformed() -> bool:
    """Whether the code that runs is inside vmap, grad or another transform, where no value can be looked at."""
    return functorch.peek_interpreter_stack() is not None


def differentiated() -> bool:
    """Whether one of the transforms that it is inside takes derivatives."""
    kinds = functorch.TransformType
    return any(level.key() in (kinds.Grad, kinds.Jvp) for level in functorch.get_interpreter_stack() or ())
