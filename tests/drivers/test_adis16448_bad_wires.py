"""Wires that lie now and then: the data-ready line that loses edges or makes them up, the data wire at the start."""

from __future__ import annotations

import pytest

from drivers.adis16448.machine import State
from drivers.condition import OK, Wellness
from drivers.data_ready import Edge
from drivers.spi import SpiError
from estimation.records import TimeKind
from tests.drivers.inertial_kit import RATE_HZ, SECOND, Bench, Lossy, flip_bit, good, on_bursts


class Ticking:
    """A broken line on which something else makes an edge every so often."""

    def __init__(self, bench: Bench, every_s: float) -> None:
        self.bench = bench
        self.every_ns = round(every_s * 1e9)
        self.next_ns = bench.clock.now_ns() + self.every_ns
        self.edges = 0

    def wait(self, timeout_s: float) -> Edge | None:
        clock = self.bench.clock
        deadline_ns = clock.now_ns() + round(timeout_s * 1e9)
        if self.next_ns > deadline_ns:
            clock.advance_to(deadline_ns)
            return None
        clock.advance_to(max(clock.now_ns(), self.next_ns))
        missed = (clock.now_ns() - self.next_ns) // self.every_ns
        edge = Edge(self.next_ns + missed * self.every_ns, TimeKind.EDGE, missed)
        self.next_ns = edge.t_ns + self.every_ns
        self.edges += missed + 1
        return edge

    def close(self) -> None:
        pass


def test_a_line_that_loses_most_edges_is_paced_and_named() -> None:
    wire = Lossy(0.0)
    bench = Bench(edge_wire=wire)
    bench.run(2.0)
    assert bench.sensor.counters.missed_unseen == 0
    wire.share = 0.9
    items = bench.run(4.0)
    counters = bench.sensor.counters
    assert len(good(items)) > 0.95 * 4 * RATE_HZ
    assert counters.silences == 1
    condition = bench.sensor.condition
    assert condition.word is Wellness.ILL
    assert "the data-ready line brings too few edges: reads are paced" in condition.what
    assert "DIO1" in condition.advice
    arrived = bench.part.account().edges
    heard = counters.edge_reads + counters.missed + counters.missed_starting + counters.unheeded
    assert heard + bench.sensor._timer.skip() == arrived
    wire.share = 0.0
    bench.run(8.0)
    assert bench.sensor.condition == OK


@pytest.mark.parametrize("rate_hz", [795.0, 844.0])
def test_edges_that_the_wire_loses_are_counted_and_named_and_none_that_it_does_not(rate_hz: float) -> None:
    from drivers.virtual.inertial_input import SteadyInput

    wire = Lossy(0.2)
    bench = Bench(source=SteadyInput(rate_hz), edge_wire=wire)
    bench.run_to(State.RUN)
    lost = bench.part.account().edges_lost_by_script
    bench.run(4.0)
    counters = bench.sensor.counters
    assert counters.missed_unseen == pytest.approx(bench.part.account().edges_lost_by_script - lost, abs=3)
    assert bench.sensor.condition.what == "edges of the data-ready line do not arrive"
    assert "data-ready wire" in bench.sensor.condition.advice
    wire.share = 0.0
    unseen = bench.sensor._timer.missed_unseen
    bench.run(1.0)
    bench.clock.sleep(3.0)  # a long stall: its edges are known to have come
    bench.run(1.0)
    assert bench.sensor._timer.missed_unseen - unseen <= 1


@pytest.mark.parametrize("every_s", [0.020, 0.060, 0.0005])
def test_edges_that_are_not_the_parts_do_not_set_the_time_of_reads(every_s: float) -> None:
    bench = Bench()
    bench.run(1.0)
    line = Ticking(bench, every_s)
    seen = bench.part.account().edges
    bench.part.is_line_cut = True
    if every_s < 1 / RATE_HZ:
        bench.run(0.2)  # given up as silent before the noise begins
    bench.lines[0].inner = line
    items = bench.run(5.0)
    assert len(good(items)) > 0.95 * 5 * RATE_HZ
    assert bench.sensor.condition.word is Wellness.ILL
    assert "reads are paced" in bench.sensor.condition.what
    counters = bench.sensor.counters
    assert counters.unheeded > 0
    heard = counters.edge_reads + counters.missed + counters.missed_starting + counters.unheeded
    assert heard - seen == pytest.approx(line.edges, abs=1)


def test_a_stamp_from_the_future_does_not_hide_a_cut_line() -> None:
    bench = Bench()
    bench.run(1.0)
    bench.part.is_line_cut = True
    bench.lines[0].extra.append(Edge(bench.clock.now_ns() + 100 * SECOND, TimeKind.EDGE))
    assert len(good(bench.run(1.0))) > 0.9 * RATE_HZ
    assert bench.sensor.counters.missed_unseen <= 1


def test_a_part_that_sent_checksums_is_never_believed_to_have_none() -> None:
    bench = Bench()
    bench.run(1.0)
    bench.wire.tamper = on_bursts(flip_bit)
    assert good(bench.run(40.0)) == []
    assert bench.sensor.counters.failed_starts > 4
    assert bench.sensor.condition.word is Wellness.WAITING
    assert "wires" in bench.sensor.condition.advice
    bench.wire.tamper = lambda _, answer: answer
    assert {burst.crc is None for burst in good(bench.run(8.0))} == {False}


def test_a_part_of_which_no_checksum_was_ever_right_is_believed_after_three_starts() -> None:
    bench = Bench()
    bench.wire.tamper = lambda data, answer: answer[:-2] + b"\x5a\xa5" if len(data) == 28 else answer
    assert bench.run_to(State.RUN)
    assert bench.sensor.counters.failed_starts == 3
    assert "old silicon" in bench.sensor.notes[0]


def test_old_silicon_that_ignores_the_checksum_bit_is_believed_at_once() -> None:
    bench = Bench(silicon="AMLZ")
    bench.run_to(State.RUN)
    assert bench.sensor.counters.failed_starts == 0
    assert "old silicon" in bench.sensor.notes[0]


def test_a_bad_sample_costs_one_look_at_a_register_and_not_the_next_sample() -> None:
    bench = Bench()
    bench.run(1.0)
    bench.wire.frames.clear()
    bad = iter([True, False, False, True])  # the first puts the round of every 0.1 s off
    bench.wire.tamper = on_bursts(lambda frame: flip_bit(frame) if next(bad, False) else frame)
    bench.run(0.02)
    asked = [data for _, data in bench.wire.frames if data != b"\x00\x00"]
    assert len(asked) == len(set(asked)) == 2
    assert bench.sensor.counters.missed == 0


def test_a_restart_of_long_ago_is_not_told_again() -> None:
    bench = Bench()
    bench.run(1.0)
    bench.part._memory.restart()
    bench.run(13.0)
    assert bench.sensor.condition == OK
    wire_transfer = bench.wire.tamper

    def broken(_data: bytes, _answer: bytes) -> bytes:
        raise ZeroDivisionError("nobody foresaw this")

    bench.wire.tamper = broken
    bench.step()
    bench.wire.tamper = wire_transfer
    bench.run_to(State.RUN)
    bench.run(0.5)
    assert "a fault of the program" in bench.sensor.condition.what
    assert "lost its settings" not in bench.sensor.condition.what


def test_a_fault_while_supervising_is_survived(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench()
    bench.run(1.0)
    complaints = bench.sensor._quality.complaints

    def broken(_now_ns: int) -> list[tuple[str, str]]:
        raise ZeroDivisionError("nobody foresaw this")

    monkeypatch.setattr(bench.sensor._quality, "complaints", broken)
    bench.run(0.5)
    assert bench.sensor.counters.errors > 0
    monkeypatch.setattr(bench.sensor._quality, "complaints", complaints)
    bench.run_to(State.RUN)


def test_a_port_that_refuses_to_close_does_not_stop_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench()
    bench.run(0.5)

    def refuse() -> None:
        raise SpiError("gone")

    monkeypatch.setattr(bench.wire, "close", refuse)
    bench.sensor.close()
    assert bench.lines[0].closed == 1
