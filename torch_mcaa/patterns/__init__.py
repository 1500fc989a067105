"""Patterns: where the points of a pixel lie in the unit square, pure functions of (seed, pixel, round, index)."""

from torch_mcaa.patterns.base import Pattern
from torch_mcaa.patterns.independent import Independent
from torch_mcaa.patterns.jittered import Jittered
from torch_mcaa.patterns.lattice import Lattice
from torch_mcaa.patterns.multijittered import MultiJittered
from torch_mcaa.patterns.sobol import Sobol

__all__ = ["Independent", "Jittered", "Lattice", "MultiJittered", "Pattern", "Sobol"]
