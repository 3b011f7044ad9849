"""Shewhart's chart over a whole record, paper C, eq. (11) and (12)."""

from __future__ import annotations

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from estimation.arrays import FloatArray

D2, N = 1.128, 2  # of ranges of two successive values


def printed_limits(y: FloatArray) -> tuple[float, float]:
    """Eq. (11) as printed: the mean *signed* difference is centre and spread at once.

    It telescopes to (y_m - y_1) / (m - 1), next to nothing, and the limits lie as close around it.
    """
    mean = float(np.diff(y).mean())
    reach = 3.0 / (D2 * sqrt(N)) * mean
    return min(mean - reach, mean + reach), max(mean - reach, mean + reach)


def moving_range_limits(y: FloatArray) -> tuple[float, float]:
    """The chart for individuals that (11) must mean: mean +- 3 MR / d2, MR the mean *absolute* difference."""
    reach = 3.0 / D2 * float(np.abs(np.diff(y)).mean())
    centre = float(y.mean())
    return centre - reach, centre + reach


def change_points(y: FloatArray, limits: tuple[float, float]) -> NDArray[np.int64]:
    """Eq. (12): indices of the values outside the limits."""
    return np.flatnonzero((y < limits[0]) | (y > limits[1]))
