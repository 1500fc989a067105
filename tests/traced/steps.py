"""A step across the circle h = 0, spelled with every operation that decides."""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
import torch.nn.functional as F
from torch import Tensor

import torch_mcaa as mcaa

Spelling = Callable[[Tensor], Tensor]
"""h to 1 inside (h < 0), 0 outside, but for rounding and smooth parts that do not depend on a parameter."""


class _Step(torch.autograd.Function):
    @staticmethod
    def forward(ctx, h):
        return (h < 0).to(h.dtype)

    @staticmethod
    def backward(ctx, *gradient):
        return torch.zeros_like(gradient[0])


def _no_grad(h: Tensor) -> Tensor:
    with torch.no_grad():
        return h < 0


def _assigned(h: Tensor) -> Tensor:
    out = torch.zeros_like(h)
    out[h < 0] = 1
    return out


def _in_place(operation: str, *arguments: float) -> Spelling:
    def spelled(h: Tensor) -> Tensor:
        value = h / 20 if operation in ("floor_", "ceil_") else h.clone()
        return getattr(value, operation)(*arguments)

    return spelled


def _pair(h: Tensor, dim: int) -> Tensor:
    return torch.stack([h, -h], dim)


SPELLINGS: dict[str, Spelling] = {
    "h < 0": lambda h: h < 0,
    "h <= 0": lambda h: h <= 0,
    "0 > h": lambda h: h < 0,
    "-h > 0": lambda h: -h > 0,
    "-h >= 0": lambda h: -h >= 0,
    "torch.lt": lambda h: torch.lt(h, 0),
    "torch.lt with keywords": lambda h: torch.lt(input=h, other=torch.zeros_like(h)),
    "torch.less": lambda h: torch.less(h, 0),
    "h.lt": lambda h: h.lt(0),
    "h.greater_equal": lambda h: ~h.greater_equal(0),
    "aten.lt": lambda h: torch.ops.aten.lt.Scalar(h, 0.0),
    "relu(h) == 0": lambda h: torch.relu(h) == 0,
    "relu(-h) != 0": lambda h: torch.relu(-h) != 0,
    "not relu(h)": lambda h: torch.logical_not(torch.relu(h)),
    "relu(-h).bool": lambda h: torch.relu(-h).bool(),
    "lt_": _in_place("lt_", 0.0),
    "floor_": lambda h: -_in_place("floor_")(h),
    "no_grad": _no_grad,
    "out[h < 0] = 1": _assigned,
    "autograd.Function": _Step.apply,
    "isclose": lambda h: torch.isclose(h + 4, torch.zeros_like(h), rtol=0, atol=4.0),
    "sign": lambda h: (1 - torch.sign(h)) / 2,
    "sgn": lambda h: (1 - h.sgn()) / 2,
    "h / |h|": lambda h: (1 - h / h.abs()) / 2,
    "h / sqrt(h h)": lambda h: (1 - torch.div(h, torch.sqrt(h * h))) / 2,
    "signbit": lambda h: torch.signbit(h),
    "copysign": lambda h: 0.5 + torch.copysign(torch.full_like(h, 0.5), -h),
    "heaviside": lambda h: torch.heaviside(-h, torch.ones((), dtype=h.dtype)),
    "floor": lambda h: -torch.floor(h / 20),
    "h.floor": lambda h: -(h / 20).floor(),
    "special.floor": lambda h: 1 - torch.special.round(h / 20 + 0.5),
    "ceil": lambda h: 1 - torch.ceil(h / 20),
    "round": lambda h: 1 - torch.round(h / 20 + 0.5),
    "round to decimals": lambda h: 1 - 10 * torch.round(h / 200 + 0.05, decimals=1),
    "trunc": lambda h: 2 - torch.trunc(h / 20 + 2),
    "fix": lambda h: 2 - torch.fix(h / 20 + 2),
    "frac": lambda h: torch.frac(h / 20 + 2) - h.detach() / 20,
    "%": lambda h: (h / 20) % 1 - h.detach() / 20,
    "remainder": lambda h: torch.remainder(h, 20) / 20 - h.detach() / 20,
    "fmod": lambda h: torch.fmod(h + 40, 20) / 20 - h.detach() / 20,
    "//": lambda h: -(h // 20),
    "floor_divide": lambda h: -torch.floor_divide(h, 20),
    "div floor": lambda h: -torch.div(h, 20, rounding_mode="floor"),
    "div trunc": lambda h: 2 - torch.div(h + 40, 20, rounding_mode="trunc"),
    "number // tensor": lambda h: 5 // (5 + h / 20),
    "number % tensor": lambda h: 1 - (5 % (5 + h / 20)) / 5,
    "int": lambda h: 2 - (h / 20 + 2).int(),
    "long": lambda h: 2 - (h / 20 + 2).long(),
    "to int16": lambda h: 2 - (h / 20 + 2).to(torch.int16),
    "to like": lambda h: 2 - (h / 20 + 2).type_as(torch.zeros(1, dtype=torch.int64)),
    "as_tensor": lambda h: 2 - torch.as_tensor(h / 20 + 2, dtype=torch.int64),
    "copy_": lambda h: 2 - torch.zeros_like(h, dtype=torch.int64).copy_(h / 20 + 2),
    "argmin": lambda h: 1 - _pair(h, 0).argmin(0),
    "argmax": lambda h: torch.argmax(_pair(h, 1), dim=1),
    "argmax keepdim": lambda h: _pair(h, 1).argmax(-1, keepdim=True)[:, 0],
    "min": lambda h: 1 - _pair(h, 0).min(0).indices,
    "max": lambda h: torch.max(_pair(h, 1), 1)[1],
    "sort": lambda h: _pair(h, 1).sort(1).indices[:, 1],
    "argsort": lambda h: torch.argsort(_pair(h, 0), dim=0)[1],
    "topk": lambda h: _pair(h, 1).topk(1, dim=1).indices[:, 0],
    "median": lambda h: 1 - torch.stack([h, -h], 0).median(0).indices,
    "cummax": lambda h: _pair(h, 1).cummax(1).indices[:, 1],
    "searchsorted": lambda h: 1 - torch.searchsorted(torch.zeros(1, dtype=h.dtype), h),
    "searchsorted in rows": lambda h: 1 - torch.searchsorted(torch.zeros(len(h), 1, dtype=h.dtype), h[:, None])[:, 0],
    "bucketize": lambda h: 2 - torch.bucketize(h, torch.tensor([-30.0, 0.0, 30.0], dtype=h.dtype)),
    "hardshrink": lambda h: F.hardshrink(20 - h, 20).detach() / (20 - h.detach()),
    "threshold": lambda h: F.threshold(20 - h, 20.0, 0.0).detach() / (20 - h.detach()),
    "atan2": lambda h: 0.5 - torch.atan2(h, torch.full_like(h, -1e9)) / (2 * math.pi),
    "arctan2 of a pole": lambda h: 0.5 - torch.atan(1e9 / h) / math.pi,
    "atan2 of zero": lambda h: torch.atan2(torch.zeros_like(h), h) / math.pi,
    "angle of a complex number": lambda h: torch.angle(torch.complex(h, torch.zeros_like(h))) / math.pi,
    "root of a complex number": lambda h: torch.sqrt(torch.complex(h, torch.zeros_like(h))).imag > 0,
    "angle": lambda h: torch.angle(h) / math.pi,
    "complex log": lambda h: 0.5 - torch.log(torch.complex(torch.full_like(h, -1e9), h)).imag / (2 * math.pi),
    "tan": lambda h: torch.tan(h / 40 + math.pi / 2) > 0,
    "grid_sample": lambda h: F.grid_sample(
        torch.tensor([1.0, 0.0], dtype=h.dtype).view(1, 1, 1, 2),
        torch.stack([h / 30, torch.zeros_like(h)], -1).view(1, 1, -1, 2),
        mode="nearest",
        align_corners=False,
    ).view(-1),
    "grid_sample of a volume": lambda h: F.grid_sample(
        torch.tensor([1.0, 0.0], dtype=h.dtype).view(1, 1, 1, 1, 2),
        torch.stack([h / 30, torch.zeros_like(h), torch.zeros_like(h)], -1).view(1, 1, 1, -1, 3),
        mode="nearest",
        align_corners=False,
    ).view(-1),
    "level_set": lambda h: mcaa.level_set(-h),
    # not one, but another margin of the same edge
    "cube": lambda h: h**3 < 0,
    "fifth power": lambda h: h**5 < 0,
    "times 10^6": lambda h: 1e6 * h < 0,
    "times 10^-6": lambda h: 1e-6 * h < 0,
    "swapped branches": lambda h: torch.where(h >= 0, 0.0, 1.0),
    "sigmoid": lambda h: torch.sigmoid(-50 * h) > 0.5,
    "saturated sigmoid": lambda h: torch.sigmoid(-1e6 * h) > 0.5,
    "reciprocal": lambda h: 1 / h < 0,
    "h ** -1": lambda h: h**-1 < 0,
    "float_power": lambda h: torch.float_power(h, -3) < 0,
    "tanh of an exponential": lambda h: torch.tanh(torch.exp(h) - 1) < 0,
}
