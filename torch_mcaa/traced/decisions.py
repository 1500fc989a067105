"""The operations of PyTorch that decide: what each decided for every point, and the margin that crosses zero where it decides otherwise.

Only the position of a margin's zero and its slope's direction count: any increasing function of a margin serves as well. Operations that
switch without a jump (`maximum`, `clamp`, `relu`, `abs`) are none, unless f takes derivatives, which jump there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode, handle_torch_function, has_torch_function_unary

from torch_mcaa.errors import McaaError
from torch_mcaa.traced.inside import transformed
from torch_mcaa.traced.nested import tensors_in


@dataclass(frozen=True)
class Level:
    """An operation that changes where a margin crosses zero.

    codes: what it decided, integers or bool of any shape; margin: a function that gives the margin, of a shape that expands to theirs, None
        where no rule says what crosses zero.
    """

    codes: Tensor
    margin: Callable[[], Tensor] | None


@dataclass(frozen=True)
class Choice:
    """An operation that chooses among the `values` along `dim`; where it goes from i to j, values[j] - values[i] crosses zero.

    codes: the indices chosen, of `values`' shape but for `dim`, which may be missing.
    """

    codes: Tensor
    values: Tensor
    dim: int


Decision = Level | Choice
Arguments = dict[str, Any]
Rule = Callable[[Sequence[Any], Arguments, Any], Decision | None]


def name_of(function: Any) -> str:
    """The name that rules go by: `lt` for torch.lt, Tensor.lt, Tensor.lt_, Tensor.__lt__, torch.ops.aten.lt.Scalar."""
    name = getattr(function, "__name__", "").split(".")[0].removeprefix("special_")
    if name.startswith("__") and name.endswith("__"):
        return name[2:-2].removeprefix("i") if name[2:-2] in _IN_PLACE else name[2:-2]
    return name.strip("_")


ESCAPES = ("item", "tolist", "numpy", "__array__", "__bool__", "__float__", "__int__", "__index__", "__complex__", "__dlpack__")
"""Functions through which values leave PyTorch, where neither the trace nor a gradient follows."""


def in_place(function: Any) -> bool:
    """Whether the function changes its first argument."""
    name = getattr(function, "__name__", "").split(".")[0]
    return name in ("__setitem__", *(f"__{n}__" for n in _IN_PLACE)) or (name.endswith("_") and not name.endswith("__"))


_IN_PLACE = ("iadd", "isub", "imul", "idiv", "itruediv", "ifloordiv", "imod", "ipow", "iand", "ior", "ixor", "ilshift", "irshift")


def rule_of(function: Any, bends: bool = False) -> Rule | None:
    """The rule for a function that `__torch_function__` is given, None if it decides nothing; `bends`: those that bend f count."""
    if getattr(function, "__name__", "") in ESCAPES:
        return None
    name = name_of(function)
    return (_BENDS.get(name) if bends or transformed() else None) or _RULES.get(name)


def unruled(function: Any, args: Sequence[Any], kwargs: Arguments, result: Any) -> Level | None:
    """What an operation without a rule decided, if it makes whole numbers or bools of floating ones: where it changes, but no margin."""
    name = name_of(function)
    # a view shows the bits of a number, which change everywhere
    if name in ESCAPES or name == "view" or made_like(function):
        return None
    codes = next((t for t in tensors_in(args[0] if in_place(function) else result) if t.dtype in _WHOLE), None)
    if codes is None or not any(_floating(given) for given in tensors_in((args, kwargs))):
        return None
    return Level(codes, None)


_WHOLE = (torch.bool, torch.uint8, torch.int8, torch.int16, torch.int32, torch.int64)


def made_like(function: Any) -> bool:
    """Whether of the function's first argument nothing but the type and the shape matter, as of x in x.new_tensor(3.0)."""
    name = getattr(function, "__name__", "")
    return name.startswith("new_") or name.endswith("_like")


_SIGN = 1e-4
"""How far apart the sizes of quotients may be, in parts of them, that are signs but for rounding."""
_WITHOUT_DERIVATIVE = ("heaviside", "floor_divide", "floordiv", "rfloordiv")
"""Steps for which autograd raises in the place of a slope of 0."""


def lacks_derivative(function: Any) -> bool:
    """Whether the function decides, and its slope, which is 0, is not known to autograd."""
    return name_of(function) in _WITHOUT_DERIVATIVE


def called(function: Any, args: Sequence[Any], kwargs: Arguments) -> Any:
    """function(*args, **kwargs), where it `lacks_derivative` without a graph to what it decides on."""
    if not lacks_derivative(function):
        return function(*args, **kwargs)
    plain, named = [_detached(a) for a in args], {name: _detached(a) for name, a in kwargs.items()}
    if in_place(function):
        # a copy of its values, so that the graph of what was there is left behind
        return args[0].copy_(function(plain[0].clone(), *plain[1:], **named))
    return function(*plain, **named)


def _detached(value: Any) -> Any:
    return value.detach() if isinstance(value, Tensor) else value


class Called(TorchFunctionMode):
    """While it is active, all functions are `called`."""

    def __torch_function__(self, func: Any, types: Any, args: Sequence[Any] = (), kwargs: Arguments | None = None) -> Any:
        return called(func, args, kwargs or {})


def _floating(value: Any) -> bool:
    return isinstance(value, Tensor) and value.is_floating_point()


def _argument(args: Sequence[Any], kwargs: Arguments, place: int, *names: str, default: Any = None) -> Any:
    for name in names:
        if name in kwargs:
            return kwargs[name]
    return args[place] if place < len(args) else default


def _compare(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
    a, b = args[0], _argument(args, kwargs, 1, "other")
    if not (_floating(a) or _floating(b)) or not isinstance(result, Tensor):
        return None
    # of a != a, which tells NaN, there is no margin
    return Level(result, None if a is b else lambda: _number(a) - _number(b))


def _number(value: Any) -> Any:
    return value.to(torch.int64) if isinstance(value, Tensor) and value.dtype == torch.bool else value


def _close(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
    a, b = args[0], _argument(args, kwargs, 1, "other")
    rtol, atol = _argument(args, kwargs, 2, "rtol", default=1e-5), _argument(args, kwargs, 3, "atol", default=1e-8)
    return Level(result, lambda: (a - b).abs() - (atol + rtol * b.abs())) if _floating(a) else None


def _fraction(q: Tensor) -> Tensor:
    """q less the nearest integer."""
    return q - q.detach().round()


def _whole(shift: float = 0.0) -> Rule:
    """Steps of one argument at the integers, or `shift` beside them."""

    def rule(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
        a = args[0]
        if not _floating(a):
            return None
        scale = 10.0 ** _argument(args, kwargs, 1, "decimals", default=0) if shift else 1.0
        return Level(result if scale == 1 else (result * scale).round(), lambda: _fraction(a * scale + shift))

    return rule


def _frac(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
    return Level(args[0].trunc(), lambda: _fraction(args[0])) if _floating(args[0]) else None


def _quotient(rounded: Callable[[Tensor], Tensor] | None, swapped: bool = False) -> Rule:
    """a - b floor(a / b) and the like step where the quotient is an integer; with None it is a rounding mode, or a pole's, that says so."""

    def rule(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
        a, b = args[0], _argument(args, kwargs, 1, "other")
        a, b = (b, a) if swapped else (a, b)
        if not (_floating(a) or _floating(b)):
            return None
        how = rounded
        if how is None:
            mode = _argument(args, kwargs, 2, "rounding_mode")
            if mode is None:
                return _divided(a, b, result)
            how = torch.floor if mode == "floor" else torch.trunc
        q = a / b
        return Level(how(q.detach()), lambda: _fraction(a / b))

    return rule


def _divided(a: Any, b: Any, result: Any) -> Decision | None:
    """a / b has a pole where b crosses zero; d / |d| and c d / sqrt(d * d) have the sign of d."""
    if _floating(a) and _floating(b) and result.numel() and not transformed() and bool((b >= 0).all()):
        size = result.detach().abs()
        if bool(size.amax() - size.amin() <= _SIGN * size.amax()):
            return Level(result.detach() < 0, lambda: a)
    return _pole(b)


def _pole(b: Any) -> Decision | None:
    """1 / b jumps from one infinity to the other where b crosses zero, and atan(a / b) with it."""
    return Level(b < 0, lambda: b) if _floating(b) else None


def _sign(place: int = 0) -> Rule:
    def rule(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
        a = _argument(args, kwargs, place, "other")
        if not _floating(a):
            return None
        return Level(torch.sign(a.detach()), lambda: a)

    return rule


def _nonzero(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
    """A float taken as a bool: it changes where the float leaves a plateau of zeros."""
    floats = [a for a in args[:2] if _floating(a)]
    if len(floats) != 1:
        return None
    a = floats[0]
    return Level(a != 0, lambda: a)


def _cast(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
    a = args[0]
    if not _floating(a) or not isinstance(result, Tensor) or result.is_floating_point() or result.is_complex():
        return None
    if result.dtype == torch.bool:
        return Level(result, lambda: a)
    return Level(result, lambda: _fraction(a))


def _taken(place: int, *names: str) -> Rule:
    """Numbers that are taken over as they are, or cast."""

    def rule(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
        given = _argument(args, kwargs, place, *names)
        return _cast([given], kwargs, args[0] if result is None else result)

    return rule


def _indices(number: int, default: Any) -> Rule:
    """Functions of (values, dim) that return indices, or (values, indices); `number`: the place of `dim` among the arguments."""

    def rule(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
        values, dim = args[0], _argument(args, kwargs, number, "dim", "axis", default=default)
        codes = result if isinstance(result, Tensor) else result[1]
        if not _floating(values) or codes.is_floating_point() or isinstance(dim, bool):
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
    y, x = args[0], _argument(args, kwargs, 1, "other")
    return _cut(y, x) if _floating(y) and _floating(x) else None


def _pow(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
    exponent = _argument(args, kwargs, 1, "exponent")
    if isinstance(exponent, (int, float)) and exponent < 0 and _floating(args[0]):
        return _pole(args[0])
    return _complex(args, kwargs, result)


def _complex(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
    z = args[0]
    return _cut(z.imag, z.real) if isinstance(z, Tensor) and z.is_complex() else None


def _angle(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
    return _sign()(args, kwargs, result) if _floating(args[0]) else _complex(args, kwargs, result)


def _tan(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
    a = args[0]
    return Level((a.detach() / math.pi + 0.5).floor(), lambda: _fraction(a / math.pi + 0.5)) if _floating(a) else None


def _search(boundaries: Tensor, values: Any, result: Any) -> Decision | None:
    if not _floating(values):
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
    return _search(_argument(args, kwargs, 0, "sorted_sequence"), _argument(args, kwargs, 1, "input", "self"), result)


def _bucketize(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
    return _search(_argument(args, kwargs, 1, "boundaries"), _argument(args, kwargs, 0, "input"), result)


def _hardshrink(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
    a, lambd = args[0], _argument(args, kwargs, 1, "lambd", default=0.5)
    return Level(a.abs() > lambd, lambda: a.abs() - lambd)


def _threshold(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
    a, threshold = args[0], _argument(args, kwargs, 1, "threshold")
    return Level(a > threshold, lambda: a - threshold) if _floating(a) else None


def _grid_sample(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
    image, grid = args[0], _argument(args, kwargs, 1, "grid")
    if _argument(args, kwargs, 2, "mode", default="bilinear") != "nearest":
        return None
    size = torch.tensor(image.shape[:1:-1], dtype=grid.dtype, device=grid.device)
    aligned = _argument(args, kwargs, 4, "align_corners", default=False)
    texel = (grid + 1) / 2 * (size - 1) if aligned else ((grid + 1) * size - 1) / 2
    return Level(texel.detach().round(), lambda: _fraction(texel + 0.5))


def level_set(g: Tensor) -> Tensor:
    """Declare, inside f, that f may jump where g crosses zero: for jumps in code that PyTorch does not show, such as a kernel or numpy.

    Comparisons, `floor`, `argmin` and the like need no declaration. What is returned may be used or not.

    >>> import torch
    >>> level_set(torch.tensor([-0.5, 2.0]))
    tensor([False,  True])

    Args:
        g: floating point, of the points' shape, differentiable in x, y and the parameters that move the jump.

    Returns:
        g > 0, a bool tensor.

    Raises:
        McaaError: g is no floating point tensor.
    """
    if not _floating(g):
        got = f"a tensor of {g.dtype}" if isinstance(g, Tensor) else type(g).__name__
        raise McaaError(
            f"level_set takes a floating point tensor of the points' shape, got {got}; pass what crosses zero at the jump"
        )
    if has_torch_function_unary(g):
        return handle_torch_function(level_set, (g,), g)
    return g > 0


def _level_set(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
    return Level(result, lambda: args[0])


_RULES: dict[str, Rule] = {
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
    "nan_to_num": lambda args, kwargs, result: Level(args[0].isfinite(), None) if _floating(args[0]) else None,
    **dict.fromkeys(("to", "int", "long", "short", "char", "byte", "type", "type_as"), _cast),
    **dict.fromkeys(("argmin", "argmax", "min", "max", "cummin", "cummax"), _indices(1, None)),
    **dict.fromkeys(("sort", "argsort", "median", "nanmedian", "mode"), _indices(1, -1)),
    **dict.fromkeys(("topk", "kthvalue"), _indices(2, -1)),
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


def _bend(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
    return Level(args[0] > 0, lambda: args[0]) if _floating(args[0]) else None


def _larger(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
    """Of two tensors; along an axis it is the one that is chosen."""
    a, b = args[0], _argument(args, kwargs, 1, "other", "dim")
    if _floating(a) and _floating(b):
        return Level(a > b, lambda: a - b)
    return _indices(1, None)(args, kwargs, result) if not isinstance(result, Tensor) else None


def _clamped(low: float | None = None, high: float | None = None) -> Rule:
    """Two bends, at the limits that are given, or these."""

    def rule(args: Sequence[Any], kwargs: Arguments, result: Any) -> Decision | None:
        a = args[0]
        limits = (
            _argument(args, kwargs, place, *names, default=default)
            for place, names, default in ((1, ("min", "min_val"), low), (2, ("max", "max_val"), high))
        )
        ends = [limit for limit in limits if limit is not None]
        if not _floating(a) or not ends:
            return None

        def margin() -> Tensor:
            margins = torch.stack([a - end for end in ends])
            return margins.gather(0, margins.detach().abs().argmin(0, keepdim=True))[0]

        return Level(torch.stack([a > end for end in ends]).sum(0), margin)

    return rule


_BENDS: dict[str, Rule] = {
    **dict.fromkeys(("abs", "absolute", "relu", "leaky_relu", "prelu", "elu"), _bend),
    **dict.fromkeys(("maximum", "minimum", "fmax", "fmin", "max", "min"), _larger),
    **dict.fromkeys(("clamp", "clip"), _clamped()),
    "clamp_min": lambda args, kwargs, result: _clamped()([args[0], _argument(args, kwargs, 1, "min")], {}, result),
    "clamp_max": lambda args, kwargs, result: _clamped()([args[0], None, _argument(args, kwargs, 1, "max")], {}, result),
    "hardtanh": _clamped(-1.0, 1.0),
    "relu6": _clamped(0.0, 6.0),
}
"""Operations that switch without a jump, and whose derivatives jump."""
