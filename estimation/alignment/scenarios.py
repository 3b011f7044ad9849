"""Nine alignments of a virtual sensor at rest, AL-1 to AL-9: grades, places and times about those of paper B."""

from __future__ import annotations

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


ALIGNMENTS = {
    "AL-1": Alignment("navigation", 40, 5, 0.1, 1, 1),
    "AL-2": Alignment("navigation", 39.84, 50, 0.1, 1, 1),
    "AL-3": Alignment("navigation", 40, 300, 0.1, 1, 1),
    "AL-4": Alignment("tactical", 40, 300, 0.2, 5, 5),
    "AL-5": Alignment("adis16448_in_run", 39.84, 50, 0.5, 5, 5),
    "AL-6": Alignment("adis16448_in_run", 39.84, 300, 0.5, 5, 5),
    "AL-7": Alignment("adis16448_turn_on", 39.84, 50, 2, 5, 5),
    "AL-8": Alignment("paper_b", 40, 5, 0.1, 1, 1),
    "AL-9": Alignment("navigation", 65, 300, 0.1, 1, 1),
}


@dataclass(frozen=True)
class Aligned:
    """What came of many runs of one setting."""

    errors: FloatArray  # (runs, 3) misalignment east, north, up [rad]
    sigma: FloatArray  # (3,) stated [rad]
    nees: FloatArray  # (runs,) of the three angles
    nis: float  # mean squared innovation in its sigmas


def play(case: Alignment, grade: SensorGrade, runs: int, seed: int) -> Aligned:
    """Align `runs` virtual sensors, each with errors of its own."""
    rng = np.random.default_rng(seed)
    place = Place(case.latitude_deg)
    tilt = radians(TILT_DEG)
    pitch, roll = rng.uniform(-tilt, tilt, runs), rng.uniform(-tilt, tilt, runs)
    true = from_angles(pitch, roll, rng.uniform(-np.pi, np.pi, runs))
    prior = Prior(radians(case.level_deg), radians(case.heading_deg))
    begun = rng.standard_normal((runs, 3)) * np.array([prior.level, prior.level, prior.heading])
    gyro_bias = grade.gyro_bias * rng.standard_normal((runs, 3))
    accel_bias = grade.accel_bias * rng.standard_normal((runs, 3))
    back = np.swapaxes(true, -1, -2)
    turn = back @ place.rate + gyro_bias
    force = back @ np.array([0.0, 0.0, place.gravity_m_s2]) + accel_bias
    fine = FineAlignment(place, grade, rotation(-begun) @ true, prior, case.velocity_mm_s * 1e-3)
    root = STEP_S**0.5
    for _ in range(round(case.duration_s / STEP_S)):
        fine.step(
            turn * STEP_S + grade.angle_walk * root * rng.standard_normal((runs, 3)),
            force * STEP_S + grade.velocity_walk * root * rng.standard_normal((runs, 3)),
            STEP_S,
            case.velocity_mm_s * 1e-3 * rng.standard_normal((runs, 2)),
        )
    errors = misalignment(fine.attitude, true)
    inverse = np.linalg.inv(fine.p[2:5, 2:5])
    nees = np.einsum("ri,ij,rj->r", errors, inverse, errors)
    return Aligned(errors, fine.sigma, nees, float(fine.innovations_2.mean()) / (2 * fine.steps))
