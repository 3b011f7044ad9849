"""Recognition of moves: when the ram started, which way, when it stopped; proposed early, confirmed a little later.

A proposal costs nothing: the estimator keeps its buffer and runs it again when the decision changes. A move is
accepted only when the kernels that see more of the burst agree, and when the speed has not come back: a blow or a
faltering pump makes pulses of speed, no steps.

The size of a step tells what it was: a push that starts and one that stops differ in sign, and a retract is faster.
So a stop is known even where its start was missed, and the start is then sought among what was not sure enough.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from math import log

import numpy as np

from estimation.burst import SLOW_START, START, STOP, Burst, fit_burst
from estimation.kernels import Kernel
from estimation.steps import StepBank, Steps

# Kernels that propose a start or a stop, with the evidence wanted, in nats of log likelihood ratio
START_EVIDENCE = {
    Kernel.START_EARLY: 14.0,
    Kernel.START_HALF: 12.0,
    Kernel.START_WHOLE: 10.0,
    Kernel.START_SOFT: 10.0,
    Kernel.START_SLOW: 10.0,
}
STOP_EVIDENCE = {Kernel.STOP_HALF: 12.0, Kernel.STOP_WHOLE: 10.0, Kernel.STOP_LATE: 10.0}
SLOW_KERNELS = (Kernel.START_SLOW, Kernel.START_SOFT)
CONFIRM_EVIDENCE, CONFIRM_SLOW_EVIDENCE = 8.0, 9.0
SUSTAINED_EVIDENCE = 2.0  # of a step against a pulse of speed
IMPOSSIBLE_DIRECTION = 12.0  # off, for a direction that the position forbids; never a prohibition
UNSTARTED = 12.0  # off, for a stop of a move whose start was not seen
UNSTARTED_AFTER_S = 2.0  # an event: its side lobes look like anything
EXPECTED_END = 5.0  # on, for a stop where the stroke ends
STOP_ODDS = 2.0  # on, for a stop: a faltering pump is rarer
QUIET_ODDS = 3.0  # most that the vibration may say for or against a stop
CANDIDATE_EVIDENCE = 2.0  # a start that was not sure enough is remembered from here on

NOT_SEEN = -10.0  # nats: no use to wait for a slow start
SEEN_AGAINST = 8.0  # times the nats of a displacement sensor that shows no such start

CONFIRM_AFTER_S = 0.75
CONFIRM_SLOW_AFTER_S = 0.8
CONFIRM_STOP_AFTER_S = 1.3
SEARCH_S = 0.3  # the refined time lies this close to the proposed one
SLOW_SEARCH_AFTER_S = 1.4  # a sharp start is proposed by its side lobes in the slow kernels, so much early
SLOW_SEARCH_S = 1.0  # a side lobe of a slow start is proposed so much late
FIT_SLACK_S, SLOW_FIT_SLACK_S = 0.15, 0.8  # a fit that lies farther from the guess has found something else
STOP_NOT_BEFORE_S = 0.6  # after the onset: the burst rings until then
STOP_NOT_BEFORE_SLOW_S = 1.3
STOP_KERNEL_BIAS_S = 0.06  # its largest answer comes so much before the start of deceleration
QUIET_AFTER_STOP_S = 0.75  # a stop rings too ...
SLOW_QUIET_AFTER_STOP_S = 1.5  # ... and the wide kernels hear it longer
CANDIDATES = 8
SHARP_SHARE = 0.55  # what a sharp kernel hears of a slow start is less, what a slow one hears of a sharp step no more
LEAST_MOVE_S = 2.0  # nearer to the stop its own side lobes look like starts
SURE = 8.0  # nats: such a candidate is believed before the last stop is doubted
QUIET_WINDOW_S = 0.3
QUIETEST_M_S2 = 0.01  # a vibration below this is none


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


def evidence(x: float, sigma: float, speed: float, spread: float) -> float:
    """Log likelihood ratio of a step of size `speed` (spread as a share of it) against none; all in m/s, signed."""
    s0 = (1.15 * sigma) ** 2 + 0.0004**2
    s1 = s0 + (spread * speed) ** 2
    return float(0.5 * x * x / s0 - 0.5 * (x - speed) ** 2 / s1 - 0.5 * log(s1 / s0))


def sustained_evidence(x: float, sigma: float, speed: float) -> float:
    """The same of a sustained kernel against a pulse of speed, of which that kernel still hears a share."""
    s0 = (1.1 * sigma) ** 2 + (0.20 * speed) ** 2
    s1 = (1.1 * sigma) ** 2 + (0.12 * speed) ** 2
    pulse, step = 0.25 * speed, 0.96 * speed
    if x * speed > step * speed:
        x = step  # more than a whole step speaks for no pulse
    return float(0.5 * (x - pulse) ** 2 / s0 - 0.5 * (x - step) ** 2 / s1 - 0.5 * log(s1 / s0))


@dataclass(slots=True, frozen=True)
class _Step:
    t_ns: int
    x: float
    sigma: float
    index: int  # blocks ago


@dataclass(slots=True, frozen=True)
class Candidate:
    """A start that was not sure enough."""

    t_ns: int
    direction: int
    evidence: float


@dataclass(slots=True)
class SegmentRecogniser:
    """Streaming state machine over the step statistics; `motion` is None at rest."""

    motion: Motion | None = None
    decide_ns: int = 0  # when the open proposal is due
    last_event_ns: int = -(10**18)
    ignore_before_ns: int = -(10**18)  # steps before this have been judged
    candidates: list[Candidate] = field(default_factory=list)  # since the last move

    def since_event_s(self, t_ns: int) -> float:
        """Time since the last onset or stop."""
        return (t_ns - self.last_event_ns) * 1e-9

    @property
    def resting(self) -> bool:
        """No move is open, not even a proposed one."""
        return self.motion is None

    def rest(self, t_ns: int) -> None:
        """Start anew at rest: what happened until now is explained."""
        self.motion = None
        self.last_event_ns = self.ignore_before_ns = t_ns
        self.candidates.clear()

    def reopen(self, motion: Motion, t_ns: int) -> None:
        """The stop of `motion` was none: look for the true one from about now on."""
        self.motion = motion
        self.ignore_before_ns = t_ns - round(1e9)

    def update(self, t_ns: int, steps: Steps, bank: StepBank, context: Context) -> Decision | None:
        """Judge one block; at most one decision a block."""
        motion = self.motion
        if motion is None or not motion.confirmed:
            if self._find_unstarted(bank, context):
                return Decision.STOP_UNSTARTED
            if motion is None:
                return self._propose_start(t_ns, steps, bank, context) or self._propose_shown(t_ns, context)
            return self._confirm_start(t_ns, motion, bank, context) if t_ns >= self.decide_ns else None
        if motion.stop_ns is None:
            return self._propose_stop(t_ns, motion, steps, bank, context)
        return self._confirm_stop(motion, bank, context) if t_ns >= self.decide_ns else None

    # --- starts -----------------------------------------------------------------------------------------------

    def _propose_start(self, t_ns: int, steps: Steps, bank: StepBank, context: Context) -> Decision | None:
        best, found = 0.0, None
        for kernel, wanted in START_EVIDENCE.items():
            x, sigma = steps.x[kernel], steps.sigma[kernel]
            direction = 1 if x > 0 else -1
            speed = context.speed(direction)
            slow = kernel in SLOW_KERNELS
            if direction not in context.felt or not 0.5 * speed < abs(x) < 1.9 * speed:
                continue
            onset_ns = bank.event_time_ns(kernel)
            if onset_ns < self.ignore_before_ns:
                continue
            if slow and onset_ns - self.last_event_ns < SLOW_QUIET_AFTER_STOP_S * 1e9:
                continue
            spread = 0.3 if kernel is Kernel.START_EARLY else 0.13
            strength = evidence(abs(x), sigma, speed, spread)
            excess = strength - wanted - context.penalty(direction)
            if slow and strength > CANDIDATE_EVIDENCE:
                self._remember(Candidate(onset_ns, direction, strength))
            if excess > best:
                best, found = excess, Motion(direction, onset_ns, slow=slow)
        if found is None:
            return None
        self.motion = found
        after_s = CONFIRM_SLOW_AFTER_S if found.slow else CONFIRM_AFTER_S
        self.decide_ns = t_ns + round(after_s * 1e9)
        return Decision.START_PROPOSED

    def _propose_shown(self, t_ns: int, context: Context) -> Decision | None:
        """A start too soft to be felt so far, but seen."""
        if context.shown is None or context.shown.onset_ns < self.last_event_ns:
            return None
        self.motion = context.shown
        self.decide_ns = t_ns + round(CONFIRM_SLOW_AFTER_S * 1e9)
        return Decision.START_PROPOSED

    def _remember(self, candidate: Candidate) -> None:
        """Keep the strongest, one for each burst."""
        for i, known in enumerate(self.candidates):
            if known.direction == candidate.direction and abs(known.t_ns - candidate.t_ns) < 2e9:
                if known.evidence < candidate.evidence:
                    self.candidates[i] = candidate
                return
        self.candidates.append(candidate)
        self.candidates.sort(key=lambda one: -one.evidence)
        del self.candidates[CANDIDATES:]

    def _confirm_start(self, t_ns: int, motion: Motion, bank: StepBank, context: Context) -> Decision | None:
        after_s = SLOW_SEARCH_AFTER_S if motion.slow else SEARCH_S
        sharp = self._largest(bank, Kernel.START_WHOLE, motion.onset_ns, after_s)
        # The side lobes of a large step look like smaller ones of the other sign: the largest of all is heard first.
        for sign in (0, motion.direction):
            step = self._largest(bank, Kernel.START_WHOLE, motion.onset_ns, after_s, sign) if sign else sharp
            if step is None:
                continue
            sustained = self._beside(bank, Kernel.START_SUSTAINED, step)
            surely = sustained_evidence(
                sustained.x * motion.direction, sustained.sigma, context.speed(motion.direction)
            )
            if sign and surely < SUSTAINED_EVIDENCE:
                continue  # smaller than a step of the other sign: two sides of a blow
            if self._accept(step, sustained, 0.55, CONFIRM_EVIDENCE, bank, context, slow=False):
                return Decision.START_CONFIRMED
        speed = context.speed(motion.direction)
        sharp_sign = 0 if sharp is None else 1 if sharp.x > 0 else -1
        if sharp is None or abs(sharp.x) < 0.75 * context.speed(sharp_sign):
            # Beside a clear step of the other sign it can only be a start of that sign, whose side lobe was proposed.
            only = sharp_sign if sharp is not None and -sharp.x * motion.direction > 0.5 * speed else 0
            before_s = SLOW_SEARCH_S if only else SEARCH_S
            for kernel in SLOW_KERNELS[::-1]:
                slow = self._largest(bank, kernel, motion.onset_ns, 1.0, only, before_s=before_s)
                if slow is None or slow.t_ns - self.last_event_ns < SLOW_QUIET_AFTER_STOP_S * 1e9:
                    continue
                sign = 1 if slow.x > 0 else -1
                beside = self._largest(bank, Kernel.START_WHOLE, slow.t_ns, 1.0, sign)
                if beside is not None and beside.x * sign > SHARP_SHARE * abs(slow.x):
                    continue  # the side lobe of a sharp step
                if self._accept(slow, None, 0.6, CONFIRM_SLOW_EVIDENCE, bank, context, slow=True):
                    return Decision.START_CONFIRMED
            if (
                t_ns < motion.onset_ns + round(2.6e9)
                and context.shown is None
                and context.seen.get(motion.direction, 0.0) > NOT_SEEN
            ):
                return None
        if context.shown is not None:
            # What was felt, if not surely, tells the time better.
            felt = not motion.slow and motion.direction == context.shown.direction
            begun = motion if felt else context.shown
            onset_ns, burst = self._refined_start(begun.onset_ns, begun.direction, bank, context, slow=begun.slow)
            self._begin(replace(begun, onset_ns=onset_ns, start_burst=burst, confirmed=True))
            return Decision.START_CONFIRMED
        self.motion = None
        self.ignore_before_ns = motion.onset_ns + round(SEARCH_S * 1e9)
        return Decision.START_DISCARDED

    def _accept(
        self,
        step: _Step,
        sustained: _Step | None,
        share: float,
        wanted: float,
        bank: StepBank,
        context: Context,
        *,
        slow: bool,
    ) -> bool:
        """Confirm the start if this step is one, and not the stop of another move or a pulse."""
        direction = 1 if step.x > 0 else -1
        speed = context.speed(direction)
        if abs(step.x) < share * speed or direction not in context.felt:
            return False
        felt = evidence(abs(step.x), step.sigma, speed, 0.13) - context.penalty(direction)
        if felt < evidence(abs(step.x), step.sigma, context.speed(-direction), 0.13) - UNSTARTED:
            return False
        # What is seen is sure; the evidence of what is felt supposes that the vibration is as it was.
        seen = context.seen.get(direction, 0.0)
        if felt + (seen if seen > 0.0 else SEEN_AGAINST * seen) < wanted:
            return False
        if sustained is not None and (
            sustained_evidence(sustained.x * direction, sustained.sigma, speed) < -SUSTAINED_EVIDENCE
        ):
            return False
        guess_ns = step.t_ns + round(bank.dt_s * 1e9)
        onset_ns, burst = self._refined_start(guess_ns, direction, bank, context, slow=slow)
        self._begin(Motion(direction, onset_ns, slow=slow, confirmed=True, start_burst=burst))
        return True

    def _refined_start(
        self, guess_ns: int, direction: int, bank: StepBank, context: Context, *, slow: bool
    ) -> tuple[int, Burst | None]:
        prior = SLOW_START if slow else START
        burst = fit_burst(bank.view(resting=True, delay_s=context.delay_s), prior, guess_ns, stop=False)
        slack_ns = (SLOW_FIT_SLACK_S if slow else FIT_SLACK_S) * 1e9
        least_m_s = 0.5 * context.speed(direction)
        if burst is None or abs(burst.t_ns - guess_ns) > slack_ns or burst.step_m_s * direction < least_m_s:
            return guess_ns, None
        return burst.t_ns, burst

    def _begin(self, motion: Motion) -> None:
        self.motion = motion
        self.last_event_ns = motion.onset_ns
        after_s = STOP_NOT_BEFORE_SLOW_S if motion.slow else STOP_NOT_BEFORE_S
        self.ignore_before_ns = motion.onset_ns + round(after_s * 1e9)
        self.candidates.clear()

    # --- stops ------------------------------------------------------------------------------------------------

    def _propose_stop(
        self, t_ns: int, motion: Motion, steps: Steps, bank: StepBank, context: Context
    ) -> Decision | None:
        speed = context.speed(motion.direction)
        best, found_ns = 0.0, None
        for kernel, wanted in STOP_EVIDENCE.items():
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
        step = self._largest(bank, Kernel.STOP_LATE, motion.stop_ns, SEARCH_S, sign=-motion.direction)
        if step is None or abs(step.x) < 0.62 * speed or self._for_stop(step, motion, bank, context) < 0.0:
            self.motion = replace(motion, stop_ns=None)
            self.ignore_before_ns = motion.stop_ns + round(SEARCH_S * 1e9)
            return Decision.STOP_DISCARDED
        stop_ns, burst = self._refined_stop(step, motion.direction, speed, bank, context)
        self.motion = replace(motion, stop_ns=stop_ns, stop_confirmed=True, stop_burst=burst)
        self.last_event_ns = stop_ns
        self.ignore_before_ns = stop_ns + round(QUIET_AFTER_STOP_S * 1e9)
        return Decision.STOP_CONFIRMED

    def _for_stop(self, step: _Step, motion: Motion, bank: StepBank, context: Context) -> float:
        """Nats for a stop against a mere dip of the speed."""
        speed = context.speed(motion.direction)
        sustained = self._beside(bank, Kernel.STOP_SUSTAINED, step)
        total = STOP_ODDS + EXPECTED_END * context.end_expected + context.seen.get(motion.direction, 0.0)
        total += evidence(abs(step.x), (step.sigma**2 + (0.05 * speed) ** 2) ** 0.5, speed, 0.06)
        total -= evidence(abs(step.x), (step.sigma**2 + (0.05 * speed) ** 2) ** 0.5, 0.6 * speed, 0.3)
        total += sustained_evidence(-sustained.x * motion.direction, sustained.sigma, speed)
        return total + _quiet_evidence(bank, step)

    def _refined_stop(
        self, step: _Step, direction: int, speed: float, bank: StepBank, context: Context
    ) -> tuple[int, Burst | None]:
        stop_ns = step.t_ns + round(STOP_KERNEL_BIAS_S * 1e9)
        burst = fit_burst(bank.view(resting=False, delay_s=context.delay_s), STOP, stop_ns, stop=True)
        if burst is None or abs(burst.t_ns - stop_ns) > FIT_SLACK_S * 1e9 or -burst.step_m_s * direction < 0.5 * speed:
            return stop_ns, None
        return burst.t_ns, burst

    def _find_unstarted(self, bank: StepBank, context: Context) -> bool:
        """A stop at rest: its move was missed, or ended too early in the belief."""
        # As far back as the slowest kernel sees: half of a slow start looks like a whole stop.
        ago = bank.post_steps[Kernel.START_SLOW] - bank.post_steps[Kernel.STOP_LATE]
        x, sigma = (
            float(bank.x.values[-1 - ago, Kernel.STOP_LATE]),
            float(bank.sigma.values[-1 - ago, Kernel.STOP_LATE]),
        )
        t_ns = bank.event_time_ns(Kernel.STOP_LATE, ago)
        direction = -1 if x > 0 else 1
        speed = context.speed(direction)
        if direction not in context.felt or t_ns - self.last_event_ns < UNSTARTED_AFTER_S * 1e9:
            return False
        if not 0.75 * speed < abs(x) < 1.3 * speed:
            return False
        as_start = evidence(abs(x), sigma, context.speed(-direction), 0.13) - context.penalty(-direction)
        strength = evidence(abs(x), sigma, speed, 0.10)
        if strength - max(as_start, 0.0) < UNSTARTED:
            return False
        largest = self._largest(bank, Kernel.STOP_LATE, t_ns, SEARCH_S, sign=-direction, judged_too=True)
        if largest is None or self._slower(bank, t_ns, abs(x), -direction, context):
            return False
        beside = self._largest(bank, Kernel.START_WHOLE, t_ns, 0.5, judged_too=True)
        if beside is not None and abs(beside.x) > 1.4 * speed:
            return False  # the side lobe of a larger step
        if self._is_pulse(bank, largest.t_ns, abs(largest.x), -direction):
            return False
        sustained = self._beside(bank, Kernel.STOP_SUSTAINED, largest)
        surely = sustained_evidence(-sustained.x * direction, sustained.sigma, speed) + _quiet_evidence(bank, largest)
        if surely < SUSTAINED_EVIDENCE:
            return False
        stop_ns, burst = self._refined_stop(largest, direction, speed, bank, context)
        onset_ns, resumes_ns = self._missed_onset(direction, stop_ns, context)
        self.motion = Motion(
            direction,
            onset_ns,
            confirmed=True,
            stop_ns=stop_ns,
            stop_confirmed=True,
            stop_burst=burst,
            resumes_ns=resumes_ns,
        )
        self.last_event_ns = stop_ns
        self.ignore_before_ns = stop_ns + round(QUIET_AFTER_STOP_S * 1e9)
        self.candidates.clear()
        return True

    def _slower(self, bank: StepBank, t_ns: int, size: float, sign: int, context: Context) -> bool:
        """Whether a slow start nearby explains more than a sharp step of that size."""
        speed = context.speed(sign)
        for kernel in SLOW_KERNELS:
            slow = self._largest(bank, kernel, t_ns, 0.6, sign, judged_too=True)
            if slow is None or not size < SHARP_SHARE * slow.x * sign < SHARP_SHARE * 1.9 * speed:
                continue
            if evidence(slow.x * sign, slow.sigma, speed, 0.13) - context.penalty(sign) > CONFIRM_SLOW_EVIDENCE:
                return True
        return False

    def _is_pulse(self, bank: StepBank, t_ns: int, size: float, sign: int) -> bool:
        """Whether this is one side of a blow: on one side of it a step back of nearly that size.

        The side lobes of a step that rings lie on both sides.
        """
        sides = []
        for middle_s in (-0.25, 0.25):
            lobe = self._largest(
                bank, Kernel.START_WHOLE, t_ns + round(middle_s * 1e9), 0.25, -sign, before_s=0.25, judged_too=True
            )
            sides.append(0.0 if lobe is None else max(-lobe.x * sign, 0.0))
        return max(sides) > 0.7 * size and min(sides) < 0.5 * max(sides)

    def _missed_onset(self, direction: int, stop_ns: int, context: Context) -> tuple[int, int | None]:
        """When the move went on whose stop has been found, and when it began if the last stop was none.

        At the best candidate, or where the last move broke off; else at the stop itself, which says: unknown.
        """
        likely = [
            one for one in self.candidates if one.direction == direction and stop_ns - one.t_ns > LEAST_MOVE_S * 1e9
        ]
        broken_off = context.broken_off
        sure = bool(likely) and likely[0].evidence >= SURE
        if not sure and broken_off is not None and broken_off.direction == direction and broken_off.stop_ns is not None:
            return broken_off.stop_ns, broken_off.resumes_ns or broken_off.onset_ns
        return (likely[0].t_ns if likely else stop_ns), None

    # --- history ----------------------------------------------------------------------------------------------

    def _largest(
        self,
        bank: StepBank,
        kernel: Kernel,
        t_ns: int,
        after_s: float,
        sign: int = 0,
        *,
        before_s: float = SEARCH_S,
        judged_too: bool = False,
    ) -> _Step | None:
        """The largest step that one kernel has seen near a time: of one sign, or (0) of either."""
        times = np.fromiter(bank.times_ns, dtype=np.int64)
        post = bank.post_steps[kernel]
        judged = len(times) - post  # blocks whose step this kernel has seen whole
        if judged <= 0:
            return None
        event_times = times[:judged]
        x = bank.x.values[-judged:, kernel]
        earliest_ns = t_ns - before_s * 1e9
        if not judged_too:
            earliest_ns = max(earliest_ns, self.ignore_before_ns)
        near = (event_times >= earliest_ns) & (event_times <= t_ns + after_s * 1e9)
        if not near.any():
            return None
        size = np.where(near, np.abs(x) if sign == 0 else sign * x, -np.inf)
        i = int(np.argmax(size))
        return _Step(int(event_times[i]), float(x[i]), float(bank.sigma.values[-judged:, kernel][i]), judged - 1 - i)

    def _beside(self, bank: StepBank, kernel: Kernel, step: _Step) -> _Step:
        """What another kernel of the same reach said of the same step, at its best within 0.06 s."""
        direction = 1.0 if step.x > 0 else -1.0
        around = range(max(step.index - 6, 0), step.index + 7)
        rows = bank.x.values
        best = max((i for i in around if i < len(rows)), key=lambda i: direction * rows[-1 - i, kernel])
        return _Step(step.t_ns, float(rows[-1 - best, kernel]), float(bank.sigma.values[-1 - best, kernel]), best)


def _quiet_evidence(bank: StepBank, step: _Step) -> float:
    """Nats that the vibration gives for a stop: has it fallen towards what it was at rest, or gone on as in motion?

    Only as far as rest and motion differ at all, and never much: a machine nearby may start or stop.
    """
    levels: Sequence[float] = bank.vibration
    end = len(levels) - 1
    stop = max(end - step.index - bank.post_steps[Kernel.STOP_LATE], 0)
    moving = _log_mean(levels[i] for i in range(max(stop - 60, 0), max(stop - 15, 1)))
    after = log(bank.vibration_lately_m_s2(QUIET_WINDOW_S) + QUIETEST_M_S2)
    resting = log(bank.level_at_rest_m_s2 + QUIETEST_M_S2)
    spread = 0.6
    fall = 0.5 * ((after - moving) ** 2 - (after - min(resting, moving)) ** 2) / spread**2
    return float(np.clip(fall, -QUIET_ODDS, QUIET_ODDS))


def _log_mean(levels: Iterable[float]) -> float:
    logs = [log(level + QUIETEST_M_S2) for level in levels]
    return sum(logs) / len(logs)
