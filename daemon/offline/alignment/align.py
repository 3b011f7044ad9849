"""Alignment of a sensor at rest: level, heading if it can be known, and what may be claimed of either."""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot, inf, nan, pi, radians

import numpy as np

from daemon.offline.alignment.rest import BLOCK_S, Rest
from estimation.alignment.attitude import from_angles, to_angles
from estimation.alignment.coarse import as_printed, nearest_rotation, triad
from estimation.alignment.earth import Place
from estimation.alignment.fine import FineAlignment, Prior
from estimation.alignment.sensor import SensorGrade
from estimation.alignment.verdict import Limits, RestFaults, Verdict, limits, rest_faults, verdicts
from estimation.arrays import FloatArray

METHODS = {
    "ours": "coarse by the triad, then the ten-state filter of paper B with the sensor's own process noise",
    "triad": "coarse alone: up is where the force points, east lies across it and the Earth's rate",
    "printed": "coarse alone by paper B's eq. (23) to (25) and the nearest rotation: spreads the gyroscopes' error",
}
VELOCITY_SIGMA_M_S = 0.005
SURVEYED_DEG = 1.0  # of a heading from the survey
UNKNOWN_HEADING = pi / 3**0.5  # sigma of anything
COARSE_SHARE = 0.2  # of the rest: what finds the first heading serves the filter no second time
AXES = ("pitch", "roll", "heading")


@dataclass(frozen=True)
class Angle:
    """One angle of the attitude [rad]."""

    name: str
    value: float
    sigma: float
    prior_sigma: float
    limit: float
    verdict: Verdict


@dataclass(frozen=True)
class Alignment:
    """What an alignment found."""

    rest_s: float
    shocks: int  # blocks left out
    angles: tuple[Angle, Angle, Angle]
    gyro_bias_deg_s: FloatArray  # (3,) support axes; the Earth's rate taken out as far as the heading is known
    bias_removed: bool  # before the fine alignment: the gyroscopes cannot feel the Earth through it
    faults: list[str]
    nis: float
    course: FloatArray  # (steps, 3) pitch, roll, heading [rad]; none of a coarse alignment
    course_sigma: FloatArray  # (steps, 3)


@dataclass(frozen=True)
class _Start:
    """What is known before the filter."""

    attitude: FloatArray
    prior: Prior
    bias: FloatArray
    blind: bool  # the gyroscopes cannot feel the Earth
    faults: RestFaults
    bound: Limits


def align(
    rest: Rest, grade: SensorGrade, place: Place, heading_deg: float | None = None, method: str = "ours"
) -> Alignment:
    """Align a sensor on its rest.

    Args:
        rest: the sensor at rest.
        grade: how good it is.
        place: where it is.
        heading_deg: of the push axis, counter-clockwise from north, from a survey; None: what the gyroscopes tell.
        method: a name of `METHODS`.
    """
    start = _start(rest, grade, place, heading_deg)
    if method == "ours":
        return _fine(rest, grade, place, start, heading_deg)
    return _coarse(rest, grade, place, start, heading_deg, method)


def _start(rest: Rest, grade: SensorGrade, place: Place, heading_deg: float | None) -> _Start:
    force, rate = (values[rest.quiet].mean(axis=0) for values in (rest.force, rest.rate))
    bound = limits(grade, place)
    blind = verdicts(np.full(3, inf), Prior(1.0, 1.0), grade, place)[2] is Verdict.REFUSED
    pitch, roll, _ = to_angles(triad(force, rate))
    first = max(1, round(COARSE_SHARE * len(rest.force)))
    begun = rest.quiet[:first] if rest.quiet[:first].any() else np.ones(first, dtype=np.bool_)
    early = triad(rest.force[:first][begun].mean(axis=0), rest.rate[:first][begun].mean(axis=0))
    yaw, sigma = to_angles(early)[2], _first_heading(grade, place, bound, first * BLOCK_S)
    if heading_deg is not None:
        yaw, sigma = np.array(radians(heading_deg)), radians(SURVEYED_DEG)
    elif blind:
        yaw, sigma = np.array(0.0), UNKNOWN_HEADING
    attitude = from_angles(pitch, roll, yaw)
    return _Start(
        attitude,
        Prior(max(10 * bound.level, radians(0.1)), sigma),
        rate - attitude.T @ place.rate,
        blind,
        rest_faults(force, rate, rest.seconds, grade, place),
        bound,
    )


def _first_heading(grade: SensorGrade, place: Place, bound: Limits, seconds: float) -> float:
    """Sigma of the triad's heading after so long, generous: its bias is not told apart from the filter's."""
    walk = grade.angle_walk / seconds**0.5 / place.rate_north_up[0]
    return min(hypot(3.0 * bound.heading, walk), UNKNOWN_HEADING)


def _fine(rest: Rest, grade: SensorGrade, place: Place, start: _Start, heading_deg: float | None) -> Alignment:
    force, rate, begin = rest.force, rest.rate, 0
    if start.blind:
        rate = rate - start.bias  # what is left is the Earth's rate as the attitude has it, and noise
        left_deg_h = grade.angle_walk_deg_sqrt_h / (rest.seconds / 3600) ** 0.5
        grade = grade.model_copy(update={"gyro_bias_deg_h": left_deg_h})
    elif heading_deg is None:
        begin = max(1, round(COARSE_SHARE * len(force)))
    mean_force, mean_rate = force[rest.quiet].mean(axis=0), rate[rest.quiet].mean(axis=0)
    fine = FineAlignment(place, grade, start.attitude, start.prior, VELOCITY_SIGMA_M_S)
    course, sigmas = [], []
    for one_rate, one_force, good in zip(rate[begin:], force[begin:], rest.quiet[begin:], strict=True):
        fine.step((one_rate if good else mean_rate) * BLOCK_S, (one_force if good else mean_force) * BLOCK_S, BLOCK_S)
        course.append([float(one) for one in to_angles(fine.attitude)])
        level = float(np.max(fine.sigma[:2]))  # the heading turns east and north into pitch and roll
        sigmas.append([level, level, float(fine.sigma[2])])
    told = _told(verdicts(fine.sigma, start.prior, grade, place), start, heading_deg)
    return _made(rest, start, told, np.array(course), np.array(sigmas), float(fine.innovations_2) / (2 * fine.steps))


def _coarse(
    rest: Rest, grade: SensorGrade, place: Place, start: _Start, heading_deg: float | None, method: str
) -> Alignment:
    force, rate = (values[rest.quiet].mean(axis=0) for values in (rest.force, rest.rate))
    c = triad(force, rate) if method == "triad" else nearest_rotation(as_printed(force, rate, place))
    values = [float(one) for one in to_angles(c)]
    level = hypot(start.bound.level, grade.velocity_walk / rest.seconds**0.5 / place.gravity_m_s2)
    walk = grade.angle_walk / rest.seconds**0.5 / place.rate_north_up[0]
    sigma = np.array([level, level, min(hypot(start.bound.heading, walk), UNKNOWN_HEADING)])
    if method == "triad":
        told = _told(verdicts(sigma, start.prior, grade, place), start, None)
        if heading_deg is not None:
            values[2], sigma[2] = radians(heading_deg), start.prior.heading
            told = (*told[:2], Verdict.NOT_OBSERVED)
    else:
        told, sigma = (Verdict.PRINTED,) * 3, np.full(3, nan)
    return _made(rest, start, told, np.array([values]), sigma[None], nan)


def _numbness(rest: Rest) -> list[str]:
    if not rest.numb:
        return []
    return [
        f"the gyroscopes read exactly zero in {rest.numb:.0%} of the rest: a dead band hides their bias "
        "and the Earth's rate; switch it off in the part"
    ]


def _told(
    told: tuple[Verdict, Verdict, Verdict], start: _Start, heading_deg: float | None
) -> tuple[Verdict, Verdict, Verdict]:
    """Verdicts in the light of what else is known."""
    pitch, roll, heading = told
    if start.faults.force:
        pitch = roll = Verdict.DOUBTFUL
    if start.faults.rate and not start.blind:
        heading = Verdict.DOUBTFUL
    if start.blind:
        heading = Verdict.REFUSED if heading_deg is None else Verdict.NOT_OBSERVED
    return pitch, roll, heading


def _made(
    rest: Rest,
    start: _Start,
    told: tuple[Verdict, Verdict, Verdict],
    course: FloatArray,
    sigmas: FloatArray,
    nis: float,
) -> Alignment:
    ends = (start.bound.level, start.bound.level, start.bound.heading)
    priors = (start.prior.level, start.prior.level, start.prior.heading)
    angles = [
        Angle(name, nan if verdict is Verdict.REFUSED else float(value), float(sigma), prior, end, verdict)
        for name, value, sigma, prior, end, verdict in zip(
            AXES, course[-1], sigmas[-1], priors, ends, told, strict=True
        )
    ]
    return Alignment(
        rest.seconds,
        rest.shocks,
        (angles[0], angles[1], angles[2]),
        np.degrees(start.bias),
        start.blind,
        [*start.faults.sentences, *_numbness(rest)],
        nis,
        course,
        sigmas,
    )
