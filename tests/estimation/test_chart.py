from __future__ import annotations

import numpy as np
import pytest

from estimation.chart import SIGMA_FLOOR_M_S2, ControlChart

DT_S = 0.01


def learned(values: list[float]) -> ControlChart:
    chart = ControlChart()
    for value in values:
        chart.learn(value, DT_S)
    return chart


@pytest.mark.parametrize("seed", range(5))
def test_spread_of_white_noise_is_found_from_its_moving_range(seed: int) -> None:
    noise = np.random.default_rng(seed).normal(0.3, 0.02, 3000)
    chart = learned(noise.tolist())
    # Running mean over 5 s = 500 values weighs like about 1000 of them; the scatter of successive ranges,
    # which overlap, is 0.91 / sqrt(n) of sigma.
    assert chart.sigma == pytest.approx(0.02, rel=4 * 0.91 / np.sqrt(1000))
    assert chart.centre == pytest.approx(0.3, abs=4 * 0.02 / np.sqrt(1000))


def test_limits_lie_three_sigmas_beside_the_centre_and_hold_nearly_all_noise() -> None:
    noise = np.random.default_rng(7).normal(-0.1, 0.05, 20_000)
    chart = learned(noise[:2000].tolist())
    lower, upper = chart.limits
    assert (lower + upper) / 2 == pytest.approx(chart.centre)
    assert upper - lower == pytest.approx(6 * chart.sigma)
    outside = np.mean((noise[2000:] < lower) | (noise[2000:] > upper))
    assert 0.0005 < outside < 0.012  # 0.0027 for exact limits; limits off by 10 % give 0.0013 to 0.007


def test_noiseless_source_gets_limits_of_half_a_bit() -> None:
    chart = learned([0.2] * 100)
    assert chart.sigma == SIGMA_FLOOR_M_S2
    assert chart.limits == pytest.approx((0.2 - 3 * SIGMA_FLOOR_M_S2, 0.2 + 3 * SIGMA_FLOOR_M_S2))


def test_a_drift_moves_the_centre_but_hardly_the_spread() -> None:
    noise = np.random.default_rng(8).normal(0.0, 0.02, 6000)
    chart = learned((noise + np.linspace(0.0, 1.0, 6000)).tolist())
    assert chart.sigma == pytest.approx(0.02, rel=0.12)
    # A mean with a memory of 5 s follows a ramp of 1/60 m/s^2 per second 5 s late.
    assert chart.centre == pytest.approx(1.0 - 5.0 / 60.0, abs=0.01)


def test_fresh_chart_has_learned_the_mean_of_what_it_saw() -> None:
    assert learned([1.0, 2.0, 3.0, 6.0]).centre == pytest.approx(3.0)
