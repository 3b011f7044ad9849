"""Matched kernels that turn levelled acceleration into the size of a velocity step.

The ram's speed changes by a known amount within half a second; the kernel h = C^-1 s / (s^T C^-1 s) is the
least-squares estimate of that change from block means of acceleration, where s is the mean burst of many machines
and C all that hides it: sensor noise, vibration, gyro walk of the levelling, unknown level and drift, scatter of s.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

VIBRATION_LEVELS_M_S2 = (0.0, 0.025, 0.05, 0.1, 0.18, 0.3, 0.5, 0.9)
PRE_LONG_S, PRE_SHORT_S = 2.5, 0.8  # quiet wanted before the step; the short one soon after another event

ACCEL_NOISE = 2.2555e-3 / 2**0.5  # m/s^2/sqrt(Hz), two-sided (data sheet: 0.23 mg/sqrt(Hz))
GYRO_WALK = 1.63e-3  # m/s^2/sqrt(s): gravity times the angle walk of the gyro
FREE_LEVEL = 1.0  # m/s^2
DRIFT = 1.5e-3  # m/s^3
VIBRATION_BAND_HZ = (5.0, 60.0)
SPEED = 0.01453  # m/s, weighs the scatter of the burst shape


@dataclass(frozen=True)
class Shape:
    """Spread of burst shapes: natural frequency [Hz], damping, ramp [s] of a second-order response."""

    frequency_hz: tuple[float, float]
    damping: tuple[float, float]
    ramp_s: tuple[float, float]

    def members(self, t_s: Array, dt_s: float) -> Array:
        """Block-mean accelerations (members, len(t_s)) of unit velocity steps at time zero."""
        grid = product(*(np.linspace(low, high, 4) for low, high in (self.frequency_hz, self.damping, self.ramp_s)))
        return np.array(
            [
                np.diff([_velocity(edge, f, z, ramp) for edge in (t_s - dt_s, t_s)], axis=0)[0] / dt_s
                for f, z, ramp in grid
            ]
        )


START = Shape((4.5, 10.0), (0.10, 0.30), (0.04, 0.13))
SLOW_START = Shape((1.5, 3.0), (0.50, 0.95), (0.30, 0.75))
STOP = Shape((5.0, 13.0), (0.10, 0.30), (0.03, 0.15))


@dataclass(frozen=True)
class KernelSpec:
    """A shape seen `post_s` after its beginning."""

    shape: Shape
    post_s: float


STARTS = (
    KernelSpec(START, 0.15),
    KernelSpec(START, 0.35),
    KernelSpec(START, 0.7),
    KernelSpec(SLOW_START, 1.2),
)
STOPS = (KernelSpec(STOP, 0.35), KernelSpec(STOP, 0.7), KernelSpec(STOP, 1.2))
SPECS = STARTS + STOPS


@dataclass(frozen=True)
class KernelBank:
    """Kernels of one step period: weights (level, spec, window), newest block last; sigma (level, spec) [m/s]."""

    weights: Array
    sigma: Array
    post_steps: tuple[int, ...]

    @property
    def window(self) -> int:
        """Blocks that a kernel looks at."""
        return int(self.weights.shape[2])


def _velocity(t_s: Array, frequency_hz: float, damping: float, ramp_s: float) -> Array:
    """Unit velocity step of a second-order system behind a ramp of its command."""
    pole = 2 * np.pi * frequency_hz * complex(-damping, np.sqrt(1 - damping**2))

    def to_unit_ramp(t: Array) -> Array:
        after = np.maximum(t, 0.0)
        # residue of w^2 / (s^2 (s - pole)(s - conj pole)) at the pole, with its conjugate
        residue = abs(pole) ** 2 / (pole**2 * (pole - pole.conjugate()))
        ringing = 2 * (residue * np.exp(pole * after)).real
        return np.where(t > 0, after + 2 * pole.real / abs(pole) ** 2 + ringing, 0.0)

    return np.asarray((to_unit_ramp(t_s) - to_unit_ramp(t_s - ramp_s)) / ramp_s)


def _vibration_covariance(n: int, dt_s: float) -> Array:
    """Unit-variance band noise, averaged over blocks of dt: covariance (n, n)."""
    f = np.linspace(*VIBRATION_BAND_HZ, 400)
    averaged = np.sinc(f * dt_s) ** 2
    lags = np.array([np.mean(averaged * np.cos(2 * np.pi * f * dt_s * k)) for k in range(n)])
    index = np.arange(n)
    return np.asarray(lags[np.abs(index[:, None] - index[None, :])])


@lru_cache(maxsize=8)
def kernel_bank(dt_s: float, pre_s: float) -> KernelBank:
    """All kernels for blocks of `dt_s` seconds with `pre_s` seconds of quiet before the step."""
    posts = [max(round(spec.post_s / dt_s), 1) for spec in SPECS]
    pre = max(round(pre_s / dt_s), 2)
    window = pre + max(posts)
    weights = np.zeros((len(VIBRATION_LEVELS_M_S2), len(SPECS), window))
    sigma = np.zeros((len(VIBRATION_LEVELS_M_S2), len(SPECS)))
    for k, (spec, post) in enumerate(zip(SPECS, posts, strict=True)):
        n = pre + post
        t_s: Array = dt_s * np.arange(1.0 - pre, 1.0 + n - pre)  # block ends, relative to the step
        members = spec.shape.members(t_s, dt_s)
        s = members.mean(axis=0)
        age = t_s - t_s[0]
        hidden = (
            np.eye(n) * ACCEL_NOISE**2 / dt_s
            + GYRO_WALK**2 * np.minimum(age[:, None], age[None, :])
            + FREE_LEVEL**2
            + DRIFT**2 * np.outer(age, age)
        )
        scatter = SPEED**2 * np.cov(members.T, bias=True)
        vibration = _vibration_covariance(n, dt_s)
        for level, vibration_m_s2 in enumerate(VIBRATION_LEVELS_M_S2):
            noise = hidden + vibration_m_s2**2 * vibration
            solved = np.linalg.solve(noise + scatter, s)
            h = solved / (s @ solved)
            weights[level, k, window - n :] = h
            sigma[level, k] = np.sqrt(h @ noise @ h)
    return KernelBank(weights, sigma, tuple(posts))
