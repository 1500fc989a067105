"""Every estimator there is, once, with densities fit for the default filter; for the tests of this folder."""

from __future__ import annotations

import math

import torch
from torch import Tensor

import torch_mcaa as mcaa
from torch_mcaa.filters import Filter

SHARED = [
    mcaa.Auto(),
    mcaa.JumpCorrected(),
    mcaa.Shared(),
    mcaa.Shared(replicates=3),
    mcaa.Shared(mcaa.Independent()),
    mcaa.Shared(mcaa.Jittered()),
    mcaa.Shared(mcaa.MultiJittered()),
    mcaa.Shared(mcaa.Sobol()),
]
BY_FILTER = [
    mcaa.Importance(mcaa.Independent()),
    mcaa.Importance(mcaa.Jittered()),
    mcaa.Importance(mcaa.MultiJittered()),
    mcaa.Importance(mcaa.Sobol()),
    mcaa.Importance(mcaa.Lattice()),
    mcaa.Importance(allocation=mcaa.EqualVariance()),
    mcaa.Importance(allocation=mcaa.Neyman(), combine="discard_pilot"),
    mcaa.Stratified(weights="filter"),
    mcaa.Stratified(weights="filter", counts="optimal"),
    mcaa.AdaptiveImportance(),
    mcaa.AdaptiveImportance(density=mcaa.Mixture),
    mcaa.OrderedStrata(),
    mcaa.ControlVariate(),
]
"""Each with weights that |w| alone bounds, for every filter."""
BY_DENSITY = [
    mcaa.Importance(density=mcaa.Normal(0.3)),
    mcaa.Stratified(weights="balance"),
    mcaa.Stratified((1, 1), weights="paper"),
    mcaa.Stratified(weights="paper", density=mcaa.Normal(0.3)),
]
"""Densities that suit Gaussian(0.5)."""
PAIRS = mcaa.Pairs(
    [
        (lambda f, dx, dy: 0.5 * f * mcaa.Gaussian(0.5)(dx, dy) / mcaa.Normal(0.3).pdf(dx, dy), mcaa.Normal(0.3)),
        (lambda f, dx, dy: 0.5 * f, mcaa.FilterDensity(mcaa.Gaussian(0.5))),
    ]
)
PER_PIXEL = [*BY_FILTER, *BY_DENSITY, PAIRS, mcaa.Crude(biased_ok=True)]
ALL = [*SHARED, *PER_PIXEL]
ADAPTIVE = [mcaa.Auto(), mcaa.JumpCorrected()]
"""Those of them whose values decide where others are asked for, in all channels at once."""
ENOUGH = 48
"""Evaluations a pixel that suffice for a pilot and the floors of each."""


def z_score(values: Tensor, truth: float) -> float:
    """(mean - truth) / standard error of the mean, of independent values."""
    values = values.to(torch.float64)
    return float((values.mean() - truth) / (values.std() / math.sqrt(values.numel())))


CHANCE = 4.42
"""Two-sided normal quantile of 1e-5."""


def rms(values: Tensor) -> float:
    return float(values.to(torch.float64).square().mean().sqrt())


def half_plane(edge: float, centre: float, filter: Filter) -> float:
    """The exact value of the pixel with this centre for f = 1 left of x = edge, 0 right of it."""
    return float(filter.profile_cdf(torch.tensor(edge - centre, dtype=torch.float64)))  # type: ignore[attr-defined]
