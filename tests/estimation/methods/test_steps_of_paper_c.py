"""Wavelet, orientation, chart and clusters of paper C, each against another route."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
import pywt
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from estimation.methods.attitude import attitudes
from estimation.methods.chart import change_points, moving_range_limits, printed_limits
from estimation.methods.clusters import by_gaps, k_means
from estimation.methods.wavelet import filtered

RATE_HZ = 819.2
G = 9.80665


@pytest.mark.parametrize(("level", "wavelet"), [(8, "coif3"), (7, "coif1"), (8, "coif5")])
def test_what_is_kept_is_the_sum_of_the_middle_details_of_a_multiresolution_analysis(level: int, wavelet: str) -> None:
    y = np.random.default_rng(1).normal(size=(16384, 3))
    # [A_J, D_J, ..., D_1], each as long as y
    parts = pywt.mra(y[:, 1], wavelet, level=level, transform="dwt", mode="symmetric")
    np.testing.assert_allclose(filtered(y, level, wavelet)[:, 1], sum(parts[1:-2]), atol=1e-10)


@pytest.mark.parametrize(("hertz", "kept"), [(0.3, 0.0), (20.0, 1.0), (350.0, 0.0)])
def test_trend_and_noise_go_and_the_band_between_stays(hertz: float, kept: float) -> None:
    t_s = np.arange(2**15) / RATE_HZ
    wave = np.sin(2 * np.pi * hertz * t_s)
    inside = slice(2**13, 3 * 2**13)
    assert np.std(filtered(wave, 8, "coif3")[inside]) / np.std(wave[inside]) == pytest.approx(kept, abs=0.05)


def test_a_burst_loses_its_speed_by_detrending() -> None:
    """Why the integrator must not get the filtered signal: a velocity step of 14.53 mm/s is gone."""
    t_s = np.arange(2**15) / RATE_HZ
    accel = np.where((t_s > 20.0) & (t_s < 20.1), 0.1453, 0.0)
    left = np.cumsum(filtered(accel, 8, "coif3")) / RATE_HZ
    assert abs(left[round(22.0 * RATE_HZ)]) < 0.1 * 0.01453


def test_a_record_too_short_for_the_level_is_refused() -> None:
    with pytest.raises(ValueError, match="too few for level 8"):
        filtered(np.zeros(500), 8, "coif3")


@given(st.lists(st.floats(-3.0, 3.0), min_size=3, max_size=3), st.integers(1, 400))
@settings(max_examples=25, deadline=None)
def test_a_constant_rate_turns_as_scipy_says(rate: list[float], n: int) -> None:
    t_s = np.arange(n + 1) / RATE_HZ
    still = np.zeros(n + 1, dtype=np.bool_)
    turned = attitudes(t_s, np.zeros((n + 1, 3)), np.tile(rate, (n + 1, 1)), still, 1.0)
    expected = Rotation.from_rotvec(np.array(rate) * t_s[-1]).as_matrix()
    np.testing.assert_allclose(turned[-1], expected, atol=1e-9)


@given(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))
@settings(max_examples=25, deadline=None)
def test_gravity_levels_a_tilted_sensor_at_once_and_keeps_it_level(pitch: float, roll: float) -> None:
    tilt = Rotation.from_euler("xy", [pitch, roll])
    n = 50
    accel = np.tile(tilt.inv().apply([0.0, 0.0, G]), (n, 1))
    always = np.ones(n, dtype=np.bool_)
    turned = attitudes(np.arange(n) / RATE_HZ, accel, np.zeros((n, 3)), always, 1.0)
    np.testing.assert_allclose(np.einsum("ijk,ik->ij", turned, accel), np.tile([0.0, 0.0, G], (n, 1)), atol=1e-6)


def test_a_tilt_that_the_gyroscopes_missed_decays_with_the_time_constant() -> None:
    n, time_constant_s = round(3 * RATE_HZ), 1.0
    t_s = np.arange(n) / RATE_HZ
    accel = np.tile([0.0, 0.0, G], (n, 1))
    accel[1:] = [0.0, G * np.sin(0.1), G * np.cos(0.1)]
    turned = attitudes(t_s, accel, np.zeros((n, 3)), np.ones(n, dtype=np.bool_), time_constant_s)
    tilt = np.arcsin(np.einsum("ij,ij->i", turned[:, 1, :], accel) / G)
    np.testing.assert_allclose(tilt[1:], 0.1 * np.exp(-t_s[1:] / time_constant_s), rtol=5e-3)


def test_printed_limits_telescope_to_nothing() -> None:
    y = np.random.default_rng(2).normal(size=5000)
    lower, upper = printed_limits(y)
    mean = (y[-1] - y[0]) / 4999
    assert (lower + upper) / 2 == pytest.approx(mean, rel=1e-9)
    assert len(change_points(y, (lower, upper))) > 0.99 * len(y)


def test_limits_of_the_mean_absolute_range_are_three_sigmas_of_white_noise() -> None:
    y = np.random.default_rng(3).normal(5.0, 2.0, 50_000)
    lower, upper = moving_range_limits(y)
    assert (lower, upper) == pytest.approx((5.0 - 6.0, 5.0 + 6.0), abs=0.1)
    share = len(change_points(y, (lower, upper))) / len(y)
    assert share == pytest.approx(0.0027, abs=0.0012)


@given(st.lists(st.integers(0, 300), min_size=6, max_size=11, unique=True), st.integers(2, 4))
@settings(max_examples=20, deadline=None)
def test_k_means_finds_the_best_of_all_cuts(points: list[int], k: int) -> None:
    ordered = np.array(sorted(points), dtype=np.int64)

    def cost(parts: list[np.ndarray]) -> float:
        return sum(float(((part - part.mean()) ** 2).sum()) for part in parts)

    # In one dimension the best clusters are intervals.
    best = min(cost(np.split(ordered, list(cuts))) for cuts in combinations(range(1, len(ordered)), k - 1))
    found = k_means(ordered, k)
    parts = [ordered[(ordered >= first) & (ordered <= last)] for first, last in found]
    assert sum(map(len, parts)) == len(ordered)
    assert cost(parts) <= 1.3 * best + 1e-6  # ten random starts may miss the very best


def test_too_few_points_for_the_clusters_are_refused() -> None:
    with pytest.raises(ValueError, match="cannot form 4 clusters"):
        k_means(np.array([3, 4, 5]), 4)


def test_gaps_give_the_clusters_of_k_means_on_the_points_they_keep_and_drop_stray_ones() -> None:
    rng = np.random.default_rng(4)
    t_s = np.arange(80_000) / RATE_HZ
    bursts = [np.sort(rng.choice(np.arange(begin, begin + 300), 120, False)) for begin in (8000, 35000, 53000, 64000)]
    stray = np.array([20_000, 21_500, 45_000])
    points = np.sort(np.concatenate([*bursts, stray])).astype(np.int64)
    kept = by_gaps(points, t_s)
    assert kept == [(int(burst[0]), int(burst[-1])) for burst in bursts]
    inside = np.array([point for point in points if any(first <= point <= last for first, last in kept)])
    assert k_means(inside, 4) == kept
    assert k_means(points, 4) != kept  # a stray point stretches a cluster
    assert by_gaps(np.array([], dtype=np.int64), t_s) == []
