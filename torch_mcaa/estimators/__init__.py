"""Estimators of (1): from points to values and variances."""

from torch_mcaa.estimators.auto import Auto
from torch_mcaa.estimators.base import Diagnostics, Estimate, Estimator, Round, Task
from torch_mcaa.estimators.jump_corrected import JumpCorrected
from torch_mcaa.estimators.paper.adaptive_importance import AdaptiveImportance
from torch_mcaa.estimators.paper.control_variate import ControlVariate
from torch_mcaa.estimators.paper.importance import Crude, Importance
from torch_mcaa.estimators.paper.ordered_strata import OrderedStrata
from torch_mcaa.estimators.paper.pairs import Pairs
from torch_mcaa.estimators.paper.pixelwise import Pixelwise, PixelwiseRound
from torch_mcaa.estimators.paper.stratified import Stratified
from torch_mcaa.estimators.shared import Shared

__all__ = [
    "AdaptiveImportance",
    "Auto",
    "ControlVariate",
    "Crude",
    "Diagnostics",
    "Estimate",
    "Estimator",
    "Importance",
    "JumpCorrected",
    "OrderedStrata",
    "Pairs",
    "Pixelwise",
    "PixelwiseRound",
    "Round",
    "Shared",
    "Stratified",
    "Task",
]
