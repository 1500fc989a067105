"""numba with Intel's vector mathematics.

Since 0.62 numba no longer turns SVML on by itself, because llvmlite lost its patch. LLVM has had SVML of its own since, and up to
0.65 (LLVM 20) the option for it reaches the loop vectoriser; in 0.66 (LLVM 22) it does not, which is why the extra `bench` ends there. It has
to be set before numba is imported. `vectorised` says whether compiled code calls it.
"""

from __future__ import annotations

import ctypes
import importlib
import sys
from functools import cache
from pathlib import Path
from typing import Any

import torch


def libraries() -> list[Path]:
    """SVML's, or none."""
    found = [Path(sys.prefix) / "lib" / name for name in ("libintlc.so.5", "libsvml.so")]
    return found if all(library.exists() for library in found) else []


@cache
def numba() -> Any:
    """The module, with SVML where it is installed, on as many threads as PyTorch."""
    if "numba" in sys.modules:
        raise RuntimeError("numba was imported before SVML was turned on: import it through peers.compiler")
    if libraries():
        binding: Any = importlib.import_module("llvmlite.binding")
        for library in libraries():
            ctypes.CDLL(str(library), ctypes.RTLD_GLOBAL)
            binding.load_library_permanently(str(library))
        binding.set_option("", "-vector-library=SVML")
    module = importlib.import_module("numba")
    module.config.THREADING_LAYER = "workqueue"  # under OpenMP numba would set PyTorch's number of threads, too
    module.set_num_threads(min(torch.get_num_threads(), module.config.NUMBA_NUM_THREADS))
    return module


def vectorised(dispatcher: Any) -> bool:
    """Whether a compiled function calls SVML."""
    return any("__svml_" in code for code in dispatcher.inspect_asm().values())
