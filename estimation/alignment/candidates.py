"""What an alignment makes of candidate process noises: many of them at once, each on the record of a run (paper B).

Paper B's candidate is one number S, added at each step to the variances of both velocities and of all three angles
(eq. 37; read as the noise of one step, in (m/s)^2 and in rad^2 alike). Its fitness (eq. 36, 38) wants the true
attitude: it is for virtual sensors only.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from estimation.alignment.attitude import misalignment
from estimation.alignment.fine import FineAlignment
from estimation.alignment.scenarios import STEP_S, Resting
from estimation.arrays import FloatArray


class Records:
    """Records of virtual sensors at rest, kept to be aligned on again and again."""

    def __init__(self, sensors: Resting) -> None:
        self.sensors = sensors
        self.increments = list(sensors.steps())

    @property
    def ours(self) -> FloatArray:
        """(2,) the process noise that is right: the sensor's random walks [(m/s)^2/s, rad^2/s]."""
        grade = self.sensors.grade
        return np.array([grade.velocity_walk**2, grade.angle_walk**2])

    def align(self, run: NDArray[np.intp], noise: FloatArray) -> Iterator[FineAlignment]:
        """Candidates `noise` (m, 2), as `FineAlignment` takes it, on runs (m,): the filter after each step."""
        case, grade = self.sensors.case, self.sensors.grade
        fine = FineAlignment(case.place, grade, self.sensors.begun[run], case.prior, case.velocity_mm_s * 1e-3, noise)
        for turn, push, moved in self.increments:
            fine.step(turn[run], push[run], STEP_S, moved[run])
            yield fine

    def fitness(self, run: NDArray[np.intp], s: FloatArray) -> FloatArray:
        """Mean squared misalignment [rad^2] over the record of candidates S (m,) on runs (m,), eq. (36)-(38)."""
        total, true = np.zeros(len(s)), self.sensors.true[run]
        with np.errstate(all="ignore"):  # an S beyond all bounds gives no finite value
            for fine in self.align(run, each_step(s)):
                total += (misalignment(fine.attitude, true) ** 2).mean(axis=-1)
        return total / len(self.increments)


def each_step(s: FloatArray) -> FloatArray:
    """Scalars S (m,) of one step as variances per second of velocity and attitude, (m, 2)."""
    return np.repeat(s[:, None] / STEP_S, 2, axis=1)
