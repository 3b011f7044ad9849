"""Spectrum of the vibration, measured where the ram stands still or runs evenly: what hides a step in speed."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from itertools import pairwise
from math import sqrt

import numpy as np

from estimation.arrays import Array, FloatArray
from estimation.noise import hidden_covariance

WINDOW = 256  # blocks
DESIGN_BAND_HZ = (5.0, 60.0)  # assumed before anything has been measured
BAND_EDGES_HZ = (1.5, 3.0, 5.0, 10.0, 20.0, 35.0)
MEMORY_WINDOWS = 24.0
DESIGN_WEIGHT = 1.5  # windows that the assumption counts for
LEAST_SHARE = 2.0  # of the sensor noise's power: a weaker vibration has no shape worth knowing
NOISE_SCATTER = 2.0  # over the root of the windows: what the noise's own periodogram may lie above its mean
WHITE_SECOND_DIFFERENCE = 6.0  # mean square of the second difference of white noise, per mean square


@dataclass(slots=True)
class VibrationSpectrum:
    """Running mean of Hann periodograms of 256 blocks of levelled acceleration, white sensor noise taken off."""

    dt_s: float
    power: Array = field(default_factory=lambda: np.zeros(0))  # per bin, mean square acceleration, [m^2/s^4]
    windows: float = 0.0

    def __post_init__(self) -> None:
        if not len(self.power):
            self.power = np.zeros(WINDOW // 2 + 1)
        if self.power.shape != (WINDOW // 2 + 1,):
            raise ValueError("spectrum of another length")

    def learn(self, levelled_m_s2: FloatArray) -> None:
        """Take one window (256,) of undisturbed levelled acceleration in."""
        hann, trend = _window()
        x = levelled_m_s2 - trend @ (trend.T @ levelled_m_s2)
        power = _bins(np.abs(np.fft.rfft(hann * x)) ** 2)
        self.windows += 1.0
        gain = 1.0 / min(self.windows, MEMORY_WINDOWS)
        self.power += gain * (power - self.power)

    def shape(self) -> FloatArray:
        """Share of each bin (129,) in the vibration's mean square; sums to one."""
        noise = _sensor_noise(self.dt_s)
        allowance = 1.0 + NOISE_SCATTER / sqrt(max(min(self.windows, MEMORY_WINDOWS), 1.0))
        vibration = np.maximum(self.power - allowance * noise, 0.0)
        total = float(vibration.sum())
        design = _design_shape(self.dt_s)
        if self.windows < 1.0 or total < LEAST_SHARE * float(noise.sum()):
            return design
        share = self.windows / (self.windows + DESIGN_WEIGHT)
        return np.asarray(share * vibration / total + (1.0 - share) * design)

    def band_shares(self) -> list[float]:
        """Shares of the power in a few bands; a step of the ram lies in the lower ones."""
        shape = self.shape()
        edges = [0, *(round(f_hz * self.dt_s * WINDOW) for f_hz in BAND_EDGES_HZ), len(shape)]
        return [float(shape[low:high].sum()) for low, high in pairwise(min(e, len(shape)) for e in edges)]

    def lags(self, n: int) -> FloatArray:
        """Autocovariance (n,) of the block means of unit vibration, at lags of 0 to n - 1 blocks.

        Of the part that blocks do not average out, that is: like that of the assumed band, whatever the band.
        """
        shape = self.shape()
        if shape is _design_shape(self.dt_s):
            return design_lags(self.dt_s, n)
        # The spectrum is drawn finer first: a Hann window makes it smooth enough for straight lines.
        fine = np.interp(np.linspace(0.0, 1.0, 4 * (len(shape) - 1) + 1), np.linspace(0.0, 1.0, len(shape)), shape)
        fine[1:-1] *= 0.5
        lags = np.fft.irfft(fine)[:n]
        return np.asarray(lags / lags[0] * design_lags(self.dt_s, 1)[0])

    def second_difference_gain(self) -> float:
        """Mean square of the second difference of such vibration, per mean square of it."""
        angle = np.linspace(0.0, np.pi, WINDOW // 2 + 1)
        gain = float(self.shape() @ (2.0 - 2.0 * np.cos(angle)) ** 2 * design_lags(self.dt_s, 1)[0])
        return max(gain, 0.5)  # long blocks average the vibration out: what is left tells little of it


@lru_cache(maxsize=1)
def _window() -> tuple[FloatArray, FloatArray]:
    """Hann window (256,), and an orthonormal basis (256, 2) of level and drift."""
    hann = 0.5 - 0.5 * np.cos(2.0 * np.pi * (np.arange(WINDOW) + 0.5) / WINDOW)
    trend, _ = np.linalg.qr(np.column_stack([np.ones(WINDOW), np.arange(WINDOW) - 0.5 * (WINDOW - 1)]))
    return hann, trend


def _bins(squares: FloatArray) -> FloatArray:
    """Periodogram (129,) from the squared Fourier coefficients of a Hann window; white noise sums to its variance."""
    hann, _ = _window()
    power = squares / (WINDOW * np.sum(hann**2))
    power[1:-1] *= 2.0
    return np.asarray(power)


@lru_cache(maxsize=4)
def _sensor_noise(dt_s: float) -> FloatArray:
    """Mean periodogram of what hides a step at rest in perfect calm."""
    hann, trend = _window()
    keep = hann[:, None] * (np.eye(WINDOW) - trend @ trend.T)
    fourier = np.fft.rfft(keep, axis=0)
    covariance = hidden_covariance(WINDOW, dt_s)
    return _bins(np.einsum("ki,ij,kj->k", fourier, covariance, fourier.conj(), optimize=True).real)


@lru_cache(maxsize=4)
def design_lags(dt_s: float, n: int) -> FloatArray:
    """Band noise averaged over blocks of `dt_s`, unit variance before the averaging."""
    f = np.linspace(*DESIGN_BAND_HZ, 400)
    averaged = np.sinc(f * dt_s) ** 2
    return np.array([np.mean(averaged * np.cos(2 * np.pi * f * dt_s * k)) for k in range(n)])


@lru_cache(maxsize=4)
def _design_shape(dt_s: float) -> FloatArray:
    """The same as shares of bins: what lies beyond half the block rate is folded back."""
    shape = np.zeros(WINDOW // 2 + 1)
    for f in np.linspace(*DESIGN_BAND_HZ, 2000):
        folded = abs(f * dt_s - round(f * dt_s))
        shape[round(folded * WINDOW)] += np.sinc(f * dt_s) ** 2
    return np.asarray(shape / shape.sum())
