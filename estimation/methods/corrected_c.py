"""Paper C's filter as it can work: what is changed against `paper_c`, and why.

1. The integrator gets the levelled acceleration, not the de-trended one: de-trending takes 98 % of a burst's speed.
2. The level is the mean of the rest before; within a burst the gyroscopes carry it on, gravity does not correct it.
3. Segments come from this program's own recogniser: a chart over the whole record and k-means find the right four in
   one record of twenty.
4. CVM holds the speed, (17) with a = 0 and no measurement: with (16) it would integrate noise for half a minute.
5. The speed is the mean over the end of the start burst, when it no longer rings: an instant holds vibration, too.
6. v = 0 after the stop is used: what the stop burst lost is a second measurement of the speed, and both are averaged.
"""

from __future__ import annotations

import numpy as np

from estimation.arrays import FloatArray
from estimation.methods.attitude import attitudes
from estimation.methods.batch import Batch, Course, Span, kinds_of
from estimation.methods.integrate import integral
from estimation.orientation import IDENTITY, corrected, matrix

START_S, STOP_S = 0.7, 0.6
RINGS_S = 0.4  # after either beginning; from then on the speed is averaged
LEAD_S = 0.05  # before an onset or a stop as found
REST_S, CRUISE_S = 5.0, 2.0  # averaged for the level before a burst
GYRO_REST_S = 10.0


def corrected_c(batch: Batch, *, both_bursts: bool = True) -> Course:
    """Speed from the bursts, held in between."""
    n = len(batch.t_s)
    p, v, a = np.full(n, batch.start_m), np.zeros(n), np.zeros(n)
    place_m, rests_s = batch.start_m, 0.0
    for move in batch.moves:
        rest = (batch.t_s >= max(rests_s, move.onset_s - GYRO_REST_S)) & (batch.t_s < move.onset_s - LEAD_S)
        bias = batch.gyro[rest].mean(axis=0) if rest.any() else np.zeros(3)
        rest_s = min(move.onset_s - LEAD_S - rests_s, REST_S)
        start = _burst(batch, move.onset_s, START_S, rest_s, bias)
        stop = _burst(batch, move.stop_s, STOP_S, None, bias)
        speed = _late_mean(batch.t_s[start[0]], start[1][1], move.onset_s)
        if both_bursts:
            speed = 0.5 * (speed - _late_mean(batch.t_s[stop[0]], stop[1][1], move.stop_s))
        _follow(batch, move, speed, (start, stop), (p, v, a), place_m)
        place_m, rests_s = float(p[stop[0].stop - 1]), move.stop_s + STOP_S
        p[stop[0].stop :] = place_m
    kind = kinds_of(batch.t_s, batch.moves, START_S, STOP_S)
    return Course(p, v, a, kind, batch.moves)


_Burst = tuple[slice, tuple[FloatArray, FloatArray]]


def _follow(
    batch: Batch,
    move: Span,
    speed: float,
    bursts: tuple[_Burst, _Burst],
    out: tuple[FloatArray, FloatArray, FloatArray],
    place_m: float,
) -> None:
    """VVM, CVM, VVM into p, v, a: each burst leads between zero and the speed, a ramp taking up what it misses."""
    p, v, a = out
    (first, (a_first, v_first)), (last, (a_last, v_last)) = bursts
    t_s = batch.t_s
    v[first.start : last.stop] = speed
    v[first] = _ending_at(t_s[first], v_first, speed, move.onset_s)
    v[last] = speed + _ending_at(t_s[last], v_last, -speed, move.stop_s)
    a[first], a[last] = a_first, a_last
    during = slice(first.start, last.stop)
    p[during] = place_m + integral(v[during], t_s[during])


def _ending_at(t_s: FloatArray, velocity: FloatArray, end: float, begin_s: float) -> FloatArray:
    """A burst's velocity with a ramp added, so that its late mean is `end`."""
    ramp = np.clip((t_s - begin_s) / RINGS_S, 0.0, 1.0)
    return np.asarray(velocity + ramp * (end - _late_mean(t_s, velocity, begin_s)))


def _late_mean(t_s: FloatArray, velocity: FloatArray, begin_s: float) -> float:
    late = t_s >= begin_s + RINGS_S
    return float(velocity[late].mean()) if late.any() else float(velocity[-1])


def _burst(batch: Batch, begin_s: float, length_s: float, rest_s: float | None, gyro_bias: FloatArray) -> _Burst:
    """Acceleration and its integral through one burst, levelled before it, by the gyroscopes within.

    rest_s: of the rest before a start, where nothing turns. A stop is levelled by the cruise before it, since even
    speed feels like rest; there the gyroscopes carry the level from the beginning.
    """
    t_s = batch.t_s
    level_s = CRUISE_S if rest_s is None else rest_s
    edges = np.searchsorted(t_s, (begin_s - LEAD_S - level_s, begin_s - LEAD_S, begin_s + length_s))
    before, begin, end = (int(edge) for edge in np.clip(edges, (0, 1, 3), len(t_s)))
    begin = min(begin, end - 2)
    before = min(before, begin - 1)
    carried = slice(before if rest_s is None else begin, end)
    never = np.zeros(end - carried.start, dtype=np.bool_)
    turn = attitudes(t_s[carried], batch.accel[carried], batch.gyro[carried] - gyro_bias, never, 1.0)
    turned = np.einsum("ijk,ik->ij", turn, batch.accel[carried])
    level = batch.accel[before:begin].mean(axis=0) if rest_s is not None else turned[: begin - before].mean(axis=0)
    upright = np.array(matrix(corrected(IDENTITY, (float(level[0]), float(level[1]), float(level[2])), 1.0)))[1]
    push = np.asarray((turned[begin - carried.start :] - level) @ upright, dtype=np.float64)
    window = slice(begin, end)
    return window, (push, integral(push, t_s[window]))
