"""One pass of orientation and filter along the buffered steps, under a given belief about the segments.

The pipeline keeps two: the settled track runs a few seconds behind, where no decision can change any more; the
provisional one is a copy of it, run to the present, and run again from there whenever a decision changes.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import sqrt

from estimation.belief import STOP_BURST_S, Belief, Phase
from estimation.chart import ControlChart
from estimation.displacement.sensor import GATE_SIGMAS, TRUST_SIGMAS, Reading
from estimation.gaussian import Gaussian
from estimation.mskf import LEARNED, LEVEL_DRIFT_M_S2, SPEED, Filter, P, flow_state
from estimation.noise import ACCEL_NOISE
from estimation.orientation import IDENTITY, Quaternion, corrected, matrix, propagated
from estimation.recognition.motion import Motion
from estimation.records import Vector
from estimation.settings import EstimatorSettings

SPEED_REACHED_S, SLOW_SPEED_REACHED_S = (0.55, 0.7, 0.85), (1.2, 1.35, 1.5)
NEARLY_STOPPED_S = (0.35, 0.5)
RINGING_SHARE = 0.1  # of the speed, so soon after a stop
LEVEL_TIME_S = 3.0
GYRO_BIAS_TIME_S = 10.0
CHART_QUIET_S = 0.5
HEALTHY_NIS = 3.0
READINGS_FOR_EVIDENCE = 10
STOP_NEAR_SIGMAS, STOP_NEAR_M = 3.0, 0.004
BEYOND_SIGMAS, BEYOND_M = 4.0, 0.01  # behind a mechanical stop
END_JUDGED_S = 1.2  # after the stop
LATE_START_S = 0.3  # a move entered later than this had been missed
DOUBTFUL_READINGS = 8  # outside the gate: from such a move nothing is learned
STRAY_GAIN, STRAY_SIGMAS = 0.03, 5.0


@dataclass(slots=True)
class Step:
    """One pipeline step: block means in support axes and the readings that came with it."""

    t_ns: int
    dt_s: float
    accel: Vector
    gyro: Vector
    smooth: Vector  # acceleration, causal wavelet
    step_m_s: float = 0.0
    vibration_m_s2: float = 0.0
    blind: bool = False  # no inertial sample in it
    new_sensor: bool = False  # the first one of another sensor
    readings: list[Reading] = field(default_factory=list)


@dataclass(slots=True)
class Ending:
    """How the last move began and ended [m]."""

    start_m: float
    end_before_stop_m: float
    sigma_before_stop_m: float
    end_m: float
    sigma_m: float
    velocity_m_s: float


@dataclass(slots=True)
class Track:
    """State of one pass."""

    filter: Filter
    pushes_learned: int = 0  # confirmed strokes that told the usual speed
    retracts_learned: int = 0
    remembered: Gaussian | None = None  # what had been learned when the present move began
    orientation: Quaternion = IDENTITY
    gravity_m_s2: float = 0.0  # as felt at rest; 0 until the first sample
    gyro_bias: Vector = (0.0, 0.0, 0.0)
    gyro_bias_s: float = 0.0
    rest_s: float = 0.0
    chart: ControlChart = field(default_factory=ControlChart)
    phase: Phase = Phase.REST
    started: int = 0  # moves begun
    direction: int = 1
    start_m: float = 0.0
    speed_checks: int = 0
    nis: float = 1.0  # running mean over the readings of a move
    worst_nis: float = 1.0  # its largest in the present move
    readings_in_move: int = 0  # or in the unexplained time
    rejected_in_move: int = 0
    stray_m: float = 0.0  # mean innovation at rest: does the ram creep?
    lost_in_move: bool = False  # the unexplained began while the ram moved
    ending: Ending | None = None
    last_motion: Motion | None = None
    judge_end_ns: int | None = None  # when the end of the last move is due to be judged
    end_certain: bool = False  # its stop has been confirmed
    acceleration_m_s2: float = 0.0
    innovation_m: float = float("nan")
    gate_m: float = float("nan")

    @classmethod
    def begin(cls, filter_: Filter) -> Track:
        """At rest, nothing learned."""
        return cls(filter_)

    def copy(self) -> Track:
        """Independent copy."""
        return replace(
            self,
            filter=self.filter.copy(),
            chart=replace(self.chart),
            ending=None if self.ending is None else replace(self.ending),
        )

    @property
    def learned(self) -> Gaussian:
        """What outlasts a move; of a move that is not over yet nothing is in it, for it may prove doubtful."""
        return self.filter.state.block(LEARNED) if self.remembered is None else self.remembered

    def usual_speed(self, direction: int) -> float:
        """Usual speed of a direction [m/s], positive."""
        return self.filter.state.x[flow_state(direction)]

    def strokes_learned(self, direction: int) -> int:
        """How many confirmed strokes have told that speed."""
        return self.pushes_learned if direction > 0 else self.retracts_learned

    def advance(self, step: Step, belief: Belief, settings: EstimatorSettings, latency_s: float) -> list[bool]:
        """Go one step on. Returns, for each usable reading of the step, whether it lay within the gate."""
        if step.new_sensor:
            self._forget_sensor()
        phase, motion = belief.phase_at(step.t_ns)
        if self.judge_end_ns is not None and (phase is not Phase.REST or step.t_ns >= self.judge_end_ns):
            self.judge_end(settings)
        if phase is not self.phase:
            self._change(phase, motion, step, settings)
        if step.blind:
            self._guess(step)
        else:
            self._feel(step, motion)
        return [self._observe(reading, step.t_ns, latency_s) for reading in step.readings if reading.usable]

    def _forget_sensor(self) -> None:
        """Another part has other biases, and may sit a little differently."""
        self.gravity_m_s2, self.rest_s = 0.0, 0.0
        self.gyro_bias, self.gyro_bias_s = (0.0, 0.0, 0.0), 0.0
        self.chart = ControlChart()

    def _guess(self, step: Step) -> None:
        """A step without inertial samples: rest and cruise go on by themselves, a burst or worse is lost."""
        if self.phase is Phase.REST:
            self.filter.rest_unwatched(step.dt_s)
        elif self.phase is Phase.CRUISE:
            self.filter.cruise_unwatched(step.dt_s)
        else:
            self.filter.blind(step.dt_s)

    def _feel(self, step: Step, motion: Motion | None) -> None:
        """Orientation, levelled acceleration and the model of the phase."""
        resting = self.phase is Phase.REST
        self._orient(step, resting or self.phase is Phase.UNFELT)
        # Gravity's part of the push axis, taken out in sensor axes: paper C, eq. (10), along the push itself.
        gravity_part = self.gravity_m_s2 * matrix(self.orientation)[2][1]
        acceleration = step.accel[1] - gravity_part
        self.acceleration_m_s2 = step.smooth[1] - gravity_part
        if resting:
            if self.rest_s > CHART_QUIET_S:
                self.chart.learn(self.acceleration_m_s2, step.dt_s)
            averaged_s = min(self.rest_s, 2.0 * LEVEL_TIME_S)
            self.filter.rest(step.dt_s, ACCEL_NOISE**2 / averaged_s + LEVEL_DRIFT_M_S2**2)
        elif self.phase is Phase.CRUISE:
            self.filter.cruise(step.dt_s, acceleration, step.vibration_m_s2)
        elif self.phase is Phase.UNFELT:
            self.filter.blind(step.dt_s)
        elif self.phase is Phase.FREE:
            self.filter.free(step.dt_s, acceleration, step.vibration_m_s2)
        else:
            self.filter.burst(step.dt_s, acceleration)
            if motion is not None:
                self._check_speed(step, motion)

    def _orient(self, step: Step, resting: bool) -> None:
        if self.gravity_m_s2 == 0.0:
            self.orientation = corrected(IDENTITY, step.accel, 1.0)
            self.gravity_m_s2 = _norm(step.accel)  # even when not at rest: the best guess for a new sensor
        if not resting:
            x, y, z = (a - b for a, b in zip(step.gyro, self.gyro_bias, strict=True))
            self.orientation = propagated(self.orientation, (x, y, z), step.dt_s)
            self.rest_s = 0.0
            return
        # At rest the rate is zero and the gyro reads its bias; integrating it would only add its noise.
        self.rest_s += step.dt_s
        gain = step.dt_s / min(self.rest_s, LEVEL_TIME_S)
        self.orientation = corrected(self.orientation, step.accel, gain)
        self.gravity_m_s2 += gain * (_norm(step.accel) - self.gravity_m_s2)
        self.gyro_bias_s = min(self.gyro_bias_s + step.dt_s, GYRO_BIAS_TIME_S)
        gain = step.dt_s / self.gyro_bias_s
        bx, by, bz = self.gyro_bias
        gx, gy, gz = step.gyro
        self.gyro_bias = (bx + gain * (gx - bx), by + gain * (gy - by), bz + gain * (gz - bz))

    def _change(self, phase: Phase, motion: Motion | None, step: Step, settings: EstimatorSettings) -> None:
        """Leave one phase and enter another."""
        moving = (Phase.START, Phase.CRUISE, Phase.STOP)
        if phase in moving and self.phase not in moving and motion is not None:
            self._begin_move(motion, step, settings)
        if phase is Phase.CRUISE:
            if motion is not None and motion.start_burst is not None:
                self.filter.hear_burst(motion.start_burst.step_m_s, motion.start_burst.sigma_m_s)
            self.filter.enter_cruise()
        elif phase in (Phase.START, Phase.STOP):
            self.speed_checks = 0
            self.filter.begin_burst(step.vibration_m_s2)
        elif phase in (Phase.FREE, Phase.UNFELT):
            self.lost_in_move = self.phase in moving
            self.readings_in_move = 0
            self.filter.begin_free()
        elif phase is Phase.REST and self.phase in (Phase.FREE, Phase.UNFELT):
            self.remembered = None
            # Constant speed feels like rest: the ram may have gone on unnoticed, and may do so still.
            if self.lost_in_move and self.readings_in_move < READINGS_FOR_EVIDENCE:
                self.filter.lose_place()
        elif phase is Phase.REST and self.phase is Phase.STOP:
            self._come_to_rest(self.last_motion, step)
        self.phase = phase
        self.last_motion = motion

    def _begin_move(self, motion: Motion, step: Step, settings: EstimatorSettings) -> None:
        self.started += 1
        self.direction = motion.direction
        if motion.resumes_ns is None or self.ending is None:
            self.start_m = self.filter.state.x[P]
        self.nis, self.worst_nis, self.readings_in_move, self.rejected_in_move = 1.0, 1.0, 0, 0
        self.remembered = self.filter.state.block(LEARNED)
        self.filter.begin_move(motion.direction, settings.speed_sigma_cycle)
        late_s = (step.t_ns - motion.onset_ns) * 1e-9
        if late_s > LATE_START_S:
            self.filter.catch_up(late_s)
        elif motion.stop_ns is not None and motion.onset_ns >= motion.stop_ns:
            self.filter.lose_way(motion.direction)

    def _check_speed(self, step: Step, motion: Motion) -> None:
        """Late in a burst the speed is known again, but for what still rings."""
        checks: tuple[float, ...]
        if self.phase is Phase.START:
            checks, since_ns = SLOW_SPEED_REACHED_S if motion.slow else SPEED_REACHED_S, motion.onset_ns
        else:
            checks, since_ns = NEARLY_STOPPED_S, motion.stop_ns or step.t_ns
        if self.speed_checks == len(checks) or step.t_ns - since_ns < checks[self.speed_checks] * 1e9:
            return
        self.speed_checks += 1
        if self.phase is Phase.START:
            self.filter.speed_reached(step.vibration_m_s2)
        else:
            self.filter.stopped(step.vibration_m_s2, RINGING_SHARE * self.filter.state.x[SPEED])

    def _come_to_rest(self, motion: Motion | None, step: Step) -> None:
        if motion is not None and motion.stop_burst is not None:
            self.filter.hear_burst(-motion.stop_burst.step_m_s, motion.stop_burst.sigma_m_s)
        self.filter.stopped(step.vibration_m_s2)
        self.end_certain = motion is not None and motion.stop_confirmed
        self.judge_end_ns = step.t_ns + round((END_JUDGED_S - STOP_BURST_S) * 1e9)

    def judge_end(self, settings: EstimatorSettings) -> None:
        """Sum the last move up, and use its mechanical stop if it reached one: a second of readings at rest helps."""
        self.judge_end_ns = None
        state = self.filter.state
        before_m, sigma_before_m = state.x[P], state.sigma(P)
        if max(-before_m, before_m - self.filter.stroke_m) > BEYOND_M + BEYOND_SIGMAS * sigma_before_m:
            self.filter.lose_place()  # no ram goes there: a move before was missed, or was none
        doubtful = self.worst_nis > HEALTHY_NIS or self.rejected_in_move >= DOUBTFUL_READINGS
        stop_m = self._stop_reached(before_m, sigma_before_m) if settings.stop_constraint else None
        if stop_m is not None:
            self.filter.at_stop(stop_m, settings.stop_sigma_mm / 1e3)
            if self.end_certain and not doubtful:
                self.pushes_learned += self.direction > 0
                self.retracts_learned += self.direction < 0
        self.ending = Ending(self.start_m, before_m, sigma_before_m, state.x[P], state.sigma(P), state.x[SPEED])
        if doubtful and self.remembered is not None:
            self.filter.state.set_block(LEARNED, self.remembered)
        if self.end_certain:
            self.remembered = None

    def _stop_reached(self, p_m: float, sigma_m: float) -> float | None:
        """The mechanical stop that the move ended at, if there is evidence for it.

        Near is not enough: without a learned flow or a displacement sensor that agrees, the place is a guess.
        """
        stop_m = self.filter.stroke_m if self.direction > 0 else 0.0
        near = abs(p_m - stop_m) < max(STOP_NEAR_SIGMAS * sigma_m, STOP_NEAR_M)
        agreed = self.readings_in_move >= READINGS_FOR_EVIDENCE and self.nis < HEALTHY_NIS
        return stop_m if near and (agreed or self.strokes_learned(self.direction) > 0) else None

    def _observe(self, reading: Reading, now_ns: int, latency_s: float) -> bool:
        """Use one reading of the displacement sensor, unless it lies outside the gate."""
        lag_s = (now_ns - reading.t_ns) * 1e-9 + latency_s
        predicted, row = self.filter.displacement_prediction(lag_s)
        variance = self.filter.state.predicted_variance(row) + reading.variance_m2
        self.innovation_m = reading.value_m - predicted
        self.gate_m = (GATE_SIGMAS if reading.trusted else TRUST_SIGMAS) * sqrt(variance)
        accepted = abs(self.innovation_m) <= self.gate_m
        nis = min(self.innovation_m**2 / variance, GATE_SIGMAS**2)
        self.nis += 0.05 * (nis - self.nis)
        self.worst_nis = max(self.worst_nis, self.nis)
        if accepted and reading.trusted:
            self.readings_in_move += 1
            self.filter.state.measure(row, self.innovation_m, reading.variance_m2)
            if self.phase is Phase.REST:
                self._watch_creep(variance)
        else:
            self.rejected_in_move += not accepted
        return accepted

    def _watch_creep(self, variance: float) -> None:
        """A leaking valve lets the ram creep: seen as innovations that stay on one side."""
        self.stray_m += STRAY_GAIN * (self.innovation_m - self.stray_m)
        if abs(self.stray_m) > STRAY_SIGMAS * sqrt(0.5 * STRAY_GAIN * variance):
            self.filter.state.diffuse(P, self.stray_m**2)
            self.stray_m = 0.0


def _norm(v: Vector) -> float:
    x, y, z = v
    return sqrt(x * x + y * y + z * z)
