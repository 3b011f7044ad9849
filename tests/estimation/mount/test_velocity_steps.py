from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation

from estimation.mount.stretch import BLOCK_S, Stretch
from estimation.mount.velocity_steps import velocity_steps
from estimation.noise import ACCEL_NOISE
from tests.estimation.support import Floats, ramp_response

GRAVITY = np.array([0.0, 0.0, 9.80665])
GYRO_NOISE = np.radians(0.0135) / np.sqrt(2)  # rad/s/sqrt(Hz), two-sided
ONSET_S = 6.0


def stretch_with(velocity: Floats, turned: Floats, rng: np.random.Generator) -> Stretch:
    """A sensor that moves and turns, values at block ends (n + 1, 3), in the axes it has at the beginning."""
    force = np.diff(velocity, axis=0) / BLOCK_S + GRAVITY
    middle = Rotation.from_rotvec((turned[1:] + turned[:-1]) / 2)
    n = len(force)
    white = rng.normal(size=(2, n, 3)) / np.sqrt(BLOCK_S)
    return Stretch(
        BLOCK_S * np.arange(1.0, n + 1),
        middle.inv().apply(force) + ACCEL_NOISE * white[0],
        np.diff(turned, axis=0) / BLOCK_S + GYRO_NOISE * white[1],
    )


def step_of(change: Floats, seconds: float = 12.0) -> Floats:
    t_s: Floats = BLOCK_S * np.arange(round(seconds / BLOCK_S) + 1.0) - ONSET_S
    return np.outer(ramp_response(7.0, 0.17, 0.08, t_s) * (t_s > 0), change)


def test_steps_are_found_in_any_direction_with_honest_sigma_while_the_sensor_tilts() -> None:
    rng = np.random.default_rng(1)
    runs, across = 40, 0.0
    for _ in range(runs):
        heading = rng.uniform(0, 2 * np.pi)
        direction = np.array([np.cos(heading), np.sin(heading), 0.0])
        velocity = step_of(rng.choice([0.0145, 0.0352]) * direction)
        # A tilt of 0.1 degree that goes with the burst: 17 mm/s^2 of gravity, 9 mm/s half a second later.
        tilt = np.outer(np.clip((BLOCK_S * np.arange(len(velocity)) - ONSET_S) / 0.3, 0, 1), [1.0, -1.0, 0.3])
        stretch = stretch_with(velocity, np.radians(0.1) * tilt, rng)
        (step,) = velocity_steps(stretch, np.zeros(3))
        assert step.t_s == pytest.approx(ONSET_S, abs=0.05)
        assert step.change @ direction == pytest.approx(np.linalg.norm(velocity[-1]), rel=0.3)
        across += float(np.sum(np.cross(step.change, direction) ** 2)) / step.sigma**2
    # Two components across: chi-square of 80 degrees of freedom, sigma rather too large than too small.
    assert 0.4 * 2 * runs < across < stats.chi2.ppf(0.999, 2 * runs)


def test_gyro_bias_matters_and_is_taken_out() -> None:
    rng = np.random.default_rng(2)
    still = np.zeros((1500, 3))
    stretch = stretch_with(step_of(np.array([0.0, 0.0145, 0.0])), still[: len(step_of(np.zeros(3)))], rng)
    bias = np.radians([0.5, -0.3, 0.2])
    biased = Stretch(stretch.t_s, stretch.accel, stretch.gyro + bias)
    (with_bias,), (without,) = velocity_steps(biased, bias), velocity_steps(stretch, np.zeros(3))
    np.testing.assert_allclose(with_bias.change, without.change, atol=1e-6)


def test_nothing_is_found_in_rest_in_vertical_steps_or_while_the_sensor_is_turned() -> None:
    rng = np.random.default_rng(3)
    rest = np.zeros((round(120 / BLOCK_S), 3))
    assert velocity_steps(stretch_with(rest, rest, rng), np.zeros(3)) == []
    up = step_of(np.array([0.0, 0.001, 0.05]))
    assert velocity_steps(stretch_with(up, np.zeros_like(up), rng), np.zeros(3)) == []
    push = step_of(np.array([0.0, 0.0352, 0.0]))
    turn = np.outer(np.linspace(0.0, 1.0, len(push)), [0.0, 0.0, np.radians(20)])
    assert velocity_steps(stretch_with(push, turn, rng), np.zeros(3)) == []
    assert velocity_steps(stretch_with(push[:50], np.zeros((50, 3)), rng), np.zeros(3)) == []


def test_noise_that_no_kernel_foresees_makes_sigma_larger() -> None:
    """Motion of half a hertz, as a floating raft makes it: no kernel's covariance holds it."""
    rng = np.random.default_rng(4)
    velocity = step_of(np.array([0.05, 0.0, 0.0]), 40.0)
    t_s = BLOCK_S * np.arange(len(velocity))
    swaying = velocity + 0.0045 * np.column_stack([np.sin(np.pi * t_s), np.cos(np.pi * t_s), 0 * t_s])
    still = np.zeros_like(velocity)
    (calm,) = velocity_steps(stretch_with(velocity, still, rng), np.zeros(3))
    (unsure,) = velocity_steps(stretch_with(swaying, still, rng), np.zeros(3))
    assert unsure.sigma > 2 * calm.sigma
