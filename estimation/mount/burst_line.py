"""The line along which velocity steps lie: weighted total least squares.

Each step is m u + noise, equal on all axes, with its own unknown size m. The maximum-likelihood line u is the first
principal axis of sum(d d^T / sigma^2); what the other two hold is chi-square of 2 (n - 1) degrees of freedom.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, lgamma, sqrt

import numpy as np
from numpy.typing import NDArray

from estimation.mount.velocity_steps import VelocityStep

Array = NDArray[np.float64]

LEAST_STEPS = 3  # two may agree by chance
UNLIKELY = 1e-3
TOLERATED_VARIANCE = 2.0  # times the stated one: then sigma is widened, and that is all
OUTLIERS = 1 / 3  # at most this share of the steps is left out


@dataclass(frozen=True)
class BurstLine:
    """Line through the steps; which way along it is the push is not known here."""

    direction: Array  # (3,), unit vector, either sign
    sigma_rad: float  # of the direction, about each of two axes across it
    chi_square: float
    degrees_of_freedom: int
    steps: tuple[VelocityStep, ...]  # that were used

    @property
    def agrees(self) -> bool:
        """Whether one line can be behind all steps."""
        return chi_square_tail(self.chi_square / TOLERATED_VARIANCE, self.degrees_of_freedom) >= UNLIKELY

    @property
    def sizes(self) -> Array:
        """Signed sizes of the steps along `direction` [m/s]."""
        return np.array([step.change @ self.direction for step in self.steps])


def burst_line(steps: Sequence[VelocityStep]) -> BurstLine:
    """The line of at least `LEAST_STEPS` steps; a few that do not fit are left out, worst first."""
    line = _fitted(steps)
    least = max(len(steps) - int(OUTLIERS * len(steps)), LEAST_STEPS)
    while not line.agrees and len(line.steps) > least:
        scaled = np.array([step.change / step.sigma for step in line.steps])
        worst = int(np.argmax(np.linalg.norm(np.cross(scaled, line.direction), axis=1)))
        line = _fitted(line.steps[:worst] + line.steps[worst + 1 :])
    return line


def _fitted(steps: Sequence[VelocityStep]) -> BurstLine:
    scaled = np.array([step.change / step.sigma for step in steps])
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    n, largest = len(steps), float(values[2])
    chi_square, dof = float(values[0] + values[1]), 2 * (n - 1)
    # The noise along the line is in `largest` too. Where the steps scatter more than stated, so does the line.
    sigma = sqrt(largest) / (largest - n) if largest > n else inf
    sigma *= sqrt(max(chi_square / dof, 1.0))
    return BurstLine(vectors[:, 2], sigma, chi_square, dof, tuple(steps))


def chi_square_tail(chi_square: float, degrees_of_freedom: int) -> float:
    """Chance of a chi-square that large or larger; degrees of freedom even, so that the sum is finite and exact."""
    x = max(chi_square / 2, 1e-300)
    terms = [k * np.log(x) - x - lgamma(k + 1) for k in range(degrees_of_freedom // 2)]
    return float(np.exp(np.logaddexp.reduce(terms)))
