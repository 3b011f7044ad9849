from __future__ import annotations

import math
from dataclasses import fields, replace

import numpy as np
import pytest

from drivers.virtual.adis16448_signal import CHANNELS, HISTORY, FilterPath
from drivers.virtual.sensor_errors import SensorErrors, SensorGrade

DT = 1 / 819.2
MILLI_G = 9.80665e-3
NOTHING = SensorGrade(**{f.name: 0.0 for f in fields(SensorGrade) if f.name != "drift_time_s"})


def rest(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return np.zeros((count, 3)), np.tile([0.0, 0.0, 9.80665], (count, 1)), np.full(count, 25.0)


def test_a_perfect_grade_changes_nothing() -> None:
    gyro, accel, temperature = rest(50)
    sensed = SensorErrors(np.random.default_rng(1), NOTHING).apply(DT, gyro, accel, temperature)
    assert np.array_equal(sensed[0], gyro)
    assert np.array_equal(sensed[1], accel)


def test_the_white_noise_of_a_sample_is_that_of_the_data_sheet() -> None:
    grade = replace(
        NOTHING,
        accel_noise_density=SensorGrade().accel_noise_density,
        gyro_noise_density=SensorGrade().gyro_noise_density,
    )
    gyro, accel, temperature = rest(40_000)
    sensed_gyro, sensed_accel = SensorErrors(np.random.default_rng(2), grade).apply(DT, gyro, accel, temperature)
    assert np.std(sensed_accel - accel, axis=0) / MILLI_G == pytest.approx(4.65, rel=0.02)
    assert np.degrees(np.std(sensed_gyro, axis=0)) == pytest.approx(0.273, rel=0.02)


def test_chunks_and_one_go_give_the_same_numbers() -> None:
    gyro, accel, temperature = rest(3000)
    whole = SensorErrors(np.random.default_rng(3)).apply(DT, gyro, accel, temperature)
    errors = SensorErrors(np.random.default_rng(3))
    parts = [
        errors.apply(DT, gyro[a:b], accel[a:b], temperature[a:b])
        for a, b in [(0, 1), (1, 82), (82, 700), (700, 701), (701, 3000)]
    ]
    np.testing.assert_allclose(np.concatenate([p[0] for p in parts]), whole[0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(np.concatenate([p[1] for p in parts]), whole[1], rtol=0, atol=1e-12)


def test_two_runs_of_one_seed_are_equal_and_of_two_seeds_are_not() -> None:
    first, again, other = (SensorErrors(np.random.default_rng(seed)).apply(DT, *rest(100))[1] for seed in (4, 4, 5))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_turn_on_biases_scatter_as_the_grade_says() -> None:
    parts = [SensorErrors(np.random.default_rng(seed)) for seed in range(400)]
    accel = np.concatenate([part.accel_bias for part in parts]) / MILLI_G
    gyro = np.degrees(np.concatenate([part.gyro_bias for part in parts]))
    assert np.std(accel) == pytest.approx(20, rel=0.07)  # 2.4 sigma of the estimate from 1200 draws
    assert np.std(gyro) == pytest.approx(0.25, rel=0.07)
    assert abs(np.mean(accel)) < 3 * 20 / math.sqrt(1200)


def test_the_slow_drift_has_its_variance_and_its_correlation_time() -> None:
    grade = replace(NOTHING, accel_drift=1.0, gyro_drift=1.0, drift_time_s=2.0)
    gyro, accel, temperature = np.zeros((40_000, 3)), np.zeros((40_000, 3)), np.full(40_000, 25.0)
    drift = np.hstack(SensorErrors(np.random.default_rng(6), grade).apply(0.1, gyro, accel, temperature))
    # 4000 s are 2000 correlation times of six channels: the variance is known to about 1.3 %.
    assert np.var(drift) == pytest.approx(1.0, rel=0.05)
    for lag_s in (1.0, 2.0, 4.0):
        lag = round(lag_s / 0.1)
        correlation = np.mean(drift[:-lag] * drift[lag:])
        assert correlation == pytest.approx(math.exp(-lag_s / 2.0), abs=0.05)


def test_the_drift_is_straight_between_its_knots() -> None:
    grade = replace(NOTHING, accel_drift=1.0)
    gyro, accel, temperature = np.zeros((101, 3)), np.zeros((101, 3)), np.full(101, 25.0)
    drift = SensorErrors(np.random.default_rng(7), grade).apply(0.01, gyro, accel, temperature)[1]
    np.testing.assert_allclose(np.diff(drift[:11], 2, axis=0), 0.0, atol=1e-12)
    assert np.any(np.abs(np.diff(drift[5:16], 2, axis=0)) > 1e-9)


def test_scale_square_temperature_and_g_act_on_their_own_quantity() -> None:
    gyro, accel, temperature = rest(2)

    def shift(**grade: float) -> tuple[np.ndarray, np.ndarray]:
        errors = SensorErrors(np.random.default_rng(8), replace(NOTHING, **grade))
        one = errors.apply(DT, gyro, accel, temperature)
        two = errors.apply(DT, gyro, 2 * accel, temperature + 10)
        return two[0] - 2 * one[0], two[1] - 2 * one[1]

    gyro_shift, accel_shift = shift(accel_scale=0.005, gyro_per_accel=0.1)
    assert np.abs(gyro_shift).max() == pytest.approx(0, abs=1e-12)  # linear in force
    assert np.abs(accel_shift).max() == pytest.approx(0, abs=1e-12)
    assert np.abs(shift(accel_square=0.01)[1][:, 2]).min() > 1e-3  # not linear
    assert np.abs(shift(accel_per_degree=0.01)[1]).min() > 1e-3
    turning = SensorErrors(np.random.default_rng(9), replace(NOTHING, gyro_scale=0.005))
    sensed, _ = turning.apply(DT, gyro + 1.0, accel, temperature)
    assert 0 < np.abs(sensed - 1).max() < 0.025


@pytest.mark.parametrize(("taps", "decimation"), [(0, 0), (2, 0), (5, 3)])
def test_a_block_without_samples_changes_nothing_in_the_filter(taps: int, decimation: int) -> None:
    rng = np.random.default_rng(6)
    samples = rng.normal(size=(64, CHANNELS))
    plain, interrupted = (FilterPath(taps, decimation, np.zeros((HISTORY, CHANNELS))) for _ in range(2))
    rows, values = plain.feed(samples)
    first_rows, first = interrupted.feed(samples[:21])
    no_rows, nothing = interrupted.feed(samples[:0])
    last_rows, last = interrupted.feed(samples[21:])
    assert len(no_rows) == len(nothing) == 0
    assert np.array_equal(np.concatenate([first_rows, last_rows + 21]), rows)
    assert np.array_equal(np.concatenate([first, last]), values)
