"""Any function f(x, y) -> colour to an anti-aliased picture with the standard error of every pixel, in PyTorch."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from torch_mcaa.allocation import EqualVariance, Neyman, Uniform
from torch_mcaa.densities import FilterDensity, Histogram, Mixture, Normal
from torch_mcaa.errors import McaaError, McaaWarning
from torch_mcaa.estimators import (
    AdaptiveImportance,
    Auto,
    ControlVariate,
    Crude,
    Importance,
    JumpCorrected,
    OrderedStrata,
    Pairs,
    Shared,
    Stratified,
)
from torch_mcaa.filters import (
    BlackmanHarris,
    Box,
    CatmullRom,
    Filter,
    Gaussian,
    Lanczos,
    Mitchell,
    SeparableFilter,
    Sinc,
    Tabulated,
    Tent,
)
from torch_mcaa.integrand import from_points
from torch_mcaa.patterns import Independent, Jittered, Lattice, MultiJittered, Sobol
from torch_mcaa.render import render
from torch_mcaa.rendering import Rendering
from torch_mcaa.texture import Texture
from torch_mcaa.tolerance import Tolerance

if TYPE_CHECKING:
    from torch_mcaa.charting import chart
    from torch_mcaa.supersampler import Supersampler
    from torch_mcaa.traced.audit import check_discontinuities
    from torch_mcaa.traced.level_set import level_set
    from torch_mcaa.warp import resize, warp_affine, warp_perspective

__version__ = "0.1.0"

# gradients and charts are half of the package, which pictures alone do not need
_LATER = {
    "Supersampler": "supersampler",
    "chart": "charting",
    "check_discontinuities": "traced.audit",
    "level_set": "traced.level_set",
    "resize": "warp",
    "warp_affine": "warp",
    "warp_perspective": "warp",
}


def __getattr__(name: str) -> Any:
    if name not in _LATER:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(f"{__name__}.{_LATER[name]}"), name)
    return value


__all__ = [
    "AdaptiveImportance",
    "Auto",
    "BlackmanHarris",
    "Box",
    "CatmullRom",
    "ControlVariate",
    "Crude",
    "EqualVariance",
    "Filter",
    "FilterDensity",
    "Gaussian",
    "Histogram",
    "Importance",
    "Independent",
    "Jittered",
    "JumpCorrected",
    "Lanczos",
    "Lattice",
    "McaaError",
    "McaaWarning",
    "Mitchell",
    "Mixture",
    "MultiJittered",
    "Neyman",
    "Normal",
    "OrderedStrata",
    "Pairs",
    "Rendering",
    "SeparableFilter",
    "Shared",
    "Sinc",
    "Sobol",
    "Stratified",
    "Supersampler",
    "Tabulated",
    "Tent",
    "Texture",
    "Tolerance",
    "Uniform",
    "chart",
    "check_discontinuities",
    "from_points",
    "level_set",
    "render",
    "resize",
    "warp_affine",
    "warp_perspective",
]
