"""Motion of the virtual roof support: push and retract cycles as a flexible machine makes them.

Ram speed is the unity-gain second-order response to a trapezoidal command (closed form), with pump ripple;
vibration, tilt and their scatter from machine to machine follow fixed distributions, drawn from a seed.
Support axes: x across, y along the push, z up. All arrays are sampled at `RATE_HZ`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

RATE_HZ = 819.2
GRAVITY = 9.80665  # m/s^2
STROKE_LIMIT_M = 0.6  # no move is longer
FloatArray = NDArray[np.float64]
Range = tuple[float, float]


@dataclass(frozen=True)
class BurstSpread:
    """Range of burst shapes: second-order response to a ramp of the command."""

    frequency_hz: Range
    damping: Range
    ramp_s: Range

    def draw(self, rng: np.random.Generator) -> _Burst:
        """One machine's own shape."""
        return _Burst(rng.uniform(*self.frequency_hz), rng.uniform(*self.damping), rng.uniform(*self.ramp_s))


@dataclass(frozen=True)
class Scenario:
    """Distributions from which a virtual machine and its moves are drawn."""

    start: BurstSpread = BurstSpread((5, 9), (0.10, 0.25), (0.05, 0.12))
    hard_stop: BurstSpread = BurstSpread((7, 13), (0.10, 0.25), (0.03, 0.06))
    valve_ramp_s: Range = (0.06, 0.15)  # a stop by the valve is softer than one at the end of the stroke
    vibration_m_s2: Range = (0.05, 0.30)
    vibration_at_rest: float = 0.12  # share of the moving level
    vibration_band_hz: Range = (5.0, 60.0)
    tilt_deg: Range = (0.05, 0.30)
    tilt_step_deg: float = 0.04
    speed_sigma_machine: float = 0.02
    speed_sigma_cycle: float = 0.015
    ripple: float = 0.008  # slow part, share of the speed
    ripple_time_s: float = 3.0
    ripple_tone: Range = (0.003, 0.010)  # amplitude, share of the speed
    ripple_tone_hz: Range = (4.0, 9.0)
    end_stop_sigma_m: float = 0.0005
    temperature_rise_c: float = 0.5
    felt: Literal["both", "push", "retract"] = "both"  # moves in which the sensor's carrier moves
    dips_per_s: float = 0.0  # of the speed, when the pump falters
    dip_depth: Range = (0.3, 0.7)
    dip_s: Range = (0.15, 0.45)
    creep_m_s: float = 0.0  # of a resting ram whose valve leaks: largest speed
    blows_per_s: float = 0.0  # against the resting support
    blow_m_s: Range = (0.01, 0.05)  # largest speed of the carrier after a blow
    leans_per_s: float = 0.0  # a neighbour tilts the resting support
    lean_deg: float = 0.3
    switches_per_s: float = 0.0  # a machine nearby starts or stops: the vibration at rest changes
    switched_on: float = 1.0  # share of the moving level while it runs


@dataclass(frozen=True)
class PlannedMove:
    """One move of a script: rest before it, where it goes, at which nominal speed, and what ends it."""

    rest_before_s: float
    target_m: float
    speed_m_s: float
    hard_stop: bool = True


def full_cycle(
    stroke_m: float = 0.5, push_m_s: float = 0.01453, retract_m_s: float = 0.03519, rest_s: float = 10.0
) -> Script:
    """Rest (10 s), full push, rest 20 s, full retract."""
    return (PlannedMove(rest_s, stroke_m, push_m_s), PlannedMove(20.0, 0.0, retract_m_s))


Script = tuple[PlannedMove, ...]


@dataclass(frozen=True)
class TrueMove:
    """What really happened: times in seconds of the script's clock, positions in metres."""

    onset_s: float
    stop_s: float  # start of deceleration
    start_m: float
    end_m: float
    speed_m_s: float  # signed mean speed before ripple


@dataclass(frozen=True)
class Trajectory:
    """Truth of one script, arrays of n samples: times (n,), vectors (n, 3)."""

    t_s: FloatArray
    displacement_m: FloatArray
    velocity_m_s: FloatArray
    accel_m_s2: FloatArray  # specific force, support axes
    gyro_rad_s: FloatArray
    temperature_c: FloatArray
    moves: tuple[TrueMove, ...]


@dataclass(frozen=True)
class _Burst:
    """Second-order response of the ram speed to a ramp of the command."""

    frequency_hz: float
    damping: float
    ramp_s: float

    def scattered(self, rng: np.random.Generator) -> _Burst:
        f, z, r = np.exp(rng.normal(0.0, 0.05, 3))
        return _Burst(self.frequency_hz * f, min(self.damping * z, 0.97), self.ramp_s * r)

    @property
    def lag_s(self) -> float:
        """Delay of the response's area behind a step at time zero."""
        return self.ramp_s / 2 + 2 * self.damping / (2 * np.pi * self.frequency_hz)

    def response(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Value and derivative [1/s] of the unit response at times after its start."""
        y0, dy0 = self._to_ramp(t_s)
        y1, dy1 = self._to_ramp(t_s - self.ramp_s)
        return (y0 - y1) / self.ramp_s, (dy0 - dy1) / self.ramp_s

    def _to_ramp(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Response to the ramp `t` and its derivative, zero before the start."""
        w, z = 2 * np.pi * self.frequency_hz, self.damping
        wd = w * np.sqrt(1 - z * z)
        t = np.maximum(t_s, 0.0)
        decay = np.exp(-z * w * t)
        sine, cosine = np.sin(wd * t), np.cos(wd * t)
        value = t - 2 * z / w + decay * (2 * z / w * cosine + (2 * z * z - 1) / wd * sine)
        slope = 1 - decay * (cosine + z * w / wd * sine)
        return value, np.where(t_s > 0, slope, 0.0)


@dataclass(frozen=True)
class _PlayedMove:
    """A move with everything that shapes it."""

    truth: TrueMove
    start: _Burst
    stop: _Burst

    def kinematics(self, t_s: FloatArray, ripple: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Velocity and acceleration of this move alone."""
        up, up_slope = self.start.response(t_s - self.truth.onset_s)
        down, down_slope = self.stop.response(t_s - self.truth.stop_s)
        rippled = self.truth.speed_m_s * ripple * np.clip(up, 0, 1) * np.clip(1 - down, 0, 1)
        velocity = self.truth.speed_m_s * (up - down) + rippled
        return velocity, self.truth.speed_m_s * (up_slope - down_slope) + np.gradient(rippled, t_s)

    def activity(self, t_s: FloatArray) -> FloatArray:
        """1 while the ram moves, dying out over about 0.3 s behind it: what the vibration follows."""
        begun = np.clip((t_s - self.truth.onset_s) / 0.05, 0, 1)
        return np.asarray(begun * np.exp(-np.maximum(t_s - self.truth.stop_s, 0) / 0.15))


@dataclass
class Machine:
    """One virtual support, drawn from a scenario; carries position and tilt from script to script."""

    rng: np.random.Generator
    scenario: Scenario = field(default_factory=Scenario)
    position_m: float = 0.0

    def __post_init__(self) -> None:
        uniform, scenario = self.rng.uniform, self.scenario
        self.start = scenario.start.draw(self.rng)
        self.hard_stop = scenario.hard_stop.draw(self.rng)
        self.valve_stop = replace(
            self.hard_stop,
            frequency_hz=0.8 * self.hard_stop.frequency_hz,
            ramp_s=uniform(*scenario.valve_ramp_s),
        )
        self.speed_factor = self.rng.normal(1.0, scenario.speed_sigma_machine)
        self.vibration_m_s2 = uniform(*scenario.vibration_m_s2)
        self.tilt_rad = np.radians(uniform(*scenario.tilt_deg))
        self.ripple = (uniform(*scenario.ripple_tone), uniform(*scenario.ripple_tone_hz))  # amplitude, Hz
        self.temperature_c = 25.0
        self._tilt_now = np.zeros(2)  # pitch, roll [rad]

    def play(self, scripts: Iterable[Script], rest_after_s: float = 0.0) -> Iterator[Trajectory]:
        """One script after the other."""
        for script in scripts:
            yield self.trajectory(script, rest_after_s)

    def trajectory(self, script: Script, rest_after_s: float = 10.0) -> Trajectory:
        """Play one script from the present position; its clock starts at zero."""
        longest_s = sum(m.rest_before_s + 1.2 * STROKE_LIMIT_M / m.speed_m_s + 2.0 for m in script)
        ripple = self._ripple(np.arange(int((longest_s + rest_after_s) * RATE_HZ)) / RATE_HZ)
        played, now, position = [], 0.0, self.position_m
        for planned in script:
            move = self._play(planned, now + planned.rest_before_s, position, ripple)
            played.append(move)
            now, position = move.truth.stop_s + 1.0, move.truth.end_m
        t_s = np.arange(int((now + rest_after_s) * RATE_HZ)) / RATE_HZ

        velocity, accel, moving, resting = np.zeros_like(t_s), np.zeros_like(t_s), np.zeros_like(t_s), np.ones_like(t_s)
        for move in played:
            move_velocity, move_accel = move.kinematics(t_s, ripple[: len(t_s)])
            velocity += move_velocity
            resting = np.minimum(resting, 1 - move.activity(t_s))
            if self._is_felt(move.truth):
                accel += move_accel
                moving = np.maximum(moving, move.activity(t_s))
        velocity += self._creep(t_s, resting)
        displacement = self.position_m + np.concatenate(
            ([0.0], np.cumsum((velocity[1:] + velocity[:-1]) / (2 * RATE_HZ)))
        )
        moves = tuple(move.truth for move in played)
        self.position_m = float(displacement[-1]) if self.scenario.creep_m_s else position

        felt = [move for move in moves if self._is_felt(move)]
        pitch, roll = self._tilt(t_s, moving > 0.5, [t for move in felt for t in (move.onset_s, move.stop_s)])
        pitch = pitch + self._leaning(t_s, resting)
        vibration = self._vibration(t_s, moving)
        vibration[:, 1] += self._blows(t_s, resting)
        inertial = np.column_stack([np.zeros_like(accel), accel, np.zeros_like(accel)]) + vibration
        return Trajectory(
            t_s=t_s,
            displacement_m=displacement,
            velocity_m_s=velocity,
            accel_m_s2=_specific_force(inertial, pitch, roll),
            gyro_rad_s=np.column_stack([np.gradient(pitch, t_s), np.gradient(roll, t_s), np.zeros_like(t_s)]),
            temperature_c=self.temperature_c + self.scenario.temperature_rise_c * t_s / max(t_s[-1], 1.0),
            moves=moves,
        )

    def _play(self, planned: PlannedMove, onset_s: float, position_m: float, ripple: FloatArray) -> _PlayedMove:
        """Draw one move and find the start of deceleration that ends it at its target."""
        speed = np.copysign(planned.speed_m_s, planned.target_m - position_m) * self.speed_factor
        speed *= self.rng.normal(1.0, self.scenario.speed_sigma_cycle)
        end = planned.target_m
        if planned.hard_stop:
            end += self.rng.normal(0.0, self.scenario.end_stop_sigma_m)
        start = self.start.scattered(self.rng)
        stop = (self.hard_stop if planned.hard_stop else self.valve_stop).scattered(self.rng)

        t_s = np.arange(len(ripple)) / RATE_HZ
        endless = _PlayedMove(TrueMove(onset_s, np.inf, position_m, end, speed), start, stop)
        velocity, _ = endless.kinematics(t_s, ripple)
        travelled = np.cumsum(velocity) / RATE_HZ
        braking = speed * stop.lag_s
        stop_s = float(np.interp(abs(end - position_m - braking), np.abs(travelled), t_s))
        return _PlayedMove(TrueMove(onset_s, stop_s, position_m, end, float(speed)), start, stop)

    def _ripple(self, t_s: FloatArray) -> FloatArray:
        """Pump ripple as a share of the speed: 0.8 % wandering over 3 s, and a tone."""
        amplitude, hertz = self.ripple
        tone = amplitude * np.sin(2 * np.pi * hertz * t_s + self.rng.uniform(0, 2 * np.pi))
        slow = self.scenario.ripple * _wander(self.rng, t_s, self.scenario.ripple_time_s)
        return slow + tone + self._dips(t_s)

    def _dips(self, t_s: FloatArray) -> FloatArray:
        """Moments in which the pump gives less, as a share of the speed."""
        dips = np.zeros_like(t_s)
        for begin_s in self._times(t_s, self.scenario.dips_per_s):
            depth, length_s = self.rng.uniform(*self.scenario.dip_depth), self.rng.uniform(*self.scenario.dip_s)
            edge = np.clip(np.minimum(t_s - begin_s, begin_s + length_s - t_s) / 0.1, 0.0, 1.0)
            dips -= depth * np.sin(0.5 * np.pi * edge) ** 2
        return np.maximum(dips, -0.9)

    def _times(self, t_s: FloatArray, per_s: float) -> list[float]:
        """Moments of a Poisson process."""
        if not per_s:
            return []  # draws nothing, so that one scenario's seeds stay what they were
        span_s = float(t_s[-1] - t_s[0])
        return sorted(self.rng.uniform(t_s[0], t_s[-1], self.rng.poisson(per_s * span_s)).tolist())

    def _is_felt(self, move: TrueMove) -> bool:
        """Does the part of the support that carries the sensor move?"""
        return self.scenario.felt in ("both", "push" if move.speed_m_s > 0 else "retract")

    def _creep(self, t_s: FloatArray, resting: FloatArray) -> FloatArray:
        if not self.scenario.creep_m_s:
            return np.zeros_like(t_s)
        return np.asarray(resting * self.rng.uniform(-1.0, 1.0) * self.scenario.creep_m_s)

    def _leaning(self, t_s: FloatArray, resting: FloatArray) -> FloatArray:
        """Pitch [rad] that a neighbour gives the resting support."""
        angle = np.zeros_like(t_s)
        for begin_s in self._times(t_s, self.scenario.leans_per_s):
            if resting[int((begin_s - t_s[0]) * RATE_HZ)] > 0.99:
                step = np.radians(self.rng.normal(0.0, self.scenario.lean_deg))
                angle += step * (1 - np.exp(-np.maximum(t_s - begin_s, 0.0) / 0.5))
        return angle

    def _blows(self, t_s: FloatArray, resting: FloatArray) -> FloatArray:
        """Acceleration of the carrier after blows: it swings and comes to rest where it was."""
        accel = np.zeros_like(t_s)
        for begin_s in self._times(t_s, self.scenario.blows_per_s):
            if resting[int((begin_s - t_s[0]) * RATE_HZ)] > 0.99:
                peak, hertz = self.rng.uniform(*self.scenario.blow_m_s), self.rng.uniform(3.0, 12.0)
                since = np.maximum(t_s - begin_s, 0.0)
                swing = np.sin(2 * np.pi * hertz * since) * np.exp(-since / 0.15)
                accel += self.rng.choice([-1.0, 1.0]) * peak * np.gradient(swing, t_s)
        return accel

    def _vibration(self, t_s: FloatArray, moving: FloatArray) -> FloatArray:
        rest: float | FloatArray = self.scenario.vibration_at_rest
        if switches := self._times(t_s, self.scenario.switches_per_s):
            on = np.searchsorted(switches, t_s) % 2 == 1
            rest = np.where(on, self.scenario.switched_on, rest)
        level = self.vibration_m_s2 * (rest + (1 - rest) * moving)
        level = level * np.exp(0.3 * _wander(self.rng, t_s, 1.0))
        band = _band_noise(self.rng, len(t_s), 3, self.scenario.vibration_band_hz)
        return np.asarray(band * level[:, None] * np.array([0.7, 1.0, 0.9]))

    def _tilt(self, t_s: FloatArray, moving: NDArray[np.bool_], changes: list[float]) -> tuple[FloatArray, FloatArray]:
        """Pitch and roll [rad]: wander while moving, a small step at each start and stop, fast flutter."""
        angles = []
        flutter = _band_noise(self.rng, len(t_s), 2, (5.0, 40.0)) * np.radians(0.003)
        moving_s = np.cumsum(moving) / RATE_HZ  # the wander's own clock stands still at rest
        clock = np.arange(0.0, moving_s[-1] + 2.0, 1 / RATE_HZ)
        for axis in range(2):
            wander = self.tilt_rad * _low_pass(_wander(self.rng, clock, 5.0), 1.0)
            angle = self._tilt_now[axis] + np.interp(moving_s, clock, wander - wander[0])
            for change in changes:
                step = np.radians(self.rng.normal(0.0, self.scenario.tilt_step_deg))
                angle = angle + step * (1 - np.exp(-np.maximum(t_s - change, 0.0) / 0.15))
            self._tilt_now[axis] = angle[-1]
            angles.append(angle + flutter[:, axis])
        return angles[0], angles[1]


def _specific_force(inertial: FloatArray, pitch: FloatArray, roll: FloatArray) -> FloatArray:
    """Acceleration (n, 3) plus gravity as felt in axes turned by pitch about x, then roll about y."""
    fx, fy, fz = inertial[:, 0], inertial[:, 1], inertial[:, 2] + GRAVITY
    fy, fz = fy * np.cos(pitch) + fz * np.sin(pitch), fz * np.cos(pitch) - fy * np.sin(pitch)
    fx, fz = fx * np.cos(roll) - fz * np.sin(roll), fz * np.cos(roll) + fx * np.sin(roll)
    return np.column_stack([fx, fy, fz])


def _wander(rng: np.random.Generator, t_s: FloatArray, tau_s: float) -> FloatArray:
    """Unit-variance Ornstein-Uhlenbeck process, exact on knots 1/50 of its time constant apart."""
    step = tau_s / 50
    n = int((t_s[-1] - t_s[0]) / step) + 2
    keep = np.exp(-step / tau_s)
    kicks = rng.normal(0.0, np.sqrt(1 - keep * keep), n)
    knots = np.empty(n)
    value = rng.normal()
    for i in range(n):
        knots[i] = value
        value = keep * value + kicks[i]
    return np.asarray(np.interp(t_s - t_s[0], np.arange(n) * step, knots))


def _low_pass(x: FloatArray, corner_hz: float) -> FloatArray:
    """First-order low-pass as a truncated exponential kernel."""
    n = int(RATE_HZ * 5 / (2 * np.pi * corner_hz))
    kernel = np.exp(-2 * np.pi * corner_hz * np.arange(n) / RATE_HZ)
    padded = np.concatenate([np.full(n - 1, x[0]), x])
    size = 1 << int(np.ceil(np.log2(len(padded) + n)))
    product = np.fft.rfft(padded, size) * np.fft.rfft(kernel / kernel.sum(), size)
    return np.asarray(np.fft.irfft(product, size)[n - 1 : n - 1 + len(x)])


def _band_noise(rng: np.random.Generator, n: int, columns: int, band_hz: Range) -> FloatArray:
    """Unit-variance Gaussian noise (n, columns) in a band, by cutting its spectrum."""
    size = 1 << max(int(np.ceil(np.log2(max(n, 2)))), 1)
    frequency = np.fft.rfftfreq(size, 1 / RATE_HZ)
    spectrum = np.fft.rfft(rng.normal(size=(size, columns)), axis=0)
    inside = (frequency >= band_hz[0]) & (frequency <= band_hz[1])
    spectrum[~inside] = 0.0
    share = inside.sum() / len(frequency)
    return np.asarray(np.fft.irfft(spectrum, size, axis=0)[:n] / np.sqrt(share))
