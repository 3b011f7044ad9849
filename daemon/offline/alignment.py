"""Alignment of a recorded sensor at rest: level, heading if it can be known, and what may be claimed of either."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import inf, pi, radians
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from daemon.offline.replay import replay, settings_of
from daemon.recording.errors import RecordingError
from daemon.recording.reader import Recording
from estimation.alignment.attitude import from_angles, to_angles
from estimation.alignment.coarse import triad
from estimation.alignment.earth import Place
from estimation.alignment.fine import FineAlignment, Prior
from estimation.alignment.sensor import SensorGrade
from estimation.alignment.verdict import Limits, Verdict, limits, rest_faults, verdicts
from estimation.arrays import FloatArray
from estimation.methods.batch import Batch, Collector
from estimation.records import Record

BLOCK_S = 0.1
LEAST_S = 5.0  # of rest
BEFORE_MOVE_S = 0.5
SHOCK_SIGMAS = 8.0  # of a block's force, in robust sigmas of the rest's blocks
MOVED_BLOCKS = 5  # in a row are a motion, fewer a shock
MOST_SHOCKS = 0.2  # of the blocks: more, and it is no rest
VELOCITY_SIGMA_M_S = 0.005
SURVEYED_DEG = 1.0  # of a heading from the survey
UNKNOWN_HEADING = pi / 3**0.5  # sigma of anything


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


def align(
    path: Path,
    grade: SensorGrade,
    place: Place,
    heading_deg: float | None = None,
    duration_s: float = inf,
    progress: Callable[[int], None] | None = None,
) -> Alignment:
    """Align on the rest at the beginning of a recording, up to its first move.

    Args:
        path: the recording.
        grade: how good its sensor is.
        place: where it was made.
        heading_deg: of the push axis, counter-clockwise from north, from a survey; None: what the gyroscopes tell.
        duration_s: of rest to use at most.
        progress: called now and then with the number of messages read.

    Raises:
        RecordingError: there is too little rest, or none.
    """
    if not duration_s > 0:
        raise ValueError("a duration must be above 0 s")
    batch = _batch(path, progress)
    rest_s = min(batch.moves[0].onset_s - BEFORE_MOVE_S if batch.moves else float(batch.t_s[-1]), duration_s)
    if rest_s < LEAST_S:
        raise RecordingError(
            f"{path}: {max(rest_s, 0):.1f} s of rest at its beginning are too little: {LEAST_S:g} s at least"
        )
    force, rate = _blocks(batch, rest_s)
    count = _rests_until(force)
    if count * BLOCK_S < LEAST_S:
        raise RecordingError(
            f"{path}: the sensor is moved {count * BLOCK_S:.1f} s after its beginning: {LEAST_S:g} s of rest at least"
        )
    force, rate, rest_s = force[:count], rate[:count], min(rest_s, count * BLOCK_S)
    quiet = _quiet(force)
    if (~quiet).mean() > MOST_SHOCKS:
        raise RecordingError(
            f"{path}: in {(~quiet).mean():.0%} of the first {rest_s:.0f} s the sensor was moved or struck"
        )
    mean_force, mean_rate = force[quiet].mean(axis=0), rate[quiet].mean(axis=0)
    faults = rest_faults(mean_force, mean_rate, rest_s, grade, place)
    bound = limits(grade, place)
    blind = verdicts(np.full(3, inf), Prior(1.0, 1.0), grade, place)[2] is Verdict.REFUSED
    coarse = triad(mean_force, mean_rate)
    pitch, roll, yaw = to_angles(coarse)
    prior_heading = min(bound.heading * 3.0, UNKNOWN_HEADING)
    if heading_deg is not None:
        yaw, prior_heading = np.array(radians(heading_deg)), radians(SURVEYED_DEG)
    elif blind:
        yaw, prior_heading = np.array(0.0), UNKNOWN_HEADING
    attitude = from_angles(pitch, roll, yaw)
    bias = mean_rate - attitude.T @ place.rate
    if blind:
        rate = rate - bias  # what is left is the Earth's rate as the attitude has it, and noise
        left_deg_h = grade.angle_walk_deg_sqrt_h / (rest_s / 3600) ** 0.5
        grade = grade.model_copy(update={"gyro_bias_deg_h": left_deg_h})
    prior = Prior(max(10 * bound.level, radians(0.1)), prior_heading)
    fine = FineAlignment(place, grade, attitude, prior, VELOCITY_SIGMA_M_S)
    for one_rate, one_force, good in zip(rate, force, quiet, strict=True):
        kept_force, kept_rate = (
            (one_force, one_rate) if good else (mean_force, mean_rate - bias if blind else mean_rate)
        )
        fine.step(kept_rate * BLOCK_S, kept_force * BLOCK_S, BLOCK_S)
    told = verdicts(fine.sigma, prior, grade, place)
    if faults.force:
        told = (Verdict.DOUBTFUL, Verdict.DOUBTFUL, told[2])
    if faults.rate and not blind:
        told = (*told[:2], Verdict.DOUBTFUL)
    if blind:
        told = (*told[:2], Verdict.REFUSED if heading_deg is None else Verdict.NOT_OBSERVED)
    return Alignment(
        rest_s,
        int((~quiet).sum()),
        _angles(fine, prior, bound, told),
        np.degrees(bias),
        blind,
        faults.sentences,
        float(fine.innovations_2) / (2 * fine.steps),
    )


def _batch(path: Path, progress: Callable[[int], None] | None) -> Batch:
    settings = settings_of(Recording(path))
    collector = Collector(settings.mount, settings.support)

    def take(record: Record) -> None:
        collector.add(record)

    moves = replay(path, progress=progress, tap=take).moves
    try:
        return collector.batch(moves)
    except ValueError as error:
        raise RecordingError(f"{path}: nothing can be aligned on it: {error}") from error


def _blocks(batch: Batch, rest_s: float) -> tuple[FloatArray, FloatArray]:
    """Mean force and rate of each tenth of a second of the rest, (n, 3) each."""
    number = np.floor(batch.t_s / BLOCK_S).astype(np.int64)
    count = int(rest_s / BLOCK_S)
    inside = number < count
    samples = np.maximum(np.bincount(number[inside], minlength=count), 1)
    force, rate = (
        np.stack(
            [np.bincount(number[inside], column, minlength=count) / samples for column in values[inside].T], axis=1
        )
        for values in (batch.accel, batch.gyro)
    )
    return force, rate


def _rests_until(force: FloatArray) -> int:
    """Blocks before the sensor is moved for half a second: its force is then not what it was in the first seconds."""
    first = force[: round(LEAST_S / BLOCK_S)]
    off = np.abs(force - np.median(first, axis=0))
    spread = 1.4826 * np.median(off[: len(first)], axis=0) + 1e-4
    moved = (off > SHOCK_SIGMAS * spread).any(axis=1)
    runs = np.convolve(moved, np.ones(MOVED_BLOCKS), "valid") == MOVED_BLOCKS
    return int(np.argmax(runs)) if runs.any() else len(force)


def _quiet(force: FloatArray) -> NDArray[np.bool_]:
    """Blocks (n,) whose force is like that of the others; one without samples is none of them."""
    off = np.abs(force - np.median(force, axis=0))
    spread = 1.4826 * np.median(off, axis=0) + 1e-4
    return np.asarray((off < SHOCK_SIGMAS * spread).all(axis=1), dtype=np.bool_)


def _angles(
    fine: FineAlignment, prior: Prior, bound: Limits, verdict: tuple[Verdict, Verdict, Verdict]
) -> tuple[Angle, Angle, Angle]:
    """Pitch, roll, heading; the misalignment's level sigmas are turned by the heading, and alike."""
    pitch, roll, yaw = (float(one) for one in to_angles(fine.attitude))
    level = float(np.max(fine.sigma[:2]))
    if verdict[2] is Verdict.REFUSED:
        yaw = float("nan")
    return (
        Angle("pitch", pitch, level, prior.level, bound.level, verdict[0]),
        Angle("roll", roll, level, prior.level, bound.level, verdict[1]),
        Angle("heading", yaw, float(fine.sigma[2]), prior.heading, bound.heading, verdict[2]),
    )
