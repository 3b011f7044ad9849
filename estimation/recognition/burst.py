"""Size and time of one burst, its shape unknown: the second-order step that explains the acceleration best.

Acceleration = A s(t; f, damping, ramp, t0) + noise, with Gauss priors on ln f, ln damping, ln ramp and t0, and A free.
A coarse grid finds the shape, Levenberg-Marquardt refines it; sigmas are those of the linearised posterior.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import exp, log, sqrt

import numpy as np
from numpy.typing import NDArray

from estimation.arrays import FloatArray
from estimation.noise import hidden_covariance
from estimation.recognition.kernels import block_means, toeplitz

PRE_S = 2.5  # quiet before it
LEAD_S = 0.08  # the burst may begin so much before the guess
SETTLED_S = 0.35  # after its beginning a burst's own ringing no longer counts as vibration
DECAY_S = 0.2  # of the vibration after a stop
LEVEL_DOUBT = 0.12  # share of the vibration, as white noise
LEAST_LEVEL_M_S2 = 0.003
ITERATIONS = 8
LEAST_PRE, LEAST_POST = 30, 20  # blocks
LONGEST_POST_S = 3.0
_TEMPLATE_LEAD = 24  # blocks before the guess
TINY = np.array([0.01, 0.02, 0.02, 0.001])


@dataclass(frozen=True)
class BurstPrior:
    """What bursts of one kind look like: median and log-spread; t0 about the guess."""

    frequency_hz: tuple[float, float]
    damping: tuple[float, float]
    ramp_s: tuple[float, float]
    t0_s: float
    shifts: int = 13

    @property
    def mean(self) -> FloatArray:
        """Of ln f, ln damping, ln ramp, t0."""
        return np.array([log(self.frequency_hz[0]), log(self.damping[0]), log(self.ramp_s[0]), 0.0])

    @property
    def sigma(self) -> FloatArray:
        """Of the same."""
        return np.array([self.frequency_hz[1], self.damping[1], self.ramp_s[1], self.t0_s])

    def grid(self) -> FloatArray:
        """Points (m, 4) that cover two sigmas."""
        axes = [
            centre + spread * np.linspace(-1.9, 1.9, n)
            for centre, spread, n in zip(self.mean, self.sigma, (11, 4, 3, self.shifts), strict=True)
        ]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 4)


START = BurstPrior((6.85, 0.22), (0.167, 0.35), (0.082, 0.35), 0.03)
SLOW_START = BurstPrior((2.1, 0.28), (0.7, 0.25), (0.5, 0.35), 0.15)
STOP = BurstPrior((9.0, 0.30), (0.167, 0.35), (0.060, 0.50), 0.03)


@dataclass(slots=True, frozen=True)
class Burst:
    """What a burst tells: step of the speed [m/s], its sigma, and when it began."""

    step_m_s: float
    sigma_m_s: float
    t_ns: int


@dataclass(frozen=True)
class BurstView:
    """The acceleration around a burst: levelled block means (n,), newest last, and what they are hidden in."""

    dt_s: float  # the kernels' block period; the blocks' own may differ by a few percent
    times_ns: NDArray[np.int64]  # (m,) ends of the newest blocks
    levelled_m_s2: FloatArray
    squares_m2_s4: FloatArray  # vibration's mean square, one noisy value a block
    lags: FloatArray  # autocovariance of unit vibration, at least (n,)
    delay_s: float = 0.0  # of the sensor's own filter


def fit_burst(view: BurstView, prior: BurstPrior, guess_ns: int, *, stop: bool) -> Burst | None:
    """The burst near `guess_ns`; None if too little lies before or after it, or nothing fits."""
    dt_s = view.dt_s
    age_s = np.asarray((view.times_ns - guess_ns) * 1e-9, dtype=np.float64)  # block ends, relative to the guess
    post = int((age_s > -LEAD_S).sum())  # blocks that may hold some of it
    n = min(len(view.levelled_m_s2), len(age_s), post + round(PRE_S / dt_s))
    pre = n - post
    if post < LEAST_POST or pre < LEAST_PRE:
        return None
    y, age_s = view.levelled_m_s2[-n:], age_s[-n:]
    level = _vibration(view.squares_m2_s4[-n:], age_s, stop)
    noise = hidden_covariance(n, dt_s) + np.outer(level, level) * toeplitz(view.lags[:n])
    noise[np.diag_indices(n)] += (LEVEL_DOUBT * level) ** 2
    whitener = np.linalg.inv(np.linalg.cholesky(noise))
    # Before the burst its template is zero, and so is it after whitening.
    seen = whitener[pre:] @ (y - y[0])
    whitener = whitener[pre:, pre:]
    t_s = age_s[pre:]

    grid = prior.grid()
    # The templates lie on whole blocks: near enough to begin with.
    first = round(float(t_s[0]) / dt_s) + _TEMPLATE_LEAD
    if not 0 <= first <= len(_templates(prior, dt_s)) - post:
        return None
    rough = whitener @ _templates(prior, dt_s)[first : first + post]
    power = np.einsum("ij,ij->j", rough, rough)
    match = rough.T @ seen
    fit = 0.5 * match**2 / power - 0.5 * (((grid - prior.mean) / prior.sigma) ** 2).sum(axis=1)
    best = int(np.argmax(fit))
    return _refined(view, prior, guess_ns, whitener, seen, t_s, grid[best], float(match[best] / power[best]))


def _refined(
    view: BurstView,
    prior: BurstPrior,
    guess_ns: int,
    whitener: FloatArray,
    seen: FloatArray,
    t_s: FloatArray,
    shape: FloatArray,
    step: float,
) -> Burst | None:
    mean, sigma = prior.mean, prior.sigma
    period_s = float(t_s[-1] - t_s[0]) / (len(t_s) - 1)

    def template(at: FloatArray) -> FloatArray:
        return np.asarray(whitener @ _shape(t_s, period_s, at))

    def cost(at: FloatArray, size: float, seen_of: FloatArray) -> float:
        return float(((seen - size * seen_of) ** 2).sum() + (((at - mean) / sigma) ** 2).sum())

    def jacobian(at: FloatArray, size: float, seen_of: FloatArray) -> FloatArray:
        moved = [size * (template(at + unit) - seen_of) / unit.sum() for unit in np.diag(TINY)]
        return np.column_stack([seen_of, *moved])

    information = np.diag(np.append(0.0, 1.0 / sigma**2))
    unit = template(shape)
    worst, damping = cost(shape, step, unit), 1e-2
    for _ in range(ITERATIONS):
        slopes = jacobian(shape, step, unit)
        hessian = slopes.T @ slopes + information
        gradient = slopes.T @ (seen - step * unit) - np.append(0.0, (shape - mean) / sigma**2)
        change = np.linalg.solve(hessian + damping * np.diag(np.diag(hessian)), gradient)
        tried, tried_step = shape + np.clip(change[1:], -0.3, 0.3), step + float(change[0])
        tried_unit = template(tried)
        tried_cost = cost(tried, tried_step, tried_unit)
        if tried_cost >= worst:
            damping *= 10.0
            continue
        gained, worst, damping = worst - tried_cost, tried_cost, damping / 5.0
        shape, step, unit = tried, tried_step, tried_unit
        if gained < 1e-3:
            break
    slopes = jacobian(shape, step, unit)
    covariance = np.linalg.inv(slopes.T @ slopes + information)
    if not np.isfinite(covariance).all() or covariance[0, 0] <= 0.0:
        return None
    return Burst(
        step_m_s=step,
        sigma_m_s=sqrt(covariance[0, 0]),
        t_ns=guess_ns + round((float(shape[3]) - view.delay_s) * 1e9),
    )


def _shape(t_s: FloatArray, dt_s: float, at: FloatArray) -> FloatArray:
    return block_means(t_s - at[3], dt_s, exp(at[0]), min(exp(at[1]), 0.97), exp(at[2]))


@lru_cache(maxsize=9)
def _templates(prior: BurstPrior, dt_s: float) -> FloatArray:
    """Block means (blocks, m) of all points of the grid, for a guess at the end of a block."""
    t_s = dt_s * np.arange(-_TEMPLATE_LEAD, int(LONGEST_POST_S / dt_s), dtype=np.float64)
    return np.column_stack([_shape(t_s, dt_s, at) for at in prior.grid()])


def prepare(dt_s: float) -> None:
    """Compute beforehand what would delay the first fit."""
    for prior in (START, SLOW_START, STOP):
        _templates(prior, dt_s)


def _vibration(squares: FloatArray, age_s: FloatArray, stop: bool) -> FloatArray:
    """Level (n,) of the vibration: one before the burst, another after it, dying away after a stop."""

    def level(chosen: FloatArray) -> float:
        return sqrt(max(float(chosen.mean()) if len(chosen) else 0.0, LEAST_LEVEL_M_S2**2))

    before = level(squares[(age_s < -0.05) & (age_s > -2.0)])
    after = level(squares[age_s > SETTLED_S])
    if not stop:
        return np.where(age_s < 0.0, before, after)
    after = min(after, before)
    return np.asarray(after + (before - after) * np.exp(-np.maximum(age_s, 0.0) / DECAY_S))
