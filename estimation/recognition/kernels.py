"""Matched kernels that turn levelled acceleration into the size of a velocity step.

The ram's speed changes by a known amount within half a second; the kernel h = C^-1 s / (s^T C^-1 s) is the
least-squares estimate of that change from block means of acceleration, where s is the mean burst of many machines
and C all that hides it: sensor noise, vibration as measured, gyro walk of the levelling, unknown level and drift,
scatter of s. To a *sustained* kernel pulses of speed are noise too: it is deaf to what comes and goes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum
from functools import lru_cache
from itertools import product

import numpy as np

from estimation.arrays import FloatArray
from estimation.noise import hidden_covariance

VIBRATION_LEVELS_M_S2 = (0.0, 0.025, 0.05, 0.1, 0.18, 0.3, 0.5, 0.9)
PRE_LONG_S, PRE_SHORT_S = 2.5, 0.8  # quiet wanted before the step; the short one soon after another event
SPEED = 0.01453  # m/s, weighs the scatter of the burst shape
PULSE = 0.45  # of that speed: what may come and go
SCATTER_RANK, PULSE_RANK = 8, 24


@dataclass(frozen=True)
class Shape:
    """Spread of burst shapes: natural frequency [Hz], damping, ramp [s] of a second-order response."""

    frequency_hz: tuple[float, float]
    damping: tuple[float, float]
    ramp_s: tuple[float, float]

    def members(self, t_s: FloatArray, dt_s: float) -> FloatArray:
        """Block-mean accelerations (members, len(t_s)) of unit velocity steps at time zero."""
        grid = product(*(np.linspace(low, high, 4) for low, high in (self.frequency_hz, self.damping, self.ramp_s)))
        return np.array([block_means(t_s, dt_s, f, z, ramp) for f, z, ramp in grid])


START = Shape((4.5, 10.0), (0.10, 0.30), (0.04, 0.13))
SOFT_START = Shape((1.5, 3.0), (0.50, 0.95), (0.30, 0.50))
SLOW_START = Shape((1.5, 3.0), (0.50, 0.95), (0.45, 0.80))
STOP = Shape((5.0, 13.0), (0.10, 0.30), (0.03, 0.15))


class Kernel(IntEnum):
    """The kernels, by what they look for and how much of it they see."""

    START_EARLY = 0
    START_HALF = 1
    START_WHOLE = 2
    START_SUSTAINED = 3
    START_SOFT = 4
    START_SLOW = 5
    STOP_HALF = 6
    STOP_WHOLE = 7
    STOP_LATE = 8
    STOP_SUSTAINED = 9


@dataclass(frozen=True)
class KernelSpec:
    """A shape seen `post_s` after its beginning."""

    shape: Shape
    post_s: float
    sustained: bool = False


SPECS = {
    Kernel.START_EARLY: KernelSpec(START, 0.15),
    Kernel.START_HALF: KernelSpec(START, 0.35),
    Kernel.START_WHOLE: KernelSpec(START, 0.7),
    Kernel.START_SUSTAINED: KernelSpec(START, 0.7, sustained=True),
    Kernel.START_SOFT: KernelSpec(SOFT_START, 1.2),
    Kernel.START_SLOW: KernelSpec(SLOW_START, 1.6),
    Kernel.STOP_HALF: KernelSpec(STOP, 0.35),
    Kernel.STOP_WHOLE: KernelSpec(STOP, 0.7),
    Kernel.STOP_LATE: KernelSpec(STOP, 1.2),
    Kernel.STOP_SUSTAINED: KernelSpec(STOP, 1.2, sustained=True),
}


def block_means(t_s: FloatArray, dt_s: float, frequency_hz: float, damping: float, ramp_s: float) -> FloatArray:
    """Mean acceleration over blocks that end at `t_s` (n,), of a unit velocity step that begins at time zero."""
    edges = np.append(t_s[:1] - dt_s, t_s)
    return np.asarray(np.diff(_velocity(edges, frequency_hz, damping, ramp_s)) / dt_s)


def _velocity(t_s: FloatArray, frequency_hz: float, damping: float, ramp_s: float) -> FloatArray:
    """Unit velocity step of a second-order system behind a ramp of its command."""
    pole = 2 * np.pi * frequency_hz * complex(-damping, np.sqrt(1 - damping**2))

    def to_unit_ramp(t: FloatArray) -> FloatArray:
        after = np.maximum(t, 0.0)
        # residue of w^2 / (s^2 (s - pole)(s - conj pole)) at the pole, with its conjugate
        residue = abs(pole) ** 2 / (pole**2 * (pole - pole.conjugate()))
        ringing = 2 * (residue * np.exp(pole * after)).real
        return np.where(t > 0, after + 2 * pole.real / abs(pole) ** 2 + ringing, 0.0)

    return np.asarray((to_unit_ramp(t_s) - to_unit_ramp(t_s - ramp_s)) / ramp_s)


@dataclass(frozen=True)
class _Template:
    """What one kernel looks for: mean shape (n,); factors (n, r) of the covariance of what is like it but is none."""

    s: FloatArray
    clutter: FloatArray


@lru_cache(maxsize=64)
def _template(spec: KernelSpec, dt_s: float, pre: int, post: int) -> _Template:
    n = pre + post
    t_s: FloatArray = dt_s * np.arange(1.0 - pre, 1.0 + n - pre)  # block ends, relative to the step
    members = spec.shape.members(t_s, dt_s)
    s = members.mean(axis=0)
    clutter = SPEED * _principal((members - s) / np.sqrt(len(members)), SCATTER_RANK)
    if spec.sustained:
        pulses = []
        for length_s in np.arange(0.1, spec.post_s - 0.1, 0.08):
            for frequency_hz, damping, ramp_s in ((4.0, 0.5, 0.1), (7.0, 0.2, 0.08)):
                for begin_s in (-0.15, 0.0, 0.15, 0.3):
                    up, down = (
                        block_means(t_s - at_s, dt_s, frequency_hz, damping, ramp_s)
                        for at_s in (begin_s, begin_s + length_s)
                    )
                    pulses.append(up - down)
        # Any of four beginnings may be the one.
        spread = np.array(pulses) * (2.0 * PULSE * SPEED / np.sqrt(len(pulses)))
        clutter = np.hstack([clutter, _principal(spread, PULSE_RANK)])
    return _Template(s, clutter)


def _principal(rows: FloatArray, rank: int) -> FloatArray:
    """Factor (n, rank) of rows^T rows, the small rest left out."""
    _, sizes, vectors = np.linalg.svd(rows, full_matrices=False)
    return np.asarray(vectors[:rank].T * sizes[:rank])


def toeplitz(lags: FloatArray) -> FloatArray:
    """Symmetric covariance (n, n) of a stationary process from its lags (n,)."""
    index = np.arange(len(lags))
    return np.asarray(lags[np.abs(index[:, None] - index[None, :])])


@dataclass
class KernelBank:
    """Kernels for blocks of `dt_s` with `pre_s` of quiet before the step, in vibration of a given autocovariance.

    A level's kernels are computed when it is first met (some 10 ms).
    """

    dt_s: float
    pre_s: float
    lags: FloatArray  # of unit vibration, at least as long as the window
    weights: FloatArray = field(init=False)  # (level, kernel, window), newest block last
    sigma: FloatArray = field(init=False)  # (level, kernel) [m/s]
    post_steps: tuple[int, ...] = field(init=False)
    window: int = field(init=False)
    _ready: list[bool] = field(init=False)

    def __post_init__(self) -> None:
        self.post_steps = post_steps(self.dt_s)
        self._pre = max(round(self.pre_s / self.dt_s), 2)
        self.window = self._pre + max(self.post_steps)
        levels = len(VIBRATION_LEVELS_M_S2)
        self.weights = np.zeros((levels, len(SPECS), self.window))
        self.sigma = np.ones((levels, len(SPECS)))
        self._ready = [False] * levels

    def prepare(self, level: int) -> None:
        """Have the kernels of one vibration level at hand."""
        if self._ready[level]:
            return
        self._ready[level] = True
        noise = hidden_covariance(self.window, self.dt_s)
        noise += VIBRATION_LEVELS_M_S2[level] ** 2 * toeplitz(self.lags[: self.window])
        # The inverse factor of a shorter window is the leading part of the longest one's.
        whitener = np.linalg.inv(np.linalg.cholesky(noise))
        for kernel, spec in SPECS.items():
            n = self._pre + self.post_steps[kernel]
            template = _template(spec, self.dt_s, self._pre, self.post_steps[kernel])
            white = whitener[:n, :n] @ np.column_stack([template.s, template.clutter])
            s, clutter = white[:, 0], white[:, 1:]
            # Woodbury: (N + F F^T)^-1 s
            inner = np.eye(clutter.shape[1]) + clutter.T @ clutter
            solved = s - clutter @ np.linalg.solve(inner, clutter.T @ s)
            h_white = solved / (s @ solved)
            self.weights[level, kernel, self.window - n :] = whitener[:n, :n].T @ h_white
            self.sigma[level, kernel] = np.sqrt(h_white @ h_white)


@lru_cache(maxsize=8)
def post_steps(dt_s: float) -> tuple[int, ...]:
    """Blocks between a step and the moment each kernel sees as much of it as it wants."""
    return tuple(max(round(spec.post_s / dt_s), 1) for spec in SPECS.values())


def longest_window(dt_s: float) -> int:
    """Blocks that the kernel with the longest look back sees."""
    return max(round(PRE_LONG_S / dt_s), 2) + max(post_steps(dt_s))
