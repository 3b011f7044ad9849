from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from estimation.blocks import SAMPLES_PER_STEP, BlockCutter
from estimation.mount.axes import Mount
from estimation.records import ImuSample, Vector
from estimation.settings import MountSettings
from estimation.track import Step

MOUNT = Mount(MountSettings())
PERIOD_NS = 1_220_703


def cut(samples: list[ImuSample], cutter: BlockCutter | None = None) -> tuple[list[float], list[Step]]:
    """Gaps and steps of a stream."""
    cutter = cutter or BlockCutter()
    results = [cutter.add(sample, MOUNT) for sample in samples]
    return [gap for gap, _ in results if gap], [step for _, step in results if step is not None]


def samples_at(times_ns: list[int], seed: int = 1) -> list[ImuSample]:
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(len(times_ns), 6)).tolist()
    return [ImuSample(t, (a, b, c), (x, y, z)) for t, (a, b, c, x, y, z) in zip(times_ns, rows, strict=True)]


def regular(n: int, start_ns: int = 0, period_ns: int = PERIOD_NS) -> list[int]:
    return [start_ns + i * period_ns for i in range(n)]


def mean_between(samples: list[ImuSample], of: Callable[[ImuSample], Vector]) -> NDArray[np.float64]:
    """Mean over time of what runs straight from sample to sample."""
    times = np.array([sample.t_ns for sample in samples]) * 1e-9
    return np.asarray(np.trapezoid([of(s) for s in samples], times, axis=0) / (times[-1] - times[0]))


def test_a_step_is_the_mean_over_eight_samples_and_lasts_eight_periods() -> None:
    samples = samples_at(regular(50))
    gaps, steps = cut(samples)
    assert gaps == []
    assert [step.t_ns for step in steps] == [samples[i].t_ns for i in range(7, 50, 8)]
    for i, step in enumerate(steps):
        of_step = samples[max(8 * i - 1, 0) : 8 * i + 8]
        np.testing.assert_allclose(step.accel, mean_between(of_step, lambda s: s.accel))
        np.testing.assert_allclose(step.gyro, mean_between(of_step, lambda s: s.gyro))
    assert [step.dt_s for step in steps[1:]] == pytest.approx([8 * PERIOD_NS * 1e-9] * 5)


def test_sensor_axes_are_turned_into_support_axes() -> None:
    mount = Mount(MountSettings(push="-x", up="+z"))
    cutter, step = BlockCutter(), None
    for t_ns in regular(8):
        _, step = cutter.add(ImuSample(t_ns, (0.0, 0.0, 1.0), (-0.5, 0.25, 9.8)), mount)
    assert step is not None
    assert step.accel == pytest.approx((0.25, 0.5, 9.8))
    assert step.smooth == pytest.approx((0.25, 0.5, 9.8))
    assert step.gyro == (0.0, 0.0, 1.0)


def test_a_gap_is_told_and_restarts_the_block() -> None:
    before, after = regular(21), regular(16, start_ns=21 * PERIOD_NS + 500_000_000)
    samples = samples_at(before + after)
    gaps, steps = cut(samples)
    assert gaps == pytest.approx([(after[0] - before[-1]) * 1e-9])
    # Five samples before the gap belong to no block; the blocks after it hold samples from after it alone.
    assert [step.t_ns for step in steps] == [before[7], before[15], after[7], after[15]]
    first = replace(samples[21], t_ns=samples[21].t_ns - PERIOD_NS)  # stands for the period before it
    np.testing.assert_allclose(steps[2].accel, mean_between([first, *samples[21:29]], lambda s: s.accel))
    assert steps[2].dt_s == pytest.approx(8 * PERIOD_NS * 1e-9, rel=1e-6)
    # Nor does the smooth value know the time before the gap: at 16 taps it is full again just now.
    assert steps[3].smooth == pytest.approx(cut(samples[21:])[1][1].smooth)


def test_smoothing_starts_anew_after_a_gap() -> None:
    times = regular(16) + regular(8, start_ns=10**9)
    samples = [ImuSample(t, (0.0,) * 3, (0.0, 0.0, 1.0 if t < 10**9 else 5.0)) for t in times]
    assert cut(samples)[1][-1].smooth == pytest.approx((0.0, 0.0, 5.0))


def test_lost_samples_hardly_change_the_integral_of_a_vibration() -> None:
    """A plain mean would count the samples beside a loss as little as any, and make a speed of 0.2 m/s^2 at 30 Hz."""
    times = regular(4000)
    rng = np.random.default_rng(5)
    kept = [t for t in times if rng.random() > 0.12]
    samples = [ImuSample(t, (0.0,) * 3, (0.0, 0.2 * math.sin(2 * math.pi * 30 * t * 1e-9), 9.8)) for t in kept]
    _, steps = cut(samples)
    speed = np.cumsum([step.accel[1] * step.dt_s for step in steps])
    amplitude = 0.2 / (2 * math.pi * 30)
    assert np.ptp(speed) < 2.6 * amplitude


def test_time_going_back_or_standing_is_dropped_and_counted() -> None:
    times = regular(24)
    disturbed = [*times[:10], times[3], times[9], *times[10:]]
    samples = samples_at(disturbed)
    clean = samples[:10] + samples[12:]
    cutter = BlockCutter()
    gaps, steps = cut(samples, cutter)
    assert cutter.backward == 2
    assert gaps == []
    assert steps == cut(clean)[1]


def test_the_period_of_the_source_is_learned() -> None:
    cutter = BlockCutter()
    cut(samples_at(regular(400)), cutter)
    assert cutter.period_s == pytest.approx(PERIOD_NS * 1e-9)


def test_jitter_and_single_lost_samples_are_no_gaps() -> None:
    rng = np.random.default_rng(2)
    times = np.cumsum(PERIOD_NS * rng.uniform(0.2, 1.8, 800)).astype(int)
    kept = [t for i, t in enumerate(times.tolist()) if i % 50]
    gaps, steps = cut(samples_at(kept))
    assert gaps == []
    assert len(steps) == len(kept) // SAMPLES_PER_STEP


@pytest.mark.parametrize("rate_hz", [1, 10, 15, 25, 100])
def test_a_slow_source_has_no_gaps_but_its_real_ones(rate_hz: int) -> None:
    period_ns = 10**9 // rate_hz
    times = regular(40, period_ns=period_ns)
    assert cut(samples_at(times))[0] == []
    gaps, _ = cut(samples_at(times + regular(16, start_ns=times[-1] + 6 * period_ns, period_ns=period_ns)))
    assert gaps == pytest.approx([6 / rate_hz])


@given(st.lists(st.integers(-(10**9), 3 * 10**9) | st.integers(1, 2 * 10**6), max_size=200))
@settings(derandomize=True, deadline=None)
def test_steps_never_have_no_duration_nor_overlap_whatever_the_times(differences: list[int]) -> None:
    times = np.cumsum([0, *differences]).tolist()
    cutter = BlockCutter()
    gaps, steps = cut([ImuSample(t, (0.0,) * 3, (0.0, 0.0, 9.8)) for t in times], cutter)
    assert all(gap > 0 for gap in gaps)
    assert all(step.dt_s > 0 for step in steps)
    end_ns = -(10**18)
    for step in steps:
        assert step.t_ns - step.dt_s * 1e9 >= end_ns - 1  # a nanosecond of rounding
        end_ns = step.t_ns
    assert len(steps) <= (len(times) - cutter.backward) // SAMPLES_PER_STEP


def period_after(*intervals_s: float) -> float:
    """What the cutter believes of the sample period after samples at these distances."""
    cutter, t_ns = BlockCutter(), 0
    for interval_s in (0.0, *intervals_s):
        t_ns += round(interval_s * 1e9)
        cutter.add(ImuSample(t_ns, (0.0, 0.0, 0.0), (0.0, 0.0, 9.8)), Mount(MountSettings()))
    return cutter.period_s


T = 1 / 819.2


@pytest.mark.parametrize("odd", [(60e-6,), (60e-6, T - 60e-6), (2 * T,), (3e-4, 3e-4), (T / 2,) * 3])
def test_a_few_odd_intervals_teach_nothing_of_the_period(odd: tuple[float, ...]) -> None:
    assert period_after(*[T] * 3000, *odd, *[T] * 10) == pytest.approx(T, rel=1e-3)


@pytest.mark.parametrize("first", [60e-6, 3 * T])
def test_a_first_interval_that_misled_is_soon_forgotten(first: float) -> None:
    assert period_after(first, *[T] * 100) == pytest.approx(T, rel=1e-3)


def test_another_rate_that_lasts_is_learned() -> None:
    assert period_after(*[T] * 3000, *[T / 2] * 10) == pytest.approx(T / 2, rel=1e-3)
    assert period_after(*[T] * 3000, *[2 * T] * 60) == pytest.approx(2 * T, rel=1e-3)


def test_every_second_sample_lost_for_a_moment_is_no_other_rate() -> None:
    assert period_after(*[T] * 3000, *[2 * T] * 30, *[T] * 5) == pytest.approx(T, rel=1e-3)


def test_samples_that_touch_are_dropped_and_never_make_a_period() -> None:
    """A nanosecond apart, as a reader stamps what it reads all at once: no sensor is that fast."""
    cutter = BlockCutter()
    times = [round(k * 5e6) for k in range(400)]
    times += [times[-1] + 50_000_000 + k for k in range(40)]
    times += [times[-1] + round(k * 5e6) for k in range(1, 400)]
    for t_ns in times:
        cutter.add(ImuSample(t_ns, (0.0, 0.0, 0.0), (0.0, 0.0, 9.8)), MOUNT)
    assert cutter.backward == 39
    assert cutter.period_s == pytest.approx(5e-3, rel=0.02)
