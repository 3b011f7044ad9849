"""A recording's inertial samples as even block means, for what looks at the whole of it at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimation.noise import ACCEL_NOISE
from estimation.recognition.spectrum import WHITE_SECOND_DIFFERENCE, VibrationSpectrum

Array = NDArray[np.float64]

BLOCK_S = 8 / 819.2


@dataclass(frozen=True)
class Stretch:
    """Block means of samples without a gap, `BLOCK_S` apart.

    t_s: ends of the blocks (n,); accel, gyro: specific force [m/s^2] and rate [rad/s] in sensor axes (n, 3).
    """

    t_s: Array
    accel: Array
    gyro: Array

    @classmethod
    def from_blocks(cls, t_s: Array, dt_s: Array, accel: Array, gyro: Array) -> Stretch:
        """Blocks of any lengths `dt_s` that join, cut anew: their integral is known exactly where they meet."""
        ends = np.concatenate([t_s[:1] - dt_s[:1], t_s])
        integral = np.cumsum(np.column_stack([accel, gyro]) * dt_s[:, None], axis=0)
        edges_s = np.arange(ends[0], ends[-1], BLOCK_S)
        at_edges = np.column_stack([np.interp(edges_s, ends, [0.0, *column]) for column in integral.T])
        means = np.diff(at_edges, axis=0) / BLOCK_S
        return cls(edges_s[1:], means[:, :3], means[:, 3:])

    def vibration(self, first: int, last: int) -> Array:
        """Level of vibration, rms of an axis [m/s^2], from `first` to `last` blocks ago, for each block (n,).

        Negative numbers are blocks to come; at the ends of the stretch there may be fewer.
        """
        second = self.accel[2:] - 2 * self.accel[1:-1] + self.accel[:-2]
        white = WHITE_SECOND_DIFFERENCE * ACCEL_NOISE**2 / BLOCK_S
        total = np.concatenate([[0.0], np.cumsum((second**2).mean(axis=1) - white)])
        place = np.arange(len(self.accel))
        begin = np.clip(place - first, 0, len(second) - 1)
        end = np.clip(place - last, begin + 1, len(second))
        square = (total[end] - total[begin]) / (end - begin)
        return np.asarray(np.sqrt(np.maximum(square, 0.0) / VibrationSpectrum(BLOCK_S).second_difference_gain()))
