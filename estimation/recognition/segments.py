"""Recognition of moves: when the ram started, which way, when it stopped; proposed early, confirmed a little later.

A proposal costs nothing: the estimator keeps its buffer and runs it again when the decision changes. A move is
accepted only when the kernels that see more of the burst agree, and when the speed has not come back: a blow or a
faltering pump makes pulses of speed, no steps.

The size of a step tells what it was: a push that starts and one that stops differ in sign, and a retract is faster.
So a stop is known even where its start was missed, and the start is then sought among what was not sure enough.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from estimation.recognition.burst import SLOW_START, START, STOP, Burst, fit_burst
from estimation.recognition.kernels import Kernel
from estimation.recognition.motion import Context, Decision, Motion
from estimation.recognition.step_evidence import SeenStep, beside, evidence, largest, quiet_evidence, sustained_evidence
from estimation.recognition.steps import StepBank, Steps

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
UNSTARTED = 12.0  # off, for a stop of a move whose start was not seen
UNSTARTED_AFTER_S = 2.0  # an event: its side lobes look like anything
EXPECTED_END = 5.0  # on, for a stop where the stroke ends
STOP_ODDS = 2.0  # on, for a stop: a faltering pump is rarer
CANDIDATE_EVIDENCE = 2.0  # a start that was not sure enough is remembered from here on

NOT_SEEN = -10.0  # nats: no use to wait for a slow start
SEEN_AGAINST = 8.0  # times the nats of a displacement sensor that shows no such start

WAIT_FOR_SLOW_NS = round(2.6e9)  # after the onset a slow start has shown itself
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
        sharpest = self._largest(bank, Kernel.START_WHOLE, motion.onset_ns, after_s)
        if self._is_sharp_start(sharpest, after_s, motion, bank, context):
            return Decision.START_CONFIRMED
        sign = 0 if sharpest is None else 1 if sharpest.x > 0 else -1
        if sharpest is None or abs(sharpest.x) < 0.75 * context.speed(sign):
            if self._is_slow_start(sharpest, motion, bank, context):
                return Decision.START_CONFIRMED
            may_show_yet = context.shown is None and context.seen.get(motion.direction, 0.0) > NOT_SEEN
            if may_show_yet and t_ns < motion.onset_ns + WAIT_FOR_SLOW_NS:
                return None
        if context.shown is not None:
            self._begin_as_shown(context.shown, motion, bank, context)
            return Decision.START_CONFIRMED
        self.motion = None
        self.ignore_before_ns = motion.onset_ns + round(SEARCH_S * 1e9)
        return Decision.START_DISCARDED

    def _is_sharp_start(
        self, sharpest: SeenStep | None, after_s: float, motion: Motion, bank: StepBank, context: Context
    ) -> bool:
        # The side lobes of a large step look like smaller ones of the other sign: the largest of all is heard first.
        for sign in (0, motion.direction):
            step = self._largest(bank, Kernel.START_WHOLE, motion.onset_ns, after_s, sign) if sign else sharpest
            if step is None:
                continue
            sustained = beside(bank, Kernel.START_SUSTAINED, step)
            surely = sustained_evidence(
                sustained.x * motion.direction, sustained.sigma, context.speed(motion.direction)
            )
            if sign and surely < SUSTAINED_EVIDENCE:
                continue  # smaller than a step of the other sign: two sides of a blow
            if self._accept(step, sustained, 0.55, CONFIRM_EVIDENCE, bank, context, slow=False):
                return True
        return False

    def _is_slow_start(self, sharpest: SeenStep | None, motion: Motion, bank: StepBank, context: Context) -> bool:
        # Beside a clear step of the other sign it can only be a start of that sign, whose side lobe was proposed.
        only = 0
        if sharpest is not None and -sharpest.x * motion.direction > 0.5 * context.speed(motion.direction):
            only = -motion.direction
        before_s = SLOW_SEARCH_S if only else SEARCH_S
        for kernel in SLOW_KERNELS[::-1]:
            slow = self._largest(bank, kernel, motion.onset_ns, 1.0, only, before_s=before_s)
            if slow is None or slow.t_ns - self.last_event_ns < SLOW_QUIET_AFTER_STOP_S * 1e9:
                continue
            sign = 1 if slow.x > 0 else -1
            sharp = self._largest(bank, Kernel.START_WHOLE, slow.t_ns, 1.0, sign)
            if sharp is not None and sharp.x * sign > SHARP_SHARE * abs(slow.x):
                continue  # the side lobe of a sharp step
            if self._accept(slow, None, 0.6, CONFIRM_SLOW_EVIDENCE, bank, context, slow=True):
                return True
        return False

    def _begin_as_shown(self, shown: Motion, motion: Motion, bank: StepBank, context: Context) -> None:
        """Begin what the displacement sensor shows; what was felt, if not surely, tells the time better."""
        felt = not motion.slow and motion.direction == shown.direction
        begun = motion if felt else shown
        onset_ns, burst = self._refined_start(begun.onset_ns, begun.direction, bank, context, slow=begun.slow)
        self._begin(replace(begun, onset_ns=onset_ns, start_burst=burst, confirmed=True))

    def _accept(
        self,
        step: SeenStep,
        sustained: SeenStep | None,
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

    def _for_stop(self, step: SeenStep, motion: Motion, bank: StepBank, context: Context) -> float:
        """Nats for a stop against a mere dip of the speed."""
        speed = context.speed(motion.direction)
        sustained = beside(bank, Kernel.STOP_SUSTAINED, step)
        total = STOP_ODDS + EXPECTED_END * context.end_expected + context.seen.get(motion.direction, 0.0)
        total += evidence(abs(step.x), (step.sigma**2 + (0.05 * speed) ** 2) ** 0.5, speed, 0.06)
        total -= evidence(abs(step.x), (step.sigma**2 + (0.05 * speed) ** 2) ** 0.5, 0.6 * speed, 0.3)
        total += sustained_evidence(-sustained.x * motion.direction, sustained.sigma, speed)
        return total + quiet_evidence(bank, step)

    def _refined_stop(
        self, step: SeenStep, direction: int, speed: float, bank: StepBank, context: Context
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
        stop = self._largest(bank, Kernel.STOP_LATE, t_ns, SEARCH_S, sign=-direction, judged_too=True)
        if stop is None or self._slower(bank, t_ns, abs(x), -direction, context):
            return False
        larger = self._largest(bank, Kernel.START_WHOLE, t_ns, 0.5, judged_too=True)
        if larger is not None and abs(larger.x) > 1.4 * speed:
            return False  # the side lobe of a larger step
        if self._is_pulse(bank, stop.t_ns, abs(stop.x), -direction):
            return False
        sustained = beside(bank, Kernel.STOP_SUSTAINED, stop)
        surely = sustained_evidence(-sustained.x * direction, sustained.sigma, speed) + quiet_evidence(bank, stop)
        if surely < SUSTAINED_EVIDENCE:
            return False
        stop_ns, burst = self._refined_stop(stop, direction, speed, bank, context)
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
    ) -> SeenStep | None:
        """The largest step near a time, but for what has been judged."""
        not_before_ns = 0 if judged_too else self.ignore_before_ns
        return largest(bank, kernel, t_ns, after_s, sign, before_s=before_s, not_before_ns=not_before_ns)
