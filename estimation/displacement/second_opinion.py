"""What the displacement sensor says of moves: it shows one that was not felt, goes on after a stop, stands, runs away.

Judged here, acted on by the pipeline.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from typing import TypeAlias

from estimation.belief import Phase
from estimation.mskf import OFFSET, SCALE, SPEED
from estimation.pipeline_state import PipelineState
from estimation.recognition.motion import Motion
from estimation.records import CanState

FELT = {"both": (1, -1), "link": (1,), "base": (-1,)}  # directions, by where the inertial sensor sits
FELT_WITHIN_S = 2.0  # a soft start needs its time
SHOWN_SHARE = (0.4, 1.6)  # of the usual speed: more or less is no move of the ram
SOFT_START_S = 0.35  # its onset lies so much before the time at which a ram of even speed would have left
FRESH_S = (1.2, 2.0)  # after a move, and after another time: the slope's window must not still hold it
TAKEN_UP_S = 0.1  # an onset and a stop shift the path by so much of a time
STANDS_STILL = 1  # a noisy sensor that repeats itself may be stuck: wait for its next reading
QUIET_SENSOR_M = 0.001  # noise of one that repeats itself wherever the ram stands
LEAST_SEEN = 4  # readings
SEEN_SIGMA_M = 0.001  # of the place from which the readings count
MOST_SEEN = 6.0, 20.0  # nats for and against: a sensor can be wrong, but seldom just then
CRUISED_S = 1.0  # before the window begins


@dataclass(slots=True, frozen=True)
class GoesOn:
    """The last stop was none."""

    motion: Motion


@dataclass(slots=True, frozen=True)
class Unfelt:
    """A move whose start nobody felt."""


@dataclass(slots=True, frozen=True)
class Stands:
    """The ram has stopped, at that time."""

    stop_ns: int


@dataclass(slots=True, frozen=True)
class RunsAway:
    """The sensor changed its speed at that time, and the ram can do so only with a burst."""

    since_ns: int


Opinion: TypeAlias = GoesOn | Unfelt | Stands | RunsAway


def second_opinion(s: PipelineState, t_ns: int, felt: tuple[int, ...], unsettled_ns: int) -> Opinion | None:
    """Compare the displacement sensor's slope with what is believed.

    Args:
        s: read, but for `shown_since_ns`.
        t_ns: now.
        felt: directions that the inertial sensor can feel.
        unsettled_ns: a stop before this cannot be taken back any more.
    """
    motion = s.recogniser.motion
    if s.head.phase is Phase.REST and motion is None:
        return _at_rest(s, t_ns, felt, unsettled_ns)
    if s.head.phase is Phase.CRUISE and motion is not None:
        return _in_motion(s, t_ns, motion)
    return None


def _at_rest(s: PipelineState, t_ns: int, felt: tuple[int, ...], unsettled_ns: int) -> Opinion | None:
    speed = sensor_speed(s)
    ended_ns = s.belief.rests_since_ns()
    fresh_s = FRESH_S[0] if s.belief.last_motion else FRESH_S[1]
    if speed is None or (ended_ns is not None and t_ns - ended_ns <= fresh_s * 1e9):
        s.shown_since_ns = None
        return None
    if s.shown_since_ns is None:
        s.shown_since_ns = t_ns
    motion = s.belief.last_motion
    stop_ns = None if motion is None else motion.stop_ns
    if motion is not None and stop_ns is not None and stop_ns > unsettled_ns and speed * motion.direction > 0:
        return GoesOn(Motion(motion.direction, motion.onset_ns, motion.slow, confirmed=True))
    if (1 if speed > 0 else -1) in felt and t_ns - s.shown_since_ns < FELT_WITHIN_S * 1e9:
        return None  # the recogniser may take it up yet
    return Unfelt()


def _in_motion(s: PipelineState, t_ns: int, motion: Motion) -> Opinion | None:
    expected_m_s, noise_m = s.head.filter.state.x[SPEED], sqrt(s.sensor.noise_m2)
    if (s.slope.since_ns - motion.onset_ns) * 1e-9 < CRUISED_S:
        return None
    if s.slope.stands(noise_m, expected_m_s) and not _may_be_frozen(s):
        # The ram stopped where its path met the reading.
        predicted_m, _ = s.head.filter.displacement_prediction(0.0)
        overrun_s = max((predicted_m - s.slope.mean()) / expected_m_s, 0.0)
        return Stands(max(t_ns - round(overrun_s * 1e9), motion.onset_ns + round(1e9)))
    if s.slope.disagrees(noise_m, expected_m_s) and not s.sensor.biased:
        return RunsAway(s.slope.since_ns)
    return None


def _may_be_frozen(s: PipelineState) -> bool:
    return s.sensor.noise_m2 > QUIET_SENSOR_M**2 and s.sensor.same_in_row >= STANDS_STILL


def sensor_speed(s: PipelineState) -> float | None:
    """Speed that the displacement sensor reports, if it is a moving ram's."""
    if s.can_state not in (CanState.OK, CanState.BIASED):
        return None
    return s.slope.moves(sqrt(s.sensor.noise_m2), s.head.usual_speed(1))


def sensor_stands(s: PipelineState, since_ns: int) -> bool:
    """Whether the displacement sensor has stood for a while within a time that began at `since_ns`; or is mute."""
    if s.can_state in (CanState.SILENT, CanState.ABSENT):
        return True
    return s.slope.since_ns >= since_ns and s.slope.stands(sqrt(s.sensor.noise_m2), s.head.usual_speed(1))


def seen_evidence(s: PipelineState, latency_s: float) -> dict[int, float]:
    """Nats, by direction, that the readings since the open proposal give for a start that way, against rest; for the
    stop of a move that way, against going on. Bounded; empty where nothing can be said."""
    motion = s.recogniser.motion
    if motion is None or s.can_state is not CanState.OK or _may_be_frozen(s):
        return {}
    if not motion.confirmed:
        totals = {direction: _for_start(s, motion, direction, latency_s) for direction in (1, -1)}
    elif motion.stop_ns is not None and not motion.stop_confirmed:
        totals = {motion.direction: _for_stop(s, motion, motion.stop_ns + round((latency_s + TAKEN_UP_S) * 1e9))}
    else:
        return {}
    return {direction: min(max(total, -MOST_SEEN[1]), MOST_SEEN[0]) for direction, total in totals.items()}


def _for_start(s: PipelineState, motion: Motion, direction: int, latency_s: float) -> float:
    """Have the readings left the place where the ram stood?"""
    after_ns = motion.onset_ns + round((latency_s + (SOFT_START_S if motion.slow else TAKEN_UP_S)) * 1e9)
    state = s.head.filter.state
    speed = direction * s.head.usual_speed(direction) * (1.0 + state.x[SCALE])
    rested_m = (1.0 + state.x[SCALE]) * s.head.start_m + state.x[OFFSET]
    total = 0.0
    for t_ns, value_m in s.slope.readings:
        moved_m = speed * max((t_ns - after_ns) * 1e-9, 0.0)
        total += (value_m - rested_m) ** 2 - (value_m - rested_m - moved_m) ** 2
    return total / (2.0 * (s.sensor.noise_m2 + SEEN_SIGMA_M**2))


def _for_stop(s: PipelineState, motion: Motion, after_ns: int) -> float:
    """Do the readings stand? Their place says nothing: the estimate has followed them."""
    since = [(t_ns * 1e-9, value_m) for t_ns, value_m in s.slope.readings if t_ns > after_ns]
    if len(since) < LEAST_SEEN:
        return 0.0
    mean_s, mean_m = sum(t_s for t_s, _ in since) / len(since), sum(value_m for _, value_m in since) / len(since)
    spread_s2 = sum((t_s - mean_s) ** 2 for t_s, _ in since)
    moment = sum((t_s - mean_s) * (value_m - mean_m) for t_s, value_m in since)
    speed = motion.direction * s.head.usual_speed(motion.direction)
    return ((moment - speed * spread_s2) ** 2 - moment**2) / (2.0 * s.sensor.noise_m2 * spread_s2)


def shown_move(s: PipelineState, felt: tuple[int, ...], latency_s: float) -> Motion | None:
    """The move that the displacement sensor shows while rest is believed, if it is one that can be felt."""
    if s.recogniser.motion is not None and s.recogniser.motion.confirmed:
        return None
    speed = sensor_speed(s)
    if speed is None or not s.slope.fresh(s.belief.rests_since_ns()):
        return None
    direction = 1 if speed > 0 else -1
    share = abs(speed) / s.head.usual_speed(direction)
    if direction not in felt or not SHOWN_SHARE[0] < share < SHOWN_SHARE[1]:
        return None
    resting_m = s.settled.filter.displacement_prediction(0.0)[0]
    before_s = (s.slope.mean() - resting_m) / speed  # of the middle of the window
    onset_ns = s.slope.middle_ns() - round((before_s + latency_s + SOFT_START_S) * 1e9)
    return Motion(direction, onset_ns, slow=True)
