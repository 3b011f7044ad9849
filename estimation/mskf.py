"""Streaming multi-segmental Kalman filter: one Gaussian, one model a segment (paper C, eq. (14)-(18), corrected).

    ZUPT   rest: v = 0, the displacement stays
    VVM    start and stop bursts: v' = a - b, levelled by the gyro
    CVM    between them: v wanders closely around V, the acceleration tells only b
    free   none of these is known to hold: v is whatever acceleration and the displacement sensor say

States: displacement p [m], velocity v [m/s], the move's constant velocity V [m/s], acceleration error b [m/s^2] (tilt
and bias); scale s, offset o [m], bow c [m] and latency d [s] (beyond the configured one) of the observed displacement
y(t) = (1 + s) p + o + 4 c p (L - p) / L^2 with p = p(t - d); and the usual speeds of push and retract [m/s], from which
V of each move scatters. They are states because everything that tells V tells them, too.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from math import exp, hypot, sqrt

from estimation.gaussian import Gaussian
from estimation.noise import ACCEL_NOISE, GYRO_WALK
from estimation.settings import EstimatorSettings, SupportSettings

STATES = 10
P, V, SPEED, B, SCALE, OFFSET, BOW, LATENCY, PUSH_FLOW, RETRACT_FLOW = range(STATES)
SENSOR = (SCALE, OFFSET, BOW, LATENCY)
LEARNED = (*SENSOR, PUSH_FLOW, RETRACT_FLOW)  # what outlasts a move

FLOW_CORRELATION = 0.9  # of the two directions' usual speeds
CREEP_M = 1e-5  # per sqrt(s) at rest
LEVEL_DRIFT_M_S2 = 3e-4  # of the rest level, beside its averaged noise
SPEED_WANDER_S = 2.5
UNWATCHED_SPEED_M_S = 0.005  # a move seldom begins in just a gap
STOPPED_SIGMA_M_S = 0.0007
VIBRATION_VELOCITY_S = 0.0092  # velocity of the vibration per rms of its acceleration
FREE_LEVEL_M_S2 = 0.3
FREE_SPEED_MEMORY_S = 2.0
FREE_ACCEL_NOISE = 0.05  # m/s^2/sqrt(Hz), of an unexplained motion
BLIND_ACCEL_NOISE = 0.06  # the same without an inertial sensor: follows a ram's start within 0.3 s


_OUTLASTING = (SPEED, *LEARNED)


def flow_state(direction: int) -> int:
    """The state that holds a direction's usual speed."""
    return PUSH_FLOW if direction > 0 else RETRACT_FLOW


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
    speed_wander: float = 0.01  # of V, around it, in the constant-velocity segment

    def __post_init__(self) -> None:
        if len(self.state.x) != STATES:
            raise ValueError(f"the filter has {STATES} states, not {len(self.state.x)}")

    @classmethod
    def start(cls, p_m: float, p_sigma_m: float, support: SupportSettings, settings: EstimatorSettings) -> Filter:
        """At rest, with what is assumed of the displacement sensor and of the flow."""
        push, retract = support.nominal_push_speed_mm_s / 1e3, support.nominal_retract_speed_mm_s / 1e3
        doubt = settings.speed_sigma_machine
        mean = [p_m, 0.0, 0.0, 0.0, settings.can_scale, 0.0, 0.0, 0.0, push, retract]
        sigma = [
            p_sigma_m,
            0.0,
            0.0,
            0.0,
            settings.can_scale_sigma,
            settings.can_offset_sigma_mm / 1e3,
            settings.can_curvature_sigma_mm / 1e3,
            settings.can_latency_sigma_ms / 1e3,
            doubt * push,
            doubt * retract,
        ]
        state = Gaussian.diagonal(mean, sigma)
        # One pump feeds both directions; the cylinder's areas, and with them the ratio of the speeds, are known well.
        both = FLOW_CORRELATION * sigma[PUSH_FLOW] * sigma[RETRACT_FLOW]
        state.p[PUSH_FLOW][RETRACT_FLOW] = state.p[RETRACT_FLOW][PUSH_FLOW] = both
        return cls(state, support.stroke_mm / 1e3, settings.speed_wander)

    def copy(self) -> Filter:
        """Independent copy."""
        return Filter(self.state.copy(), self.stroke_m, self.speed_wander)

    # --- one step of each model -------------------------------------------------------------------------------

    def rest(self, dt_s: float, level_variance: float) -> None:
        """ZUPT: at rest the level is what the accelerometer says, b only its uncertainty."""
        g = self.state
        if g.x[V] != 0.0 or g.p[V][V] != 0.0:
            g.reset(V, 0.0, 0.0)
        if g.x[B] != 0.0 or g.p[B][P] != 0.0:
            g.reset(B, 0.0, level_variance)
        g.p[B][B] = level_variance
        g.diffuse(P, CREEP_M**2 * dt_s)

    def begin_move(self, direction: int, cycle_share: float) -> None:
        """Leave rest: V scatters by `cycle_share` around what this direction usually makes."""
        flow = flow_state(direction)
        self.state.reset(SPEED, 0.0, (cycle_share * self.state.x[flow]) ** 2)
        self.state.add(SPEED, flow, float(direction))

    def catch_up(self, late_s: float) -> None:
        """The move has gone on for so long already, unnoticed."""
        self.state.add(P, SPEED, late_s)

    def lose_way(self, direction: int) -> None:
        """A move of unknown length has ended: anywhere between here and its mechanical stop."""
        g = self.state
        stop_m = self.stroke_m if direction > 0 else 0.0
        way_m = stop_m - g.x[P]
        g.reset(P, g.x[P] + 0.5 * way_m, g.p[P][P] + way_m**2 / 12.0)

    def hear_burst(self, speed_m_s: float, sigma_m_s: float) -> None:
        """The size of a start or stop burst is a measurement of V."""
        g = self.state
        g.measure(((SPEED, 1.0),), speed_m_s - g.x[SPEED], sigma_m_s**2)

    def begin_burst(self, vibration_m_s2: float) -> None:
        """From here on v holds the velocity of the vibration, too, less what it is just now."""
        self.state.diffuse(V, (VIBRATION_VELOCITY_S * vibration_m_s2) ** 2)

    def burst(self, dt_s: float, acceleration_m_s2: float) -> None:
        """VVM: integrate the levelled acceleration."""
        self._integrate(dt_s, acceleration_m_s2, ACCEL_NOISE)
        self.state.diffuse(B, GYRO_WALK**2 * dt_s)

    def speed_reached(self, vibration_m_s2: float) -> None:
        """Pseudo-measurement v = V late in the start burst; v carries the real velocity of the vibration.

        It corrects the path through the burst. Of V it tells nothing new: the burst as a whole is heard later.
        """
        g = self.state
        variance = (VIBRATION_VELOCITY_S * vibration_m_s2) ** 2 + (self.speed_wander * g.x[SPEED]) ** 2
        g.measure(((V, 1.0), (SPEED, -1.0)), g.x[SPEED] - g.x[V], variance, hold=_OUTLASTING)

    def enter_cruise(self) -> None:
        """v := V + ripple: what v holds of the vibration must not be carried through the segment."""
        g = self.state
        g.replace(V, SPEED, (self.speed_wander * g.x[SPEED]) ** 2)
        g.reset(B, g.x[B], g.p[B][B])

    def cruise(self, dt_s: float, acceleration_m_s2: float, vibration_m_s2: float) -> None:
        """CVM: v is an Ornstein-Uhlenbeck process around V; the acceleration measures b alone.

        b is a scalar filter of its own here: what it shares with the other states no longer matters.
        """
        self.cruise_unwatched(dt_s)
        g = self.state
        variance = ACCEL_NOISE**2 / dt_s + (0.3 * vibration_m_s2) ** 2
        predicted = g.p[B][B] + GYRO_WALK**2 * dt_s
        gain = predicted / (predicted + variance)
        g.x[B] += gain * (acceleration_m_s2 - g.x[B])
        g.p[B][B] = (1.0 - gain) * predicted

    def cruise_unwatched(self, dt_s: float) -> None:
        """CVM without an acceleration."""
        g = self.state
        g.add(P, V, dt_s)
        keep = exp(-dt_s / SPEED_WANDER_S)
        g.scale(V, keep)
        g.add(V, SPEED, 1.0 - keep)
        g.diffuse(V, (self.speed_wander * g.x[SPEED]) ** 2 * (1.0 - keep * keep))

    def rest_unwatched(self, dt_s: float) -> None:
        """ZUPT through a short gap: had a move begun in it, this is how far it might have come."""
        self.state.diffuse(P, (UNWATCHED_SPEED_M_S * dt_s) ** 2)

    def stopped(self, vibration_m_s2: float, ringing_m_s: float = 0.0) -> None:
        """v = 0 after the stop corrects the path through its burst; V has been told by the burst as a whole."""
        g = self.state
        variance = STOPPED_SIGMA_M_S**2 + (VIBRATION_VELOCITY_S * vibration_m_s2) ** 2 + ringing_m_s**2
        g.measure(((V, 1.0),), -g.x[V], variance, hold=_OUTLASTING)

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
        lag_s += x[LATENCY]
        p = x[P] - lag_s * x[V]
        bow = 4.0 * p * (stroke - p) / stroke**2
        slope = 1.0 + x[SCALE] + 4.0 * x[BOW] * (stroke - 2.0 * p) / stroke**2
        predicted = (1.0 + x[SCALE]) * p + x[OFFSET] + x[BOW] * bow
        return predicted, (
            (P, slope),
            (V, -slope * lag_s),
            (SCALE, p),
            (OFFSET, 1.0),
            (BOW, bow),
            (LATENCY, -slope * x[V]),
        )

    def at_stop(self, stop_m: float, sigma_m: float) -> None:
        """The piston stands at a mechanical stop."""
        g = self.state
        g.measure(((P, 1.0),), stop_m - g.x[P], sigma_m**2)

    def _admit_ignorance(self) -> None:
        """A doubt beyond half a stroke: nothing is known, not even that the sensor still sits on the ram."""
        if self.state.sigma(P) > 0.5 * self.stroke_m:
            self.lose_place()
