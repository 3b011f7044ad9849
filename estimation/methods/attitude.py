"""Orientation through a whole record, paper C, eq. (4)-(8), and the acceleration without gravity, eq. (10)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimation.arrays import FloatArray
from estimation.methods.batch import LEAD_S, STOPPED_S, Batch
from estimation.orientation import IDENTITY, corrected, matrix, propagated

REST_TIME_CONSTANT_S = 3.0


def attitudes(
    t_s: FloatArray, accel: FloatArray, gyro: FloatArray, corrects: NDArray[np.bool_], time_constant_s: float
) -> FloatArray:
    """Rotation matrices (n, 3, 3) that carry sensor vectors into the level frame.

    Args:
        t_s: (n,) times.
        accel: (n, 3), with gravity.
        gyro: (n, 3), bias removed.
        corrects: (n,) where gravity corrects; elsewhere the gyroscopes alone carry on.
        time_constant_s: of the correction; the paper's gain, which it does not print, is dt over this.
    """
    q = IDENTITY
    out = np.empty((len(t_s), 3, 3))
    last_s = float(t_s[0])
    rows = zip(t_s.tolist(), accel.tolist(), gyro.tolist(), corrects.tolist(), strict=True)
    for i, (t, (ax, ay, az), (gx, gy, gz), gravity_corrects) in enumerate(rows):
        dt_s, last_s = t - last_s, t
        q = propagated(q, (gx, gy, gz), dt_s)
        if gravity_corrects:
            q = corrected(q, (ax, ay, az), 1.0 if i == 0 else min(dt_s / time_constant_s, 1.0))
        out[i] = matrix(q)
    return out


def gyro_levelled(batch: Batch) -> FloatArray:
    """Push acceleration (n,) without gravity: attitude by gravity at rest, by the gyroscopes in each move."""
    resting = np.ones(len(batch.t_s), dtype=np.bool_)
    for move in batch.moves:
        resting &= (batch.t_s < move.onset_s - LEAD_S) | (batch.t_s > move.stop_s + STOPPED_S)
    bias = batch.gyro[resting].mean(axis=0)
    turn = attitudes(batch.t_s, batch.accel, batch.gyro - bias, resting, REST_TIME_CONSTANT_S)
    return np.asarray(np.einsum("ij,ij->i", turn[:, 1, :], batch.accel))
