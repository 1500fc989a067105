"""Any function f(x, y) -> colour to an anti-aliased picture with the standard error of every pixel, in PyTorch."""

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
    Gaussian,
    Lanczos,
    Mitchell,
    Sinc,
    Tabulated,
    Tent,
)
from torch_mcaa.integrand import from_points
from torch_mcaa.patterns import Independent, Jittered, Lattice, MultiJittered, Sobol
from torch_mcaa.render import render
from torch_mcaa.rendering import Rendering
from torch_mcaa.supersampler import Supersampler
from torch_mcaa.texture import Texture
from torch_mcaa.tolerance import Tolerance
from torch_mcaa.traced.audit import check_discontinuities
from torch_mcaa.traced.decisions import level_set
from torch_mcaa.warp import resize, warp_affine, warp_perspective

__version__ = "0.1.0"

__all__ = [
    "AdaptiveImportance",
    "Auto",
    "BlackmanHarris",
    "Box",
    "CatmullRom",
    "ControlVariate",
    "Crude",
    "EqualVariance",
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
    "check_discontinuities",
    "from_points",
    "level_set",
    "render",
    "resize",
    "warp_affine",
    "warp_perspective",
]
