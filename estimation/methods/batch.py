"""What a batch method gets and gives: a whole record as arrays, the course of the stroke through it."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from estimation.arrays import FloatArray
from estimation.mount.axes import Mount
from estimation.records import Displacement, ImuSample, Move, MoveKind, Record
from estimation.settings import MountSettings, SupportSettings, TwoStateSettings

SAMPLES_WANTED = 1024  # less than a second or two is no record
REST_S, LEAD_S = 5.0, 0.1  # of a rest, up to shortly before a move
STOPPED_S = 1.5  # after the start of deceleration nothing rings any more


class Kind(IntEnum):
    """Segment of a sample, in the words of paper C."""

    ZUPT = 0
    VVS = 1
    CVS = 2


@dataclass(frozen=True)
class Span:
    """One move: start of acceleration, start of deceleration [s of the record], +1 push or -1 retract."""

    onset_s: float
    stop_s: float
    direction: int


@dataclass(frozen=True)
class Batch:
    """A record in support axes (x across, y push, z up), times from its first sample."""

    first_ns: int
    t_s: FloatArray  # (n,), strictly increasing
    accel: FloatArray  # (n, 3) specific force [m/s^2]
    gyro: FloatArray  # (n, 3) [rad/s]
    seen_s: FloatArray  # (m,) times of the observed displacement's valid readings
    seen_m: FloatArray  # (m,)
    start_m: float  # stroke at the beginning
    support: SupportSettings
    two_state: TwoStateSettings = field(default_factory=TwoStateSettings)
    moves: tuple[Span, ...] = ()  # as this program's own recogniser found them

    def nominal_speed(self, direction: int) -> float:
        """Of a push (+1) or retract (-1), signed [m/s]."""
        support = self.support
        mm_s = support.nominal_push_speed_mm_s if direction > 0 else -support.nominal_retract_speed_mm_s
        return mm_s / 1e3


@dataclass(frozen=True)
class Course:
    """What a method makes of a record, sample by sample."""

    displacement_m: FloatArray  # (n,)
    velocity_m_s: FloatArray  # (n,)
    acceleration_m_s2: FloatArray  # (n,) as the method uses it
    kind: NDArray[np.int8]  # (n,) of `Kind`
    moves: tuple[Span, ...]
    limits_m_s2: tuple[float, float] = (float("nan"), float("nan"))  # of its control chart, if it has one
    t_s: FloatArray | None = None  # (n,) where its times are not the record's


@dataclass
class Collector:
    """Gathers records for a batch method."""

    mount: MountSettings = field(default_factory=MountSettings)
    support: SupportSettings = field(default_factory=SupportSettings)
    two_state: TwoStateSettings = field(default_factory=TwoStateSettings)
    start_m: float = 0.0
    _t_ns: array[int] = field(default_factory=lambda: array("q"))
    _values: array[float] = field(default_factory=lambda: array("d"))  # six a sample
    _readings: list[Displacement] = field(default_factory=list)

    def add(self, record: Record) -> None:
        """Take the next record; samples that do not go on in time are left out."""
        if isinstance(record, ImuSample):
            if not self._t_ns or record.t_ns > self._t_ns[-1]:
                self._t_ns.append(record.t_ns)
                self._values.extend((*record.accel, *record.gyro))
        elif isinstance(record, Displacement) and record.valid and not record.is_reference:
            self._readings.append(record)

    def batch(self, moves: Sequence[Move] = ()) -> Batch:
        """The record as arrays. Raises ValueError if there is too little of it."""
        if len(self._t_ns) < SAMPLES_WANTED:
            raise ValueError(f"{len(self._t_ns)} inertial samples are too few: a batch method wants {SAMPLES_WANTED}")
        first_ns = self._t_ns[0]
        turn = np.array([Mount(self.mount).to_support(unit) for unit in ((1.0, 0, 0), (0, 1.0, 0), (0, 0, 1.0))])
        values = np.array(self._values).reshape(-1, 6)
        whole = Batch(
            first_ns,
            (np.array(self._t_ns) - first_ns) * 1e-9,
            values[:, :3] @ turn,
            values[:, 3:] @ turn,
            np.array([(reading.t_ns - first_ns) * 1e-9 for reading in self._readings], dtype=np.float64),
            np.array([reading.value_m for reading in self._readings], dtype=np.float64),
            self.start_m,
            self.support,
            self.two_state,
        )
        return replace(whole, moves=tuple(span_of(move, first_ns) for move in moves))


def span_of(move: Move, first_ns: int) -> Span:
    """A summary as a span of a record that begins at `first_ns`."""
    return Span(
        (move.onset_ns - first_ns) * 1e-9,
        (move.stop_ns - first_ns) * 1e-9,
        1 if move.kind is MoveKind.PUSH else -1,
    )


def kinds_of(t_s: FloatArray, moves: Sequence[Span], start_s: float, stop_s: float) -> NDArray[np.int8]:
    """Segments of moves whose bursts last `start_s` and `stop_s`."""
    kind = np.zeros(len(t_s), dtype=np.int8)
    for move in moves:
        kind[(t_s >= move.onset_s) & (t_s < move.stop_s + stop_s)] = Kind.VVS
        kind[(t_s >= move.onset_s + start_s) & (t_s < move.stop_s)] = Kind.CVS
    return kind


def levelled_at_rest(batch: Batch) -> FloatArray:
    """Push acceleration (n,) less its mean over the rest before each move (5 s of it at most)."""
    t_s, push = batch.t_s, batch.accel[:, 1]
    level = np.full(len(t_s), push[t_s < REST_S].mean())
    begin, rests_s = 0, 0.0
    for move in batch.moves:
        resting = (t_s >= max(rests_s, move.onset_s - REST_S)) & (t_s < move.onset_s - LEAD_S)
        if resting.any():
            level[begin:] = push[resting].mean()
        rests_s = move.stop_s + STOPPED_S
        begin = int(np.searchsorted(t_s, rests_s))
    return np.asarray(push - level)
