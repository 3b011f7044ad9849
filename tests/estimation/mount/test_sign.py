from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from estimation.mount.sign import odds_from_displacement, odds_from_speeds
from estimation.mount.velocity_steps import VelocityStep
from estimation.settings import SupportSettings
from tests.estimation.support import Floats

SUPPORT = SupportSettings()
PUSH, RETRACT = 0.01453, 0.03519
CYCLE = [PUSH, -PUSH, -RETRACT, RETRACT]
TIMES = [10.0, 18.0, 28.0, 31.4]
SURE = 7.0


def steps(
    sizes: Sequence[float], times: Sequence[float] | None = None, louder: Sequence[float] = ()
) -> list[VelocityStep]:
    times = times or [10.0 * k for k in range(len(sizes))]
    louder = louder or [1.0] * len(sizes)
    return [
        VelocityStep(t, np.array([0.0, size, 0.0]), 1e-3, ratio)
        for t, size, ratio in zip(times, sizes, louder, strict=True)
    ]


def by_speeds(sizes: Sequence[float], imu_on: str = "both", louder: Sequence[float] = ()) -> float:
    return odds_from_speeds(np.array(sizes), steps(sizes, louder=louder), SUPPORT, imu_on)  # type: ignore[arg-type]  # a literal


def readings(rng: np.random.Generator, until_s: float = 40.0) -> Floats:
    """A displacement sensor 15 times a second, 3.5 mm of noise, rounded to 1 mm, while the ram makes `CYCLE`."""
    t_s: Floats = np.arange(0.0, until_s, 1 / 15)
    truth = sum(size * np.maximum(t_s - at, 0.0) for at, size in zip(TIMES, CYCLE, strict=True))
    return np.column_stack([t_s, np.round(truth + rng.normal(0, 3.5e-3, len(t_s)), 3)])


def test_a_whole_cycle_tells_the_sign_by_its_speeds_and_the_mirrored_one_the_opposite() -> None:
    odds = by_speeds(CYCLE)
    assert odds > SURE
    assert by_speeds([-size for size in CYCLE]) == pytest.approx(-odds)


def test_a_burst_that_was_missed_does_not_turn_the_sign() -> None:
    for missing in range(8):
        cycle = CYCLE * 2
        del cycle[missing]
        assert by_speeds(cycle) > SURE


def test_pushes_alone_could_be_read_backwards_unless_vibration_tells_motion_from_rest() -> None:
    pushes = [PUSH, -PUSH] * 3
    assert abs(by_speeds(pushes, "link")) < SURE
    assert by_speeds(pushes, "link", louder=[8.0, 1 / 8] * 3) > SURE
    assert by_speeds(pushes, "link", louder=[1 / 8, 8.0] * 3) < -SURE


def test_a_sensor_on_the_base_feels_retracts_only() -> None:
    assert by_speeds([-RETRACT, RETRACT] * 3, "base", louder=[8.0, 1 / 8] * 3) > SURE


def test_steps_of_other_sizes_than_the_nominal_ones_tell_nothing() -> None:
    assert by_speeds([0.024, -0.024, -0.060, 0.060]) == 0.0
    assert by_speeds([0.020, -0.020, -0.030, 0.030]) == 0.0


def test_equal_speeds_both_ways_tell_nothing() -> None:
    support = SupportSettings(nominal_push_speed_mm_s=20, nominal_retract_speed_mm_s=20)
    sizes = [0.02, -0.02, -0.02, 0.02]
    assert odds_from_speeds(np.array(sizes), steps(sizes), support, "both") == pytest.approx(0.0, abs=1e-9)


def test_displacement_tells_the_sign_whatever_the_speeds() -> None:
    for seed in range(20):
        table = readings(np.random.default_rng(seed))
        assert odds_from_displacement(np.array(CYCLE), steps(CYCLE, TIMES), table) > SURE
        assert odds_from_displacement(-np.array(CYCLE), steps(CYCLE, TIMES), table) < -SURE


def test_displacement_that_is_missing_stuck_or_noise_tells_nothing() -> None:
    seen = steps(CYCLE, TIMES)
    sizes = np.array(CYCLE)
    t_s: Floats = np.arange(0.0, 40.0, 1 / 15)
    assert odds_from_displacement(sizes, seen, np.zeros((0, 2))) == 0.0
    assert odds_from_displacement(sizes, seen, readings(np.random.default_rng(0), until_s=9.0)) == 0.0
    assert odds_from_displacement(sizes, seen, np.column_stack([t_s, 0 * t_s])) == 0.0
    for seed in range(100):
        noise = np.random.default_rng(seed).normal(0.2, 0.1, len(t_s))
        assert abs(odds_from_displacement(sizes, seen, np.column_stack([t_s, noise]))) < SURE
