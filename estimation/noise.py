"""What hides the motion of the ram from the inertial sensor."""

from __future__ import annotations

import numpy as np

from estimation.arrays import FloatArray

ACCEL_NOISE = 2.2555e-3 / 2**0.5  # m/s^2/sqrt(Hz), two-sided (data sheet: 0.23 mg/sqrt(Hz))
GYRO_WALK = 1.63e-3  # m/s^2/sqrt(s): gravity times the angle walk of the gyro
FREE_LEVEL = 1.0  # m/s^2, unknown level of a window
DRIFT = 1.5e-3  # m/s^3, of the level


def hidden_covariance(n: int, dt_s: float) -> FloatArray:
    """Covariance (n, n) of all that hides a step in a window of n blocks, but for the vibration."""
    age = dt_s * np.arange(n)
    return np.asarray(
        np.eye(n) * ACCEL_NOISE**2 / dt_s
        + GYRO_WALK**2 * np.minimum(age[:, None], age[None, :])
        + FREE_LEVEL**2
        + DRIFT**2 * np.outer(age, age)
    )
