"""Tuning: noises of a Kalman filter, and the optimisers of papers A and B. For notebooks: `tune_kf2`, `minimize`."""

from estimation.tuning.optimisers import OPTIMISERS, minimize
from estimation.tuning.search import Found
from estimation.tuning.two_state_tuning import Tuned, tune_kf2

__all__ = ["OPTIMISERS", "Found", "Tuned", "minimize", "tune_kf2"]
