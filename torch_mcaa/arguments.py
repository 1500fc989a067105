"""What a user passes to `render`, checked."""

from __future__ import annotations

import math

import torch

from torch_mcaa.errors import McaaError
from torch_mcaa.estimators import Task
from torch_mcaa.filters import Filter
from torch_mcaa.grid import Screen
from torch_mcaa.integrand import Function, Integrand
from torch_mcaa.rng import check_seed
from torch_mcaa.texture import Texture
from torch_mcaa.traced.inside import watched


def task_of(
    f: Function,
    screen: Screen,
    filter: Filter,
    boundary: str,
    nonfinite: str,
    seed: int,
    dtype: torch.dtype,
    device: torch.device | str | None,
    placed_once: bool = True,
) -> Task:
    """The `Task` of the arguments of `render`; `placed_once`: a `Texture` covers the screen once.

    Raises:
        McaaError: an argument that cannot be used.
    """
    if watched():
        raise McaaError(
            "a picture cannot be made inside an f whose decisions are followed; make it before, and let f read it: Texture(picture)"
        )
    if not callable(f):
        raise McaaError(f"f must be a function of two tensors x, y, got {type(f).__name__}; wrap an image in Texture(image)")
    if isinstance(f, type):
        raise McaaError(f"f must be a function of two tensors x, y, got the class {f.__name__}; pass an instance of it")
    if not isinstance(filter, Filter):
        raise McaaError(f"filter must be a filter such as Gaussian(0.5) or Box(), got {filter!r}")
    if boundary not in ("extend", "zero", "renormalize"):
        raise McaaError(f"boundary must be 'extend', 'zero' or 'renormalize', got {boundary!r}")
    if nonfinite not in ("raise", "ignore", "propagate"):
        raise McaaError(f"nonfinite must be 'raise', 'ignore' or 'propagate', got {nonfinite!r}")
    check_seed(seed)
    if dtype not in (torch.float32, torch.float64):
        raise McaaError(f"dtype must be torch.float32 or torch.float64, got {dtype}; f itself may return any real dtype")
    if math.isinf(max(filter.radius)) and boundary != "zero":
        raise McaaError(
            f"{filter} reaches over the whole plane, where |w| has no finite integral, so no estimate of it has a finite variance; "
            f"got boundary={boundary!r}: pass boundary='zero', or take Lanczos(3)"
        )
    try:
        placed = torch.empty(0, device="cpu" if device is None else device).device
    except (RuntimeError, TypeError, AssertionError) as error:
        raise McaaError(
            f"device {device!r} cannot be used: {str(error).splitlines()[0]}; pass device='cpu' or one that is there"
        ) from error
    if placed.type == "meta":
        raise McaaError("device 'meta' cannot be used: it holds no values; pass device='cpu'")
    bound = f
    if placed_once and isinstance(f, Texture):
        bound = f.on((screen.height, screen.width))
    return Task(screen, Integrand(bound, dtype, nonfinite), filter, boundary, seed, dtype, placed)
