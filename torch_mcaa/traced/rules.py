"""The operations of PyTorch that decide: what each decided for every point, and the margin that crosses zero where it decides otherwise.

Operations that switch without a jump (`maximum`, `clamp`, `relu`, `abs`) are none.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor

from torch_mcaa.traced.decisions import Arguments, Choice, Decision, Level, Rule, argument, floating
from torch_mcaa.traced.inside import transformed

_SIGN = 1e-4
"""How far apart the sizes of quotients may be, in parts of them, that are signs but for rounding."""


def _compare(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
    a, b = args[0], argument(args, kwargs, 1, "other")
    if not (floating(a) or floating(b)) or not isinstance(result, Tensor):
        return None
    # of a != a, which tells NaN, there is no margin
    return Level(result, None if a is b else lambda: _number(a) - _number(b))


def _number(value: Any) -> Any:
    return value.to(torch.int64) if isinstance(value, Tensor) and value.dtype == torch.bool else value


def _close(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
    a, b = args[0], argument(args, kwargs, 1, "other")
    rtol, atol = argument(args, kwargs, 2, "rtol", default=1e-5), argument(args, kwargs, 3, "atol", default=1e-8)
    return Level(result, lambda: (a - b).abs() - (atol + rtol * b.abs())) if floating(a) else None


def _fraction(q: Tensor) -> Tensor:
    """q less the nearest integer."""
    return q - q.detach().round()


def _whole(shift: float = 0.0) -> Rule:
    """Steps of one argument at the integers, or `shift` beside them."""

    def rule(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
        a = args[0]
        if not floating(a):
            return None
        scale = 10.0 ** argument(args, kwargs, 1, "decimals", default=0) if shift else 1.0
        return Level(result if scale == 1 else (result * scale).round(), lambda: _fraction(a * scale + shift))

    return rule


def _frac(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
    return Level(args[0].trunc(), lambda: _fraction(args[0])) if floating(args[0]) else None


def _quotient(rounded: Callable[[Tensor], Tensor] | None, swapped: bool = False) -> Rule:
    """a - b floor(a / b) and the like step where the quotient is an integer; with None it is a rounding mode, or a pole's, that says so."""

    def rule(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
        a, b = args[0], argument(args, kwargs, 1, "other")
        a, b = (b, a) if swapped else (a, b)
        if not (floating(a) or floating(b)):
            return None
        how = rounded
        if how is None:
            mode = argument(args, kwargs, 2, "rounding_mode")
            if mode is None:
                return _divided(a, b, result)
            how = torch.floor if mode == "floor" else torch.trunc
        q = a / b
        return Level(how(q.detach()), lambda: _fraction(a / b))

    return rule


def _divided(a: Any, b: Any, result: Any) -> Decision | None:
    """a / b has a pole where b crosses zero; d / |d| and c d / sqrt(d * d) have the sign of d."""
    if floating(a) and floating(b) and result.numel() and not transformed() and bool((b >= 0).all()):
        size = result.detach().abs()
        if bool(size.amax() - size.amin() <= _SIGN * size.amax()):
            return Level(result.detach() < 0, lambda: a)
    return _pole(b)


def _pole(b: Any) -> Decision | None:
    """1 / b jumps from one infinity to the other where b crosses zero, and atan(a / b) with it."""
    return Level(b < 0, lambda: b) if floating(b) else None


def _sign(place: int = 0) -> Rule:
    def rule(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
        a = argument(args, kwargs, place, "other")
        if not floating(a):
            return None
        return Level(torch.sign(a.detach()), lambda: a)

    return rule


def _nonzero(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
    """A float taken as a bool: it changes where the float leaves a plateau of zeros."""
    floats = [a for a in args[:2] if floating(a)]
    if len(floats) != 1:
        return None
    a = floats[0]
    return Level(a != 0, lambda: a)


def _cast(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
    a = args[0]
    if not floating(a) or not isinstance(result, Tensor) or result.is_floating_point() or result.is_complex():
        return None
    if result.dtype == torch.bool:
        return Level(result, lambda: a)
    return Level(result, lambda: _fraction(a))


def _taken(place: int, *names: str) -> Rule:
    """Numbers that are taken over as they are, or cast."""

    def rule(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
        return _cast([argument(args, kwargs, place, *names)], kwargs, result)

    return rule


def indices(number: int, default: Any) -> Rule:
    """Functions of (values, dim) that return indices, or (values, indices); `number`: the place of `dim` among the arguments."""

    def rule(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
        values, dim = args[0], argument(args, kwargs, number, "dim", "axis", default=default)
        codes = result if isinstance(result, Tensor) else result[1]
        if not floating(values) or codes.is_floating_point() or isinstance(dim, bool):
            return None
        if dim is None:
            values, dim = values.flatten(), 0
        dim %= values.ndim
        return Choice(codes if codes.ndim == values.ndim else codes.unsqueeze(dim), values, dim)

    return rule


def _cut(y: Tensor, x: Tensor) -> Level:
    """The branch cut of the angle of (x, y): y = 0 where x < 0. At x = 0 only the code changes."""
    code = (x < 0).to(torch.int64) * (1 + (y < 0).to(torch.int64))
    if not transformed() and not bool(y.any()):
        # of a number without an imaginary part the angle is a sign
        return Level(code, lambda: x)
    return Level(code, lambda: torch.where(x.detach().abs() < y.detach().abs(), x, y))


def _atan2(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
    y, x = args[0], argument(args, kwargs, 1, "other")
    return _cut(y, x) if floating(y) and floating(x) else None


def _pow(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
    exponent = argument(args, kwargs, 1, "exponent")
    if isinstance(exponent, (int, float)) and exponent < 0 and floating(args[0]):
        return _pole(args[0])
    return _complex(args, kwargs, result)


def _complex(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
    z = args[0]
    return _cut(z.imag, z.real) if isinstance(z, Tensor) and z.is_complex() else None


def _angle(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
    return _sign()(args, kwargs, result) if floating(args[0]) else _complex(args, kwargs, result)


def _tan(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
    a = args[0]
    return Level((a.detach() / math.pi + 0.5).floor(), lambda: _fraction(a / math.pi + 0.5)) if floating(a) else None


def _search(boundaries: Tensor, values: Any, result: Any) -> Decision | None:
    if not floating(values):
        return None

    def margin() -> Tensor:
        # the nearest boundary is one of the two beside the value
        count = boundaries.shape[-1]
        place = result.clamp(1, count - 1) if count > 1 else torch.ones_like(result)
        below, above = (
            values - (boundaries[at] if boundaries.ndim == 1 else boundaries.gather(-1, at))
            for at in (place - 1, place.clamp(max=count - 1))
        )
        return torch.where(below.detach().abs() < above.detach().abs(), below, above)

    return Level(result, margin)


def _searchsorted(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
    return _search(argument(args, kwargs, 0, "sorted_sequence"), argument(args, kwargs, 1, "input", "self"), result)


def _bucketize(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
    return _search(argument(args, kwargs, 1, "boundaries"), argument(args, kwargs, 0, "input"), result)


def _hardshrink(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
    a, lambd = args[0], argument(args, kwargs, 1, "lambd", default=0.5)
    return Level(a.abs() > lambd, lambda: a.abs() - lambd)


def _threshold(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
    a, threshold = args[0], argument(args, kwargs, 1, "threshold")
    return Level(a > threshold, lambda: a - threshold) if floating(a) else None


def _grid_sample(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
    image, grid = args[0], argument(args, kwargs, 1, "grid")
    if argument(args, kwargs, 2, "mode", default="bilinear") != "nearest":
        return None
    size = torch.tensor(image.shape[:1:-1], dtype=grid.dtype, device=grid.device)
    aligned = argument(args, kwargs, 4, "align_corners", default=False)
    texel = (grid + 1) / 2 * (size - 1) if aligned else ((grid + 1) * size - 1) / 2
    return Level(texel.detach().round(), lambda: _fraction(texel + 0.5))


def _level_set(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
    return Level(result, lambda: args[0])


RULES: dict[str, Rule] = {
    **dict.fromkeys(
        ["lt", "le", "gt", "ge", "eq", "ne", "less", "less_equal", "greater", "greater_equal", "not_equal"],
        _compare,
    ),
    "isclose": _close,
    **dict.fromkeys(("floor", "ceil", "trunc", "fix"), _whole()),
    "round": _whole(0.5),
    "frac": _frac,
    **dict.fromkeys(("remainder", "mod", "floordiv", "floor_divide"), _quotient(torch.floor)),
    **dict.fromkeys(("rmod", "rfloordiv"), _quotient(torch.floor, swapped=True)),
    "fmod": _quotient(torch.trunc),
    **dict.fromkeys(("div", "divide", "true_divide", "truediv"), _quotient(None)),
    **dict.fromkeys(("rdiv", "rtruediv", "reciprocal"), lambda args, kwargs, result: _pole(args[0])),
    **dict.fromkeys(("sign", "sgn", "signbit", "heaviside"), _sign()),
    "copysign": _sign(1),
    **dict.fromkeys(("bool", "logical_not", "logical_and", "logical_or", "logical_xor"), _nonzero),
    **dict.fromkeys(("as_tensor", "asarray", "tensor"), _taken(0, "data", "obj")),
    **dict.fromkeys(("new_tensor", "copy"), _taken(1, "data", "src")),
    "nan_to_num": lambda args, kwargs, result: Level(args[0].isfinite(), None) if floating(args[0]) else None,
    **dict.fromkeys(("to", "int", "long", "short", "char", "byte", "type", "type_as"), _cast),
    **dict.fromkeys(("argmin", "argmax", "min", "max", "cummin", "cummax"), indices(1, None)),
    **dict.fromkeys(("sort", "argsort", "median", "nanmedian", "mode"), indices(1, -1)),
    **dict.fromkeys(("topk", "kthvalue"), indices(2, -1)),
    **dict.fromkeys(("atan2", "arctan2"), _atan2),
    **dict.fromkeys(("log", "log2", "log10", "sqrt"), _complex),
    **dict.fromkeys(("pow", "float_power"), _pow),
    "angle": _angle,
    "tan": _tan,
    "searchsorted": _searchsorted,
    "bucketize": _bucketize,
    "hardshrink": _hardshrink,
    "threshold": _threshold,
    "grid_sample": _grid_sample,
    "level_set": _level_set,
}
