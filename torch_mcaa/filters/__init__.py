"""Filters: the weight functions w that a pixel's value is an average under. One family a file."""

from __future__ import annotations

from torch_mcaa.filters.base import Filter, SeparableFilter
from torch_mcaa.filters.blackman_harris import BlackmanHarris
from torch_mcaa.filters.box import Box
from torch_mcaa.filters.gaussian import Gaussian
from torch_mcaa.filters.lanczos import Lanczos
from torch_mcaa.filters.mitchell import CatmullRom, Mitchell
from torch_mcaa.filters.parse import parse_filter
from torch_mcaa.filters.sinc import Sinc
from torch_mcaa.filters.tabulated import Tabulated, TabulatedProfile
from torch_mcaa.filters.tabulated_grid import TabulatedGrid
from torch_mcaa.filters.tent import Tent

__all__ = [
    "BlackmanHarris",
    "Box",
    "CatmullRom",
    "Filter",
    "Gaussian",
    "Lanczos",
    "Mitchell",
    "SeparableFilter",
    "Sinc",
    "Tabulated",
    "TabulatedGrid",
    "TabulatedProfile",
    "Tent",
    "parse_filter",
]
