"""Paper A's filter, eq. (1)-(6), over a record for many candidates of Q and R at once, exactly; and a quicker scan.

The estimate depends on q/r alone (P_0 = 0), so a candidate is a ratio, with R = 1; the size of both follows from the
innovations.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import log
from typing import Any

import numpy as np

from estimation.arrays import FloatArray
from estimation.tuning import compiled
from estimation.tuning.observed import Observed

FEW = 12  # candidates: so few are done one by one, plain floats are as fast as arrays of this size
STEPS_PER_LOG = 8  # variances multiplied before a logarithm is taken: it costs as much as the rest of a step


@dataclass(frozen=True)
class Fit:
    """Sums over the readings of one record, or several, for each candidate: (m,) each."""

    readings: int
    squares: FloatArray  # (posterior position - truth)^2; NaN without a truth
    weighted: FloatArray  # e^2/s of the innovations, with R = 1
    log_s: FloatArray

    @property
    def mse(self) -> FloatArray:
        """Mean squared error against the truth."""
        return self.squares / self.readings

    @property
    def r(self) -> FloatArray:
        """R by which the mean of e^2/s becomes one, the likeliest; Q = ratio R."""
        return self.weighted / self.readings

    @property
    def deviance(self) -> FloatArray:
        """-2 log likelihood with that R, but for a constant: concentrated."""
        with np.errstate(divide="ignore"):
            return np.asarray(self.readings * np.log(self.r) + self.log_s)

    def __add__(self, other: Fit) -> Fit:
        return Fit(
            self.readings + other.readings,
            self.squares + other.squares,
            self.weighted + other.weighted,
            self.log_s + other.log_s,
        )


def exact(observed: Observed, ratio: FloatArray) -> Fit:
    """The filter itself for ratios (m,)."""
    if len(ratio) > FEW and not compiled.wanted(len(ratio)):
        columns = (observed.dt_s.tolist(), observed.added.tolist(), observed.noise.tolist(), observed.y.tolist())
        sums = _many(*columns, _truth(observed).tolist(), ratio, np.zeros(len(ratio)), _NOTHING, _NOTHING)
        return Fit(len(observed.y), *sums)
    columns, run = _run_of(observed, len(ratio))
    each = np.array([run(*columns, one, 0.0, _NOTHING, _NOTHING) for one in ratio.tolist()])
    return Fit(len(observed.y), *each.T)


def innovations(observed: Observed, ratio: float) -> tuple[FloatArray, FloatArray]:
    """Innovations (n,) and their variances for R = 1, (n,)."""
    e, s = np.empty(len(observed.y)), np.empty(len(observed.y))
    columns, run = _run_of(observed, 1)
    run(*columns, ratio, 0.0, e, s)
    return e, s


def estimate(observed: Observed, ratio: float) -> FloatArray:
    """Posterior positions (n,) at the readings."""
    e, s = innovations(observed, ratio)
    return np.asarray(observed.y - e / s)  # p + k e with k = 1 - 1/s


def scan(observed: Observed, ratio: FloatArray) -> Fit:
    """The same with the settled gain from the first step on, for records of even steps: quick, not quite exact.

    What the input alone makes of the motion is no candidate's business: it is taken off once, and a fixed linear filter
    of the rest gives the innovations, E(z) (1 - 2/z + 1/z^2) = A(z) e.
    """
    from scipy.signal import lfilter

    dt = float(observed.dt_s[0])
    v = np.cumsum(observed.added[:, 1])
    rest = observed.y - np.cumsum(observed.added[:, 0] + dt * np.concatenate([[0.0], v[:-1]]))
    sums = np.empty((3, len(ratio)))
    for i, (s, k0, k1) in enumerate(zip(*steady_gain(observed, ratio), strict=True)):
        e = lfilter([1.0, -2.0, 1.0], [1.0, k0 + dt * k1 - 2.0, 1.0 - k0], rest)
        squares = ((observed.y - e / s - observed.truth) ** 2).sum() if observed.truth is not None else np.nan
        sums[:, i] = squares, (e @ e) / s, len(e) * log(s)
    return Fit(len(observed.y), *sums)


def steady_gain(observed: Observed, ratio: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Variance of the innovation for R = 1, gains of position and velocity, once they have settled, (m,) each.

    With the posterior's entries written as gains, the Riccati equation becomes a quartic in u = sqrt(1 - k0) that reads
    the same forwards and backwards, hence a quadratic in z = u + 1/u. For q B B^T it is Kalata's tracking index.
    """
    dt = float(observed.dt_s[0])
    pp, pv, vv = (ratio * unit for unit in observed.noise[0])
    g = dt * np.sqrt(vv)
    z = (g + np.sqrt(g * g + 4.0 * (4.0 + pp - pv * dt))) / 2.0
    u = (z - np.sqrt(z * z - 4.0)) / 2.0
    return 1.0 / (u * u), 1.0 - u * u, np.sqrt(vv) * u


def _truth(observed: Observed) -> FloatArray:
    return np.full(len(observed.y), np.nan) if observed.truth is None else observed.truth


def _run_of(observed: Observed, candidates: int) -> tuple[tuple[Any, ...], Callable[..., Any]]:
    """Columns of the record and the run for one ratio: compiled from arrays, or plain from lists."""
    columns = (observed.dt_s, observed.added, observed.noise, observed.y, _truth(observed))
    if compiled.wanted(candidates):
        return columns, compiled.of(_one)
    return tuple(column.tolist() for column in columns), _one


def _run_with(log_of: Callable[[Any], Any]) -> Callable[..., Any]:
    """The filter along a record: for one ratio (floats), for many at once (arrays), or to be compiled.

    Gives the sums of squared errors, of e^2/s and of log s; `e_out` and `s_out`, where they are not empty, get e and s.
    """

    def run(  # type: ignore[no-untyped-def]  # floats, arrays, or what a compiler makes of them
        dt_s, added, noise, seen, truth, ratio, zero, e_out, s_out
    ):
        p = v = ppp = ppv = pvv = squares = weighted = log_s = zero
        product = zero + 1.0
        for k in range(len(dt_s)):
            dt = dt_s[k]
            p = p + (dt * v + added[k][0])  # (1), (13)
            v = v + added[k][1]
            ppp = ppp + (2 * dt) * ppv + (dt * dt) * pvv + noise[k][0] * ratio  # (2)
            ppv = ppv + dt * pvv + noise[k][1] * ratio
            pvv = pvv + noise[k][2] * ratio
            s = ppp + 1.0
            e = seen[k] - p
            kp, kv = ppp / s, ppv / s  # (4)
            p = p + kp * e  # (5)
            v = v + kv * e
            pvv = pvv - kv * ppv  # (6)
            ppv = ppv - kp * ppv
            ppp = ppp / s
            squares = squares + (p - truth[k]) * (p - truth[k])
            weighted = weighted + e * (e / s)
            product = product * s
            if k % STEPS_PER_LOG == STEPS_PER_LOG - 1:
                log_s, product = log_s + log_of(product), zero + 1.0
            if len(e_out):
                e_out[k] = e
                s_out[k] = s
        return squares, weighted, log_s + log_of(product)

    return run


_one, _many = _run_with(log), _run_with(np.log)
_NOTHING = np.empty(0)
