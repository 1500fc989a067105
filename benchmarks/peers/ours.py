"""Our own methods in the form of a peer, eager and compiled."""

from __future__ import annotations

import warnings
from functools import cache
from typing import Any

import torch

import torch_mcaa as mcaa

from .base import Outcome, Peer
from .cases import Case


@cache
def uncompiled(estimator: mcaa.Estimator) -> str:
    """Why `render` does not compile f for an estimator here; "" where it does."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", mcaa.McaaWarning)  # it says so where f runs eagerly after all
            mcaa.render(lambda x, y: torch.cos(x) * y, (64, 64), estimator=estimator, compile=True)
    except (mcaa.McaaError, mcaa.McaaWarning) as problem:
        return str(problem)
    return ""


def _render(case: Case, spp: int, seed: int, **more: Any) -> Outcome:
    picture = mcaa.render(case.scene, (case.size, case.size), spp=spp, seed=seed, **more)
    return Outcome(picture.image[0], picture.evaluations)


def auto(case: Case, spp: int, seed: int) -> Outcome:
    return _render(case, spp, seed, compile=False)


def shared(case: Case, spp: int, seed: int) -> Outcome:
    return _render(case, spp, seed, estimator=mcaa.Shared(), compile=False)


def shared_compiled(case: Case, spp: int, seed: int) -> Outcome:
    return _render(case, spp, seed, estimator=mcaa.Shared(), compile=True)


BUDGETS = (1, 2, 3, 4, 5, 8, 16, 64, 256)
OURS = [Peer("Auto()", "ours", function="auto", budgets=BUDGETS), Peer("Shared()", "ours", function="shared", budgets=BUDGETS)]
COMPILED = Peer("Shared(), compiled", "ours", function="shared_compiled", budgets=(4, 16, 64, 256), warms=True)
