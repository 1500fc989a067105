"""Filters by name, for the command line."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from fractions import Fraction

from torch_mcaa.errors import McaaError
from torch_mcaa.filters.base import Filter
from torch_mcaa.filters.blackman_harris import BlackmanHarris
from torch_mcaa.filters.box import Box
from torch_mcaa.filters.gaussian import Gaussian
from torch_mcaa.filters.lanczos import Lanczos
from torch_mcaa.filters.mitchell import CatmullRom, Mitchell
from torch_mcaa.filters.sinc import Sinc
from torch_mcaa.filters.tent import Tent

_FILTERS: dict[str, Callable[..., Filter]] = {
    "box": Box,
    "tent": Tent,
    "gaussian": Gaussian,
    "mitchell": Mitchell,
    "catmull-rom": CatmullRom,
    "lanczos": Lanczos,
    "blackman-harris": BlackmanHarris,
    "sinc": Sinc,
}


def parse_filter(text: str) -> Filter:
    """The filter that `text` names: a name, then its arguments in order after a colon: "mitchell:1/3,1/3".

    Case, hyphens and underscores in the name count for nothing. Raises McaaError for an unknown name (it
    lists the known ones), for too many arguments, and for one that the filter refuses.
    """
    name, _, arguments = text.partition(":")
    known = {key.replace("-", ""): make for key, make in _FILTERS.items()}
    make = known.get(name.strip().lower().replace("-", "").replace("_", ""))
    if make is None:
        raise McaaError(f"no filter is named {name!r}: the names are {', '.join(_FILTERS)}; received {text!r}")
    values = [_number(part, text) for part in arguments.split(",")] if arguments.strip() else []
    names = list(inspect.signature(make).parameters)
    if len(values) > len(names):
        raise McaaError(
            f"filter {name!r} takes {len(names)} argument(s) ({', '.join(names) or 'none'}); "
            f"received {len(values)} in {text!r}: leave the rest out"
        )
    return make(*values)


def _number(part: str, text: str) -> float:
    try:
        return float(Fraction(part)) if "/" in part else float(part)
    except (ValueError, ZeroDivisionError):
        raise McaaError(
            f"arguments of a filter must be numbers separated by commas; received {part!r} in {text!r}: write them as in gaussian:0.5 or "
            "mitchell:1/3,1/3"
        ) from None
