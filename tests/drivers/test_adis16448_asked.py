"""A client in another process: the part answers as of the request, within reason."""

from __future__ import annotations

import pytest

from drivers.adis16448.crc import burst_crc
from drivers.virtual.adis16448 import VirtualAdis16448
from tests.drivers.fault_kit import BURST, PERIOD_NS, START_NS, Bench, Reading, healthy

HEALTHY = healthy()
EDGE = 400  # number of the edge in question
EDGE_NS = START_NS + EDGE * PERIOD_NS


def burst(bench: Bench, asked_ns: int | None) -> Reading:
    assert isinstance(bench.part, VirtualAdis16448)
    return Reading(0.0, 0, bench.part.transfer(BURST, 1_000_000, asked_ns), 0)


def outputs(number: int) -> bytes:
    return HEALTHY[number - 1].outputs


@pytest.mark.parametrize("way_us", [0, 300, 1300, 4900])
def test_what_the_way_took_does_not_count(way_us: int) -> None:
    bench = Bench()
    bench.clock.advance_to(EDGE_NS + 1000 * way_us)
    line = bench.line.wait(0.0)  # somebody else knows of the updates since
    assert line is not None
    reading = burst(bench, EDGE_NS)
    assert reading.outputs == outputs(EDGE)
    assert reading.is_good


def test_a_request_held_up_too_long_is_answered_as_of_now() -> None:
    bench = Bench()
    bench.clock.advance_to(EDGE_NS + 4 * PERIOD_NS + 10_000)
    assert burst(bench, EDGE_NS).outputs == outputs(EDGE + 4)
    bench = Bench()
    bench.clock.advance_to(EDGE_NS + 4 * PERIOD_NS - 10_000)
    assert burst(bench, EDGE_NS).outputs == outputs(EDGE)


@pytest.mark.parametrize("asked_ns", [None, 0, EDGE_NS + 1, 1 << 62])
def test_a_request_without_a_credible_time_is_answered_as_of_now(asked_ns: int | None) -> None:
    bench = Bench()
    bench.clock.advance_to(EDGE_NS)
    assert burst(bench, asked_ns).outputs == outputs(EDGE)


def test_a_client_that_asks_late_gets_a_torn_burst_all_the_same() -> None:
    verdicts = {}
    for late_us in (0, 700, 900, 1040, 1100, 1150):
        bench = Bench()
        bench.clock.advance_to(EDGE_NS + PERIOD_NS + 400_000)
        verdicts[late_us] = burst(bench, EDGE_NS + 1000 * late_us).is_good
    assert [late_us for late_us, is_good in verdicts.items() if is_good] == [0, 700, 900]


def test_a_time_before_the_end_of_the_last_frame_does_not_count() -> None:
    bench = Bench()
    bench.clock.advance_to(EDGE_NS + PERIOD_NS + 100_000)
    first = burst(bench, EDGE_NS + 50_000)
    assert first.outputs == outputs(EDGE)
    assert burst(bench, EDGE_NS + 60_000).outputs == outputs(EDGE + 1)


def test_a_register_is_read_as_of_the_request() -> None:
    bench = Bench()
    assert isinstance(bench.part, VirtualAdis16448)
    bench.clock.advance_to(EDGE_NS + 2 * PERIOD_NS)
    bench.part.transfer(b"\x0a\x00", 1_000_000, EDGE_NS + 1000)  # XACCL_OUT
    answer = bench.part.transfer(b"\x00\x00", 1_000_000, EDGE_NS + 60_000)
    assert answer == outputs(EDGE)[6:8]


def test_a_late_setting_counts_no_update_twice() -> None:
    bench = Bench()
    bench.clock.advance_to(EDGE_NS + 3 * PERIOD_NS)
    assert bench.line.wait(0.0) is not None
    assert isinstance(bench.part, VirtualAdis16448)
    bench.part.transfer(b"\xb8\x03", 1_000_000, EDGE_NS)  # more filter taps
    rest = bench.read()
    assert bench.part.account().updates == len(HEALTHY)
    assert len(rest) == len(HEALTHY) - EDGE - 3
    assert all(burst_crc(reading.words[2:13]) == reading.words[13] for reading in rest)


def test_a_listener_with_the_wrong_polarity_waits_for_each_edge_once() -> None:
    bench = Bench()
    line = bench.part.data_ready(active_high=False)
    stamps = []
    for _ in range(20):
        edge = line.wait(1.0)
        assert edge is not None
        stamps.append(edge.t_ns)
    assert stamps == [START_NS + (i + 1) * PERIOD_NS - 210_000 for i in range(20)]
