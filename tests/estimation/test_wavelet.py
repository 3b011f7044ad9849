from __future__ import annotations

import numpy as np
import pytest
import pywt

from estimation.wavelet import TAPS, CausalSmoother


def smoothed(values: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> list[tuple[float, float, float]]:
    smoother, out = CausalSmoother(), []
    for x in values.tolist():
        smoother.add((x, -x, 2 * x))
        out.append(smoother.value())
    return out


def test_it_is_the_level_2_approximation_of_the_stationary_coiflet_transform() -> None:
    rng = np.random.default_rng(1)
    x = rng.normal(size=256)
    # Each swt level gains sqrt(2); its time origin is found with an impulse.
    impulse = np.zeros(256)
    impulse[100] = 1.0
    response = pywt.swt(impulse, "coif1", level=2)[0][0] / 2
    ahead = 100 - int(np.flatnonzero(np.abs(response) > 1e-12)[0])
    approximation = np.roll(pywt.swt(x, "coif1", level=2)[0][0] / 2, ahead)
    ours = np.array(smoothed(x))
    np.testing.assert_allclose(ours[len(TAPS) :, 0], approximation[len(TAPS) :], atol=1e-12)
    np.testing.assert_allclose(ours[:, 1], -ours[:, 0], atol=1e-15)
    np.testing.assert_allclose(ours[:, 2], 2 * ours[:, 0], atol=1e-15)


def test_a_constant_passes_unchanged_from_the_first_sample_on() -> None:
    for value in smoothed(np.full(40, 9.81)):
        assert value == pytest.approx((9.81, -9.81, 19.62), rel=1e-12)


def test_alternating_noise_is_removed() -> None:
    out = np.array(smoothed(np.resize([1.0, -1.0], 60)))
    assert np.abs(out[len(TAPS) :]).max() < 1e-12


def test_a_ramp_comes_eleven_milliseconds_late() -> None:
    rate_hz = 819.2
    out = np.array(smoothed(np.arange(100.0)))[:, 0]
    delay_s = (np.arange(100.0) - out)[50:] / rate_hz
    assert delay_s == pytest.approx(0.011, abs=0.0005)


def test_cleared_smoother_knows_no_past() -> None:
    smoother = CausalSmoother()
    for _ in range(20):
        smoother.add((1.0, 1.0, 1.0))
    smoother.clear()
    smoother.add((5.0, 6.0, 7.0))
    assert smoother.value() == pytest.approx((5.0, 6.0, 7.0))
