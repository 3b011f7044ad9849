"""What an alignment may claim: each angle with its sigma, its limit, and whether it was observed at all."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from math import cos, hypot, tan

import numpy as np

from estimation.alignment.earth import RATE_RAD_S, Place
from estimation.alignment.fine import Prior
from estimation.alignment.sensor import SensorGrade
from estimation.arrays import FloatArray

OBSERVED_SHARE = 0.5  # of the prior's sigma: what is left of an angle that was observed
BLIND_RAD = 0.5  # heading error that the gyroscopes' bias alone makes: beyond it there is nothing to find
MOVED_SIGMAS = 5.0  # of the felt force or rate off the Earth's: the sensor moved, or is worse than its grade


class Verdict(StrEnum):
    """Of one angle."""

    OBSERVED = "observed"
    NOT_OBSERVED = "not observed: value is the prior"
    DOUBTFUL = "doubtful: this grade does not explain what was felt"
    PRINTED = "as printed: nothing tells how good it is"
    REFUSED = "refused: the gyroscopes cannot feel the Earth's rate"


@dataclass(frozen=True)
class Limits:
    """One sigma that the biases of a resting sensor leave, however long it rests [rad]."""

    level: float
    heading: float


def limits(grade: SensorGrade, place: Place) -> Limits:
    """Level: accelerometer bias over g. Heading: east gyroscope's over the Earth's northern rate, and the level's."""
    level = grade.accel_bias / place.gravity_m_s2
    return Limits(level, hypot(_gyro_heading(grade, place), tan(place.latitude) * level))


def verdicts(sigma: FloatArray, prior: Prior, grade: SensorGrade, place: Place) -> tuple[Verdict, Verdict, Verdict]:
    """Of the angles about east, north and up, for posterior sigmas (3,) [rad]."""
    level = [Verdict.OBSERVED if s <= OBSERVED_SHARE * prior.level else Verdict.NOT_OBSERVED for s in sigma[:2]]
    if _gyro_heading(grade, place) > BLIND_RAD:
        heading = Verdict.REFUSED
    else:
        heading = Verdict.OBSERVED if sigma[2] <= OBSERVED_SHARE * prior.heading else Verdict.NOT_OBSERVED
    return level[0], level[1], heading


@dataclass(frozen=True)
class RestFaults:
    """A sentence each, empty where all is well."""

    force: str
    rate: str

    @property
    def sentences(self) -> list[str]:
        """Those there are."""
        return [sentence for sentence in (self.force, self.rate) if sentence]


def rest_faults(force: FloatArray, rate: FloatArray, duration_s: float, grade: SensorGrade, place: Place) -> RestFaults:
    """What in mean force and rate (3,) a resting sensor of this grade at this place cannot feel."""
    on_force = on_rate = ""
    wide = hypot(grade.accel_bias, grade.velocity_walk / duration_s**0.5)
    off = float(np.linalg.norm(force)) - place.gravity_m_s2
    if abs(off) > MOVED_SIGMAS * wide:
        on_force = (
            f"the force felt is {off:+.4f} m/s² off gravity ({place.gravity_m_s2:.4f}), {abs(off) / wide:.0f} sigma of "
            "this grade: the accelerometers are worse, or the sensor did not rest"
        )
    # Three gyroscopes err; against a rate much larger than the Earth's their size is what shows.
    wide = 3**0.5 * hypot(grade.gyro_bias, grade.angle_walk / duration_s**0.5)
    off = float(np.linalg.norm(rate)) - RATE_RAD_S
    if abs(off) > MOVED_SIGMAS * wide:
        on_rate = (
            f"the rate felt is {np.degrees(off) * 3600:+.0f} deg/h off the Earth's, {abs(off) / wide:.0f} sigma of "
            "this grade: the gyroscopes' turn-on bias is larger, or the sensor turned"
        )
    return RestFaults(on_force, on_rate)


def _gyro_heading(grade: SensorGrade, place: Place) -> float:
    return grade.gyro_bias / (RATE_RAD_S * cos(place.latitude))
