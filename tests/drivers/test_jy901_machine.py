"""The JY901 through everything a fault script can do to it: what is said meanwhile, what is lost, how it goes on."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import pytest

from drivers.condition import OK, Condition, Wellness
from drivers.jy901.port import PortError
from tests.drivers.jy901_kit import Bench


def longest_gap_s(bench: Bench) -> float:
    times = [one.t_ns for one in bench.readings if not one.is_frozen]
    return max(b - a for a, b in pairwise(times)) * 1e-9


def conditions(bench: Bench, until_s: float) -> list[Condition]:
    """All that were told on the way."""
    told: list[Condition] = []
    while bench.now_s < until_s:
        bench.run(bench.now_s + 1e-6)
        if not told or told[-1] != bench.sensor.condition:
            told.append(bench.sensor.condition)
    return told


def test_it_starts_within_a_second_and_a_half_from_any_baud_rate() -> None:
    bench = Bench(seconds=6.0, found_at=4800)
    bench.run(5.0)
    assert bench.sensor.condition == OK
    assert bench.identities[0].t_ns < 3e9
    assert bench.sensor.counters.starts == 1
    assert bench.sensor.counters.lost == 0
    assert bench.readings[0].t_ns >= bench.identities[0].t_ns - 100_000_000


# fault: (keys, word meanwhile, words, seconds without samples beyond the fault's own 2 s, what is counted)
TABLE: dict[str, tuple[dict[str, Any], Wellness, str, float, str]] = {
    "serial_cut": ({}, Wellness.WAITING, "nothing comes on the serial line", 0.1, "silences"),
    "adapter_gone": ({}, Wellness.WAITING, "the serial port of the virtual JY901 is gone", 1.5, "port_failures"),
    "jy901_brown_out": ({}, Wellness.WAITING, "bytes come that are no samples", 2.0, "silences"),
    "serial_drops": ({"share": 0.02}, Wellness.ILL, "samples are lost on the serial line", -1.8, "halves"),
    "serial_flips": ({"probability": 2e-3}, Wellness.ILL, "samples are lost", -1.8, "bad_checksums"),
    "serial_garbage": ({"rate_hz": 50}, Wellness.OK, "", -1.8, "skipped_bytes"),
    "serial_heaps": ({"every_ms": 16.0}, Wellness.OK, "", -1.9, "samples"),
    "jy901_frozen": ({}, Wellness.ILL, "the samples stand still", 0.1, "frozen"),
}


@pytest.mark.parametrize("kind", TABLE)
def test_each_fault_is_told_survived_and_counted(kind: str) -> None:
    keys, word, words, beyond_s, counted = TABLE[kind]
    bench = Bench({"kind": kind, "at_s": 6.0, "for_s": 2.0, **keys}, seconds=22.0)
    bench.run(5.9)
    assert bench.sensor.condition == OK
    told = conditions(bench, 12.0)
    assert any(one.word is word and words in one.what for one in told), told
    assert all(one.advice for one in told if one.what)
    assert not any("samples a second" in one.what for one in told)
    assert longest_gap_s(bench) < 2.0 + beyond_s
    assert getattr(bench.sensor.counters, counted) > 0
    bench.run(20.0)
    assert bench.sensor.condition == OK
    assert bench.sensor.counters.errors == 0
    assert len(bench.between(13.0, 20.0)) == pytest.approx(7 * 200, abs=4)
    times = [one.t_ns for one in bench.readings]
    assert times == sorted(set(times))


def test_what_is_lost_is_counted() -> None:
    bench = Bench({"kind": "serial_drops", "at_s": 5.0, "for_s": 5.0, "share": 0.01}, seconds=14.0)
    bench.run(5.0)
    before = len(bench.readings)
    bench.run(12.0)
    wanted = 7 * 200
    got = len(bench.readings) - before
    assert wanted - got > 50
    # Half a group and a whole one that left a hole; a hole at the end of a half counts once.
    assert bench.sensor.counters.missed == pytest.approx(wanted - got, abs=0.1 * (wanted - got) + 2)


def test_noise_that_looks_like_packets_makes_no_sample() -> None:
    script = {"kind": "serial_garbage", "at_s": 5.0, "for_s": 10.0, "rate_hz": 200}
    clean, noisy = Bench(seconds=20.0), Bench(script, seconds=20.0)
    for bench in (clean, noisy):
        bench.run(18.0)
    words = {(one.accel, one.gyro) for one in clean.readings}
    strange = [one for one in noisy.readings if (one.accel, one.gyro) not in words]
    assert len(noisy.between(5.0, 15.0)) > 0.8 * 2000
    assert len(strange) <= 2  # a false head whose sum fits by chance: one in 256 of those that overlap nothing


def test_a_dead_band_is_noted() -> None:
    bench = Bench({"kind": "jy901_dead_band", "at_s": 0.0, "for_s": 100.0}, seconds=10.0)
    bench.part.motion._gyro[:] = 0.001  # type: ignore[attr-defined]  # a slow turn
    bench.run(8.0)
    assert "dead band" in bench.sensor.notes[0]
    assert len(bench.sensor.notes) == 1


def test_a_part_that_came_back_with_its_speed_but_not_its_rate_is_set_up_again() -> None:
    bench = Bench(seconds=30.0, found_at=115200)
    bench.run(5.0)
    bench.part.power_cycle(bench.clock.now_ns())
    assert bench.part.rate_hz == 10
    bench.run(15.0)
    assert bench.part.rate_hz == 200
    assert bench.sensor.condition == OK
    assert bench.sensor.counters.starts == 2


def test_a_part_that_sends_too_few_samples_is_told() -> None:
    bench = Bench(seconds=30.0)
    bench.run(3.0)
    bench.part.registers[0x03] = 9  # 100 Hz
    bench.run(14.0)
    assert bench.sensor.condition.word is Wellness.ILL
    assert "the part sends 100 samples a second, not 200" in bench.sensor.condition.what
    assert "bandwidth_hz in [jy901]" in bench.sensor.condition.advice


def test_a_port_that_cannot_be_opened_is_tried_for_ever_and_told() -> None:
    bench = Bench(seconds=60.0)

    def refuse() -> Any:
        bench.opened += 1
        raise PortError("cannot open the serial port /dev/ttyUSB0: No such file or directory")

    bench.sensor._open_port = refuse
    bench.run(10.0)
    assert bench.sensor.condition.what.startswith("cannot open the serial port")
    assert "port in [jy901]" in bench.sensor.condition.advice
    assert 15 <= bench.opened <= 21
    bench.sensor._open_port = bench.open
    bench.run(16.0)
    assert bench.sensor.condition == OK


def test_a_fault_of_the_program_is_survived(caplog: pytest.LogCaptureFixture) -> None:
    bench = Bench(seconds=30.0)
    bench.run(4.0)
    assert bench.sensor._reader is not None
    bench.sensor._reader.feed = lambda *_: 1 / 0  # type: ignore[assignment, method-assign]
    bench.run(4.5)
    assert "a fault of the program (ZeroDivisionError" in bench.sensor.condition.what
    bench.run(9.0)
    assert bench.sensor.condition == OK
    assert bench.sensor.counters.errors == 1
    assert "a fault of the program" in caplog.text


def test_counters_go_on_over_restarts() -> None:
    fault = {"kind": "jy901_brown_out", "at_s": 6.0, "for_s": 0.3}
    bench = Bench({"kind": "serial_drops", "at_s": 3.0, "for_s": 2.0}, fault, seconds=20.0)
    bench.run(5.5)
    before = bench.sensor.counters.halves
    assert before > 0
    bench.run(12.0)
    assert bench.sensor.counters.halves >= before
    assert bench.sensor.counters.starts == 2
    assert bench.sensor.counters.other_parts == 0


@pytest.mark.parametrize("stall_s", [0.02, 0.045, 0.06, 0.3])
def test_a_reader_that_was_held_up_squeezes_no_samples(stall_s: float) -> None:
    """What waited for it is stamped too late; what comes then must not be stamped all at once."""
    bench = Bench(seconds=20.0)
    bench.run(8.0)
    for _ in range(5):
        bench.clock.sleep(stall_s)
        bench.run(bench.now_s + 0.6)
    steps = [(b.t_ns - a.t_ns) * 1e-9 for a, b in pairwise(bench.readings) if a.t_ns > 7.5e9]
    assert min(steps) > 0.7 / 200
    assert max(steps) < 0.06 + stall_s
    assert abs(bench.readings[-1].t_ns * 1e-9 - bench.now_s) < 0.02
    assert bench.sensor.counters.missed < 5  # they waited; nothing was lost
    assert bench.sensor.counters.samples > 0.97 * 200 * (bench.now_s - bench.identities[0].t_ns * 1e-9)


def test_half_a_sample_before_a_cable_is_pulled_is_no_other_baud_rate() -> None:
    for at_s in (6.0, 6.001, 6.002, 6.003, 6.004):
        bench = Bench({"kind": "serial_cut", "at_s": at_s, "for_s": 2.0}, seconds=12.0)
        bench.run(10.0)
        assert bench.sensor.counters.starts == 1
        assert longest_gap_s(bench) < 2.1


def test_a_cable_that_comes_back_late_is_found_within_a_second_and_a_half() -> None:
    for for_s in (8.0, 8.4, 8.8, 9.2):
        bench = Bench({"kind": "serial_cut", "at_s": 4.0, "for_s": for_s}, seconds=22.0)
        bench.run(20.0)
        assert longest_gap_s(bench) < for_s + 1.5
