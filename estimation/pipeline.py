"""The one pipeline for live, simulated, replayed and tuned data: records in, estimates, moves and events out.

Time enters only in the records, and steps are cut by count, so the same records give the same bytes, however they
were handed over. All that it remembers is one tree of plain data, `PipelineState`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import acos, degrees, hypot, log, sqrt

from estimation.belief import SEGMENT_OF, Phase
from estimation.blocks import GAP_PERIODS, SAMPLES_PER_STEP, BlockCutter
from estimation.displacement.second_opinion import (
    FELT,
    GoesOn,
    Opinion,
    RunsAway,
    Stands,
    Unfelt,
    second_opinion,
    seen_evidence,
    sensor_speed,
    sensor_stands,
    shown_move,
)
from estimation.displacement.sensor import STUCK_READINGS
from estimation.learned import Learned, Machine
from estimation.mount.axes import Mount
from estimation.mskf import P, V
from estimation.orientation import matrix
from estimation.pipeline_state import PipelineState, Start
from estimation.recognition.burst import prepare as prepare_bursts
from estimation.recognition.kernels import Kernel
from estimation.recognition.motion import Context, Decision, Motion
from estimation.recognition.steps import Block, StepBank
from estimation.records import (
    CanState,
    Displacement,
    Estimate,
    Event,
    ImuSample,
    Move,
    MoveKind,
    Output,
    Record,
    SensorChange,
    Tick,
    Tier,
)
from estimation.settings import EstimatorSettings, MountSettings, SupportSettings
from estimation.track import Ending, Step, Track

__all__ = ["Pipeline", "Start"]

NOMINAL_RATE_HZ = 819.2
LAG_S = 4.0  # the settled tier runs so far behind; every decision is taken within it
WARM_UP_S = 3.0  # gyro bias and level must be known before a burst can be told from them
LOUD_WARM_UP_S, LOUD_M_S2 = 7.0, 0.08  # and the spectrum of a vibration that could hide one
SILENT_IMU_S = 0.25
FIRST_SAMPLE_S = 2.0  # a sensor that is being started is not silent yet
SENSOR_CHANCE_S = 2.0
UPSET_LOOK_BACK_S = 0.5  # an unexplained motion began before it was too large to explain
UNEXPLAINED_READINGS = 3  # outside the gate in a row
UNFELT_LOOK_BACK_S = 1.2
KNOWN_SIGMA_M = 0.03  # a stroke known no better than this is a guess
FORBIDDEN_M = 0.015  # from an end of the stroke
STOP_UNNOTICED_S = 0.2
LEAST_UPRIGHT = 0.7  # cosine: a face dips, but not by 45 degrees
PERIOD_STEPS = 1.1  # kernels fit step periods within 5 %; they are built on this geometric grid


class Pipeline:
    """Feed it every record in order; `finish` at the end of a recording settles the rest."""

    def __init__(
        self,
        mount: MountSettings | None = None,
        support: SupportSettings | None = None,
        estimator: EstimatorSettings | None = None,
        latency_s: float = 0.0175,
        timeout_s: float = 1.0,
        start: Start | None = None,
        imu_delay_s: float = 0.0037,
    ) -> None:
        mount = mount or MountSettings()
        self._mount = Mount(mount)
        self._imu_on = mount.imu_on
        self._felt = FELT[mount.imu_on]
        self._support = support or SupportSettings()
        self._settings = estimator or EstimatorSettings()
        self._latency_s = latency_s
        self._delay_s = imu_delay_s
        self.state = PipelineState.begin(self._support, self._settings, start or Start(), timeout_s)
        self.on_settled: Callable[[Estimate], object] = lambda _: None  # called while the settled track stands there

    @staticmethod
    def prepare(rate_hz: float = NOMINAL_RATE_HZ) -> None:
        """Do beforehand what would delay the first seconds of a live source of about that sample rate."""
        dt_s = _on_grid(SAMPLES_PER_STEP / rate_hz)
        StepBank(dt_s).prepare()
        prepare_bursts(dt_s)

    # --- snapshot ---------------------------------------------------------------------------------------------

    def snapshot(self) -> bytes:
        """All that is remembered, as JSON; floats survive exactly."""
        return self.state.dump()

    def restore(self, snapshot: bytes) -> None:
        """Continue from a snapshot. Raises pydantic.ValidationError on foreign or damaged bytes."""
        self.state = PipelineState.load(snapshot)

    def learned(self, machine: Machine | None = None) -> Learned | None:
        """What another run on the same machine may begin with, out of the settled track; None if there is nothing yet.

        machine: the support with the names of its sensors, if they are known.
        """
        return self.state.learned(machine or Machine.of(self._support))

    @property
    def strokes_learned(self) -> int:
        """How many confirmed strokes are in `learned`."""
        return self.state.strokes_learned

    # --- the stream -------------------------------------------------------------------------------------------

    def feed(self, record: Record) -> list[Output]:
        """Take one record; returns what it brought about, oldest first."""
        out: list[Output] = []
        if isinstance(record, ImuSample):
            self._feed_sample(record, out)
        elif isinstance(record, Tick):
            self._pass_time(record.t_ns, out)
        elif isinstance(record, SensorChange):
            self._change_sensor(record, out)
        elif not record.is_reference:
            self._feed_reading(record, out)
        return out

    def finish(self) -> list[Output]:
        """End of the data: settle what is still open, under the present belief."""
        s, out = self.state, list[Output]()
        if s.summary_due:
            if s.head.judge_end_ns is not None:
                s.head.judge_end(self._settings)
            self._sum_up(out)
        self._settle(out, until_ns=s.last_ns)
        return out

    def _feed_sample(self, sample: ImuSample, out: list[Output]) -> None:
        s = self.state
        if s.first_ns is None:
            s.first_ns = s.last_ns = sample.t_ns
        elif sample.t_ns < s.last_ns:
            s.cutter.backward += 1
            return
        gap_s, step = s.cutter.add(sample, self._mount)
        if gap_s:
            out.append(Event(sample.t_ns, f"gap of {gap_s:.3f} s in the inertial samples"))
            self._pass_time(sample.t_ns, out, even_short=True)
        if step is not None:
            self._take(step, out)

    def _change_sensor(self, change: SensorChange, out: list[Output]) -> None:
        """Begin anew with the inertial sensor; the stroke and what the displacement sensor is like stay known."""
        s = self.state
        if s.first_ns is None:
            return  # the first one
        self._pass_time(change.t_ns, out, even_short=True)
        out.append(Event(change.t_ns, "another inertial sensor: its errors are learned anew"))
        s.cutter, s.bank, s.new_sensor, s.mount_checked = BlockCutter(backward=s.cutter.backward), None, True, False

    def _feed_reading(self, reading: Displacement, out: list[Output]) -> None:
        s = self.state
        if s.first_ns is None:
            s.first_ns = s.last_ns = reading.t_ns
        self._pass_time(reading.t_ns, out)
        predicted_m, _ = s.head.filter.displacement_prediction((s.last_ns - reading.t_ns) * 1e-9 + self._latency_s)
        was_stuck = s.sensor.stuck
        known = s.head.filter.state.sigma(P) < KNOWN_SIGMA_M
        judged = s.sensor.judge(reading, predicted_m, known=known, velocity_m_s=s.head.filter.state.x[V])
        s.pending.append(judged)
        if s.sensor.leapt:
            s.slope.clear()
        if judged.usable:
            s.slope.add(reading.t_ns, reading.value_m)
        if s.sensor.stuck and not was_stuck:
            self._withdraw_stuck_readings()

    def _withdraw_stuck_readings(self) -> None:
        """The sensor froze some readings ago: take those back and estimate again without them."""
        s = self.state
        readings = [reading for step in s.buffer for reading in step.readings] + s.pending
        for reading in readings[-max(STUCK_READINGS, s.sensor.same_in_row) :]:
            reading.usable = False
        s.slope.clear()
        self._run_head_again()

    def _pass_time(self, t_ns: int, out: list[Output], *, even_short: bool = False) -> None:
        """Make a step without inertial samples if they have been silent for long."""
        s = self.state
        if s.first_ns is None:
            s.first_ns = s.last_ns = t_ns
        silent_s = (t_ns - s.last_ns) * 1e-9
        # A slow source makes a step less often than it makes samples.
        heard_ns = max(s.last_ns, s.cutter.last_ns or 0)
        patience_s = max(SILENT_IMU_S, GAP_PERIODS * s.cutter.period_s)
        if s.last_ns == s.first_ns:
            patience_s = max(patience_s, FIRST_SAMPLE_S)
        if silent_s <= 0 or ((t_ns - heard_ns) * 1e-9 < patience_s and not even_short):
            return
        if silent_s >= patience_s and s.belief.open_free is None:
            self._go_free(s.last_ns)
            s.bank = None  # what it saw no longer joins what it will see
            out.append(
                Event(t_ns, "the inertial sensor is silent: only the displacement sensor can tell the stroke now")
            )
        zero = (0.0, 0.0, 0.0)
        self._take(Step(t_ns, silent_s, zero, zero, zero, blind=True), out)

    # --- one step ---------------------------------------------------------------------------------------------

    def _take(self, step: Step, out: list[Output]) -> None:
        s = self.state
        step.readings, s.pending = s.pending, []
        if s.new_sensor and not step.blind:
            s.new_sensor, step.new_sensor, s.warm_from_ns = False, True, step.t_ns
        decision = None
        if not step.blind:
            decision = self._recognise(step)
        s.last_ns = step.t_ns
        if s.waiting_start is not None:
            self._consider_waiting_start(step, out)
        s.buffer.append(step)
        s.can_state = s.sensor.state(step.t_ns)
        s.can_states.append(s.can_state)
        if s.head.phase is not Phase.REST and s.can_state not in (CanState.OK, CanState.LATE):
            s.worst_in_move = s.can_state

        if decision is not None:
            out.append(Event(step.t_ns, f"{decision} ({_direction_word(s.recogniser.motion)})"))
            self._believe(decision)
            self._run_head_again()
            if decision in (Decision.STOP_CONFIRMED, Decision.STOP_UNSTARTED):
                if s.belief.last_motion is not None and s.belief.last_motion.resumes_ns is not None:
                    s.moves -= 1  # its summary comes again, under the same number
                s.summary_due = True
        else:
            for accepted in self._advance(s.head, step):
                if self._is_in_doubt():
                    continue
                if self._imu_on == "both" or s.head.phase is not Phase.REST:
                    s.sensor.gated(accepted, s.head.innovation_m, s.head.filter.state.sigma(P))
                    continue
                # The ram may make a move that the inertial sensor cannot feel: no reason to doubt the reading.
                s.unexplained_in_row = 0 if accepted else s.unexplained_in_row + 1
            self._supervise(step, out)
        self._check_mount(step, out)
        if s.summary_due and s.head.judge_end_ns is None and s.head.phase is Phase.REST:
            self._sum_up(out)
        out.append(self._estimate(s.head, step, s.can_state, Tier.PROVISIONAL))
        self._settle(out, until_ns=step.t_ns - round(LAG_S * 1e9))

    def _is_in_doubt(self) -> bool:
        """A stop or start is only proposed: a reading that contradicts it speaks against it, not against the sensor."""
        motion = self.state.recogniser.motion
        return motion is not None and (
            not motion.confirmed or (motion.stop_ns is not None and not motion.stop_confirmed)
        )

    def _consider_waiting_start(self, step: Step, out: list[Output]) -> None:
        """Believe the saved stroke once the displacement sensor has had its chance to speak."""
        s = self.state
        assert s.first_ns is not None
        assert s.waiting_start is not None
        if any(reading.usable for reading in step.readings):
            s.waiting_start = None
        elif step.t_ns - s.first_ns > SENSOR_CHANCE_S * 1e9:
            start, s.waiting_start = s.waiting_start, None
            if start.displacement_m is not None:
                for track in (s.settled, s.head):
                    track.filter.state.reset(P, start.displacement_m, start.sigma_m**2)
                out.append(Event(step.t_ns, "no displacement reading: the saved stroke is believed"))

    def _recognise(self, step: Step) -> Decision | None:
        s = self.state
        bank = self._bank(step)
        block = Block(step.t_ns, step.accel[1], step.gyro[0], s.head.gravity_m_s2 or 9.8)
        bank.keep_pace(step.t_ns, s.cutter.period_s * SAMPLES_PER_STEP or step.dt_s)
        steps = bank.add(
            block,
            s.head.gyro_bias[0],
            since_event_s=s.recogniser.since_event_s(step.t_ns) if s.belief.open_free is None else 0.0,
            resting=s.head.phase is Phase.REST,
        )
        step.vibration_m_s2 = bank.vibration_m_s2
        step.step_m_s = steps.x[Kernel.START_WHOLE]
        s.supervisor.see(step)
        if s.belief.open_free is not None or not self._is_warm(step):
            return None
        return s.recogniser.update(step.t_ns, steps, bank, self._context())

    def _is_warm(self, step: Step) -> bool:
        s = self.state
        assert s.first_ns is not None
        since_s = (step.t_ns - max(s.first_ns, s.warm_from_ns)) * 1e-9
        if since_s < WARM_UP_S:
            s.warm_up_s = 0.0
            return False
        if s.warm_up_s == 0.0:
            # At its least: a move that has just begun is loud, too.
            loud = s.bank is not None and s.bank.least_vibration_m_s2(0.5 * WARM_UP_S) > LOUD_M_S2
            s.warm_up_s = LOUD_WARM_UP_S if loud else WARM_UP_S
        return since_s >= s.warm_up_s

    def _check_mount(self, step: Step, out: list[Output]) -> None:
        """Say once if gravity does not lie where the mount says that up is."""
        s = self.state
        if not s.mount_checked and self._is_warm(step):
            s.mount_checked = True
            upright = matrix(s.head.orientation)[2][2]
            if s.head.gravity_m_s2 > 0 and upright < LEAST_UPRIGHT:
                tilt_deg = degrees(acos(max(upright, -1.0)))
                out.append(
                    Event(step.t_ns, f"the sensor is tilted by {tilt_deg:.0f} degrees: check [mount] push and up")
                )

    def _bank(self, step: Step) -> StepBank:
        """The kernels, built for this source's own step period once that is known."""
        s = self.state
        if s.bank is None or (s.cutter.periods < 2000 and s.cutter.periods % 256 < SAMPLES_PER_STEP):
            period_s = s.cutter.period_s * SAMPLES_PER_STEP or step.dt_s
            dt_s = _on_grid(period_s)
            if s.bank is None or s.bank.dt_s != dt_s:
                s.bank = StepBank(dt_s)
        return s.bank

    def _context(self) -> Context:
        s = self.state
        p, sigma = self._place()
        known, stroke_m = sigma < KNOWN_SIGMA_M, self._support.stroke_mm / 1e3
        return Context(
            push_speed=s.head.usual_speed(1),
            retract_speed=s.head.usual_speed(-1),
            push_forbidden=known and p > stroke_m - FORBIDDEN_M,
            retract_forbidden=known and p < FORBIDDEN_M,
            end_expected=self._end_expected(),
            delay_s=self._delay_s,
            felt=self._felt,
            broken_off=self._broken_off(),
            shown=shown_move(s, self._felt, self._latency_s),
            seen=seen_evidence(s, self._latency_s),
        )

    def _place(self) -> tuple[float, float]:
        """Where the ram is, with sigma; where a move that is only proposed would lead says nothing against another."""
        s = self.state
        state, motion = s.head.filter.state, s.recogniser.motion
        only_proposed = motion is not None and not motion.confirmed and s.head.phase is not Phase.REST
        return s.head.start_m if only_proposed else state.x[P], state.sigma(P)

    def _end_expected(self) -> bool:
        """Whether the stroke ends about here, as far as it is known."""
        s = self.state
        p, sigma = self._place()
        end_m = self._support.stroke_mm / 1e3 if s.head.direction > 0 else 0.0
        return abs(p - end_m) < 3.0 * sqrt(sigma**2 + (0.02 * abs(p - s.head.start_m)) ** 2)

    def _broken_off(self) -> Motion | None:
        """The last move, if it ended far from its mechanical stop."""
        s = self.state
        motion = s.belief.last_settled_motion
        if motion is None or motion.stop_ns is None:
            return None
        stop_m = self._support.stroke_mm / 1e3 if motion.direction > 0 else 0.0
        return motion if abs(s.head.filter.state.x[P] - stop_m) > 2.0 * FORBIDDEN_M else None

    def _believe(self, decision: Decision) -> None:
        """Bring the belief in line with what the recogniser decided."""
        s = self.state
        s.belief.follow(decision, s.recogniser.motion)
        if decision is Decision.START_PROPOSED:
            # A frame that is a little late says nothing about the sensor.
            s.worst_in_move = CanState.OK if s.can_state is CanState.LATE else s.can_state
        elif decision in (Decision.STOP_CONFIRMED, Decision.STOP_UNSTARTED):
            s.recogniser.motion = None

    def _advance(self, track: Track, step: Step) -> list[bool]:
        return track.advance(step, self.state.belief, self._settings, self._latency_s)

    def _run_head_again(self) -> None:
        """From the settled track to the present, under the present belief."""
        s = self.state
        s.head = s.settled.copy()
        for step in s.buffer:
            self._advance(s.head, step)

    def _settle(self, out: list[Output], until_ns: int) -> None:
        s = self.state
        while s.buffer and s.buffer[0].t_ns <= until_ns:
            step, can_state = s.buffer.popleft(), s.can_states.popleft()
            self._advance(s.settled, step)
            estimate = self._estimate(s.settled, step, can_state, Tier.SETTLED)
            self.on_settled(estimate)
            out.append(estimate)
        s.belief.forget_before(until_ns)

    # --- supervision ------------------------------------------------------------------------------------------

    def _supervise(self, step: Step, out: list[Output]) -> None:
        """Look for what no hypothesis of the recogniser explains."""
        s = self.state
        free = s.belief.open_free
        if free is not None:
            moves = sensor_speed(s) is not None or (free.unfelt and not sensor_stands(s, free.from_ns))
            if not step.blind and s.supervisor.calm(step.t_ns, free.from_ns, moves):
                s.belief.end_free(step.t_ns)
                s.recogniser.rest(step.t_ns)
                out.append(Event(step.t_ns, "at rest again after an unexplained motion"))
        elif not step.blind and s.supervisor.upset(step, s.head):
            self._go_free(step.t_ns - round(UPSET_LOOK_BACK_S * 1e9))
            out.append(Event(step.t_ns, "motion that is neither a push nor a retract"))
        elif s.unexplained_in_row >= UNEXPLAINED_READINGS and s.head.phase is Phase.REST:
            s.unexplained_in_row = 0
            self._go_free(step.t_ns - round(UNFELT_LOOK_BACK_S * 1e9), unfelt=True)
            out.append(Event(step.t_ns, "a move that cannot be felt: following the displacement sensor"))
        elif step.readings and s.can_state in (CanState.OK, CanState.BIASED):
            self._act_on(second_opinion(s, step.t_ns, self._felt, step.t_ns - round(LAG_S * 1e9)), step, out)

    def _act_on(self, opinion: Opinion | None, step: Step, out: list[Output]) -> None:
        """Bring belief and tracks in line with what the displacement sensor shows."""
        s = self.state
        if isinstance(opinion, GoesOn):
            s.belief.replace_last(opinion.motion)
            s.recogniser.reopen(opinion.motion, step.t_ns)
            s.moves -= not s.summary_due  # its summary will come again, under the same number
            s.summary_due = False
            self._run_head_again()
            out.append(Event(step.t_ns, "the displacement sensor still moves: the stop was none, move re-opened"))
        elif isinstance(opinion, Unfelt):
            self._go_free(step.t_ns - round(2e9), unfelt=self._imu_on != "both")
            out.append(Event(step.t_ns, "the displacement sensor moves although no start was felt: following it"))
        elif isinstance(opinion, Stands):
            motion = s.recogniser.motion
            assert motion is not None
            s.belief.replace_last(replace(motion, stop_ns=opinion.stop_ns, stop_confirmed=True))
            s.recogniser.rest(step.t_ns)
            self._run_head_again()
            out.append(Event(step.t_ns, "no stop was felt, but the displacement sensor stands: move ended"))
            s.summary_due = True
        elif isinstance(opinion, RunsAway):
            for reading in [reading for past in s.buffer for reading in past.readings] + s.pending:
                if reading.t_ns >= opinion.since_ns:
                    reading.usable = False
            s.sensor.distrust()
            s.slope.clear()
            self._run_head_again()
            out.append(Event(step.t_ns, "the displacement sensor changed its speed and the ram did not: not believed"))

    def _go_free(self, from_ns: int, *, unfelt: bool = False) -> None:
        s = self.state
        s.belief.begin_free(from_ns, unfelt=unfelt)
        s.recogniser.motion = None
        self._run_head_again()

    # --- outputs ----------------------------------------------------------------------------------------------

    def _estimate(self, track: Track, step: Step, can_state: CanState, tier: Tier) -> Estimate:
        state = track.filter.state
        sigma_m = state.sigma(P)
        if tier is Tier.PROVISIONAL and track.phase is Phase.CRUISE and self._end_expected():
            # The ram may have stopped a moment ago: a stop is recognised that much later.
            sigma_m = hypot(sigma_m, STOP_UNNOTICED_S * state.x[V])
        lower, upper = track.chart.limits
        fresh = any(reading.usable for reading in step.readings)
        return Estimate(
            t_ns=step.t_ns,
            displacement_m=state.x[P],
            sigma_m=sigma_m,
            velocity_m_s=state.x[V],
            velocity_sigma_m_s=state.sigma(V),
            segment=SEGMENT_OF[track.phase],
            tier=tier,
            can_state=can_state,
            move=track.started,
            acceleration_m_s2=track.acceleration_m_s2,
            chart_lower_m_s2=lower,
            chart_upper_m_s2=upper,
            step_m_s=step.step_m_s,
            innovation_m=track.innovation_m if fresh else float("nan"),
            gate_m=track.gate_m if fresh else float("nan"),
        )

    def _sum_up(self, out: list[Output]) -> None:
        """Give the move whose stop is certain and whose end has been judged."""
        s = self.state
        s.summary_due = False
        motion, ending = s.belief.last_settled_motion, s.head.ending
        if motion is not None and ending is not None:
            s.moves += 1
            out.append(self._summary(motion, ending))

    def _summary(self, motion: Motion, ending: Ending) -> Move:
        s = self.state
        assert motion.stop_ns is not None
        return Move(
            number=s.moves,
            kind=MoveKind.PUSH if motion.direction > 0 else MoveKind.RETRACT,
            onset_ns=motion.onset_ns if motion.resumes_ns is None else motion.resumes_ns,
            stop_ns=motion.stop_ns,
            start_m=ending.start_m,
            end_m=ending.end_m,
            sigma_m=ending.sigma_m,
            end_before_stop_m=ending.end_before_stop_m,
            sigma_before_stop_m=ending.sigma_before_stop_m,
            velocity_m_s=ending.velocity_m_s,
            can_state=s.worst_in_move,
            tier=Tier.SETTLED,
        )


def _direction_word(motion: Motion | None) -> str:
    if motion is None:
        return "none"
    return MoveKind.PUSH if motion.direction > 0 else MoveKind.RETRACT


def _on_grid(period_s: float) -> float:
    """The nearest step period on a geometric grid through the nominal one, so that kernels are seldom rebuilt."""
    nominal = SAMPLES_PER_STEP / NOMINAL_RATE_HZ
    return float(nominal * PERIOD_STEPS ** round(log(period_s / nominal) / log(PERIOD_STEPS)))
