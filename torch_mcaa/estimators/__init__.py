"""Estimators of (1): from points to values and variances."""

from torch_mcaa.estimators.adaptive_importance import AdaptiveImportance
from torch_mcaa.estimators.auto import Auto
from torch_mcaa.estimators.base import Diagnostics, Estimate, Estimator, Round, Task
from torch_mcaa.estimators.control_variate import ControlVariate
from torch_mcaa.estimators.importance import Crude, Importance
from torch_mcaa.estimators.jump_corrected import JumpCorrected
from torch_mcaa.estimators.ordered_strata import OrderedStrata
from torch_mcaa.estimators.pairs import Pairs
from torch_mcaa.estimators.pixelwise import Pixelwise, PixelwiseRound
from torch_mcaa.estimators.shared import Shared
from torch_mcaa.estimators.stratified import Stratified

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
