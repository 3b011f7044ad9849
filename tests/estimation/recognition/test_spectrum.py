"""Spectrum of the vibration as measured, against processes whose autocovariance is known."""

from __future__ import annotations

import numpy as np
import pytest

from estimation.arrays import RollingWindow
from estimation.noise import ACCEL_NOISE, hidden_covariance
from estimation.recognition.spectrum import WINDOW, VibrationSpectrum, design_lags
from tests.estimation.support import Floats

DT_S = 8 / 819.2


def band_noise(rng: np.random.Generator, n: int, low_hz: float, high_hz: float, rms: float) -> Floats:
    spectrum = np.fft.rfft(rng.normal(size=n))
    f = np.fft.rfftfreq(n, DT_S)
    spectrum[(f < low_hz) | (f > high_hz)] = 0.0
    noise = np.fft.irfft(spectrum, n)
    return np.asarray(rms * noise / np.std(noise))


def learned(noise: Floats, white: bool = True) -> VibrationSpectrum:
    spectrum = VibrationSpectrum(DT_S)
    rng = np.random.default_rng(1)
    felt = noise + white * rng.normal(0.0, ACCEL_NOISE / np.sqrt(DT_S), len(noise))
    for begin in range(0, len(felt) - WINDOW, WINDOW // 2):
        spectrum.learn(felt[begin : begin + WINDOW])
    return spectrum


def test_lags_are_the_autocovariance_of_the_band() -> None:
    rng = np.random.default_rng(2)
    low, high = 8.0, 20.0
    found = learned(band_noise(rng, 8000, low, high, 0.3)).lags(200)
    k = np.arange(200) * DT_S
    # Of a flat band: sin(w2 t) - sin(w1 t) over (w2 - w1) t.
    true = (high * np.sinc(2 * high * k) - low * np.sinc(2 * low * k)) / (high - low)
    scale = design_lags(DT_S, 1)[0]
    assert np.abs(found / scale - true).max() < 0.15  # 60 windows of half overlap, a twelfth of it design


def test_white_noise_and_slow_wander_are_no_vibration() -> None:
    rng = np.random.default_rng(3)
    root = np.linalg.cholesky(hidden_covariance(WINDOW, DT_S))
    spectrum = VibrationSpectrum(DT_S)
    for _ in range(40):
        spectrum.learn(root @ rng.normal(size=WINDOW))
    assert np.array_equal(spectrum.lags(300), design_lags(DT_S, 300))


def test_power_below_the_assumed_band_is_noticed() -> None:
    rng = np.random.default_rng(4)
    shaking = learned(band_noise(rng, 4000, 2.0, 45.0, 0.2))
    assumed = VibrationSpectrum(DT_S)
    assert sum(shaking.band_shares()) == pytest.approx(1.0)
    assert sum(assumed.band_shares()) == pytest.approx(1.0)
    assert shaking.band_shares()[1] + shaking.band_shares()[2] > 0.05  # 1.5 to 5 Hz
    assert sum(assumed.band_shares()[:2]) < 0.01


def test_second_difference_gain_is_that_of_the_process() -> None:
    rng = np.random.default_rng(5)
    noise = band_noise(rng, 20_000, 5.0, 25.0, 0.25)
    gain = learned(noise).second_difference_gain() / design_lags(DT_S, 1)[0]
    assert np.mean(np.diff(noise, 2) ** 2) / np.var(noise) == pytest.approx(gain, rel=0.1)


def test_windows_of_another_length_are_refused() -> None:
    with pytest.raises(ValueError, match="spectrum of another length"):
        VibrationSpectrum(DT_S, np.zeros(7))


def test_a_rolling_window_is_the_last_values_in_order() -> None:
    window = RollingWindow(np.zeros(5))
    for i in range(1, 24):
        window.add(float(i))
        expected = [float(max(j, 0)) for j in range(i - 4, i + 1)]
        assert window.values.tolist() == expected
