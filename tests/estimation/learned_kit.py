"""Something that might have been learned, for tests that need not learn it."""

from __future__ import annotations

from typing import Any

import numpy as np

from estimation.gaussian import Gaussian
from estimation.learned import NAMES, Learned, Machine, prior_of
from estimation.settings import EstimatorSettings, SupportSettings

SUPPORT = SupportSettings()
PRIOR = prior_of(SUPPORT, EstimatorSettings())
MEAN = (-0.019, 0.0012, -0.0004, 0.004, 0.01461, 0.0354)  # as NAMES: the nominal speeds are 14.53 and 35.19 mm/s


def covariance(seed: int = 0) -> Any:
    """What the prior becomes by random measurements, in information form: some ten times as certain."""
    n = len(NAMES)
    prior = np.array(PRIOR.p)
    rows = np.random.default_rng(seed).normal(size=(50, n)) / np.sqrt(np.diag(prior))
    posterior = np.linalg.inv(np.linalg.inv(prior) + 2.0 * rows.T @ rows)
    return 0.5 * (posterior + posterior.T)


def learned_of(machine: Machine | None = None, *, seed: int = 0, pushes: int = 4, retracts: int = 3) -> Learned:
    """Usual speeds and sensor of a support that lies a little off its nominal values."""
    states = Gaussian(list(MEAN), covariance(seed).tolist())
    return Learned.of(machine or Machine.of(SUPPORT), states, pushes, retracts, 0.0028)
