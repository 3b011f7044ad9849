"""Where in a recording the sensor keeps its attitude, and what that tells: gravity and the gyro's bias.

A ram at constant speed is as good as one at rest here; only somebody who handles the sensor is left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimation.mount.stretch import BLOCK_S, Stretch

Array = NDArray[np.float64]

WINDOW_S = 5.0
PARTS = 8  # of a window, compared with each other
LARGEST_CHANGE_M_S2 = 0.1  # rms between the parts: 0.6 degrees of tilt
GYRO_BIAS_SPAN_S = 60.0


@dataclass(frozen=True)
class Stillness:
    """Means over windows of `WINDOW_S` in which the sensor did not turn, in order of time."""

    t_s: Array  # (n,), middle
    force: Array  # (n, 3), m/s^2
    rate: Array  # (n, 3), rad/s
    vibration: Array  # (n,), m/s^2

    def __len__(self) -> int:
        return len(self.t_s)

    def gyro_bias(self, t_s: Array) -> Array:
        """Bias (m, 3) [rad/s] at times (m,): mean rate of the quieter half, which is rest, over about a minute."""
        quiet = self.vibration <= np.median(self.vibration)
        t, rate = self.t_s[quiet], self.rate[quiet]
        first, last = (np.searchsorted(t, t + side * GYRO_BIAS_SPAN_S / 2, "right") for side in (-1, 1))
        total = np.concatenate([np.zeros((1, 3)), np.cumsum(rate, axis=0)])
        mean = (total[last] - total[first]) / (last - first)[:, None]
        return np.column_stack([np.interp(t_s, t, column) for column in mean.T])


def stillness(stretches: list[Stretch]) -> Stillness:
    """All still windows of the stretches."""
    n = PARTS * round(WINDOW_S / BLOCK_S / PARTS)
    rows = [np.zeros((0, 8))]
    for stretch in stretches:
        k = len(stretch.t_s) // n
        force, rate = (
            values[: k * n].reshape(k, PARTS, n // PARTS, 3).mean(axis=2) for values in (stretch.accel, stretch.gyro)
        )
        shaken = stretch.vibration(0, -n)[: k * n : n]
        felt = np.linalg.norm(force.mean(axis=1), axis=1) > 0.0  # nothing at all is what a dead sensor feels
        still = felt & (np.sqrt(force.var(axis=1).sum(axis=1)) < LARGEST_CHANGE_M_S2)
        middle = stretch.t_s[: k * n].reshape(k, n).mean(axis=1)
        rows.append(np.column_stack([middle, force.mean(axis=1), rate.mean(axis=1), shaken])[still])
    table = np.concatenate(rows)
    return Stillness(table[:, 0], table[:, 1:4], table[:, 4:7], table[:, 7])
