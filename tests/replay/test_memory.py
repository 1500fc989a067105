"""The layer's memory does not grow with the samples, forward or backward, where f jumps and is followed too."""

from __future__ import annotations

import weakref
from collections import Counter
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

import torch_mcaa as mcaa
from torch_mcaa.estimators.base import Estimator


class Live(TorchDispatchMode):
    """The bytes of the storages of tensors that are alive, and the most there were."""

    def __init__(self) -> None:
        super().__init__()
        self.peak = self._now = 0
        self._tensors: Counter[int] = Counter()
        self._bytes: dict[int, int] = {}

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        result = func(*args, **(kwargs or {}))
        for tensor in tree_leaves(result):
            if isinstance(tensor, Tensor):
                storage = tensor.untyped_storage()
                key = storage._cdata
                if key not in self._bytes:
                    self._bytes[key] = storage.nbytes()
                    self._now += storage.nbytes()
                self._tensors[key] += 1
                weakref.finalize(tensor, self._gone, key)
        self.peak = max(self.peak, self._now)
        return result

    def _gone(self, key: int) -> None:
        self._tensors[key] -= 1
        if not self._tensors[key]:
            self._now -= self._bytes.pop(key)


@pytest.mark.parametrize(("estimator", "most"), [(mcaa.Auto(), 1.2), (mcaa.Shared(), 1.5)], ids=str)
def test_memory_at_256_samples_is_hardly_that_at_16(estimator: Estimator, most: float) -> None:
    peaks = []
    for spp in (16, 256):
        radius = torch.tensor(80.0, requires_grad=True)
        layer = mcaa.Supersampler((256, 256), spp=spp, estimator=estimator)
        with Live() as live:
            layer(lambda x, y, r=radius: (torch.hypot(x - 130, y - 120) < r).to(x)).square().sum().backward()
        peaks.append(live.peak)
    # a picture has 0.25 MiB, and one block of samples 0.5
    assert peaks[1] < most * peaks[0] < 24 * 2**20
