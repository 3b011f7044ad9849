"""Which of the two directions along the line of the bursts is the push: log odds from two independent witnesses."""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, log, pi, sqrt
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from estimation.mount.velocity_steps import VelocityStep
from estimation.settings import SupportSettings

Array = NDArray[np.float64]

SPEED_SPREAD = 0.10  # of one move around the nominal speed, and of the answers to it: as a share of the speed
LARGEST_MISFIT = 1.5  # rms of the steps' distances from the nominal speeds, in sigmas: beyond, those are not theirs
UNEXPLAINED = 0.02  # share of bursts, or of displacement readings, that fit no hypothesis
UNNOTICED = 0.01  # share of moves that begin or end without a burst that is found
LARGEST_STEP_M_S = 0.2
LOUDER, QUIETER_NATS = 2.0, 3.0  # a ram that starts does not become quieter: against that it seems to

SIDE_S = 3.0  # how far around a burst the displacement readings are looked at
LEAST_SPAN_S, LEAST_READINGS = 0.5, 4  # of them on each side of it
BURST_S = 0.1  # the speed has changed by half so long after the beginning of a burst
LEAST_READING_SIGMA_M = 1e-3  # equal readings are not exact


def odds_from_displacement(sizes: Array, steps: Sequence[VelocityStep], readings: Array) -> float:
    """Log odds [nats] that a step with positive size speeds the stroke up; 0 if the readings know of no step.

    sizes: (n,) along the line [m/s]; readings: (m, 2), time [s] and displacement [m] in order of time.
    """
    times = [step.t_s + BURST_S for step in steps]
    edges = [-np.inf, *times, np.inf]
    with_it = against_it = unrelated = 0.0
    for k, (size, step) in enumerate(zip(sizes, steps, strict=True)):
        seen = _change_of_slope(readings, times[k], edges[k], edges[k + 2])
        if seen is not None:
            change, sigma = seen
            variance = sigma**2 + step.sigma**2 + (SPEED_SPREAD * size) ** 2
            with_it += _log_likelihood(change - size, variance)
            against_it += _log_likelihood(change + size, variance)
            unrelated += _log_likelihood(change, variance)
    # A reading that is noise or stands still is nearer to one sign by chance: it must beat having nothing to say, too.
    odds = max(with_it, against_it) - max(min(with_it, against_it), unrelated)
    return max(odds, 0.0) if with_it > against_it else -max(odds, 0.0)


def _log_likelihood(error: float, variance: float) -> float:
    normal = exp(-0.5 * error**2 / variance) / sqrt(2 * pi * variance)
    return log((1 - UNEXPLAINED) * normal + UNEXPLAINED / (2 * LARGEST_STEP_M_S))


def _change_of_slope(readings: Array, t_s: float, earliest_s: float, latest_s: float) -> tuple[float, float] | None:
    """Least squares of a line with a bend at `t_s`: change of slope there and its sigma [m/s]; None if unseen."""
    t, y = readings[:, 0] - t_s, readings[:, 1]
    near = (t > max(earliest_s - t_s, -SIDE_S)) & (t < min(latest_s - t_s, SIDE_S))
    t, y = t[near], y[near]
    for side in (t[t < 0], t[t >= 0]):
        if len(side) < LEAST_READINGS or np.ptp(side) < LEAST_SPAN_S:
            return None
    design = np.column_stack([np.ones_like(t), t, np.maximum(t, 0.0)])
    inverse = np.linalg.inv(design.T @ design)
    fitted = inverse @ design.T @ y
    variance = max(float(np.sum((y - design @ fitted) ** 2)) / (len(t) - 3), LEAST_READING_SIGMA_M**2)
    return float(fitted[2]), float(np.sqrt(variance * inverse[2, 2]))


def odds_from_speeds(
    sizes: Array, steps: Sequence[VelocityStep], support: SupportSettings, imu_on: Literal["both", "link", "base"]
) -> float:
    """Log odds [nats] that a step with positive size speeds the stroke up, by the nominal speeds of the moves."""
    push, retract = support.nominal_push_speed_mm_s / 1e3, support.nominal_retract_speed_mm_s / 1e3
    speeds = np.array([0.0, push, -retract])[[True, imu_on != "base", imu_on != "link"]]
    sigmas = np.array([step.sigma for step in steps])
    moving = np.abs(speeds[1:])
    misfits = (np.abs(sizes)[:, None] - moving) / np.hypot(sigmas[:, None], SPEED_SPREAD * moving)
    if np.mean(np.min(misfits**2, axis=1)) > LARGEST_MISFIT**2:
        return 0.0
    return _log_likelihood_of_moves(sizes, steps, speeds) - _log_likelihood_of_moves(-sizes, steps, speeds)


def _log_likelihood_of_moves(sizes: Array, steps: Sequence[VelocityStep], speeds: Array) -> float:
    """Forward pass of a hidden Markov chain: what the ram does between the bursts; state 0 is rest."""
    n = len(speeds)
    moves = np.arange(n) > 0
    start, stop = np.outer(~moves, moves), np.outer(moves, ~moves)
    change = speeds[None, :] - speeds[:, None]
    unnoticed = np.eye(n) + UNNOTICED * (start | stop)
    unnoticed = np.linalg.matrix_power(unnoticed / unnoticed.sum(axis=1, keepdims=True), 2)
    belief = np.full(n, 1.0 / n)
    total = 0.0
    for size, step in zip(sizes, steps, strict=True):
        variance = step.sigma**2 + (SPEED_SPREAD * change) ** 2
        density = np.exp(-0.5 * (size - change) ** 2 / variance) / np.sqrt(2 * np.pi * variance)
        odd = start * (step.louder < 1 / LOUDER) + stop * (step.louder > LOUDER)
        burst = density * (start | stop) * np.exp(-QUIETER_NATS * odd)
        belief = belief @ unnoticed @ (burst + UNEXPLAINED / (2 * LARGEST_STEP_M_S) * np.eye(n))
        total += log(belief.sum())
        belief = belief / belief.sum()
    return total
