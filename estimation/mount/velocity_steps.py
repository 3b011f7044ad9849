"""Where the velocity stepped in a recording, how far and which way, however the sensor sits.

The matched kernels of `kernels` look along all three sensor axes. Gravity is levelled out with the gyro: within
the few seconds of a kernel, a vector f that stands still in space is f + phi x f in the axes of the beginning, phi
the angle turned since. Kernels are blind to levels, so phi may as well be counted from the stretch's beginning.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimation.mount.stretch import BLOCK_S, Stretch
from estimation.recognition.kernels import PRE_LONG_S, VIBRATION_LEVELS_M_S2, Kernel, KernelBank, longest_window
from estimation.recognition.spectrum import design_lags

Array = NDArray[np.float64]

SIGNIFICANT_SIGMAS = 6.0
KERNEL_SIGMA_FACTOR = 1.15  # shapes differ, and the largest of several answers is taken
MEDIAN_CHI_SQUARE = 2 * np.log(2.0)  # of two degrees of freedom: the horizontal answers to noise alone
LEAST_AWAY = 0.3  # share of a stretch away from what looks like bursts; if less, all of it looks so
SWITCHED_VIBRATION_S = 0.0092  # rms velocity per m/s^2 of 5-60 Hz noise: it stays where vibration begins or ends
BEFORE_BLOCKS = (60, 10)  # where vibration is measured, counted back from a step
AFTER_BLOCKS = (-72, -122)  # the burst has rung out by then
LEAST_VIBRATION_M_S2 = 0.005
TWIN_S = 0.6  # answers closer together belong to one burst
SIDE_LOBE = 0.6  # a smaller share of a larger step, within a kernel's window, is its side lobe
LARGEST_TURN_RAD = 0.03  # within a kernel's window; more, and somebody handles the sensor


@dataclass(frozen=True)
class VelocityStep:
    """One burst: when [s], change of velocity (3,) in sensor axes and its sigma on each of them [m/s]."""

    t_s: float
    change: Array
    sigma: float
    louder: float  # vibration after it, as a multiple of that before


def velocity_steps(stretch: Stretch, gyro_bias: Array) -> list[VelocityStep]:
    """All significant horizontal steps, in order of time. gyro_bias: (n, 3) or (3,) [rad/s]."""
    bank = KernelBank(BLOCK_S, PRE_LONG_S, design_lags(BLOCK_S, longest_window(BLOCK_S)))
    post = bank.post_steps[Kernel.START_WHOLE]
    pre = bank.window - max(bank.post_steps)
    window = pre + post
    judged = slice(pre - 1, len(stretch.t_s) - post)  # places that the kernel has whole: m of them
    if judged.stop - judged.start < 3:
        return []
    before, after = stretch.vibration(*BEFORE_BLOCKS)[judged], stretch.vibration(*AFTER_BLOCKS)[judged]
    levels = np.searchsorted(VIBRATION_LEVELS_M_S2, 0.8 * np.maximum(before, after))
    levels = np.minimum(levels, len(VIBRATION_LEVELS_M_S2) - 1)
    turned = np.cumsum((stretch.gyro - gyro_bias) * BLOCK_S, axis=0)
    felt, tilted = np.zeros((2, len(levels), 3))  # (m, 3): answers to force and to angle
    for level in np.unique(levels):
        bank.prepare(int(level))
        kernel = bank.weights[level, Kernel.START_WHOLE, -window:]
        here = levels == level
        for axis in range(3):
            felt[here, axis] = np.correlate(stretch.accel[:, axis], kernel)[here]
            tilted[here, axis] = np.correlate(turned[:, axis], kernel)[here]
    total = np.concatenate([np.zeros((1, 3)), np.cumsum(stretch.accel, axis=0)])
    gravity = (total[window:] - total[:-window]) / window
    up = gravity / np.maximum(np.linalg.norm(gravity, axis=1, keepdims=True), 1e-9)
    change = felt + np.cross(tilted, gravity)
    size = np.linalg.norm(np.cross(change, up), axis=1)  # of the horizontal part

    sigma = KERNEL_SIGMA_FACTOR * bank.sigma[levels, Kernel.START_WHOLE]
    sigma *= _unforeseen(size / sigma, pre, post)
    sigma = np.hypot(sigma, SWITCHED_VIBRATION_S * np.sqrt(np.abs(after**2 - before**2)))
    louder = np.maximum(after, LEAST_VIBRATION_M_S2) / np.maximum(before, LEAST_VIBRATION_M_S2)
    return [
        VelocityStep(float(stretch.t_s[judged][i]), change[i], float(sigma[i]), float(louder[i]))
        for i in _peaks(size / sigma, size, window)
        if np.ptp(turned[i : i + window], axis=0).max() < LARGEST_TURN_RAD
    ]


def _unforeseen(ratio: Array, pre: int, post: int) -> float:
    """How much larger the horizontal answers are than their sigma away from the bursts, at least 1.

    More than white noise and vibration of 5 to 60 Hz may go on, which is all that the kernels know of.
    """
    away = np.ones(len(ratio), dtype=bool)
    for i in _peaks(ratio, ratio, pre + post):
        away[max(i - post, 0) : i + pre] = False
    if np.mean(away) < LEAST_AWAY:
        away[:] = True
    return float(np.sqrt(max(np.median(ratio[away] ** 2) / MEDIAN_CHI_SQUARE, 1.0)))


def _peaks(ratio: Array, size: Array, window: int) -> list[int]:
    """Places of the significant answers, without the twins and side lobes of larger ones.

    ratio: size by its sigma.
    """
    inner = size[1:-1]
    highest = 1 + np.flatnonzero((inner >= size[:-2]) & (inner > size[2:]) & (ratio[1:-1] > SIGNIFICANT_SIGMAS))
    found: list[int] = []
    for i in highest[np.argsort(-size[highest])].tolist():
        distances = np.abs(np.array(found) - i)
        lobe = (distances < window) & (size[i] < SIDE_LOBE * size[found])
        if not np.any(lobe | (distances * BLOCK_S < TWIN_S)):
            found.append(i)
    return sorted(found)
