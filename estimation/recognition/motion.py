"""The belief about a move, what the recogniser decides about it, and what it is told by the rest of the estimator."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from estimation.recognition.burst import Burst

IMPOSSIBLE_DIRECTION = 12.0  # nats off, for a direction that the position forbids; never a prohibition


@dataclass(slots=True, frozen=True)
class Motion:
    """The belief about one move. Without `stop_ns` it still goes on; `confirmed` says how far the belief is proven."""

    direction: int  # +1 push, -1 retract
    onset_ns: int
    slow: bool = False
    confirmed: bool = False
    stop_ns: int | None = None
    stop_confirmed: bool = False
    cut_ns: int | None = None  # given up here: how it went on is not known
    start_burst: Burst | None = None
    stop_burst: Burst | None = None
    resumes_ns: int | None = None  # onset of the last move, which this one turned out to continue


class Decision(StrEnum):
    """What the recogniser has just made up its mind about."""

    START_PROPOSED = "start proposed"
    START_CONFIRMED = "start confirmed"
    START_DISCARDED = "start discarded"
    STOP_PROPOSED = "stop proposed"
    STOP_CONFIRMED = "stop confirmed"
    STOP_DISCARDED = "stop discarded"
    STOP_UNSTARTED = "stop of a move whose start was missed"


@dataclass(slots=True, frozen=True)
class Context:
    """What the estimator knows and the recogniser may use. Speeds are positive [m/s]."""

    push_speed: float
    retract_speed: float
    push_forbidden: bool = False
    retract_forbidden: bool = False
    end_expected: bool = False  # the stroke is predicted to end about now
    delay_s: float = 0.0  # of the inertial sensor's own filter
    felt: tuple[int, ...] = (1, -1)  # directions that the sensor can feel
    broken_off: Motion | None = None  # the last move, if it ended in mid-stroke
    shown: Motion | None = None  # a move that the displacement sensor shows while rest is believed
    seen: Mapping[int, float] = field(default_factory=dict)  # nats that the displacement sensor gives, by direction

    def speed(self, direction: int) -> float:
        """Usual speed of a direction."""
        return self.push_speed if direction > 0 else self.retract_speed

    def penalty(self, direction: int) -> float:
        """Nats against a direction."""
        forbidden = self.push_forbidden if direction > 0 else self.retract_forbidden
        return IMPOSSIBLE_DIRECTION if forbidden else 0.0
