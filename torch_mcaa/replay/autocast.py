"""f under the autocast of the forward pass, the samples' sums in their own precision."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torch_mcaa.integrand import Function
from torch_mcaa.texture import Texture


@dataclass(frozen=True)
class Autocast:
    """The state of autocast for a type of device: the dtype that operations are cast to, or None where it is off."""

    device: str
    dtype: torch.dtype | None

    @classmethod
    def now(cls, device: str) -> Autocast:
        return cls(device, torch.get_autocast_dtype(device) if torch.is_autocast_enabled(device) else None)

    def of(self, f: Function) -> Function:
        """f in this state wherever it is called; a texture, which has nothing to cast, as it is."""
        if self.dtype is None or isinstance(f, Texture):
            return f

        def cast(x: Tensor, y: Tensor) -> object:
            # what is cast without grad mode must not be found again with it
            with torch.autocast(self.device, self.dtype, cache_enabled=False):
                return f(x, y)

        return cast
