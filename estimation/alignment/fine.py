"""Fine alignment of a resting sensor: strapdown navigation corrected by a ten-state Kalman filter (paper B, eq. 26-35).

    x = [dv_E dv_N  phi_E phi_N phi_U  na_E na_N  ep_E ep_N ep_U]

velocity errors, misalignment (computed = (I - [phi x]) true), biases of accelerometers and gyroscopes in east-north-up.
The computed velocity of a sensor at rest is its error, eq. (34). Attitude and velocity are corrected once a second: an
uncorrected misalignment grows beyond what first order describes. Of the ten states seven can be observed; na_E, na_N
and ep_E, with them level and heading, stay as the sensor's biases leave them.

The covariance depends on time, place, grade, priors and process noise alone, so one filter serves a thousand runs at
once; runs whose process noises differ (`noise`) have a covariance each.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import tan

import numpy as np

from estimation.alignment.attitude import rotation
from estimation.alignment.earth import Place
from estimation.alignment.mechanisation import Strapdown
from estimation.alignment.sensor import SensorGrade
from estimation.arrays import FloatArray

STATES = 10
DV, PHI, NA, EP = slice(0, 2), slice(2, 5), slice(5, 7), slice(7, 10)
H = np.eye(2, STATES)  # (34)
FEEDBACK_S = 1.0


@dataclass(frozen=True)
class Prior:
    """One sigma, before the first sample."""

    level: float  # rad
    heading: float  # rad
    velocity: float = 1e-6  # m/s; it begins at rest


def error_dynamics(place: Place) -> FloatArray:
    """F (10, 10) of x' = F x + w, at rest."""
    north, up = place.rate_north_up
    g, r = place.gravity_m_s2, place.mean_radius_m
    f = np.zeros((STATES, STATES))
    f[0, [1, 3, 5]] = 2 * up, -g, 1.0
    f[1, [0, 2, 6]] = -2 * up, g, 1.0
    f[2, [3, 4, 1, 7]] = up, -north, -1 / r, -1.0
    f[3, [2, 0, 8]] = -up, 1 / r, -1.0
    f[4, [2, 0, 9]] = north, tan(place.latitude) / r, -1.0
    return f


class FineAlignment:
    """Feed it increments of a resting sensor, of one run or of many (..., 3).

    The process noise is the grade's, angle and velocity random walk; `noise` (..., 2) takes its place: variances per
    second of velocity [(m/s)^2/s] and of attitude [rad^2/s], one pair for all runs or one for each.
    """

    def __init__(
        self,
        place: Place,
        grade: SensorGrade,
        attitude: FloatArray,
        prior: Prior,
        velocity_sigma_m_s: float,
        noise: FloatArray | None = None,
    ) -> None:
        if noise is None:
            noise = np.array([grade.velocity_walk**2, grade.angle_walk**2])
        runs = np.broadcast_shapes(attitude.shape[:-2], noise.shape[:-1])
        self.strapdown = Strapdown(place, attitude, np.zeros((*runs, 3)), moves_place=False, holds_height=True)
        self.x = np.zeros((*runs, STATES))
        sigma = np.concatenate(
            [
                np.full(2, prior.velocity),
                [prior.level, prior.level, prior.heading],
                np.full(2, grade.accel_bias),
                np.full(3, grade.gyro_bias),
            ]
        )
        self.p = np.diag(sigma**2)
        self._dt_s = 0.0
        self._phi, self._q = np.eye(STATES), np.zeros((STATES, STATES))  # of an interval, (35)
        self._noise = np.zeros((*noise.shape[:-1], STATES, STATES))
        for states, of in ((DV, 0), (PHI, 1)):
            for state in range(states.start, states.stop):
                self._noise[..., state, state] = noise[..., of]
        self._r = velocity_sigma_m_s**2
        self._since_feedback_s = 0.0
        self.innovations_2 = np.zeros(runs)  # sum of squared innovations in their sigmas; two a step
        self.steps = 0

    def step(self, turn: FloatArray, push: FloatArray, dt_s: float, moved: FloatArray | float = 0.0) -> None:
        """One interval at rest: increments (..., 3); `moved` (..., 2) is the true velocity, as vibration makes it."""
        self.strapdown.step(turn, push, dt_s)
        if dt_s != self._dt_s:
            self._discretise(dt_s)
        phi = self._phi
        self.x = self.x @ phi.T
        self.p = phi @ self.p @ phi.T + self._q
        inverse = np.linalg.inv(self.p[..., DV, DV] + self._r * np.eye(2))
        gain = self.p[..., :, DV] @ inverse
        innovation = self.strapdown.velocity[..., :2] - moved - self.x[..., DV]  # (34)
        self.innovations_2 = self.innovations_2 + np.einsum("...i,...ij,...j->...", innovation, inverse, innovation)
        self.steps += 1
        self.x = self.x + np.einsum("...ij,...j->...i", gain, innovation)
        kept = np.eye(STATES) - gain @ H
        self.p = kept @ self.p @ np.swapaxes(kept, -1, -2) + self._r * gain @ np.swapaxes(gain, -1, -2)
        self._since_feedback_s += dt_s
        if self._since_feedback_s >= FEEDBACK_S - 1e-9:
            self.feed_back()

    def _discretise(self, dt_s: float) -> None:
        f, q = error_dynamics(self.strapdown.place), self._noise * dt_s
        self._dt_s = dt_s
        self._phi = np.eye(STATES) + f * dt_s + 0.5 * (f @ f) * dt_s**2
        self._q = 0.5 * (q + self._phi @ q @ self._phi.T)

    def feed_back(self) -> None:
        """Correct attitude (29) and velocity by what is estimated; biases stay in the state."""
        self._since_feedback_s = 0.0
        self.strapdown.attitude = rotation(self.x[..., PHI]) @ self.strapdown.attitude
        self.strapdown.velocity[..., :2] -= self.x[..., DV]
        self.x[..., DV] = 0.0
        self.x[..., PHI] = 0.0

    @property
    def attitude(self) -> FloatArray:
        """C_b^n (..., 3, 3) with all that is estimated."""
        return np.asarray(rotation(self.x[..., PHI]) @ self.strapdown.attitude)

    @property
    def sigma(self) -> FloatArray:
        """Of the misalignment east, north, up [rad], (..., 3) with the shape of `noise`."""
        return np.asarray(np.sqrt(np.diagonal(self.p, axis1=-2, axis2=-1)[..., PHI]))
