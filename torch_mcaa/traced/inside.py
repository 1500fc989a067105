"""Whether code runs inside a transform of torch.func."""

from __future__ import annotations

from typing import Any

import torch

functorch: Any = torch._C._functorch  # pyright: ignore[reportAttributeAccessIssue]


def transformed() -> bool:
    """Whether the code that runs is inside vmap, grad or another transform, where no value can be looked at."""
    return functorch.peek_interpreter_stack() is not None
