"""Counter-based random bits: every number is a pure function of a seed and integer keys; there is no state.

The hash is `lowbias32` of C. Wellons ("Prospecting for Hash Functions", 2018,
https://nullprogram.com/blog/2018/07/31/), chained over the keys. It runs in int32 with wrap-around: PyTorch
vectorises and compiles that, and integers have the same bits on every device.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from torch_mcaa.errors import McaaError

__all__ = ["bits", "check_seed", "uniform"]

_MASK = 0xFFFFFFFF
_MULTIPLIERS = 0x7FEB352D, 0x846CA68B
_SEED, _KEY, _LOW = 0x9E3779B9, 0x85EBCA6B, 0x27D4EB2F


def bits(seed: int, *keys: int | Tensor) -> Tensor:
    """32 random bits for each combination of keys: int64, 0 .. 2**32 - 1, of the keys' broadcast shape.

    seed: int in [0, 2**64). keys: ints in [-2**63, 2**63) or integer tensors; an int and a tensor that holds
    it give the same number, and the order of the keys matters. Put large tensors last: each is hashed at the
    broadcast shape of those up to it. Like any 32-bit numbers, those of N keys contain about N**2 / 2**33
    equal pairs.

    Raises McaaError for a seed or an int out of range, or a key that is not of an integer type.
    """
    h = _hash(seed, _folded(keys))
    return torch.tensor(h) if isinstance(h, int) else h.to(torch.int64) & _MASK


def uniform(seed: int, *keys: int | Tensor, dtype: torch.dtype = torch.float32) -> Tensor:
    """Uniform numbers in [0, 1), never 1, of the keys' broadcast shape.

    They are multiples of 2**-24 in float32 and of 2**-53 in float64: the float32 number is the float64 one of
    the same keys, cut to 24 bits. Arguments and errors are those of `bits`; McaaError too for any other
    dtype.
    """
    if dtype not in (torch.float32, torch.float64):
        raise McaaError(f"dtype must be torch.float32 or torch.float64, received {dtype}: convert after")
    folded = _folded(keys)
    high = _tensor(_hash(seed, folded))
    if dtype == torch.float32:
        return _logical_shift(high, 8).to(dtype).mul_(2.0**-24)
    # The low bits come from a second stream, not from `high`: else float64 would know only 2**32 values.
    low = _tensor(_hash(seed, (*_folded((_LOW,)), *folded)))
    return _logical_shift(high, 5).to(dtype).mul_(2.0**-27).add_(_logical_shift(low, 6), alpha=2.0**-53)


def check_seed(seed: object) -> None:
    """Raises McaaError for what is no seed."""
    if isinstance(seed, bool) or not isinstance(seed, int) or not 0 <= seed < 2**64:
        raise McaaError(f"seed must be an integer from 0 to 2^64 - 1, got {seed!r}")


def _hash(seed: int, folded: Sequence[int | Tensor]) -> int | Tensor:
    """The chain over `_folded` keys: an unsigned int while all were ints, an int32 tensor from the first tensor on."""
    if not 0 <= seed < 1 << 64:
        raise McaaError(f"seed must be an int in [0, 2**64), received {seed}: reduce it modulo 2**64")
    state: int | Tensor = _mix_int(_mix_int(seed >> 32 ^ _SEED) ^ seed & _MASK)
    for key in folded:
        if isinstance(state, int):
            if isinstance(key, int):
                state = _mix_int(state + key & _MASK)
                continue
            state, key = key, state
        state = _mix(state + (_signed(key) if isinstance(key, int) else key))
    return state


def _folded(keys: tuple[int | Tensor, ...]) -> list[int | Tensor]:
    """Each key, hashed.

    A raw one would let two whole rows of pixels share their streams wherever two states differ in low bits only. They meet in a sum, since an
    exclusive or would make chance meetings come in pairs, (r, c) with (s, d) and (r, d) with (s, c).
    """
    return [_fold(key) if isinstance(key, Tensor) else _fold_int(_checked(key)) for key in keys]


def _checked(key: int) -> int:
    if not -(1 << 63) <= key < 1 << 63:
        raise McaaError(f"a key must lie in [-2**63, 2**63), received {key}: reduce it to 64 bits")
    return key


def _fold_int(key: int) -> int:
    return _mix_int(_mix_int(key >> 32 & _MASK ^ _KEY) ^ key & _MASK)


def _fold(key: Tensor) -> Tensor:
    if key.is_floating_point() or key.is_complex() or key.dtype == torch.bool:
        raise McaaError(f"a key must be an int or an integer tensor, received {key.dtype}: use torch.int64")
    key = key.to(torch.int64)
    high = (key >> 32).to(torch.int32).bitwise_xor_(_signed(_KEY))
    return _mix(_mix(high).bitwise_xor_(key.to(torch.int32)))


def _mix_int(x: int) -> int:
    x = (x ^ x >> 16) * _MULTIPLIERS[0] & _MASK
    x = (x ^ x >> 15) * _MULTIPLIERS[1] & _MASK
    return x ^ x >> 16


def _mix(x: Tensor) -> Tensor:
    """lowbias32 in place."""
    x ^= _logical_shift(x, 16)
    x *= _signed(_MULTIPLIERS[0])
    x ^= _logical_shift(x, 15)
    x *= _signed(_MULTIPLIERS[1])
    x ^= _logical_shift(x, 16)
    return x


def _logical_shift(x: Tensor, count: int) -> Tensor:
    return (x >> count).bitwise_and_(_MASK >> count)


def _tensor(x: int | Tensor) -> Tensor:
    return torch.tensor(_signed(x), dtype=torch.int32) if isinstance(x, int) else x


def _signed(x: int) -> int:
    return x - (1 << 32) if x >> 31 else x
