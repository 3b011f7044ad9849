"""Noise of a recorded sensor from the longest rest in the recording, and the sensor grade that follows."""

from __future__ import annotations

import re
from array import array
from dataclasses import dataclass, field
from math import degrees, nan
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from daemon.offline.replaying.replay import Progress, replay
from daemon.recording.errors import RecordingError
from daemon.recording.topics import Recorded
from estimation.alignment.allan import Noise, noise_of
from estimation.alignment.sensor import G_M_S2, SensorGrade
from estimation.arrays import FloatArray
from estimation.records import Estimate, ImuSample, Record, Segment, SensorChange, Tier

LEAST_S = 60.0  # of rest
MARGIN_S = 2.0  # from a move: what rings and creeps
GAP_PERIODS = 10.0  # are a hole; fewer lost samples are made up by the mean period
HANDLED_M_S2, HANDLED_RAD_S = 0.3, 0.05  # from one second's mean to the next: carried or turned, not shaken
HELD = 0.9  # of the samples the same value: dead band or resolution hide the noise


@dataclass(frozen=True)
class Axis:
    """One axis of the sensor."""

    name: str  # "gyro x" ... "accel z", the sensor's own axes
    noise: Noise

    @property
    def hidden(self) -> bool:
        """Whether the sensor's output steps are too coarse to show the noise."""
        return self.noise.held > HELD

    @property
    def excess(self) -> float:
        """How many times the white noise's line the curve reaches at times before it holds; 0 if it holds at once."""
        curve, white = self.noise.curve, self.noise.white
        if white is None:
            return nan
        before = curve.tau_s < white.from_s
        return float(np.max(curve.deviation[before] * np.sqrt(curve.tau_s[before]) / white.density, initial=0.0))


@dataclass(frozen=True)
class Allan:
    """Noise of a recorded sensor."""

    path: Path
    start_s: float  # of the rest, on the recording's clock
    rest_s: float
    period_s: float  # mean
    samples: int
    missing: int  # single samples lost within the rest
    gyro: tuple[Axis, ...]  # x, y, z; rad/s
    accel: tuple[Axis, ...]  # m/s^2

    @property
    def source(self) -> str:
        """Where the figures are from."""
        return f"Allan deviation of {self.path.name}, {self.rest_s:.0f} s of rest"

    @property
    def name(self) -> str:
        """Of the grade: the file's, as a TOML key without quotes."""
        return re.sub(r"[^A-Za-z0-9_-]", "_", self.path.stem)

    @property
    def obstacles(self) -> list[str]:
        """Why there is no grade, a sentence each; empty if there is one."""
        found = []
        for axes, what in ((self.gyro, "gyroscopes"), (self.accel, "accelerometers")):
            if all(axis.hidden for axis in axes):
                found.append(f"the {what} show no noise: take it from the data sheet.")
            found += [
                f"{axis.name} has no stretch of white noise: record a longer rest, with nothing that shakes."
                for axis in axes
                if not axis.hidden and (axis.noise.white is None or axis.noise.instability is None)
            ]
        return found

    def grade(self) -> SensorGrade | None:
        """The worst axes' figures; axes that hide their noise left out. None: see `obstacles`."""
        if self.obstacles:
            return None
        return SensorGrade(
            gyro_bias_deg_h=degrees(_worst_instability(self.gyro)) * 3600,
            angle_walk_deg_sqrt_h=degrees(_worst_white(self.gyro)) * 60,
            accel_bias_mg=_worst_instability(self.accel) / G_M_S2 * 1e3,
            velocity_walk_m_s_sqrt_h=_worst_white(self.accel) * 60,
            source=self.source,
        )


def _worst_white(axes: tuple[Axis, ...]) -> float:
    return max(axis.noise.white.density for axis in axes if axis.noise.white is not None and not axis.hidden)


def _worst_instability(axes: tuple[Axis, ...]) -> float:
    return max(axis.noise.instability.value for axis in axes if axis.noise.instability is not None and not axis.hidden)


def allan(path: Path, progress: Progress | None = None, least_s: float = LEAST_S) -> Allan:
    """Noise of the sensor in the longest rest of a recording.

    A rest is what lies between moves, handling, gaps and changes of the sensor. One that shakes is a rest too: its
    vibration is in the curve.

    Args:
        path: the recording, of any kind.
        progress: called now and then with the share of the file that has been read.
        least_s: shorter rests are refused.

    Raises:
        RecordingError: it cannot be read, or has no rest of `least_s`.
    """
    collector = _Collector()
    replay(path, sink=collector.see, progress=progress, tap=collector.take)
    t_ns, values = collector.arrays()
    begin, end = _longest_rest(t_ns, values, np.array(collector.moving_ns), np.array(collector.changes_ns))
    rest_s = (int(t_ns[end - 1]) - int(t_ns[begin])) * 1e-9 if end > begin else 0.0
    if rest_s < least_s or not rest_s > 0:
        raise RecordingError(
            f"{path}: its longest rest without gaps lasts {rest_s:.1f} s: --allan wants {least_s:g} s at least of a "
            "sensor that nobody moves, and hours to see how steady its biases are"
        )
    period_s = rest_s / (end - begin - 1)
    steps = np.diff(t_ns[begin:end])
    missing = np.maximum(np.rint(steps / np.median(steps)) - 1, 0).sum()
    try:
        axes = [
            Axis(f"{kind} {axis}", noise_of(np.ascontiguousarray(values[begin:end, 3 * first + number]), period_s))
            for first, kind in enumerate(("gyro", "accel"))
            for number, axis in enumerate("xyz")
        ]
    except ValueError as error:
        raise RecordingError(f"{path}: no Allan deviation can be made of its rest: {error}") from error
    return Allan(
        path,
        int(t_ns[begin]) * 1e-9,
        rest_s,
        period_s,
        end - begin,
        int(missing),
        tuple(axes[:3]),
        tuple(axes[3:]),
    )


@dataclass
class _Collector:
    """Samples in compact arrays (a night is twenty million), and when the support or the sensor was another."""

    t_ns: array[int] = field(default_factory=lambda: array("q"))
    values: array[float] = field(default_factory=lambda: array("d"))
    moving_ns: array[int] = field(default_factory=lambda: array("q"))  # settled steps of moves
    changes_ns: array[int] = field(default_factory=lambda: array("q"))  # last sample before another sensor

    def take(self, record: Record) -> None:
        """What the estimator gets."""
        if isinstance(record, ImuSample):
            if not self.t_ns or record.t_ns > self.t_ns[-1]:
                self.t_ns.append(record.t_ns)
                self.values.extend(record.gyro + record.accel)
        elif isinstance(record, SensorChange) and self.t_ns:
            self.changes_ns.append(self.t_ns[-1])

    def see(self, _topic: str, record: Recorded) -> None:
        """What the estimator makes of it."""
        if isinstance(record, Estimate) and record.tier is Tier.SETTLED and record.segment is not Segment.ZUPT:
            self.moving_ns.append(record.t_ns)

    def arrays(self) -> tuple[NDArray[np.int64], FloatArray]:
        """Times (n,) [ns] and samples (n, 6): gyro [rad/s], accel [m/s^2]."""
        return np.array(self.t_ns, dtype=np.int64), np.frombuffer(self.values, dtype=np.float64).reshape(-1, 6)


def _longest_rest(
    t_ns: NDArray[np.int64], values: FloatArray, moving_ns: NDArray[np.int64], changes_ns: NDArray[np.int64]
) -> tuple[int, int]:
    """First and last + 1 sample of the longest rest; (0, 0) if there is none."""
    if len(t_ns) < 2:
        return 0, 0
    still = ~_near(t_ns, moving_ns) & ~_near(t_ns, _handled_ns(t_ns, values))
    steps = np.diff(t_ns)
    cut = (steps > GAP_PERIODS * np.median(steps)) | (still[1:] != still[:-1]) | np.isin(t_ns[:-1], changes_ns)
    begins = np.concatenate([[0], np.flatnonzero(cut) + 1])
    ends = np.concatenate([begins[1:], [len(t_ns)]])
    length_ns = np.where(still[begins], t_ns[ends - 1] - t_ns[begins], -1)
    longest = int(np.argmax(length_ns))
    return (int(begins[longest]), int(ends[longest])) if length_ns[longest] > 0 else (0, 0)


def _near(t_ns: NDArray[np.int64], marks_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which times lie within the margin of one of the marks, which are in order."""
    margin_ns = round(MARGIN_S * 1e9)
    inside = np.searchsorted(marks_ns, t_ns + margin_ns, "right") > np.searchsorted(marks_ns, t_ns - margin_ns, "left")
    return np.asarray(inside, dtype=np.bool_)


def _handled_ns(t_ns: NDArray[np.int64], values: FloatArray) -> NDArray[np.int64]:
    """Times between two seconds whose mean force or rate differ: the sensor was carried or turned by hand."""
    second = (t_ns - t_ns[0]) // 1_000_000_000
    begins = np.flatnonzero(np.diff(second, prepend=-1))
    counts = np.diff(begins, append=len(t_ns))
    jumps = np.abs(np.diff(np.add.reduceat(values, begins) / counts[:, None], axis=0))
    full = np.minimum(counts[1:], counts[:-1]) > 0.5 * np.median(counts)  # the mean of a few samples may be a vibration
    handled = full & ((jumps[:, :3] > HANDLED_RAD_S) | (jumps[:, 3:] > HANDLED_M_S2)).any(axis=1)
    return np.asarray(t_ns[begins[1:][handled]], dtype=np.int64)
