from __future__ import annotations

import numpy as np

from estimation.mount.stillness import WINDOW_S, stillness
from estimation.mount.stretch import BLOCK_S, Stretch
from tests.estimation.support import Floats


def stretch_of(accel: Floats, gyro: Floats, start_s: float = 0.0) -> Stretch:
    return Stretch(start_s + BLOCK_S * np.arange(1.0, len(accel) + 1), accel, gyro)


def rest(seconds: float, rng: np.random.Generator) -> tuple[Floats, Floats]:
    n = round(seconds / BLOCK_S)
    return rng.normal((0.0, 0.0, 9.8), 0.016, (n, 3)), rng.normal(0.0, np.radians(0.1), (n, 3))


def test_windows_in_which_the_sensor_is_turned_are_left_out() -> None:
    accel, gyro = rest(60.0, np.random.default_rng(1))
    tilt = np.radians(10) * np.clip((BLOCK_S * np.arange(len(accel)) - 20) / 8, 0, 1)
    accel += 9.8 * np.column_stack([np.zeros_like(tilt), np.sin(tilt), np.cos(tilt) - 1])
    still = stillness([stretch_of(accel, gyro)])
    assert ((still.t_s + WINDOW_S / 2 < 20.1) | (still.t_s - WINDOW_S / 2 > 27.9)).all()
    assert len(still) >= 9
    before = still.t_s < 20
    np.testing.assert_allclose(still.force[before], [[0, 0, 9.8]] * before.sum(), atol=0.005)


def test_gyro_bias_follows_a_drift_and_does_not_hear_the_moves() -> None:
    """A drift of 0.1 degree/s in ten minutes; while it vibrates, the sensor turns at 0.05 degree/s to and fro."""
    rng = np.random.default_rng(2)
    accel, gyro = rest(600.0, rng)
    t_s = BLOCK_S * np.arange(1.0, len(accel) + 1)
    bias = np.radians(0.1) * np.outer(t_s / 600, [1.0, -1.0, 0.5])
    moving = (t_s % 60) > 40
    gyro += bias + np.radians(0.05) * moving[:, None]
    accel[moving] += rng.normal(0.0, 0.1, (moving.sum(), 3))
    half = len(t_s) // 2
    parts = [stretch_of(accel[:half], gyro[:half]), stretch_of(accel[half:], gyro[half:], t_s[half - 1])]
    error = np.degrees(stillness(parts).gyro_bias(t_s) - bias)[(t_s > 60) & (t_s < 540)]
    # The kernels allow a drift of 1.5 mm/s^3, which is 0.0088 degree/s.
    assert np.sqrt(np.mean(error**2)) < 0.0088


def test_a_stretch_shorter_than_a_window_tells_nothing() -> None:
    for seconds in (0.0, BLOCK_S, 4.9):
        assert len(stillness([stretch_of(*rest(seconds, np.random.default_rng(3)))])) == 0
    assert len(stillness([])) == 0
