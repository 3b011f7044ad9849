"""Recognition of moves: when the ram started, which way, when it stopped; proposed early, confirmed a little later.

A proposal costs nothing: the estimator keeps its buffer and runs it again when the decision changes. A move is
accepted only when the kernels that see more of the burst agree.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from math import log

import numpy as np

from estimation.kernels import STARTS, STOPS
from estimation.steps import StepBank, Steps

# Kernels by their place in kernels.SPECS
START_KERNELS = tuple(range(len(STARTS)))
SLOW_START = START_KERNELS[-1]
CONFIRM_START = 2  # sees 0.7 s of the burst
STOP_KERNELS = tuple(range(len(STARTS), len(STARTS) + len(STOPS)))
CONFIRM_STOP = STOP_KERNELS[-1]

# Evidence wanted, in nats of log likelihood ratio
START_EVIDENCE = (14.0, 12.0, 10.0, 16.0)  # the wide kernel hears slow sensor noise best
STOP_EVIDENCE = (12.0, 10.0, 10.0)
CONFIRM_EVIDENCE, CONFIRM_SLOW_EVIDENCE = 8.0, 14.0
IMPOSSIBLE_DIRECTION = 12.0  # off, for a direction that the position forbids; never a prohibition
EXPECTED_END = 5.0  # on, for a stop where the stroke ends

CONFIRM_AFTER_S = 0.75
CONFIRM_SLOW_AFTER_S = 1.3
CONFIRM_STOP_AFTER_S = 1.3
SEARCH_S = 0.3  # the refined time lies this close to the proposed one
STOP_NOT_BEFORE_S = 0.6  # after the onset: the burst rings until then
STOP_NOT_BEFORE_SLOW_S = 1.3
STOP_KERNEL_BIAS_S = 0.06  # its largest answer comes so much before the start of deceleration
QUIET_AFTER_STOP_S = 0.6  # a stop rings too ...
SLOW_QUIET_AFTER_STOP_S = 1.5  # ... and the wide kernel hears it longer
RECENT_S = 3.0  # kernels look back less far so soon after an event


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


class Decision(StrEnum):
    """What the recogniser has just made up its mind about."""

    START_PROPOSED = "start proposed"
    START_CONFIRMED = "start confirmed"
    START_DISCARDED = "start discarded"
    STOP_PROPOSED = "stop proposed"
    STOP_CONFIRMED = "stop confirmed"
    STOP_DISCARDED = "stop discarded"


@dataclass(slots=True, frozen=True)
class Context:
    """What the estimator knows and the recogniser may use. Speeds are positive [m/s]."""

    push_speed: float
    retract_speed: float
    push_forbidden: bool = False
    retract_forbidden: bool = False
    end_expected: bool = False  # the stroke is predicted to end about now

    def speed(self, direction: int) -> float:
        """Usual speed of a direction."""
        return self.push_speed if direction > 0 else self.retract_speed

    def penalty(self, direction: int) -> float:
        """Nats against a direction."""
        forbidden = self.push_forbidden if direction > 0 else self.retract_forbidden
        return IMPOSSIBLE_DIRECTION if forbidden else 0.0


def evidence(x: float, sigma: float, speed: float, spread: float) -> float:
    """Log likelihood ratio of a step of size `speed` (spread as a share of it) against none; both in m/s."""
    s0 = (1.15 * sigma) ** 2 + 0.0004**2
    s1 = s0 + (spread * speed) ** 2
    return float(0.5 * x * x / s0 - 0.5 * (x - speed) ** 2 / s1 - 0.5 * log(s1 / s0))


@dataclass(slots=True, frozen=True)
class _Step:
    t_ns: int
    x: float
    sigma: float


@dataclass(slots=True)
class SegmentRecogniser:
    """Streaming state machine over the step statistics; `motion` is None at rest."""

    motion: Motion | None = None
    decide_ns: int = 0  # when the open proposal is due
    last_event_ns: int = -(10**18)
    ignore_before_ns: int = -(10**18)  # steps before this have been judged

    def recent_event(self, t_ns: int) -> bool:
        """True soon after an onset or a stop."""
        return t_ns - self.last_event_ns < RECENT_S * 1e9

    @property
    def resting(self) -> bool:
        """No move is open, not even a proposed one."""
        return self.motion is None

    def rest(self, t_ns: int) -> None:
        """Start anew at rest: what happened until now is explained."""
        self.motion = None
        self.last_event_ns = self.ignore_before_ns = t_ns

    def reopen(self, motion: Motion, t_ns: int) -> None:
        """The stop of `motion` was none: look for the true one from about now on."""
        self.motion = motion
        self.ignore_before_ns = t_ns - round(1e9)

    def update(self, t_ns: int, steps: Steps, bank: StepBank, context: Context) -> Decision | None:
        """Judge one block; at most one decision a block."""
        motion = self.motion
        if motion is None:
            return self._propose_start(t_ns, steps, bank, context)
        if not motion.confirmed:
            return self._confirm_start(t_ns, motion, bank, context) if t_ns >= self.decide_ns else None
        if motion.stop_ns is None:
            return self._propose_stop(t_ns, motion, steps, bank, context)
        return self._confirm_stop(motion, bank, context) if t_ns >= self.decide_ns else None

    def _propose_start(self, t_ns: int, steps: Steps, bank: StepBank, context: Context) -> Decision | None:
        best, found = 0.0, None
        for kernel, wanted in zip(START_KERNELS, START_EVIDENCE, strict=True):
            x, sigma = steps.x[kernel], steps.sigma[kernel]
            direction = 1 if x > 0 else -1
            speed = context.speed(direction)
            if not 0.5 * speed < abs(x) < 1.9 * speed:
                continue
            onset_ns = bank.event_time_ns(kernel)
            if onset_ns < self.ignore_before_ns:
                continue
            if kernel == SLOW_START and onset_ns - self.last_event_ns < SLOW_QUIET_AFTER_STOP_S * 1e9:
                continue
            spread = 0.3 if kernel == START_KERNELS[0] else 0.13
            excess = evidence(abs(x), sigma, speed, spread) - wanted - context.penalty(direction)
            if excess > best:
                best, found = excess, Motion(direction, onset_ns, slow=kernel == SLOW_START)
        if found is None:
            return None
        self.motion = found
        after_s = CONFIRM_SLOW_AFTER_S if found.slow else CONFIRM_AFTER_S
        self.decide_ns = t_ns + round(after_s * 1e9)
        return Decision.START_PROPOSED

    def _confirm_start(self, t_ns: int, motion: Motion, bank: StepBank, context: Context) -> Decision | None:
        after_s = 1.0 if motion.slow else SEARCH_S
        sharp = self._largest(bank, CONFIRM_START, motion.onset_ns, after_s)
        if sharp is not None and self._accept(sharp, bank, context, 0.55, slow=False):
            return Decision.START_CONFIRMED
        speed = context.speed(motion.direction)
        if sharp is None or abs(sharp.x) < 0.7 * speed:
            due_ns = motion.onset_ns + round((CONFIRM_SLOW_AFTER_S + 1.0) * 1e9)
            slow = self._largest(bank, SLOW_START, motion.onset_ns, 1.0)
            if slow is not None and self._accept(slow, bank, context, 0.6, slow=True):
                return Decision.START_CONFIRMED
            if t_ns < due_ns:
                return None
        self.motion = None
        self.ignore_before_ns = motion.onset_ns + round(SEARCH_S * 1e9)
        return Decision.START_DISCARDED

    def _accept(self, step: _Step, bank: StepBank, context: Context, share: float, slow: bool) -> bool:
        direction = 1 if step.x > 0 else -1
        speed = context.speed(direction)
        if abs(step.x) < share * speed:
            return False
        wanted = CONFIRM_SLOW_EVIDENCE if slow else CONFIRM_EVIDENCE
        if evidence(abs(step.x), step.sigma, speed, 0.13) - context.penalty(direction) < wanted:
            return False
        onset_ns = step.t_ns + round(bank.dt_s * 1e9)
        self.motion = Motion(direction, onset_ns, slow=slow, confirmed=True)
        self.last_event_ns = onset_ns
        after_s = STOP_NOT_BEFORE_SLOW_S if slow else STOP_NOT_BEFORE_S
        self.ignore_before_ns = onset_ns + round(after_s * 1e9)
        return True

    def _propose_stop(
        self, t_ns: int, motion: Motion, steps: Steps, bank: StepBank, context: Context
    ) -> Decision | None:
        speed = context.speed(motion.direction)
        best, found_ns = 0.0, None
        for kernel, wanted in zip(STOP_KERNELS, STOP_EVIDENCE, strict=True):
            x = -steps.x[kernel] * motion.direction
            stop_ns = bank.event_time_ns(kernel)
            if stop_ns < self.ignore_before_ns or not 0.5 * speed < x < 1.9 * speed:
                continue
            sigma = (steps.sigma[kernel] ** 2 + (0.05 * speed) ** 2) ** 0.5
            excess = evidence(x, sigma, speed, 0.13) - wanted + EXPECTED_END * context.end_expected
            if excess > best:
                best, found_ns = excess, stop_ns
        if found_ns is None:
            return None
        self.motion = replace(motion, stop_ns=found_ns)
        self.decide_ns = max(found_ns + round(CONFIRM_STOP_AFTER_S * 1e9), t_ns)
        return Decision.STOP_PROPOSED

    def _confirm_stop(self, motion: Motion, bank: StepBank, context: Context) -> Decision | None:
        assert motion.stop_ns is not None
        speed = context.speed(motion.direction)
        step = self._largest(bank, CONFIRM_STOP, motion.stop_ns, SEARCH_S, sign=-motion.direction)
        x = 0.0 if step is None else abs(step.x)
        if step is None or x < 0.62 * speed or (x < 0.78 * speed and not _slowed(bank, step.t_ns, motion, speed)):
            self.motion = replace(motion, stop_ns=None)
            self.ignore_before_ns = motion.stop_ns + round(SEARCH_S * 1e9)
            return Decision.STOP_DISCARDED
        stop_ns = step.t_ns + round(STOP_KERNEL_BIAS_S * 1e9)
        self.motion = replace(motion, stop_ns=stop_ns, stop_confirmed=True)
        self.last_event_ns = stop_ns
        self.ignore_before_ns = stop_ns + round(QUIET_AFTER_STOP_S * 1e9)
        return Decision.STOP_CONFIRMED

    def _largest(self, bank: StepBank, kernel: int, t_ns: int, after_s: float, sign: int = 0) -> _Step | None:
        """The largest step that one kernel has seen near a time: of one sign, or (0) of either."""
        times = np.fromiter(bank.times_ns, dtype=np.int64)
        post = bank.post_steps[kernel]
        judged = len(times) - post  # blocks whose step this kernel has seen whole
        if judged <= 0:
            return None
        event_times = times[:judged]
        x = bank.x[-judged:, kernel]
        earliest_ns = max(t_ns - SEARCH_S * 1e9, self.ignore_before_ns)
        near = (event_times >= earliest_ns) & (event_times <= t_ns + after_s * 1e9)
        if not near.any():
            return None
        size = np.where(near, np.abs(x) if sign == 0 else sign * x, -np.inf)
        i = int(np.argmax(size))
        return _Step(int(event_times[i]), float(x[i]), float(bank.sigma[-judged:, kernel][i]))


def _slowed(bank: StepBank, stop_ns: int, motion: Motion, speed: float) -> bool:
    """Is the mean speed lower well after the stop? A mere dip of the speed is not."""
    times = np.fromiter(bank.times_ns, dtype=np.int64)
    v = np.cumsum(bank.levelled_m_s2[-len(times) :]) * bank.dt_s
    age_s = (times - stop_ns) * 1e-9
    before = (age_s > -0.35) & (age_s <= -0.05)
    after = (age_s >= 0.55) & (age_s <= 0.85)
    if not before.any() or not after.any():
        return False
    return bool((v[before].mean() - v[after].mean()) * motion.direction > 0.45 * speed)
