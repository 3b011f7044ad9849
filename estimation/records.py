"""The plain types that flow between devices, estimator, recorder and viewers.

SI units throughout. Times are integer nanoseconds of one monotonic clock (live: the host's; offline: the
recording's); integers survive a recording exactly, so a replay computes with the very same numbers.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum, StrEnum

Vector = tuple[float, float, float]


class TimeKind(IntEnum):
    """Where a sample's time stamp comes from."""

    EDGE = 0  # kernel time of the data-ready edge
    READ = 1  # time of the read: the data-ready line was silent
    IMPORTED = 2  # given by a file


@dataclass(slots=True, frozen=True)
class ImuSample:
    """One inertial sample in the sensor's own axes, as specific force (+g on the axis that points up)."""

    t_ns: int
    gyro: Vector  # rad/s
    accel: Vector  # m/s^2
    temperature_c: float = float("nan")
    time_kind: TimeKind = TimeKind.EDGE


class ReadingFault(IntEnum):
    """What a displacement reading shows to be wrong by itself, before any judgement by the estimator."""

    NONE = 0
    INVALID = 1  # the source's own word: validity flag, error code, emergency
    OUT_OF_RANGE = 2  # beyond the limits set for the source
    MALFORMED = 3  # wrong length or undecodable: there is no value
    CHECKSUM = 4  # the frame's own checksum does not fit
    REPEATED = 5  # the frame's own counter stands still: the sender froze


@dataclass(slots=True, frozen=True)
class Displacement:
    """One reading of a displacement sensor."""

    t_ns: int
    value_m: float
    fault: ReadingFault = ReadingFault.NONE
    # A laboratory sensor beside the observed one: recorded and compared with, never estimated from.
    is_reference: bool = False

    @property
    def valid(self) -> bool:
        """Whether nothing speaks against it so far."""
        return self.fault is ReadingFault.NONE


@dataclass(slots=True, frozen=True)
class SensorChange:
    """From here on another inertial sensor speaks: what was learned of the last one is void."""

    t_ns: int


@dataclass(slots=True, frozen=True)
class Tick:
    """Time passed although no inertial sample came (sent only while the sensor is silent)."""

    t_ns: int


Record = ImuSample | Displacement | Tick | SensorChange


class Segment(StrEnum):
    """What the ram does, in the words of paper C."""

    ZUPT = "ZUPT"  # at rest: zero-velocity update
    VVS = "VVS"  # varying velocity: start or stop burst
    CVS = "CVS"  # constant velocity


class Tier(StrEnum):
    """How final an estimate is."""

    PROVISIONAL = "provisional"  # at once
    SETTLED = "settled"  # after the segment has been recognised


class CanState(StrEnum):
    """What the displacement sensor is thought to be."""

    OK = "ok"
    LATE = "late"
    SILENT = "silent"
    STUCK = "stuck"
    OUT_OF_RANGE = "out_of_range"
    INVALID = "invalid"
    BIASED = "biased"
    ABSENT = "absent"


class MoveKind(StrEnum):
    """Direction of a move: push = the piston extends, retract = it withdraws."""

    PUSH = "push"
    RETRACT = "retract"


@dataclass(slots=True, frozen=True)
class Estimate:
    """State of the stroke at one pipeline step, with the reasons behind it."""

    t_ns: int
    displacement_m: float
    sigma_m: float
    velocity_m_s: float
    velocity_sigma_m_s: float
    segment: Segment
    tier: Tier
    can_state: CanState
    move: int  # number of the current or last move, 0 before the first
    acceleration_m_s2: float  # along the push axis, levelled, causal wavelet: what the chart sees
    chart_lower_m_s2: float
    chart_upper_m_s2: float
    step_m_s: float  # velocity-step statistic of the detector
    innovation_m: float  # last displacement reading minus its prediction, NaN without one
    gate_m: float  # largest innovation that would have been accepted, NaN without one


@dataclass(slots=True, frozen=True)
class Move:
    """Summary of one finished move. Times: start of acceleration and start of deceleration."""

    number: int
    kind: MoveKind
    onset_ns: int
    stop_ns: int
    start_m: float
    end_m: float
    sigma_m: float
    end_before_stop_m: float  # before any mechanical-stop constraint
    sigma_before_stop_m: float
    velocity_m_s: float  # signed mean speed of the constant-velocity segment
    can_state: CanState
    tier: Tier


@dataclass(slots=True, frozen=True)
class Event:
    """Something that happened, in words a person understands."""

    t_ns: int
    what: str


Output = Estimate | Move | Event
