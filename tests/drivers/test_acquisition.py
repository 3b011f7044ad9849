from __future__ import annotations

import itertools
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from drivers.acquisition import Acquisition
from drivers.adis16448.burst import Burst, Fault, failed
from drivers.adis16448.configuration import ImuSettings
from drivers.adis16448.device import Adis16448
from drivers.clock import SystemClock, VirtualClock
from drivers.data_ready import DataReadyError, Edge, PacedDataReady
from drivers.virtual.adis16448 import VirtualAdis16448
from drivers.virtual.inertial_input import SteadyInput
from drivers.virtual.sensor_errors import SensorErrors
from estimation.records import TimeKind

SECOND = 1_000_000_000


def ignore(_block: list[Burst]) -> None:
    pass


class Bench:
    """A started driver on a virtual part in simulated time, and the acquisition on top."""

    def __init__(self, settings: ImuSettings | None = None, *, rate_hz: float = 819.2, **source: Any) -> None:
        self.clock = VirtualClock()
        self.twin = VirtualAdis16448(
            SteadyInput(rate_hz, **source), self.clock, errors=SensorErrors(np.random.default_rng(1))
        )
        self.device = Adis16448(self.twin, self.clock, settings or ImuSettings())
        self.device.start()
        self.acquisition = Acquisition(self.device, self.twin.data_ready(), self.clock, 8, ignore)

    def run(self, seconds: float) -> list[Burst]:
        end_ns = self.clock.now_ns() + round(seconds * 1e9)
        bursts = []
        while self.clock.now_ns() < end_ns:
            bursts += self.acquisition.read_block()
        return bursts


def test_blocks_hold_every_sample_in_order_with_the_time_of_its_edge() -> None:
    bench = Bench()
    blocks = [bench.acquisition.read_block() for _ in range(20)]
    assert [len(block) for block in blocks] == [8] * 20
    numbers = [burst.t_ns * 819.2e-9 for block in blocks for burst in block]
    assert np.diff(numbers) == pytest.approx(1.0, abs=1e-5)
    assert numbers[0] == pytest.approx(round(numbers[0]), abs=1e-5)
    counters = bench.acquisition.counters
    assert (counters.samples, counters.missed, counters.paced_reads) == (160, 0, 0)
    assert not any(counters.faults.values())
    assert Fault.NONE not in counters.faults


def test_samples_that_nobody_read_are_counted() -> None:
    bench = Bench()
    bench.acquisition.read_block()
    bench.clock.sleep(10 / 819.2)
    bench.acquisition.read_block()
    assert bench.acquisition.counters.missed == 9


def test_a_part_of_a_block_is_handed_over_when_the_sensor_falls_silent() -> None:
    bench = Bench(duration_s=0.5)
    blocks = []
    while not bench.twin.exhausted:
        start_ns = bench.clock.now_ns()
        blocks.append(bench.acquisition.read_block())
        assert bench.clock.now_ns() - start_ns <= 0.12 * SECOND
    lengths = [len(block) for block in blocks]
    assert set(lengths[:-1]) == {8}
    assert 0 < lengths[-1] < 8
    assert blocks[-1][-1].t_ns == pytest.approx(0.5 * SECOND, abs=0.002 * SECOND)
    assert bench.acquisition.read_block() == []


def test_slow_samples_are_handed_over_before_the_block_is_full() -> None:
    bench = Bench(ImuSettings(decimation_exponent=5))
    lengths = {len(bench.acquisition.read_block()) for _ in range(10)}
    assert lengths == {4}  # 39 ms each: the fourth is the first that is 0.1 s younger


def test_a_silent_line_is_replaced_by_paced_reads_and_taken_back_when_it_lives() -> None:
    bench = Bench()
    before = bench.run(0.1)
    bench.twin.is_line_cut = True
    silent = bench.run(3.0)
    assert bench.acquisition.is_paced
    bench.twin.is_line_cut = False
    after = bench.run(2.0)
    assert not bench.acquisition.is_paced

    assert {burst.time_kind for burst in before} == {TimeKind.EDGE}
    assert {burst.time_kind for burst in silent} == {TimeKind.READ}
    # Given up after 0.3 s; paced at the nominal rate but for the two retries of two periods each.
    assert len(silent) == pytest.approx(2.7 * 819.2, abs=20)
    kinds = [burst.time_kind for burst in after]
    back = kinds.index(TimeKind.EDGE)
    assert set(kinds[back:]) == {TimeKind.EDGE}
    assert back <= 1.05 * 819.2
    times = [burst.t_ns for burst in before + silent + after]
    assert np.all(np.diff(times) > 0)
    counters = bench.acquisition.counters
    assert counters.silences == 1
    assert counters.paced_reads == len(silent) + back
    assert "check its wire" in counters.last_error
    assert counters.samples == len(times)


@pytest.mark.parametrize("rate_hz", [795.0, 819.2, 844.0])
def test_paced_reads_step_out_of_the_way_of_the_parts_updates(rate_hz: float) -> None:
    bench = Bench(rate_hz=rate_hz)
    pace = PacedDataReady(bench.clock, bench.device.settings.nominal_period_s)
    acquisition = Acquisition(bench.device, pace, bench.clock, 8, ignore)
    start_ns = bench.clock.now_ns()
    good = 0
    while bench.clock.now_ns() - start_ns < 4 * SECOND:
        good += sum(burst.fault is Fault.NONE for burst in acquisition.read_block())
    counters = acquisition.counters
    assert counters.paced_reads == counters.samples
    assert counters.silences == 0
    # Standing their ground they would lose the 0.37 ms of 1.2 ms in which a burst is torn: 30 %.
    assert good > 0.9 * 4 * min(rate_hz, 819.2)
    assert (counters.faults[Fault.CRC] > 0) == (rate_hz != 819.2)


def test_paced_reads_faster_than_the_part_find_samples_twice() -> None:
    bench = Bench()
    pace = PacedDataReady(bench.clock, 0.0003)
    acquisition = Acquisition(bench.device, pace, bench.clock, 8, ignore)
    words = []
    start_ns = bench.clock.now_ns()
    while bench.clock.now_ns() - start_ns < SECOND:
        words += [burst.words[1:] for burst in acquisition.read_block() if burst.fault is Fault.NONE]
    assert acquisition.counters.faults[Fault.REPEATED] > 800
    assert all(one != other for one, other in itertools.pairwise(words))


def test_an_unplugged_sensor_is_read_at_a_bounded_rate_and_called_by_its_name() -> None:
    bench = Bench()
    bench.twin.stuck_byte = 0xFF
    bench.twin.is_line_cut = True
    bursts = bench.run(3.0)
    assert {burst.fault for burst in bursts} == {Fault.ALL_ONE}
    assert 0 < len(bursts) <= 3 * 820
    assert bench.acquisition.counters.faults[Fault.ALL_ONE] == len(bursts)


class Line:
    """A data-ready line that follows a script; an exception in it is raised, a number of seconds passes."""

    def __init__(self, clock: VirtualClock, script: list[Edge | Exception | None]) -> None:
        self.clock = clock
        self.script = script

    def wait(self, timeout_s: float) -> Edge | None:
        step = self.script.pop(0) if self.script else None
        if isinstance(step, Exception):
            raise step
        if step is None:
            self.clock.sleep(timeout_s)
        return step

    def close(self) -> None:
        pass


class Reader:
    """A device whose every burst differs, or which fails."""

    settings = ImuSettings()

    def __init__(self, fault: Fault = Fault.NONE) -> None:
        self.fault = fault
        self.reads = 0

    def read_burst(self, edge: Edge) -> Burst:
        self.reads += 1
        if self.fault is Fault.SPI:
            return failed(edge.t_ns, edge.kind)
        return Burst(edge.t_ns, edge.kind, (self.reads & 0xFFFF,) * 12, None, self.fault)


class Restless(Line):
    """A floating line: an edge at every look."""

    def wait(self, timeout_s: float) -> Edge | None:
        return Edge(self.clock.now_ns(), TimeKind.EDGE)


def test_a_dead_port_under_a_floating_line_does_not_spin() -> None:
    clock = VirtualClock()
    reader = Reader(Fault.SPI)
    acquisition = Acquisition(reader, Restless(clock, []), clock, 8, ignore)
    while clock.now_ns() < SECOND:
        acquisition.read_block()
    assert 800 <= reader.reads <= 830
    assert acquisition.counters.faults[Fault.SPI] == reader.reads


def test_a_glitch_of_the_line_shows_as_a_repeated_sample() -> None:
    clock = VirtualClock()

    class Same(Reader):
        def read_burst(self, edge: Edge) -> Burst:
            return Burst(edge.t_ns, edge.kind, (7,) * 12, None)

    edges: list[Edge | Exception | None] = [
        Edge(1_000_000, TimeKind.EDGE),
        Edge(1_100_000, TimeKind.EDGE),
        Edge(2_200_000, TimeKind.EDGE),
    ]
    acquisition = Acquisition(Same(), Line(clock, edges), clock, 3, ignore)
    assert [burst.fault for burst in acquisition.read_block()] == [Fault.NONE, Fault.REPEATED, Fault.NONE]
    assert acquisition.counters.faults[Fault.REPEATED] == 1


def test_a_line_that_fails_is_paced_around_and_tried_again() -> None:
    clock = VirtualClock()
    gone = DataReadyError("the chip is gone")
    stale = Edge(1, TimeKind.EDGE, 500)
    live = Edge(3 * SECOND, TimeKind.EDGE, 7)
    # First wait, first retry; second retry finds a queue of old edges and then a live one.
    line = Line(clock, [gone, gone, stale, live])
    acquisition = Acquisition(Reader(), line, clock, 8, ignore)
    assert acquisition.read_block() == []
    assert acquisition.is_paced
    bursts: list[Burst] = []
    while acquisition.is_paced:
        bursts += acquisition.read_block()
    assert clock.now_ns() == pytest.approx(2 * SECOND, abs=0.12 * SECOND)
    edge = next(burst for burst in bursts if burst.time_kind is TimeKind.EDGE)
    assert edge.t_ns == 3 * SECOND
    assert acquisition.counters.missed == 0  # old edges: their samples were read in paces
    assert acquisition.counters.silences >= 1
    assert "the chip is gone" in acquisition.counters.last_error


def threaded(on_block: Callable[[list[Burst]], None], reader: Reader | None = None) -> Acquisition:
    clock = SystemClock()
    return Acquisition(reader or Reader(), PacedDataReady(clock, 0.001), clock, 4, on_block)


def test_the_thread_hands_over_blocks_until_it_is_stopped() -> None:
    enough = threading.Event()
    blocks: list[list[Burst]] = []

    def take(block: list[Burst]) -> None:
        blocks.append(block)
        if len(blocks) == 5:
            enough.set()

    acquisition = threaded(take)
    acquisition.start()
    assert enough.wait(20)
    acquisition.stop()
    assert "acquisition" not in {thread.name for thread in threading.enumerate()}
    assert [len(block) for block in blocks[:5]] == [4] * 5
    words = [burst.words[0] for block in blocks for burst in block]
    assert words == list(range(1, len(words) + 1))


def test_the_thread_survives_exceptions_of_both_sides_and_counts_them() -> None:
    enough = threading.Event()
    calls = []

    class Moody(Reader):
        def read_burst(self, edge: Edge) -> Burst:
            burst = super().read_burst(edge)
            if self.reads == 2:
                raise RuntimeError("a bad day")
            return burst

    def take(block: list[Burst]) -> None:
        calls.append(len(block))
        if len(calls) == 1:
            raise ValueError("not now")
        enough.set()

    acquisition = threaded(take, Moody())
    acquisition.start()
    assert enough.wait(20)
    acquisition.stop()
    assert acquisition.counters.errors == 2
    assert acquisition.counters.last_error == "ValueError: not now"


def test_stopping_what_was_never_started_is_fine() -> None:
    threaded(ignore).stop()
