"""The contract of f: what it is given, what it may return, and what is said when it does something else."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import torch
from torch import Tensor

from torch_mcaa.dense import described
from torch_mcaa.errors import McaaError

Function = Callable[[Tensor, Tensor], Any]
Nonfinite = Literal["raise", "ignore", "propagate"]

# PyTorch cuts loops of over 2^15 elements into equal parts, at most four for a block. A block's points are a multiple of 12 x 256, so that
# every part of every number of threads is whole vectors and no loop over points has a tail of scalars: in the tail atan2, sigmoid and pow
# give other last bits, and where it lies would depend on the number of threads. Of fewer points than are cut, pairs of vectors are enough: 64
# numbers of half precision.
_GRAIN = 2**15
_WHOLE, _FEW = 256, 64
# One call of f on a CPU sees at most this many points: few enough to stay in the cache, enough to pay for the call.
BLOCK = 4 * _GRAIN // (12 * _WHOLE) * (12 * _WHOLE)
_WIDE, _CALLED = 64, 16
"""What another device works on at once, and gives to one call of f, in blocks. What a call of a network keeps is hundreds of times its points."""


def width_of(device: torch.device) -> int:
    """What a device works on at once, in parts of what a CPU's cache holds: launching many small kernels is what a GPU is slow at."""
    return 1 if device.type == "cpu" else _WIDE


@dataclass
class Integrand:
    """f with its contract checked: `integrand(x, y)` returns C tensors of x's shape in `dtype`.

    Attributes:
        function: f(x, y) -> a tensor of x's shape, a tuple or list of C of them, or a (C, *shape) tensor; bool and integers count as numbers.
        dtype: the picture's dtype.
        nonfinite: what to do about NaN and infinities; anything but "raise" leaves them to the caller, who calls `invalid`.
        evaluations: the points f was called on so far.
        random: whether f was found to return something else for the same point.
        refused: why f was not compiled though it was to be; empty if it was, or was not to be.
    """

    function: Function
    dtype: torch.dtype = torch.float32
    nonfinite: Nonfinite = "raise"
    evaluations: int = field(default=0, init=False)
    channels: int = field(default=0, init=False)
    random: bool = field(default=False, init=False)
    refused: str = field(default="", init=False)

    def __call__(self, x: Tensor, y: Tensor) -> list[Tensor]:
        """Evaluate f at the points x, and y of a shape that expands to x's; f gets them in one row.

        Raises:
            McaaError: f raised (chained, with the block's place); it returned another shape, dtype, device or number of channels than
                it may; it returned NaN or an infinity under nonfinite="raise" (the first place is named).
        """
        values = self._called(x, y)
        if self.nonfinite == "raise":
            for channel, value in enumerate(values):
                # the sum is a cheap test that may cry wolf, on overflow
                if not math.isfinite(value.sum().item()) and not bool(torch.isfinite(value).all()):
                    first = tuple((~torch.isfinite(value)).nonzero()[0].tolist())
                    raise McaaError(
                        f"f returned {float(value[first])} at x = {float(x[first]):.9g}, y = {float(y.expand(x.shape)[first]):.9g} "
                        f"(channel {channel}); mend f, or what it reads; render alone passes over such samples, by nonfinite='ignore' or 'propagate'"
                    )
        return values

    def _called(self, x: Tensor, y: Tensor) -> list[Tensor]:
        """f's channels, whatever they are, by as many calls as the points need."""
        shape, count = x.shape, x.numel()
        block = BLOCK * min(width_of(x.device), _CALLED)
        if count > block and shape[0] > 1:
            step = max(1, block * shape[0] // count)
            parts = [self._called(a, b) for a, b in zip(x.split(step), y.expand(shape).split(step), strict=True)]
            return [torch.cat(channel) for channel in zip(*parts, strict=True)]
        x, y = _flat(x, shape), _flat(y, shape)
        self.evaluations += x.numel()
        try:
            returned = self.function(x, y)
        except Exception as error:
            (left, right), (top, bottom) = (torch.aminmax(t.detach()) for t in (x, y))
            place = f"x in [{float(left):g}, {float(right):g}], y in [{float(top):g}, {float(bottom):g}]"
            raise McaaError(f"f raised {type(error).__name__}: {error}; it was asked for {len(x)} points with {place}") from error
        values = [value[:count].view(shape) for value in channels_of(returned, x, self.dtype)]
        if self.channels not in (0, len(values)):
            raise McaaError(
                f"f returned {len(values)} channels where it had returned {self.channels}; return the same number at each call"
            )
        self.channels = len(values)
        return values

    @staticmethod
    def invalid(values: Sequence[Tensor]) -> Tensor | None:
        """Where any channel is not finite, a bool tensor; None where all is well."""
        if all(math.isfinite(value.sum().item()) for value in values):
            return None
        mask = ~torch.isfinite(torch.stack(list(values))).all(0)
        return mask if bool(mask.any()) else None


def from_points(network: Callable[[Tensor], Tensor]) -> Function:
    """Adapt a function on points, (N, 2) -> (N, C) or (N,), to f(x, y).

    A module with parameters is given points of their dtype.

    >>> f = from_points(lambda points: points.sum(-1))
    >>> f(torch.tensor([1.0, 2.0]), torch.tensor([10.0, 20.0]))
    (tensor([11., 22.]),)

    Raises:
        McaaError: when called, if `network` returns anything but (N, C) or (N,).
    """

    parameter = next(network.parameters(), None) if isinstance(network, torch.nn.Module) else None

    def f(x: Tensor, y: Tensor) -> tuple[Tensor, ...]:
        points = torch.stack([x.reshape(-1), y.reshape(-1)], -1)
        out = network(points if parameter is None else points.to(parameter.dtype))
        if not isinstance(out, Tensor) or out.ndim not in (1, 2) or out.shape[0] != x.numel():
            raise McaaError(f"a function on points must return (N, C) or (N,) with N = {x.numel()}, got {described(out)}")
        return tuple(channel.reshape(x.shape) for channel in out.reshape(x.numel(), -1).unbind(-1))

    return f


def channels_of(returned: object, x: Tensor, dtype: torch.dtype) -> list[Tensor]:
    """What f returned for points x as channels of x's shape in `dtype`.

    Raises:
        McaaError: another shape, dtype or device than f may return.
    """
    return [_checked(value, x, dtype) for value in as_channels(returned, x)]


def _flat(places: Tensor, shape: torch.Size) -> Tensor:
    """The places in one row, the last one repeated until the row is whole."""
    count = shape.numel()
    whole = _FEW if count <= _GRAIN else 12 * _WHOLE
    row = places.new_empty(-(-count // whole) * whole)
    row[:count].view(shape).copy_(places)
    if len(row) > count:
        row[count:].copy_(row[count - 1 : count])
    return row


def as_channels(returned: object, x: Tensor) -> Sequence[object]:
    """What f returned for x, channel by channel."""
    if isinstance(returned, Tensor):
        if returned.shape == x.shape:
            return [returned]
        if returned.ndim == x.ndim + 1 and returned.shape[1:] == x.shape and returned.shape[0] > 0:
            return returned.unbind(0)
    elif isinstance(returned, (tuple, list)) and returned:
        return returned
    raise McaaError(
        f"f must return a tensor of its input's shape {tuple(x.shape)}, a tuple of C such tensors, or one of shape (C, {len(x)}); "
        f"got {described(returned)}; for a constant return torch.full_like(x, value)"
    )


def _checked(value: object, x: Tensor, dtype: torch.dtype) -> Tensor:
    if not isinstance(value, Tensor) or value.shape != x.shape:
        raise McaaError(f"each channel that f returns must be a tensor of shape {tuple(x.shape)}, got {described(value)}")
    if value.device != x.device:
        raise McaaError(
            f"f was asked on {x.device} and returned a tensor on {value.device}; move what f uses to {x.device}, or ask for the picture there"
        )
    if value.layout != torch.strided:
        raise McaaError(f"f returned a tensor of layout {value.layout}; return value.to_dense()")
    if value.is_complex():
        raise McaaError(f"f returned {value.dtype}; a colour is real: return the real part, the modulus, or both as channels")
    return value.to(dtype).contiguous()
