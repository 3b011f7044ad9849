"""A sensor at rest, out of a recording: means over tenths of a second, and which of them are disturbed."""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field
from math import inf
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from daemon.imu.roles import Role
from daemon.inertial import SampleDecoder
from daemon.offline.replaying.replay import Progress, replay, settings_of
from daemon.recording import topics
from daemon.recording.errors import RecordingError
from daemon.recording.reader import Recording
from daemon.recording.topics import Recorded
from daemon.settings import Settings
from drivers.adis16448.burst import Burst
from drivers.jy901.reading import Reading
from estimation.arrays import FloatArray
from estimation.mount.axes import Mount
from estimation.records import Estimate, ImuSample, Segment

BLOCK_S = 0.1
LEAST_S = 5.0
BEFORE_MOVE_S = 0.5
SHOCK_SIGMAS = 8.0  # of a block's force, in robust sigmas of the rest's blocks
MOVED_BLOCKS = 5  # in a row are a motion, fewer a shock
MOST_SHOCKS = 0.2  # of the blocks: more, and it is no rest
_INERTIAL = (topics.IMU_RAW, topics.IMU_SAMPLE, topics.JY901)


@dataclass(frozen=True)
class Rest:
    """Means over tenths of a second, in the axes that the configuration names, without the tilt that it may give."""

    force: FloatArray  # (n, 3) m/s^2
    rate: FloatArray  # (n, 3) rad/s
    quiet: NDArray[np.bool_]  # (n,)

    @property
    def seconds(self) -> float:
        """How long it lasts."""
        return len(self.force) * BLOCK_S

    @property
    def numb(self) -> float:
        """Share of the blocks in which the gyroscopes read exactly zero: no noise does that, a dead band does."""
        return float((self.rate == 0.0).all(axis=1).mean())

    @property
    def shocks(self) -> int:
        """Blocks that are left out."""
        return int((~self.quiet).sum())


def rests_at_beginning(path: Path, duration_s: float = inf, progress: Progress | None = None) -> dict[Role, Rest]:
    """The rest at the beginning of a recording, up to its first move, of the sensor and of one beside it.

    Raises RecordingError: there is too little rest, or none. A sensor beside with too little of it is left out.
    """
    settings = settings_of(Recording(path))
    samples = _samples(settings)

    def receive(_topic: str, record: Recorded) -> None:
        if isinstance(record, Burst | Reading | ImuSample):
            for one in samples.values():
                one.take(record)

    moves = replay(path, sink=receive, progress=progress).moves
    first_ns = samples["main"].first_ns(path)
    end_s = (moves[0].onset_ns - first_ns) * 1e-9 - BEFORE_MOVE_S if moves else inf
    return _rests(path, samples, first_ns, min(end_s, duration_s))


def rests_since(path: Path, from_ns: int, duration_s: float) -> dict[Role, Rest]:
    """The rest since `from_ns` of a recording that is still being written. Raises RecordingError, as above."""
    recording = Recording(path)
    samples = _samples(settings_of(recording))
    for _, record in recording.messages((*_INERTIAL, topics.PROVISIONAL)):
        if isinstance(record, Estimate):
            if record.t_ns >= from_ns and record.segment is not Segment.ZUPT:
                raise RecordingError(f"{path}: the ram moved meanwhile: align while it rests")
        elif isinstance(record, Burst | Reading | ImuSample) and record.t_ns >= from_ns:
            for one in samples.values():
                one.take(record)
    return _rests(path, samples, samples["main"].first_ns(path), duration_s)


@dataclass
class _Samples:
    """Of one sensor, in compact arrays."""

    decoder: SampleDecoder
    mount: Mount
    t_ns: array[int] = field(default_factory=lambda: array("q"))
    values: array[float] = field(default_factory=lambda: array("d"))

    def take(self, record: Burst | Reading | ImuSample) -> None:
        """A good sample of this sensor that goes on in time; others pass."""
        sample = self.decoder.sample(record) if self.decoder.is_mine(record) else None
        if sample is not None and (not self.t_ns or sample.t_ns > self.t_ns[-1]):
            self.t_ns.append(sample.t_ns)
            self.values.extend((*self.mount.to_support(sample.accel), *self.mount.to_support(sample.gyro)))

    def first_ns(self, path: Path) -> int:
        """Raises RecordingError if there is none."""
        if not self.t_ns:
            raise RecordingError(f"{path}: nothing can be aligned on it: it holds no inertial samples")
        return self.t_ns[0]

    def blocks(self, from_ns: int, seconds: float) -> tuple[FloatArray, FloatArray]:
        """Mean force and rate of each tenth of a second, (n, 3) each; zero where there is no sample."""
        t_ns = np.array(self.t_ns, dtype=np.int64)
        values = np.frombuffer(self.values, dtype=np.float64).reshape(-1, 6)
        number = np.floor((t_ns - from_ns) * (1e-9 / BLOCK_S)).astype(np.int64)
        last_s = (int(t_ns[-1]) - from_ns) * 1e-9 if len(t_ns) else 0.0
        count = max(int(min(seconds, last_s) / BLOCK_S), 0)
        inside = (number >= 0) & (number < count)
        samples = np.maximum(np.bincount(number[inside], minlength=count), 1)
        means = [np.bincount(number[inside], column, minlength=count) / samples for column in values[inside].T]
        return np.stack(means[:3], axis=1), np.stack(means[3:], axis=1)


def _samples(settings: Settings) -> dict[Role, _Samples]:
    made: dict[Role, _Samples] = {"main": _Samples(SampleDecoder(settings), Mount(settings.mount, with_tilt=False))}
    if settings.jy901.use == "beside":
        made["beside"] = _Samples(SampleDecoder(settings, "beside"), Mount(settings.jy901_mount, with_tilt=False))
    return made


def _rests(path: Path, samples: dict[Role, _Samples], first_ns: int, seconds: float) -> dict[Role, Rest]:
    rests = {"main": _rest(path, *samples["main"].blocks(first_ns, seconds), seconds)}
    found: dict[Role, Rest] = {"main": rests["main"]}
    beside = samples.get("beside")
    if beside is not None and beside.t_ns:
        begun_ns = max(first_ns, beside.t_ns[0])  # it starts later
        left_s = found["main"].seconds - (begun_ns - first_ns) * 1e-9
        if left_s >= LEAST_S:
            found["beside"] = _rest(path, *beside.blocks(begun_ns, left_s), left_s)
    return found


def _rest(path: Path, force: FloatArray, rate: FloatArray, wanted_s: float) -> Rest:
    if len(force) * BLOCK_S < LEAST_S:
        raise RecordingError(
            f"{path}: {max(min(wanted_s, len(force) * BLOCK_S), 0):.1f} s of rest at its beginning are too little: "
            f"{LEAST_S:g} s at least"
        )
    count = _rests_until(force)
    if count * BLOCK_S < LEAST_S:
        raise RecordingError(
            f"{path}: the sensor is moved {count * BLOCK_S:.1f} s after its beginning: {LEAST_S:g} s of rest at least"
        )
    quiet = _quiet(force[:count])
    if (~quiet).mean() > MOST_SHOCKS:
        raise RecordingError(
            f"{path}: in {(~quiet).mean():.0%} of the first {count * BLOCK_S:.0f} s the sensor was moved or struck"
        )
    return Rest(force[:count], rate[:count], quiet)


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
