"""Samples of the JY901 as they were felt, at the times at which they were taken."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as rules
from hypothesis import strategies as st

from drivers.jy901.pace import SampleClock
from drivers.jy901.packets import ACCEL_LSB, GYRO_LSB, SIZE, Kind, encode
from drivers.jy901.samples import SampleReader
from tests.drivers.jy901_kit import MOTION_NS, STEPS, Bench


@pytest.mark.parametrize("rate_hz", [50, 100, 200])
def test_samples_are_what_was_felt(rate_hz: int) -> None:
    bench = Bench(seconds=8.0, rate_hz=rate_hz, bandwidth_hz=256)
    bench.run(7.0)
    began_s = bench.identities[0].t_ns * 1e-9
    assert len(bench.readings) == pytest.approx((7.0 - began_s) * rate_hz, abs=0.02 * rate_hz + 2)
    for reading in bench.readings[5::20]:
        # The part means over 2 ms; the stamp is that of the packet's first byte.
        k = reading.t_ns / MOTION_NS + np.arange(-4.0, 2.0, 0.1)[:, None]
        off = np.abs(9.0 * np.sin(k * STEPS) + np.array([0, 0, 9.8]) - reading.sample().accel).max(axis=1) / ACCEL_LSB
        assert off.min() < 5
        near = int(np.argmin(off))
        assert np.abs(2.0 * np.sin(k[near] * STEPS) - reading.sample().gyro).max() < 5 * GYRO_LSB
        assert reading.sample().temperature_c == pytest.approx(31.0)


def test_a_slow_line_lowers_the_rate() -> None:
    bench = Bench(seconds=10.0)
    bench.part.registers[0x02], bench.part.registers[0x03] = 0x0006, 9  # 100 Hz of two packets at 9600 baud
    reader, port, count = SampleReader(9600, 100, 256), bench.port(9600), 0
    while bench.now_s < 4.0:
        count += len(reader.feed(port.read(), bench.clock.now_ns()))
    assert count == pytest.approx(4 * 43.6, abs=3)


def test_half_a_group_is_counted_and_left_out() -> None:
    reader = SampleReader(115200, 100, 256)
    accel, gyro = encode(Kind.ACCEL, (0, 0, 2048, 2500)), encode(Kind.GYRO, (1, 2, 3, 2500))
    data = [accel + gyro, gyro, accel, accel + gyro, b"\x55" * 5 + accel + gyro[:-1], b"\x00" + accel + gyro]
    readings = [one for i, piece in enumerate(data) for one in reader.feed(piece, (i + 1) * 10_000_000)]
    assert len(readings) == 3
    assert reader.halves == 3
    assert reader.parser.skipped >= SIZE


def test_a_part_that_repeats_itself_is_frozen_and_one_word_of_difference_ends_that() -> None:
    reader = SampleReader(115200, 100, 5)  # a slow filter
    group = encode(Kind.ACCEL, (0, 0, 2048, 2500)) + encode(Kind.GYRO, (1, 2, 3, 2500))
    other = encode(Kind.ACCEL, (0, 0, 2049, 2500)) + encode(Kind.GYRO, (1, 2, 3, 2500))
    frozen = [reader.feed(group, i * 10_000_000)[0].is_frozen for i in range(150)]
    assert frozen == [False] * 80 + [True] * 70
    assert not reader.feed(other, 1_500_000_000)[0].is_frozen
    quick = SampleReader(115200, 200, 256)
    assert [quick.feed(group, i * 5_000_000)[0].is_frozen for i in range(14)] == [False] * 12 + [True] * 2


@given(
    rate_hz=st.sampled_from([50, 100, 200]),
    clock=st.floats(-0.03, 0.03),
    heap_ms=st.floats(0.0, 16.0),
    lost=st.sets(st.integers(1000, 1800), max_size=40),
    seed=st.integers(0, 1000),
)
@rules(max_examples=60, deadline=None)
def test_times_are_those_of_the_samples_whatever_the_adapter_does(
    rate_hz: int, clock: float, heap_ms: float, lost: set[int], seed: int
) -> None:
    """Arrival late by anything up to a heap's time; some samples lost."""
    rng = np.random.default_rng(seed)
    period_ns = 1e9 / rate_hz * (1 + clock)
    taken = np.rint(np.arange(2000) * period_ns).astype(int)
    heap_ns = max(1.0, heap_ms * 1e6)
    arrived = np.ceil((taken + rng.uniform(0, 2e5, 2000)) / heap_ns) * heap_ns
    made = SampleClock(rate_hz)
    kept = [k for k in range(2000) if k not in lost]
    told = [made.time(int(arrived[k]), was_disturbed=k - before > 1) for before, k in pairwise([-1, *kept])]
    assert all(b > a for a, b in pairwise(told))
    off_ms = (np.array(told) - taken[kept])[600:] * 1e-6  # once the pace is known
    assert off_ms.min() > -2.0 - heap_ms / 2
    assert off_ms.max() < heap_ms + 1.5
    # Distances are what an estimator integrates over: they are even although arrivals come in heaps.
    rates = np.diff(told[600:])[np.diff(kept[600:]) == 1]
    assert np.median(np.abs(rates - period_ns)) < 0.1 * period_ns
