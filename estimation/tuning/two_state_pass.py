"""Paper A's filter, eq. (1)-(6), over a record for many candidates of Q and R at once, exactly; and a quicker scan.

The estimate depends on q/r alone (P_0 = 0), so a candidate is a ratio, with R = 1; the size of both follows from the
innovations.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import log
from typing import TypeVar

import numpy as np

from estimation.arrays import FloatArray
from estimation.tuning.observed import Observed

Number = TypeVar("Number", float, FloatArray)
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
    if len(ratio) <= FEW:
        sums = np.array([_run(observed, one, 0.0, log) for one in ratio.tolist()])
        return Fit(len(observed.y), *sums.T)
    return Fit(len(observed.y), *_run(observed, ratio, np.zeros(len(ratio)), np.log))


def innovations(observed: Observed, ratio: float) -> tuple[FloatArray, FloatArray]:
    """Innovations (n,) and their variances for R = 1, (n,)."""
    kept: list[tuple[float, float]] = []
    _run(observed, ratio, 0.0, log, kept)
    e, s = np.array(kept).T
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


def _run(
    observed: Observed,
    ratio: Number,
    zero: Number,
    log_of: Callable[[Number], Number],
    kept: list[tuple[Number, Number]] | None = None,
) -> tuple[Number, Number, Number]:
    """Sums of squared errors, of e^2/s, of log s, for one ratio or an array of them; `kept` collects e and s."""
    p = v = ppp = ppv = pvv = squares = weighted = log_s = zero
    product = zero + 1.0
    truth = [float("nan")] * len(observed.y) if observed.truth is None else observed.truth.tolist()
    columns = (observed.dt_s, observed.added, observed.noise, observed.y)
    rows = zip(*(column.tolist() for column in columns), truth, strict=True)
    for k, (dt, (dp, dv), (gpp, gpv, gvv), y, true) in enumerate(rows):
        p = p + (dt * v + dp)  # (1), (13)
        v = v + dv
        ppp = ppp + (2 * dt) * ppv + (dt * dt) * pvv + gpp * ratio  # (2)
        ppv = ppv + dt * pvv + gpv * ratio
        pvv = pvv + gvv * ratio
        s = ppp + 1.0
        e = y - p
        kp, kv = ppp / s, ppv / s  # (4)
        p = p + kp * e  # (5)
        v = v + kv * e
        pvv = pvv - kv * ppv  # (6)
        ppv = ppv - kp * ppv
        ppp = ppp / s
        squares = squares + (p - true) * (p - true)
        weighted = weighted + e * (e / s)
        product = product * s
        if k % STEPS_PER_LOG == STEPS_PER_LOG - 1:
            log_s, product = log_s + log_of(product), zero + 1.0
        if kept is not None:
            kept.append((e, s))
    return squares, weighted, log_s + log_of(product)
