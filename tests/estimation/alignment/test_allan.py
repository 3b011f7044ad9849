"""Allan deviation and the noise read from it: allantools, closed forms, statistics."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimation.alignment.allan import (
    FLICKER,
    LEAST_CLUSTERS,
    AllanCurve,
    allan_curve,
    bias_instability,
    noise_of,
    slopes,
    white_noise,
)
from estimation.arrays import FloatArray
from tests.estimation.alignment import allan_oracle

PERIOD_S = 0.01
FILTER = np.convolve(np.full(4, 0.25), np.full(4, 0.25))  # of an ADIS16448 as it is set by default


def white(samples: int, seed: int, density: float = 1.0) -> FloatArray:
    """White noise whose Allan deviation at 1 s is `density`."""
    return np.asarray(density / PERIOD_S**0.5 * np.random.default_rng(seed).standard_normal(samples))


def walk(samples: int, seed: int, density: float) -> FloatArray:
    """Random walk of the rate: density sqrt(s) after s seconds."""
    return np.asarray(density * PERIOD_S**0.5 * np.cumsum(np.random.default_rng(seed).standard_normal(samples)))


@pytest.mark.parametrize("name", ["made", "measured"])
def test_deviations_are_those_of_allantools(name: str) -> None:
    theirs = json.loads(allan_oracle.STORED.read_text())[name]
    signal, rate_hz = {
        "made": (allan_oracle.made(), allan_oracle.RATE_HZ),
        "measured": (allan_oracle.measured(), allan_oracle.BROAD_RATE_HZ),
    }[name]
    curve = allan_curve(signal, 1 / rate_hz)
    np.testing.assert_allclose(curve.tau_s, theirs["tau_s"], rtol=1e-12)
    np.testing.assert_allclose(curve.deviation, theirs["deviation"], rtol=1e-9)


def test_a_ramp_has_slope_one_exactly() -> None:
    slope = 0.37
    curve = allan_curve(slope * PERIOD_S * np.arange(5000.0), PERIOD_S)
    np.testing.assert_allclose(curve.deviation, slope * curve.tau_s / 2**0.5, rtol=1e-9)
    assert white_noise(curve) is None


def test_a_vibration_has_the_deviation_of_theory() -> None:
    """IEEE Std 952, C.1.6: A sin^2(pi f tau) / (pi f tau); of samples, sin(pi f period) takes the angle's place."""
    hz, amplitude = 2.3, 0.4
    phase = np.pi * hz * PERIOD_S
    curve = allan_curve(amplitude * np.sin(2 * phase * np.arange(100_000)), PERIOD_S)
    sizes = np.rint(curve.tau_s / PERIOD_S)
    expected = amplitude * np.sin(phase * sizes) ** 2 / (sizes * np.sin(phase))
    np.testing.assert_allclose(curve.deviation, expected, rtol=2e-3, atol=1e-5 * amplitude)


def test_a_random_walk_rises_with_slope_one_half() -> None:
    curve = allan_curve(walk(200_000, 3, 0.2), PERIOD_S)
    long = (curve.tau_s > 30 * PERIOD_S) & (curve.clusters > 100)
    error = curve.deviation[long] / (0.2 * np.sqrt(curve.tau_s[long] / 3)) - 1
    assert np.all(np.abs(error) < 4 * curve.relative_sigma[long])
    np.testing.assert_allclose(slopes(curve)[long], 0.5, atol=0.1)
    assert white_noise(curve) is None


def test_white_noise_is_found_within_its_stated_sigma() -> None:
    samples, records = 2000, 200
    found = [one for seed in range(records) if (one := noise_of(white(samples, seed, 0.7), PERIOD_S).white)]
    assert len(found) >= records - 2  # so short a record may hide its slope
    errors = np.array([(one.density - 0.7) / one.sigma for one in found])
    # Of 200 standard normals: mean 0 +- 0.07, root mean square 1 +- 0.05; the sigma itself is stated to a fifth.
    assert abs(errors.mean()) < 0.2
    assert 0.75 < np.sqrt(np.mean(errors**2)) < 1.25
    for one in found:
        assert one.from_s <= 3 * PERIOD_S
        assert one.to_s <= samples * PERIOD_S / LEAST_CLUSTERS
    assert np.median([one.to_s for one in found]) > 0.5


def test_a_filter_in_the_sensor_and_its_steps_do_not_bend_the_result() -> None:
    """The filter takes noise away at short times only; what integrates stays. Steps as large as the noise's sigma."""
    filtered = np.convolve(white(120_000, 5), FILTER, "valid")
    curve = allan_curve(filtered, PERIOD_S)
    assert curve.deviation[0] == pytest.approx(1 / PERIOD_S**0.5 / 8, rel=0.01)  # of this filter, by hand
    step = float(np.std(filtered))
    noise = noise_of(np.rint(filtered / step) * step, PERIOD_S)
    assert noise.white is not None
    assert noise.white.density == pytest.approx(1.0, abs=3 * noise.white.sigma)
    assert noise.white.sigma < 0.02
    assert 5 * PERIOD_S < noise.white.from_s < 50 * PERIOD_S


def test_white_noise_is_read_behind_a_vibration() -> None:
    t_s = PERIOD_S * np.arange(200_000)
    shaken = white(200_000, 6) + 60 * np.sin(2 * np.pi * 11.3 * t_s)
    curve = allan_curve(shaken, PERIOD_S)
    noise = white_noise(curve)
    assert noise is not None
    assert noise.density == pytest.approx(1.0, abs=4 * noise.sigma)
    assert noise.from_s > 0.1
    assert np.max(curve.deviation * np.sqrt(curve.tau_s)) > 3  # it stays in the curve


def test_the_floor_between_white_noise_and_random_walk() -> None:
    """N^2 / tau + K^2 tau / 3 is least at sqrt(3) N / K: 2 N K / sqrt(3)."""
    n, k = 1.0, 0.5
    rate = white(400_000, 7, n) + walk(400_000, 8, k)
    whole = noise_of(rate, PERIOD_S).instability
    assert whole is not None
    assert whole.reached
    assert whole.tau_s == pytest.approx(3**0.5 * n / k, rel=0.5)
    expected = (2 * n * k / 3**0.5) ** 0.5 / FLICKER
    assert whole.value == pytest.approx(expected, rel=0.1)
    # A record that ends before the floor tells a bound, and says so.
    short = noise_of(rate[:1000], PERIOD_S).instability
    assert short is not None
    assert not short.reached
    assert short.value > expected


def test_white_noise_alone_has_no_floor() -> None:
    for seed in range(30):
        found = noise_of(white(5000, 100 + seed), PERIOD_S).instability
        assert found is not None
        assert not found.reached


def test_a_floor_at_the_end_of_the_curve_is_a_bound_with_its_sigma() -> None:
    tau_s = np.array([1.0, 2, 4, 8, 16, 32, 64, 128])
    curve = AllanCurve(tau_s, tau_s**-0.5, (3000 / tau_s).astype(np.int64))
    found = bias_instability(curve)
    assert found is not None
    assert not found.reached
    assert found.tau_s == 128
    assert found.value == pytest.approx(128**-0.5 * (1 + 44**-0.5) / FLICKER)  # 23 clusters: 2 (23 - 1)


def test_what_a_filter_takes_away_at_short_times_is_no_floor() -> None:
    tau_s = np.array([1.0, 2, 4, 8, 16, 32, 64, 128])
    curve = AllanCurve(tau_s, np.array([0.1, 0.6, 0.5, 0.35, 0.25, 0.2, 0.3, 0.5]), (30000 / tau_s).astype(np.int64))
    found = bias_instability(curve, from_s=4.0)
    assert found is not None
    assert (found.tau_s, found.reached) == (32.0, True)
    assert found.value == pytest.approx(0.2 / FLICKER)


def test_a_constant_is_no_sensor_without_noise() -> None:
    noise = noise_of(np.full(1000, 0.1 + 0.2), PERIOD_S)
    assert noise.constant
    assert (noise.white, noise.instability) == (None, None)
    assert np.all(noise.curve.deviation == 0)


def test_a_dead_band_shows_in_the_share_of_equal_samples() -> None:
    rate = white(10_000, 9)
    rate[np.abs(rate) < 2 * np.std(rate)] = 0.0
    assert noise_of(rate, PERIOD_S).held == pytest.approx(0.954, abs=0.01)
    assert noise_of(white(10_000, 9), PERIOD_S).held == 0.0


@pytest.mark.parametrize(
    ("rate", "period_s", "words"),
    [
        (np.zeros(29), 0.01, "29 samples are too few"),
        (np.zeros(100), 0.0, "above 0 s"),
        (np.zeros(100), float("nan"), "finite"),
        (np.append(np.zeros(100), np.nan), 0.01, "finite"),
    ],
)
def test_what_cannot_be_judged_is_refused(rate: FloatArray, period_s: float, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        allan_curve(rate, period_s)


def test_the_shortest_record_has_a_curve() -> None:
    curve = allan_curve(white(30, 1), PERIOD_S)
    assert curve.clusters.min() >= 3
    assert np.isfinite(curve.relative_sigma).all()
    noise_of(white(30, 1), PERIOD_S)


@settings(deadline=None, max_examples=40)
@given(
    seed=st.integers(0, 2**32 - 1),
    samples=st.integers(30, 3000),
    scale=st.floats(1e-6, 1e6),
    offset=st.floats(-100, 100),
    period_s=st.floats(1e-4, 10),
)
def test_scale_offset_and_direction_of_time(
    seed: int, samples: int, scale: float, offset: float, period_s: float
) -> None:
    rate = np.random.default_rng(seed).standard_normal(samples)
    one = allan_curve(rate, period_s)
    for other, factor in ((scale * rate, scale), (rate + offset, 1.0), (rate[::-1], 1.0), (-rate, 1.0)):
        np.testing.assert_allclose(allan_curve(other, period_s).deviation, factor * one.deviation, rtol=1e-7)
    # Time only stretches: the deviations of a rate stay, at other times.
    np.testing.assert_allclose(allan_curve(rate, 2 * period_s).deviation, one.deviation, rtol=1e-9)
