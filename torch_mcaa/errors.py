"""What this library raises and warns with."""

from __future__ import annotations

import os
import sys
import warnings

import torch

HOMES = tuple(os.path.dirname(os.path.abspath(file)) + os.sep for file in (__file__, str(torch.__file__)))
"""Our code, and PyTorch's."""


class McaaError(ValueError):
    """Something a user passed, or a user's function returned, cannot be used; the message says what, and the mend."""


class McaaWarning(UserWarning):
    """The result stands, but not for everything that was asked."""


def warn(message: str) -> None:
    """Warn (`McaaWarning`) at the innermost line of code that is neither ours nor PyTorch's: the user's call, or their `backward()`."""
    frame, level = sys._getframe(1), 2
    while frame.f_back is not None and frame.f_code.co_filename.startswith(HOMES):
        frame, level = frame.f_back, level + 1
    warnings.warn(message, McaaWarning, stacklevel=level)
