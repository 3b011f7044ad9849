from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimation.mount.stretch import BLOCK_S, Stretch
from tests.estimation.support import Floats


def joined(dt_s: Floats, accel: Floats) -> Stretch:
    return Stretch.from_blocks(5.0 + np.cumsum(dt_s), dt_s, accel, -accel)


@given(st.lists(st.floats(0.3 * BLOCK_S, 3 * BLOCK_S), min_size=10, max_size=40), st.integers(0, 2**32 - 1))
def test_cutting_anew_keeps_the_integral(lengths: list[float], seed: int) -> None:
    dt_s = np.array(lengths)
    accel = np.random.default_rng(seed).normal(size=(len(dt_s), 3))
    stretch = joined(dt_s, accel)
    assert np.diff(stretch.t_s) == pytest.approx(BLOCK_S)
    # What the grid does not reach is less than one of its blocks.
    left_s = 5.0 + dt_s.sum() - stretch.t_s[-1]
    assert 0 <= left_s < 1.001 * BLOCK_S
    total = (accel * dt_s[:, None]).sum(axis=0)
    assert np.abs(stretch.accel.sum(axis=0) * BLOCK_S - total).max() <= left_s * np.abs(accel).max() + 1e-12
    np.testing.assert_array_equal(stretch.gyro, -stretch.accel)


def test_a_ramp_stays_a_ramp_whatever_the_blocks() -> None:
    dt_s = np.random.default_rng(1).uniform(0.5 * BLOCK_S, 1.5 * BLOCK_S, 200)
    middle = np.cumsum(dt_s) - dt_s / 2
    stretch = joined(dt_s, np.outer(middle, [1.0, 2.0, -3.0]))
    expected = np.outer(stretch.t_s - 5.0 - BLOCK_S / 2, [1.0, 2.0, -3.0])
    # Within a block the ramp is a stair: off by no more than an eighth of the block, on each side.
    np.testing.assert_allclose(stretch.accel, expected, atol=3 * 1.5 * BLOCK_S / 4)


def test_vibration_is_measured_where_it_is_asked_for() -> None:
    # Band noise of 5 to 60 Hz at 1024 Hz, averaged over blocks of ten: quiet, then 0.3 m/s^2 rms from the middle on.
    rng, fine, n = np.random.default_rng(2), 10, 4000
    spectrum = np.fft.rfft(rng.normal(size=(n * fine, 3)), axis=0)
    f = np.fft.rfftfreq(n * fine, BLOCK_S / fine)
    inside = (f >= 5) & (f <= 60)
    spectrum[~inside] = 0.0
    noise = 0.3 * np.fft.irfft(spectrum, n * fine, axis=0) / np.sqrt(inside.mean())
    noise[: n * fine // 2] = 0.0
    accel = noise.reshape(n, fine, 3).mean(axis=1)
    stretch = Stretch(BLOCK_S * np.arange(1.0, n + 1), accel, np.zeros_like(accel))
    before, after = stretch.vibration(1000, 0)[n // 2 - 2], stretch.vibration(0, -1000)[n // 2]
    assert before == 0.0
    assert after == pytest.approx(0.3, rel=0.15)
