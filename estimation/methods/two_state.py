"""Paper A's Kalman filter, eq. (1)-(6) and (13)-(14): acceleration as input, observed displacement as measurement.

    x = [p, v], A = [[1, dt], [0, 1]], B = [dt^2/2, dt], H = [1, 0]

Millimetres and seconds as in the paper. x_0 and P_0 are not printed: the stroke at the beginning, and zero. Between two
readings of the displacement, which come slower than samples, only (1) and (2) are done. Q enters (2) as q I (the
literal reading) or as q B B^T (noise of the acceleration, which the text means). Only the ratio q/r matters to x.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from estimation.arrays import FloatArray
from estimation.methods.batch import Batch, Course, kinds_of, levelled_at_rest
from estimation.settings import TwoStateSettings

BURST_S, BRAKING_S = 1.0, 0.8  # of the segments shown; the filter itself knows none


@dataclass(frozen=True)
class Tuning:
    """Q and R, (mm and s), and how the scalar Q enters the covariance."""

    q: float
    r: float
    form: Literal["qI", "BqB"] = "qI"
    q_bias: float = 0.0  # (mm/s^2)^2 per second, with a third state: the error of the acceleration
    bias_sigma: float = 0.0  # mm/s^2, at the beginning


PAPER = Tuning(0.1758, 0.4935)  # paper A, Table 5


def tuning_of(settings: TwoStateSettings) -> Tuning:
    """The configuration's values, which are SI, in millimetres."""
    return Tuning(settings.q * 1e6, settings.r * 1e6, settings.form)


def two_state(batch: Batch, tuning: Tuning = PAPER) -> Course:
    """The filter along the whole record, on the acceleration less its level at rest."""
    a_mm = levelled_at_rest(batch) * 1e3
    p, v = _run(batch, a_mm, tuning)
    kind = kinds_of(batch.t_s, batch.moves, BURST_S, BRAKING_S)
    return Course(p / 1e3, v / 1e3, a_mm / 1e3, kind, batch.moves)


def three_state(batch: Batch, tuning: Tuning, acceleration: FloatArray) -> Course:
    """The same with the error b of the acceleration as a third state, x = [p, v, b]; not in the paper."""
    p, v = _run(batch, acceleration * 1e3, tuning)
    kind = kinds_of(batch.t_s, batch.moves, BURST_S, BRAKING_S)
    return Course(p / 1e3, v / 1e3, acceleration, kind, batch.moves)


def _run(batch: Batch, a_mm: FloatArray, tuning: Tuning) -> tuple[FloatArray, FloatArray]:
    """p [mm] and v [mm/s], (n,) each. Scalars instead of matrices: it runs at every sample."""
    q, r = tuning.q, tuning.r
    whole = tuning.form == "qI"
    p, v, b = batch.start_m * 1e3, 0.0, 0.0
    ppp = ppv = ppb = pvv = pvb = 0.0
    pbb = tuning.bias_sigma**2
    seen = zip(batch.seen_s.tolist(), (batch.seen_m * 1e3).tolist(), strict=True)
    reading = next(seen, None)
    out_p, out_v = np.empty(len(a_mm)), np.empty(len(a_mm))
    last_s = float(batch.t_s[0])
    for i, (t_s, a) in enumerate(zip(batch.t_s.tolist(), a_mm.tolist(), strict=True)):
        dt = t_s - last_s
        last_s = t_s
        half = 0.5 * dt * dt
        p += dt * v + half * (a - b)  # (1), (13)
        v += dt * (a - b)
        # (2): P := A P A^T + Q, b constant but for its own noise
        ppp += 2 * dt * ppv - 2 * half * ppb + dt * dt * pvv - 2 * dt * half * pvb + half * half * pbb
        ppv += dt * pvv - (half + dt * dt) * pvb - dt * ppb + dt * half * pbb
        ppb += dt * pvb - half * pbb
        pvv += -2 * dt * pvb + dt * dt * pbb
        pvb -= dt * pbb
        pbb += tuning.q_bias * dt
        if whole:
            ppp, pvv = ppp + q, pvv + q
        else:
            ppp, ppv, pvv = ppp + q * half * half, ppv + q * half * dt, pvv + q * dt * dt
        while reading is not None and reading[0] <= t_s:
            s = ppp + r  # (4)
            kp, kv, kb = ppp / s, ppv / s, ppb / s
            innovation = reading[1] - p
            p, v, b = p + kp * innovation, v + kv * innovation, b + kb * innovation  # (5)
            pvv -= kv * ppv  # (6)
            pvb -= kv * ppb
            pbb -= kb * ppb
            ppv -= kp * ppv
            ppb -= kp * ppb
            ppp -= kp * ppp
            reading = next(seen, None)
        out_p[i], out_v[i] = p, v
    return out_p, out_v
