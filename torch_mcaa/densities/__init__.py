"""Sampling densities around a pixel's centre. One idea a file."""

from __future__ import annotations

from torch_mcaa.densities.base import Density
from torch_mcaa.densities.filter_density import FilterDensity
from torch_mcaa.densities.histogram import Histogram
from torch_mcaa.densities.mixture import Mixture
from torch_mcaa.densities.normal import Normal

__all__ = ["Density", "FilterDensity", "Histogram", "Mixture", "Normal"]
