"""Any function f(x, y) -> colour to an anti-aliased picture with the standard error of every pixel, in PyTorch."""

from torch_mcaa.densities import FilterDensity, Normal
from torch_mcaa.errors import McaaError, McaaWarning
from torch_mcaa.estimators import Auto, Importance, Shared
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
from torch_mcaa.render import Tolerance, render
from torch_mcaa.rendering import Rendering
from torch_mcaa.texture import Texture

__version__ = "0.1.0"

__all__ = [
    "Auto",
    "BlackmanHarris",
    "Box",
    "CatmullRom",
    "FilterDensity",
    "Gaussian",
    "Importance",
    "Independent",
    "Jittered",
    "Lanczos",
    "Lattice",
    "McaaError",
    "McaaWarning",
    "Mitchell",
    "MultiJittered",
    "Normal",
    "Rendering",
    "Shared",
    "Sinc",
    "Sobol",
    "Tabulated",
    "Tent",
    "Texture",
    "Tolerance",
    "from_points",
    "render",
]
