"""What the code that runs is inside of: a transform of torch.func, or an f that is followed."""

from __future__ import annotations

from typing import Any

import torch
from torch.overrides import _get_current_function_mode_stack

functorch: Any = torch._C._functorch  # pyright: ignore[reportAttributeAccessIssue]


def transformed() -> bool:
    """Whether the code that runs is inside vmap, grad or another transform, where no value can be looked at."""
    return functorch.peek_interpreter_stack() is not None


def differentiated() -> bool:
    """Whether one of the transforms that it is inside takes derivatives."""
    kinds = functorch.TransformType
    return any(level.key() in (kinds.Grad, kinds.Jvp) for level in functorch.get_interpreter_stack() or ())


def watched() -> bool:
    """Whether it is inside an f whose decisions are followed, by a `Watch`."""
    return any(getattr(mode, "follows", False) for mode in _get_current_function_mode_stack())
