"""Alignments of a virtual sensor at rest: AL-1 to AL-9, and paper B's experiment; grades, places, times, priors."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import radians

import numpy as np

from estimation.alignment.attitude import from_angles, misalignment, rotation
from estimation.alignment.earth import Place
from estimation.alignment.fine import FineAlignment, Prior
from estimation.alignment.sensor import SensorGrade
from estimation.arrays import FloatArray

STEP_S = 0.1
TILT_DEG = 5.0  # of the true attitude, uniform; the heading is anything


@dataclass(frozen=True)
class Alignment:
    """One setting."""

    grade: str  # a name of config/sensor_grades.toml
    latitude_deg: float
    duration_s: float
    level_deg: float  # prior
    heading_deg: float  # prior
    velocity_mm_s: float  # vibration of the place, one sigma
    height_m: float = 0.0

    @property
    def place(self) -> Place:
        """Where it is."""
        return Place(self.latitude_deg, self.height_m)

    @property
    def prior(self) -> Prior:
        """What is known of the attitude beforehand."""
        return Prior(radians(self.level_deg), radians(self.heading_deg))


ALIGNMENTS = {
    "AL-1": Alignment("navigation", 40, 5, 0.1, 1, 1),
    "AL-2": Alignment("navigation", 39.84, 50, 0.1, 1, 1),
    "AL-3": Alignment("navigation", 40, 300, 0.1, 1, 1),
    "AL-4": Alignment("tactical", 40, 300, 0.2, 5, 5),
    "AL-5": Alignment("adis16448_in_run", 39.84, 50, 0.5, 5, 5),
    "AL-6": Alignment("adis16448_in_run", 39.84, 300, 0.5, 5, 5),
    "AL-7": Alignment("adis16448_turn_on", 39.84, 50, 2, 5, 5),
    "AL-8": Alignment("paper_b", 40, 5, 0.1, 1, 1, height_m=40),  # paper B, Table 2
    "AL-9": Alignment("navigation", 65, 300, 0.1, 1, 1),
}
EXPERIMENT = Alignment("jy901", 39.84, 50, 2, 5, 5, height_m=36)  # paper B, Table 4


@dataclass(frozen=True)
class Aligned:
    """What came of many runs of one setting."""

    errors: FloatArray  # (runs, 3) misalignment east, north, up [rad]
    sigma: FloatArray  # (3,) stated [rad]
    nees: FloatArray  # (runs,) of the three angles
    nis: float  # mean squared innovation in its sigmas


class Resting:
    """`runs` virtual sensors at rest, each with errors of its own."""

    def __init__(self, case: Alignment, grade: SensorGrade, runs: int, seed: int) -> None:
        self.case, self.grade, self.runs = case, grade, runs
        rng = self._rng = np.random.default_rng(seed)
        tilt, place, prior = radians(TILT_DEG), case.place, case.prior
        pitch, roll = rng.uniform(-tilt, tilt, runs), rng.uniform(-tilt, tilt, runs)
        self.true = from_angles(pitch, roll, rng.uniform(-np.pi, np.pi, runs))  # (runs, 3, 3)
        begun = rng.standard_normal((runs, 3)) * np.array([prior.level, prior.level, prior.heading])
        self.begun = rotation(-begun) @ self.true  # as the coarse alignment left it
        gyro_bias = grade.gyro_bias * rng.standard_normal((runs, 3))
        accel_bias = grade.accel_bias * rng.standard_normal((runs, 3))
        back = np.swapaxes(self.true, -1, -2)
        self._turn = back @ place.rate + gyro_bias
        self._force = back @ np.array([0.0, 0.0, place.gravity_m_s2]) + accel_bias

    def steps(self) -> Iterator[tuple[FloatArray, FloatArray, FloatArray]]:
        """Increments of rotation and velocity (runs, 3) and true velocity (runs, 2) of each interval; drawn once."""
        rng, root = self._rng, STEP_S**0.5
        for _ in range(round(self.case.duration_s / STEP_S)):
            yield (
                self._turn * STEP_S + self.grade.angle_walk * root * rng.standard_normal((self.runs, 3)),
                self._force * STEP_S + self.grade.velocity_walk * root * rng.standard_normal((self.runs, 3)),
                self.case.velocity_mm_s * 1e-3 * rng.standard_normal((self.runs, 2)),
            )


def play(case: Alignment, grade: SensorGrade, runs: int, seed: int) -> Aligned:
    """Align `runs` virtual sensors, each with errors of its own."""
    sensors = Resting(case, grade, runs, seed)
    fine = FineAlignment(case.place, grade, sensors.begun, case.prior, case.velocity_mm_s * 1e-3)
    for turn, push, moved in sensors.steps():
        fine.step(turn, push, STEP_S, moved)
    errors = misalignment(fine.attitude, sensors.true)
    inverse = np.linalg.inv(fine.p[2:5, 2:5])
    nees = np.einsum("ri,ij,rj->r", errors, inverse, errors)
    return Aligned(errors, fine.sigma, nees, float(fine.innovations_2.mean()) / (2 * fine.steps))
