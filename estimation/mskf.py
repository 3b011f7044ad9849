"""Streaming multi-segmental Kalman filter: one Gaussian, one model a segment (paper C, eq. (14)-(18), corrected).

    ZUPT   rest: v = 0, the displacement stays
    VVM    start and stop bursts: v' = a - b, levelled by the gyro
    CVM    between them: v wanders closely around V, the acceleration tells only b
    free   none of these is known to hold: v is whatever acceleration and the displacement sensor say

States: displacement p [m], velocity v [m/s], the move's constant velocity V [m/s], acceleration error b [m/s^2] (tilt
and bias), and scale s, offset o [m], bow c [m] of the observed displacement y = (1 + s) p + o + 4 c p (L - p) / L^2.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from math import exp, hypot, sqrt

from estimation.gaussian import Gaussian
from estimation.kernels import ACCEL_NOISE, GYRO_WALK

STATES = 7
P, V, SPEED, B, SCALE, OFFSET, BOW = range(STATES)

CREEP_M = 1e-5  # per sqrt(s) at rest
LEVEL_DRIFT_M_S2 = 3e-4  # of the rest level, beside its averaged noise
SPEED_WANDER = 0.01  # of V, around it, in the constant-velocity segment
SPEED_WANDER_S = 2.5
UNWATCHED_SPEED_M_S = 0.005  # a move seldom begins in just a gap
STOPPED_SIGMA_M_S = 0.0007
VIBRATION_VELOCITY_S = 0.0092  # velocity of the vibration per rms of its acceleration
FREE_LEVEL_M_S2 = 0.3
FREE_SPEED_MEMORY_S = 2.0
FREE_ACCEL_NOISE = 0.05  # m/s^2/sqrt(Hz), of an unexplained motion
BLIND_ACCEL_NOISE = 0.06  # the same without an inertial sensor: follows a ram's start within 0.3 s


class Model(StrEnum):
    """Model in use."""

    ZUPT = "ZUPT"
    VVM = "VVM"
    CVM = "CVM"
    FREE = "free"


@dataclass(slots=True)
class Filter:
    """The Gaussian state with the moves it can make."""

    state: Gaussian
    stroke_m: float

    def __post_init__(self) -> None:
        if len(self.state.x) != STATES:
            raise ValueError(f"the filter has {STATES} states, not {len(self.state.x)}")

    @classmethod
    def start(
        cls,
        p_m: float,
        p_sigma_m: float,
        scale_sigma: float,
        offset_sigma_m: float,
        bow_sigma_m: float,
        stroke_m: float,
        scale: float = 0.0,
    ) -> Filter:
        """At rest, with what is assumed of the displacement sensor."""
        sigma = [p_sigma_m, 0.0, 0.0, 0.0, scale_sigma, offset_sigma_m, bow_sigma_m]
        return cls(Gaussian.diagonal([p_m, 0.0, 0.0, 0.0, scale, 0.0, 0.0], sigma), stroke_m)

    def copy(self) -> Filter:
        """Independent copy."""
        return Filter(self.state.copy(), self.stroke_m)

    # --- one step of each model -------------------------------------------------------------------------------

    def rest(self, dt_s: float, level_variance: float) -> None:
        """ZUPT: at rest the level is what the accelerometer says, b only its uncertainty."""
        g = self.state
        if g.x[V] != 0.0 or g.p[V][V] != 0.0:
            g.reset(V, 0.0, 0.0)
        g.reset(B, 0.0, level_variance)
        g.diffuse(P, CREEP_M**2 * dt_s)

    def begin_move(self, speed_m_s: float, speed_sigma_m_s: float) -> None:
        """Leave rest: V is what this direction usually makes."""
        self.state.reset(SPEED, speed_m_s, speed_sigma_m_s**2)

    def burst(self, dt_s: float, acceleration_m_s2: float) -> None:
        """VVM: integrate the levelled acceleration."""
        self._integrate(dt_s, acceleration_m_s2, ACCEL_NOISE)
        self.state.diffuse(B, GYRO_WALK**2 * dt_s)

    def speed_reached(self, vibration_m_s2: float) -> None:
        """Pseudo-measurement v = V late in the start burst; v carries the real velocity of the vibration."""
        g = self.state
        variance = (VIBRATION_VELOCITY_S * vibration_m_s2) ** 2 + (SPEED_WANDER * g.x[SPEED]) ** 2
        g.measure(((V, 1.0), (SPEED, -1.0)), g.x[SPEED] - g.x[V], variance)

    def enter_cruise(self) -> None:
        """v := V + ripple: what v holds of the vibration must not be carried through the segment."""
        self.state.replace(V, SPEED, (SPEED_WANDER * self.state.x[SPEED]) ** 2)

    def cruise(self, dt_s: float, acceleration_m_s2: float, vibration_m_s2: float) -> None:
        """CVM: v is an Ornstein-Uhlenbeck process around V; the acceleration measures b alone."""
        self.cruise_unwatched(dt_s)
        g = self.state
        g.diffuse(B, GYRO_WALK**2 * dt_s)
        variance = ACCEL_NOISE**2 / dt_s + (0.3 * vibration_m_s2) ** 2
        g.measure(((B, 1.0),), acceleration_m_s2 - g.x[B], variance)

    def cruise_unwatched(self, dt_s: float) -> None:
        """CVM without an acceleration."""
        g = self.state
        g.add(P, V, dt_s)
        keep = exp(-dt_s / SPEED_WANDER_S)
        g.scale(V, keep)
        g.add(V, SPEED, 1.0 - keep)
        g.diffuse(V, (SPEED_WANDER * g.x[SPEED]) ** 2 * (1.0 - keep * keep))

    def rest_unwatched(self, dt_s: float) -> None:
        """ZUPT through a short gap: had a move begun in it, this is how far it might have come."""
        self.state.diffuse(P, (UNWATCHED_SPEED_M_S * dt_s) ** 2)

    def stopped(self, vibration_m_s2: float) -> None:
        """v = 0 at the end of the stop burst; through its covariance this corrects V and p over the whole move."""
        g = self.state
        variance = STOPPED_SIGMA_M_S**2 + (VIBRATION_VELOCITY_S * vibration_m_s2) ** 2
        g.measure(((V, 1.0),), -g.x[V], variance)

    def begin_free(self) -> None:
        """An unexplained motion may tilt the sensor by degrees: the level is lost."""
        self.state.diffuse(B, FREE_LEVEL_M_S2**2)

    def free(self, dt_s: float, acceleration_m_s2: float, vibration_m_s2: float) -> None:
        """No model holds: integrate with great doubt, the shaking taken for white, and forget the speed in seconds."""
        noise = hypot(FREE_ACCEL_NOISE, vibration_m_s2 * sqrt(dt_s))
        self._integrate(dt_s, acceleration_m_s2, noise)
        self.state.scale(V, exp(-dt_s / FREE_SPEED_MEMORY_S))
        self._admit_ignorance()

    def blind(self, dt_s: float) -> None:
        """No inertial sensor: v wanders freely, the displacement sensor leads."""
        g = self.state
        dt_s = min(dt_s, 10.0)  # longer makes nothing more unknown than it is
        g.add(P, V, dt_s)
        q = BLIND_ACCEL_NOISE**2
        g.diffuse(P, q * dt_s**3 / 3.0)
        g.diffuse(V, q * dt_s)
        g.scale(V, exp(-dt_s / FREE_SPEED_MEMORY_S))
        self._admit_ignorance()

    def lose_place(self) -> None:
        """The displacement may be anything."""
        self.state.reset(P, 0.5 * self.stroke_m, self.stroke_m**2)

    def _integrate(self, dt_s: float, acceleration_m_s2: float, noise: float) -> None:
        g = self.state
        g.add(P, V, dt_s)
        g.add(P, B, -0.5 * dt_s * dt_s)
        g.x[P] += 0.5 * dt_s * dt_s * acceleration_m_s2
        g.add(V, B, -dt_s)
        g.x[V] += dt_s * acceleration_m_s2
        g.diffuse(V, noise**2 * dt_s)

    # --- measurements -----------------------------------------------------------------------------------------

    def displacement_prediction(self, lag_s: float) -> tuple[float, tuple[tuple[int, float], ...]]:
        """What the displacement sensor should say of the moment `lag_s` ago, and its sensitivity to the state."""
        x, stroke = self.state.x, self.stroke_m
        p = x[P] - lag_s * x[V]
        bow = 4.0 * p * (stroke - p) / stroke**2
        slope = 1.0 + x[SCALE] + 4.0 * x[BOW] * (stroke - 2.0 * p) / stroke**2
        predicted = (1.0 + x[SCALE]) * p + x[OFFSET] + x[BOW] * bow
        return predicted, ((P, slope), (V, -slope * lag_s), (SCALE, p), (OFFSET, 1.0), (BOW, bow))

    def at_stop(self, stop_m: float, sigma_m: float) -> None:
        """The piston stands at a mechanical stop."""
        g = self.state
        g.measure(((P, 1.0),), stop_m - g.x[P], sigma_m**2)

    def _admit_ignorance(self) -> None:
        """A doubt beyond half a stroke: nothing is known, not even that the sensor still sits on the ram."""
        if self.state.sigma(P) > 0.5 * self.stroke_m:
            self.lose_place()
