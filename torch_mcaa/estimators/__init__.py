"""Estimators of (1): from points to values and variances."""

from torch_mcaa.estimators.base import Estimate, Estimator, Round, Task
from torch_mcaa.estimators.importance import Importance
from torch_mcaa.estimators.shared import Auto, Shared

__all__ = ["Auto", "Estimate", "Estimator", "Importance", "Round", "Shared", "Task"]
