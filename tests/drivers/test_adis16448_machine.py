"""The sensor's state machine on a virtual part: the way to data, the faults of samples, the words about them."""

from __future__ import annotations

import logging
import pickle
from dataclasses import asdict
from typing import Any

import numpy as np
import pytest

from drivers.adis16448.burst import Fault
from drivers.adis16448.identity import Identity
from drivers.adis16448.machine import State
from drivers.condition import OK, Wellness
from drivers.data_ready import Edge
from estimation.records import TimeKind
from tests.drivers.inertial_kit import RATE_HZ, SECOND, Bench, bursts, flip_bit, good, identities, on_bursts

PERIOD_NS = SECOND / RATE_HZ


def test_the_way_to_data_takes_its_states_in_order_and_the_times_of_the_data_sheet() -> None:
    bench = Bench()
    entered: dict[State, int] = {}
    while State.RUN not in entered:
        came = bench.step()
        entered.setdefault(bench.sensor.state, bench.clock.now_ns())
        assert came == [] or State.RUN in entered
    assert list(entered) == [
        State.RESET,
        State.IDENTIFY,
        State.SELF_TEST,
        State.VERDICT,
        State.CONFIGURE,
        State.RUN,
    ]
    (reset_ns,) = bench.wire.sent(0xBE80)
    next_word_ns = min(t_ns for t_ns, _ in bench.wire.frames if t_ns > reset_ns)
    assert next_word_ns - reset_ns >= 90e6
    (test_ns,) = bench.wire.sent(0xB504)
    next_word_ns = min(t_ns for t_ns, _ in bench.wire.frames if t_ns > test_ns)
    assert next_word_ns - test_ns >= 45e6
    assert bench.clock.now_ns() < 0.3 * SECOND
    assert bench.longest_call_s < 0.3


def test_the_identity_comes_first_and_all_samples_follow_with_the_times_of_their_edges() -> None:
    bench = Bench()
    items = bench.run(2.0)
    assert isinstance(items[0], Identity)
    assert (items[0].product_id, items[0].lot_id, items[0].serial) == (16448, 0x1824_0042, 1234)
    assert bench.sensor.identity == items[0]
    assert identities(items) == [items[0]]
    times = [burst.t_ns for burst in good(items)]
    assert len(times) == len(items) - 1
    assert times[0] > items[0].t_ns
    assert np.diff(times) == pytest.approx(PERIOD_NS, abs=1)
    assert bench.sensor.condition == OK
    assert bench.sensor.counters.starts == 1


def test_a_block_is_handed_over_when_it_is_full_or_a_tenth_of_a_second_old() -> None:
    fast, slow = Bench({"block_samples": 16}), Bench({"decimation_exponent": 5})
    for bench, lengths in ((fast, {16}), (slow, {2, 3})):  # 40 ms apart: two or three in a tenth of a second
        bench.run_to(State.RUN)
        assert {len(bench.step()) for _ in range(20)} == lengths


@pytest.mark.parametrize(
    ("failing", "words"),
    [
        (0x2000, "the x accelerometer failed its self-test"),
        (0x0C00, "the y gyroscope failed its self-test and the x gyroscope failed its self-test"),
        (0x0020, "the self-test failed"),
    ],
)
def test_a_part_that_fails_its_self_test_three_times_is_used_but_ill(failing: int, words: str) -> None:
    bench = Bench(failing_parts=failing)
    sensor = bench.sensor
    while len(bench.wire.sent(0xB504)) < 3:
        assert bench.step() == []
        if sensor.counters.failed_self_tests and sensor.state is State.RECOVER:
            assert sensor.condition.word is Wellness.WAITING
            assert sensor.condition.what.startswith(f"{words} (DIAG_STAT 0x")
    assert np.diff(bench.wire.sent(0xB504)) / SECOND == pytest.approx([0.64, 1.14], abs=0.01)
    bench.run_to(State.RUN)
    assert len(good(bench.run(15.0))) == pytest.approx(15 * RATE_HZ, abs=10)
    assert sensor.condition.word is Wellness.ILL
    assert words in sensor.condition.what
    assert "used all the same" in sensor.condition.what
    assert sensor.notes[0].startswith(words)
    assert sensor.counters.failed_self_tests == 3
    bench.part._failing_parts = 0
    bench.part.stuck_byte = 0x00  # pulled and plugged: it is tested again
    bench.run(3.0)
    bench.part.stuck_byte = None
    bench.run_to(State.RUN)
    bench.run(20.0)
    assert (sensor.condition, sensor.notes) == (OK, [])


def test_a_part_that_passed_before_is_used_at_once_when_it_fails_its_self_test() -> None:
    bench = Bench()
    bench.run(1.0)
    bench.part._failing_parts = 0x2000
    bench.part.stuck_byte = 0x00
    bench.run(3.0)
    bench.part.stuck_byte = None
    bench.run_to(State.RUN)
    bench.run(12.0)
    assert len(bench.wire.sent(0xB504)) == 2
    assert bench.sensor.condition.word is Wellness.ILL
    assert "the x accelerometer failed its self-test" in bench.sensor.condition.what


@pytest.mark.parametrize(("stuck", "cause"), [(0xFF, "floats"), (0x00, "stays low")])
def test_a_wire_that_fails_during_the_self_test_is_blamed_and_not_the_part(stuck: int, cause: str) -> None:
    bench = Bench()
    bench.run_to(State.VERDICT)
    bench.part.stuck_byte = stuck
    bench.run_to(State.RECOVER)
    assert "PROD_ID" in bench.sensor.condition.what
    assert cause in bench.sensor.condition.advice
    assert bench.sensor.counters.failed_self_tests == 0
    assert bench.sensor.counters.wrong_id == 1


def test_a_failed_magnetometer_or_barometer_is_a_note_and_no_illness() -> None:
    bench = Bench(failing_parts=0x0003)
    bench.run(1.0)
    assert bench.sensor.state is State.RUN
    assert bench.sensor.condition == OK
    assert bench.sensor.notes == ["the barometer failed its self-test", "the magnetometer failed its self-test"]


def test_a_self_test_that_never_ends_is_given_up_and_repeated() -> None:
    bench = Bench()
    bench.wire.tamper = lambda _, answer: b"\x04\x06" if answer == b"\x00\x06" else answer
    bench.run(2.0)
    assert "the self-test did not end within 1 s" in bench.sensor.condition.what
    bench.wire.tamper = lambda _, answer: answer
    bench.run_to(State.RUN)


def test_a_required_checksum_that_the_part_has_not_keeps_it_waiting() -> None:
    bench = Bench({"burst_crc": "on"}, silicon="AMLZ")
    assert bench.run(3.0) == []
    assert bench.sensor.condition.advice == 'set burst_crc = "auto" in [imu]'
    assert bench.sensor.counters.failed_starts >= 2


@pytest.mark.parametrize(
    ("change", "fault", "wire"),
    [
        (flip_bit, Fault.CRC, "MISO"),
        (lambda frame: bytes(len(frame)), Fault.ALL_ZERO, "DOUT"),
        (lambda frame: b"\xff" * len(frame), Fault.ALL_ONE, "DOUT"),
    ],
)
def test_more_than_ten_open_faults_start_the_part_anew_at_once(change: Any, fault: Fault, wire: str) -> None:
    bench = Bench()
    bench.run(2.0)
    before = len(bench.wire.sent(0xBE80))
    bench.wire.tamper = on_bursts(change)
    bad = bursts(bench.run_to(State.RESET))
    assert [burst.fault for burst in bad] == [fault] * 11
    assert wire in bench.sensor.condition.advice
    bench.wire.tamper = lambda _, answer: answer
    began_ns = bench.clock.now_ns()
    (identity,) = identities(bench.run_to(State.RUN))
    assert bench.clock.now_ns() - began_ns < 0.15 * SECOND  # no second self-test
    assert len(bench.wire.sent(0xB504)) == 1
    assert len(bench.wire.sent(0xBE80)) == before + 1
    assert identity.t_ns >= bad[-1].t_ns
    assert bench.sensor.counters.faults[fault.name.lower()] == 11
    bench.run(0.5)
    assert bench.sensor.condition.word is Wellness.ILL
    assert "started anew" in bench.sensor.condition.what
    bench.run(11.0)
    assert bench.sensor.condition == OK


def test_a_good_sample_pays_back_what_a_bad_one_cost() -> None:
    bench = Bench()
    bench.run(1.0)
    state = {"n": 0}

    def every_second(frame: bytes) -> bytes:
        state["n"] += 1
        return flip_bit(frame) if state["n"] % 2 else frame

    bench.wire.tamper = on_bursts(every_second)
    items = bench.run(2.0)
    assert len(bench.wire.sent(0xBE80)) == 1
    assert sum(burst.fault is Fault.CRC for burst in bursts(items)) == pytest.approx(len(items) / 2, abs=1)
    condition = bench.sensor.condition
    assert (condition.word, condition.what) == (Wellness.ILL, "samples fail their checksum")


def test_counts_that_the_part_cannot_measure_are_told() -> None:
    for word, value, bad in ((2, 32_501, True), (2, -32_501, True), (2, 32_500, False), (5, 25_921, True)):
        bench = Bench({"burst_crc": "off"})
        bench.run_to(State.RUN)
        count = (value & 0xFFFF).to_bytes(2, "big")
        bench.wire.tamper = on_bursts(lambda f, w=word, c=count: f[: 2 * w] + c + f[2 * w + 2 :])  # type: ignore[misc]
        faults = {burst.fault for burst in bursts(bench.step())}
        assert faults == ({Fault.OUT_OF_RANGE} if bad else {Fault.NONE})


def test_torn_bursts_of_old_silicon_are_told_by_their_time_and_cost_no_reset() -> None:
    bench = Bench({"filter_taps_exponent": 2}, silicon="AMLZ")
    bench.run(1.0)
    late = {"s": 0.0}
    transfer = bench.part.transfer

    def slow(data: bytes, speed_hz: int) -> bytes:
        if len(data) == 26:
            bench.clock.sleep(late["s"])
        return transfer(data, speed_hz)

    bench.part.transfer = slow  # type: ignore[method-assign,assignment]
    # The burst takes 208 us; the registers change from 1040 us after the edge on.
    for late_s, fault in ((0.00082, Fault.NONE), (0.00084, Fault.TORN)):
        late["s"] = late_s
        assert {burst.fault for burst in bursts(bench.run(0.05))} == {fault}
    bench.run(1.0)
    assert len(bench.wire.sent(0xBE80)) == 1
    condition = bench.sensor.condition
    assert condition.word is Wellness.ILL
    assert "torn" in condition.what
    assert "realtime_priority" in condition.advice


def test_a_checksum_mismatch_is_torn_or_the_wires_according_to_its_time() -> None:
    bench = Bench()
    bench.run(1.0)
    bench.wire.tamper = on_bursts(flip_bit)
    assert bursts(bench.step())[0].fault is Fault.CRC
    bench.wire.tamper = lambda _, answer: answer
    bench.run(0.2)
    transfer = bench.part.transfer

    def slow(data: bytes, speed_hz: int) -> bytes:
        if len(data) == 28:
            bench.clock.sleep(0.0011)
        return transfer(data, speed_hz)

    bench.part.transfer = slow  # type: ignore[method-assign,assignment]
    faults = [burst.fault for burst in bursts(bench.run(0.1))]
    assert Fault.TORN in faults
    assert Fault.CRC not in faults


def test_a_doubled_edge_gives_a_repeated_sample_and_costs_no_reset() -> None:
    bench = Bench()
    bench.run(1.0)
    line = bench.lines[0]
    resets = len(bench.wire.sent(0xBE80))
    for _ in range(30):
        last = bursts(bench.run(0.001))[-1]
        line.extra.append(Edge(last.t_ns + 100_000, TimeKind.EDGE))
        bench.run(0.02)
    assert bench.sensor.counters.faults["repeated"] == 30
    assert len(bench.wire.sent(0xBE80)) == resets


def test_edge_stamps_from_the_future_or_the_past_never_turn_time_back() -> None:
    bench = Bench()
    items = bench.run(1.0)
    for offset_s in (100.0, -0.5, 1e9):
        bench.lines[0].extra.append(Edge(bench.clock.now_ns() + round(offset_s * 1e9), TimeKind.EDGE))
        items += bench.run(0.1)
    times = [burst.t_ns for burst in bursts(items)]
    assert np.all(np.diff(times) >= 0)
    assert np.all(np.diff([burst.t_ns for burst in good(items)]) > 0)
    assert times[-1] <= bench.clock.now_ns()
    assert bench.sensor.state is State.RUN


def test_frozen_registers_are_reset() -> None:
    bench = Bench()
    bench.run(1.0)
    frame: list[bytes] = []

    def freeze(answer: bytes) -> bytes:
        frame.append(answer)
        return frame[0]

    bench.wire.tamper = on_bursts(freeze)
    bad = bursts(bench.run_to(State.RESET))
    assert [burst.fault for burst in bad] == [Fault.NONE] * 13 + [Fault.REPEATED] * 11


def test_the_parts_own_diagnosis_is_counted_latched_and_told_for_ten_seconds() -> None:
    bench = Bench()
    bench.run(1.0)

    def over_range(frame: bytes) -> bytes:
        return frame[:2] + bytes([frame[2], frame[3] | 0x10]) + frame[4:]

    bench.wire.tamper = on_bursts(over_range)
    count = len(bench.step())
    bench.wire.tamper = lambda _, answer: answer
    bench.run(0.5)
    sensor = bench.sensor
    assert sensor.counters.diagnoses["a sensor is beyond its range"] == count
    assert sum(sensor.counters.diagnoses.values()) == count  # NEW DATA is no fault
    assert sensor.condition.what == "the sensor says: a sensor is beyond its range"
    bench.run(9.0)
    assert sensor.condition.word is Wellness.ILL
    bench.run(1.5)
    assert sensor.condition == OK


def test_a_diagnosis_beside_a_wrong_checksum_does_not_count() -> None:
    bench = Bench()
    bench.run(1.0)
    bench.wire.tamper = on_bursts(lambda frame: flip_bit(frame[:2] + b"\xff\xff" + frame[4:]))
    bench.step()
    assert sum(bench.sensor.counters.diagnoses.values()) == 0


def test_lateness_is_counted_in_bins_and_the_worst_is_kept() -> None:
    bench = Bench()
    bench.run(1.0)
    before = list(bench.sensor.counters.lateness)
    newest = bursts(bench.run(0.01))[-1].t_ns
    bench.clock.advance_to(round(newest + PERIOD_NS + 300_000))
    bench.step()
    gained = np.array(bench.sensor.counters.lateness) - before
    assert gained[3] == 1
    assert gained[1:3].sum() + gained[4:].sum() == 0
    assert bench.sensor.counters.latest_read_s == pytest.approx(300e-6, abs=2e-6)


def test_the_counters_are_plain_data() -> None:
    bench = Bench()
    bench.run(0.5)
    counters = bench.sensor.counters
    assert pickle.loads(pickle.dumps(counters)) == counters
    twice = asdict(counters.plus(counters))
    assert twice["samples"] == 2 * counters.samples
    assert twice["lateness"] == [2 * n for n in counters.lateness]
    assert twice["latest_read_s"] == counters.latest_read_s


def test_progress_moves_also_while_nothing_comes() -> None:
    bench = Bench()
    bench.part.stuck_byte = 0x00
    for call in range(1, 51):
        assert bench.step() == []
        assert bench.sensor.progress == call
    assert 2 * SECOND < bench.clock.now_ns() < 6 * SECOND
    assert bench.longest_call_s <= 0.11


def test_a_fault_of_the_program_is_survived_counted_and_told(caplog: pytest.LogCaptureFixture) -> None:
    bench = Bench()
    bench.run(1.0)

    def broken(_data: bytes, _answer: bytes) -> bytes:
        raise ZeroDivisionError("nobody foresaw this")

    bench.wire.tamper = broken
    with caplog.at_level(logging.INFO):
        bench.run(2.0)
    assert bench.sensor.counters.errors > 1
    assert "nobody foresaw this" in bench.sensor.condition.what
    assert sum(record.exc_info is not None for record in caplog.records) == 1
    bench.wire.tamper = lambda _, answer: answer
    bench.run_to(State.RUN)


def test_a_diagnosis_that_does_not_come_again_is_counted_but_not_told() -> None:
    """No checksum covers DIAG_STAT: a bit that a wire turned over is no failed self-test."""
    bench = Bench()
    bench.run(1.0)
    turned_over = [True]

    def flip_once(frame: bytes) -> bytes:
        return frame[:2] + bytes([frame[2] | 0x10]) + frame[3:] if turned_over and turned_over.pop() else frame

    bench.wire.tamper = on_bursts(flip_once)
    bench.run(0.5)
    assert bench.sensor.counters.diagnoses["the z gyroscope failed its self-test"] == 1
    assert bench.sensor.condition == OK
