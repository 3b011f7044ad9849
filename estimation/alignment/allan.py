"""Noise of a sensor at rest by its overlapping Allan deviation (IEEE Std 952-1997, annex C)."""

from __future__ import annotations

from dataclasses import dataclass
from math import log, nan, pi, sqrt

import numpy as np
from numpy.typing import NDArray

from estimation.arrays import FloatArray

PER_DECADE = 8  # cluster sizes
LEAST_SAMPLES = 30
LEAST_CLUSTERS = 9  # behind a figure: a deviation of fewer is off by a quarter and more
FLICKER = sqrt(2 * log(2) / pi)  # floor of the deviation / bias instability: 0.664
SLOPE_TOLERANCE = 0.1  # of the white slope -1/2, beside the statistical one
SPREAD = 1.6  # sigma of N over that of the first deviation used: two unknowns; from simulated records
HALF_SPAN = 2  # cluster sizes to either side of one, for its slope: half a decade altogether


@dataclass(frozen=True)
class AllanCurve:
    """Allan deviation of a rate over the averaging time; k cluster sizes."""

    tau_s: FloatArray  # (k,), increasing
    deviation: FloatArray  # (k,) [unit of the rate]
    clusters: NDArray[np.int64]  # (k,) that do not overlap: samples // cluster size

    @property
    def relative_sigma(self) -> FloatArray:
        """One sigma of each deviation as a share of it (k,).

        IEEE Std 952, annex C: 1 / sqrt(2 (clusters - 1)). It holds for clusters that do not overlap; ours do and are
        a little better.
        """
        return np.asarray(1 / np.sqrt(2.0 * (self.clusters - 1)))


@dataclass(frozen=True)
class WhiteNoise:
    """White noise of a rate: its random walk once integrated."""

    density: float  # N [unit of the rate x sqrt(s)]: the deviation at 1 s
    sigma: float  # of N
    from_s: float  # averaging times between which the slope is -1/2
    to_s: float


@dataclass(frozen=True)
class BiasInstability:
    """Floor of the Allan deviation / 0.664; an upper bound if the record ends before the floor."""

    value: float  # [unit of the rate]; with its sigma added if it is only a bound
    tau_s: float  # where it was read
    reached: bool  # whether the deviation rises again behind it


@dataclass(frozen=True)
class Noise:
    """What the Allan deviation of one axis tells."""

    curve: AllanCurve
    white: WhiteNoise | None  # None: no slope of -1/2 anywhere, or no noise at all
    instability: BiasInstability | None  # None: the signal is constant, or the record too short for any
    held: float  # share of the samples that have the most frequent value, if that is more than half of them

    @property
    def constant(self) -> bool:
        """Whether all samples are the same: a dead band, or a dead sensor."""
        return self.held == 1.0


def cluster_sizes(samples: int) -> NDArray[np.int64]:
    """Cluster sizes, about `PER_DECADE` a decade, from one sample to a third of the record."""
    largest = samples // 3
    steps = int(np.log10(largest) * PER_DECADE)
    return np.unique(np.rint(10 ** (np.arange(steps + 1) / PER_DECADE)).astype(np.int64))


def allan_curve(rate: FloatArray, period_s: float) -> AllanCurve:
    """Overlapping Allan deviation.

    Args:
        rate: (n,) samples of a rate or specific force, evenly spaced.
        period_s: between two samples [s].

    Raises:
        ValueError: there are too few samples, or they are not finite.
    """
    count = len(rate)
    if count < LEAST_SAMPLES:
        raise ValueError(f"{count} samples are too few: {LEAST_SAMPLES} at least")
    if not (period_s > 0 and np.isfinite(rate).all()):
        raise ValueError("rate and period must be finite, the period above 0 s")
    sizes = cluster_sizes(count)
    # The first sample goes before the mean: a constant must become zero exactly.
    less = rate - rate[0]
    angle = np.concatenate([[0.0], np.cumsum(less - less.mean())]) * period_s
    deviation = np.empty(len(sizes))
    for i, size in enumerate(sizes.tolist()):
        change = angle[size:] - angle[:-size]
        difference = change[size:] - change[:-size]
        deviation[i] = sqrt(float(difference @ difference) / (2 * len(difference))) / (size * period_s)
    return AllanCurve(np.asarray(sizes * period_s, dtype=np.float64), deviation, count // sizes)


def noise_of(rate: FloatArray, period_s: float) -> Noise:
    """Noise of one axis; arguments and errors as for `allan_curve`."""
    curve = allan_curve(rate, period_s)
    held = float(np.mean(rate == np.median(rate)))
    if held == 1.0:
        return Noise(curve, None, None, held)
    white = white_noise(curve)
    return Noise(curve, white, bias_instability(curve, 0.0 if white is None else white.from_s), held)


def white_noise(curve: AllanCurve) -> WhiteNoise | None:
    """The longest stretch of averaging times where the slope is -1/2 within its doubt, and the line through it.

    A filter in the sensor, vibration or quantisation bend the curve at short times, bias drift at long ones.
    None if no such stretch is half a decade long.
    """
    holds = np.abs(slopes(curve) + 0.5) <= SLOPE_TOLERANCE + curve.relative_sigma  # NaN: does not
    holds &= curve.clusters >= LEAST_CLUSTERS
    edges = np.flatnonzero(np.diff(np.concatenate([[False], holds, [False]]).astype(np.int8)))
    runs = [(begin, end) for begin, end in edges.reshape(-1, 2).tolist() if end - begin > 2 * HALF_SPAN]
    if not runs:
        return None
    begin, end = max(runs, key=lambda run: float(curve.tau_s[run[1] - 1] / curve.tau_s[run[0]]))
    inside = slice(begin, end)
    tau_s, share = curve.tau_s[inside], curve.relative_sigma[inside]
    # variance x tau = N^2 + D / tau: D is what a filter (below 0) or quantisation (above 0) has left at short times.
    scaled = curve.deviation[inside] ** 2 * tau_s
    weight = 1 / share
    terms = np.stack([weight, weight / tau_s], axis=1)
    square = float(np.linalg.lstsq(terms, weight * scaled)[0][0])
    if not square > 0:
        return None
    # Averages over longer times are made of the same samples: no better together than those over the shortest.
    density = sqrt(square)
    return WhiteNoise(density, SPREAD * density * float(share[0]), float(tau_s[0]), float(tau_s[-1]))


def slopes(curve: AllanCurve) -> FloatArray:
    """Slope of the curve on logarithmic axes (k,), over half a decade around each size; NaN near the ends."""
    found = np.full(len(curve.tau_s), nan)
    for i in range(HALF_SPAN, len(found) - HALF_SPAN):
        around = slice(i - HALF_SPAN, i + HALF_SPAN + 1)
        if (curve.deviation[around] > 0).all():
            found[i] = np.polyfit(np.log(curve.tau_s[around]), np.log(curve.deviation[around]), 1)[0]
    return found


def bias_instability(curve: AllanCurve, from_s: float = 0.0) -> BiasInstability | None:
    """The floor behind `from_s`: before it a filter may have taken noise away.

    It is reached if the curve rises behind it by more than both ends are uncertain.
    """
    usable = np.flatnonzero((curve.clusters >= LEAST_CLUSTERS) & (curve.tau_s >= from_s))
    if not len(usable):
        return None
    at = int(usable[np.argmin(curve.deviation[usable])])
    share = curve.relative_sigma
    floor = float(curve.deviation[at] * (1 + share[at]))
    behind = curve.deviation[at + 1 :] * (1 - share[at + 1 :])
    reached = bool((behind > floor).any())
    value = float(curve.deviation[at]) if reached else floor
    return BiasInstability(value / FLICKER, float(curve.tau_s[at]), reached)
