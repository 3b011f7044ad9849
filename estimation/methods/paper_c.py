"""Paper C's multi-segmental Kalman filter to the letter: a batch method that cannot work, with what it makes.

Order as in the paper's Figure 1: de-trending and de-noising, orientation, chart, k-means, then VVM - CVM - VVM - ZUPT.
What the paper leaves open is a field of `Reading`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from estimation.arrays import FloatArray
from estimation.methods.attitude import attitudes
from estimation.methods.batch import Batch, Course, Kind, Span
from estimation.methods.chart import change_points, moving_range_limits, printed_limits
from estimation.methods.clusters import k_means
from estimation.methods.wavelet import filtered

GYRO_BIAS_S = 5.0  # at the beginning the support rests


@dataclass(frozen=True)
class Reading:
    """How the undecided points of paper C are read; by default as printed, where anything is."""

    level: int = 8  # of the transform: 8 in the method, 7 in the experiment
    wavelet: str = "coif3"  # a coiflet; the order is not printed
    time_constant_s: float = 1.0  # of the correction by gravity; not printed
    chart: Literal["printed", "moving_range"] = "printed"
    k: Literal[4, 5] = 4
    cvm: Literal["zero", "vvm"] = "zero"  # third row of eq. (17): zeros, or VVM's
    q_m_s2: float = 0.0465  # noise of the acceleration state from sample to sample; not printed
    r_m_s2: float = 0.0465  # of its measurement: what the sensor has in a sample; not printed
    segments: tuple[Span, ...] | None = None  # given ones instead of chart and k-means


def paper_c(batch: Batch, reading: Reading | None = None) -> Course:
    """The method along one record of a push and the advance after it.

    Raises:
        ValueError: the record is too short for the transform, or has too few change points for k clusters.
    """
    reading = reading or Reading()
    y_local = filtered(batch.accel, reading.level, reading.wavelet)
    bias = batch.gyro[batch.t_s < GYRO_BIAS_S].mean(axis=0)
    always = np.ones(len(batch.t_s), dtype=np.bool_)
    turn = attitudes(batch.t_s, batch.accel, batch.gyro - bias, always, reading.time_constant_s)
    # Eq. (10). De-trending has taken gravity out already: taking g away once more would count it twice.
    y = np.einsum("ij,ij->i", turn[:, 1, :], y_local)
    if reading.segments is None:
        limits = printed_limits(y) if reading.chart == "printed" else moving_range_limits(y)
        moves, bursts = _moves(k_means(change_points(y, limits), reading.k), batch, reading.k)
    else:
        limits = (float("nan"), float("nan"))
        moves = reading.segments
        bursts = [(move.onset_s, move.onset_s + 1.0) for move in moves]
        bursts += [(move.stop_s, move.stop_s + 0.8) for move in moves]
    kind = np.zeros(len(y), dtype=np.int8)
    begins: dict[int, bool] = {}
    for move in moves:
        kind[(batch.t_s >= move.onset_s) & (batch.t_s <= move.stop_s)] = Kind.CVS
    for begin_s, end_s in bursts:
        inside = np.flatnonzero((batch.t_s >= begin_s) & (batch.t_s <= end_s))
        kind[inside] = Kind.VVS
        direction = next((move.direction for move in moves[::-1] if begin_s >= move.onset_s), 1)
        begins[int(inside[0])] = float(y[inside].mean()) * direction > 0.0  # (18): it accelerates
    p, v, a = _estimated(batch, y, kind, begins, reading)
    return Course(p, v, a, kind, tuple(moves), limits)


def _moves(clusters: list[tuple[int, int]], batch: Batch, k: int) -> tuple[tuple[Span, ...], list[tuple[float, float]]]:
    """Two moves of the clusters in order: start, stop, start, stop; with k = 5 one more burst before the first stop."""
    bursts = [(float(batch.t_s[first]), float(batch.t_s[last])) for first, last in clusters]
    push = Span(bursts[0][0], bursts[k - 3][0], 1)
    advance = Span(bursts[k - 2][0], bursts[k - 1][0], -1)
    return (push, advance), bursts


def _estimated(
    batch: Batch, y: FloatArray, kind: NDArray[np.int8], begins: dict[int, bool], reading: Reading
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Eq. (14)-(18) with the usual recursion; X = [x, v, a] along the push, H = [0 0 1].

    P starts at zero in each VVS (`begins`: its first sample, and whether it accelerates). Only the acceleration is
    ever observed, so of P only a's variance and its covariance with x and v play a part.
    """
    p_m, v_m_s, a_m_s2 = batch.start_m, 0.0, 0.0
    variance = with_p = with_v = 0.0
    q, r = reading.q_m_s2**2, reading.r_m_s2**2
    out = np.zeros((3, len(y)))
    last_s = float(batch.t_s[0])
    for i, (t_s, z, segment) in enumerate(zip(batch.t_s.tolist(), y.tolist(), kind.tolist(), strict=True)):
        dt, last_s = t_s - last_s, t_s
        if i in begins:
            variance = with_p = with_v = 0.0
            if begins[i]:
                v_m_s = a_m_s2 = 0.0
        if segment == Kind.ZUPT:
            v_m_s = a_m_s2 = variance = with_p = with_v = 0.0
            out[0, i] = p_m
            continue
        p_m += dt * v_m_s + 0.5 * dt * dt * a_m_s2  # (15), (17)
        v_m_s += dt * a_m_s2
        with_p += dt * with_v + 0.5 * dt * dt * variance
        with_v += dt * variance
        if segment == Kind.CVS and reading.cvm == "zero":
            a_m_s2 = variance = with_p = with_v = 0.0
        variance += q
        s = variance + r  # (16)
        innovation = z - a_m_s2
        p_m += with_p / s * innovation
        v_m_s += with_v / s * innovation
        a_m_s2 += variance / s * innovation
        with_p, with_v, variance = with_p * r / s, with_v * r / s, variance * r / s
        out[:, i] = p_m, v_m_s, a_m_s2
    return out[0], out[1], out[2]
