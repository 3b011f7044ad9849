"""Pushes of a support as a strapdown sensor feels them, in closed form: rates and forces of the body over a minute."""

from __future__ import annotations

import numpy as np

from estimation.arrays import FloatArray

RATE_HZ, DURATION_S = 100.0, 60.0
LATITUDE_DEG, LONGITUDE_DEG, HEIGHT_M = 40.0, 110.0, 40.0
PITCH_DEG, ROLL_DEG, YAW_DEG = 2.0, -3.0, 35.0
FINE = 20  # parts of an interval, for its integral by Simpson


def felt(t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rate [rad/s] and specific force [m/s^2] in body axes x, y (push), z (up): (n, 3) each."""
    shake = np.stack(
        [0.02 * np.sin(3.1 * t_s), 0.015 * np.cos(2.3 * t_s + 0.4), 0.01 * np.sin(0.7 * t_s) + 0.002], axis=1
    )
    burst = 0.4 * np.sin(2 * np.pi * 0.05 * t_s) * np.exp(-(((t_s % 20) - 10) ** 2) / 8)
    force = np.stack([0.3 * np.sin(1.7 * t_s), burst + 0.2 * np.cos(2.9 * t_s), 9.79 + 0.1 * np.sin(4.2 * t_s)], axis=1)
    return shake, force


def increments() -> tuple[FloatArray, FloatArray]:
    """Integrals over each of the intervals of 1/RATE_HZ: (n, 3) each."""
    n = round(DURATION_S * RATE_HZ)
    edges = np.arange(n * FINE + 1) / (RATE_HZ * FINE)
    weights = np.ones(FINE + 1)
    weights[1:-1:2], weights[2:-1:2] = 4.0, 2.0
    weights /= 3.0 * FINE * RATE_HZ
    rows = np.arange(n)[:, None] * FINE + np.arange(FINE + 1)[None, :]
    turn, push = (np.einsum("f,nfx->nx", weights, values[rows]) for values in felt(edges))
    return turn, push
