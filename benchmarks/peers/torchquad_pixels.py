"""torchquad's MonteCarlo, Simpson and VEGAS, over the unit square mapped to the Gaussian.

Fair: the map leaves f alone as the integrand, so that no weight adds to the error. The first two take a vector of integrands, f around many
pixels at the same points, which is torchquad's fastest form; Simpson has an odd number of points along each axis. VEGAS takes a
single integrand, so it goes pixel by pixel, with the number of iterations that suits so few points, on few pixels. All run on pixels that are
not flat, drawn at random, and their time is scaled to the whole picture: it does not depend on what is in a pixel.
"""

from __future__ import annotations

import math
import warnings
from typing import Any

import torch
from torch import Tensor

from .base import STD, Outcome
from .cases import Case
from .sobol_pixels import WITHIN

PIXELS, ALONE = 4096, 16
"""Pixels of the vector of integrands, and of the method that takes one at a time."""
BLOCK = 2**18
DOMAIN = [[0, 1], [0, 1]]


def _torchquad() -> Any:
    import torchquad
    from loguru import logger

    logger.disable("torchquad")  # it writes every integral
    return torchquad


def _asked(case: Case, points: Tensor, pixels: Tensor) -> Tensor:
    """f at points of the unit square mapped to the Gaussian around pixels, (points, pixels)."""
    x, y = (points.mul(2).sub_(1).mul_(WITHIN).erfinv_().mul_(STD * math.sqrt(2))).split(1, 1)
    return case.scene(x + (pixels % case.size + 0.5), y + (pixels // case.size + 0.5))


def _vector(case: Case, method: Any, spp: int, pixels: Tensor, **more: Any) -> Outcome:
    parts = [
        method.integrate(
            lambda points, some=some: _asked(case, points, some), dim=2, N=spp, integration_domain=DOMAIN, backend="torch", **more
        )
        for some in pixels.split(max(1, BLOCK // spp))
    ]
    return Outcome(torch.cat(parts), spp * len(pixels), pixels)


def monte_carlo(case: Case, spp: int, seed: int) -> Outcome:
    return _vector(case, _torchquad().MonteCarlo(), spp, case.some_pixels(PIXELS, seed), seed=seed)


def simpson(case: Case, spp: int, seed: int) -> Outcome:
    along = max(3, math.isqrt(spp) | 1)
    return _vector(case, _torchquad().Simpson(), along**2, case.some_pixels(PIXELS, seed))


def vegas(case: Case, spp: int, seed: int) -> Outcome:
    pixels, method = case.some_pixels(ALONE, seed), _torchquad().VEGAS()
    values, evaluations = [], 0
    for pixel in pixels.split(1):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # f can be 0 at all of so few points
            value = method.integrate(
                lambda points, one=pixel: _asked(case, points, one)[:, 0],
                dim=2,
                N=spp,
                integration_domain=DOMAIN,
                seed=seed,
                max_iterations=5,
                use_warmup=False,
                backend="torch",
            )
        values.append(value.reshape(()))
        evaluations += method._nr_of_fevals
    return Outcome(torch.stack(values), evaluations, pixels)
