"""Parts pulled, replaced and browned out, ports and lines that fail and come back; nothing ends the sensor."""

from __future__ import annotations

import logging
from itertools import pairwise

import numpy as np
import pytest

from drivers.adis16448.burst import Fault
from drivers.adis16448.machine import State
from drivers.adis16448.registers import CMD_RESET
from drivers.condition import OK, Wellness
from drivers.virtual.adis16448 import VirtualAdis16448
from drivers.virtual.adis16448_memory import Memory
from estimation.records import TimeKind
from tests.drivers.inertial_kit import RATE_HZ, SECOND, Bench, bursts, good, identities


def pull(bench: Bench) -> None:
    bench.part.stuck_byte = 0xFF
    bench.part.is_line_cut = True


def plug(bench: Bench, serial: int = 1234) -> None:
    """The same part, or another one, powers up with registers as from the factory."""
    part: VirtualAdis16448 = bench.part
    part._memory = Memory(0x1824_0042, serial, has_crc=True)
    part._update_signal(bench.clock.now_ns())
    part.stuck_byte = None
    part.is_line_cut = False


def test_a_pulled_part_is_named_waited_for_tested_and_started_again() -> None:
    bench = Bench()
    before = bench.run(2.0)
    pull(bench)
    away = bench.run(6.9)
    assert {burst.fault for burst in bursts(away)} == {Fault.ALL_ONE}
    assert len(bursts(away)) <= 12
    condition = bench.sensor.condition
    assert condition.word is Wellness.WAITING
    assert condition.what == "register PROD_ID (0x56) reads 0xFFFF instead of 0x4040"
    assert "floats" in condition.advice
    assert bench.sensor.counters.wrong_id == pytest.approx(65, abs=6)  # ten a second
    plug(bench)
    plugged_ns = bench.clock.now_ns()
    back = bench.run_to(State.RUN)
    assert bench.clock.now_ns() - plugged_ns < 0.6 * SECOND
    back += bench.run(2.0)
    (identity,) = identities(back)
    assert back[0] == identity
    assert identity.is_same_part(identities(before)[0])
    assert len(bench.wire.sent(0xB504)) == 2
    assert len(good(back)) == pytest.approx(2 * RATE_HZ, abs=10)
    assert bench.longest_call_s < 0.3
    assert bench.sensor.counters.other_parts == 0


def test_a_part_that_powers_up_is_given_the_time_of_the_data_sheet() -> None:
    bench = Bench()
    bench.part.stuck_byte = 0x00
    bench.run(0.5)
    bench.part.stuck_byte = None
    bench.run_to(State.SELF_TEST)
    asked = bench.wire.sent(0x5600)
    assert max(np.diff(asked)) >= 205e6
    bench.run_to(State.RUN)


def test_another_part_is_told_tested_and_has_its_own_clock() -> None:
    bench = Bench()
    first = bench.run(2.0)
    pull(bench)
    bench.run(2.0)
    plug(bench, serial=777)
    (identity,) = identities(bench.run(1.0))
    assert identity.serial == 777
    assert not identity.is_same_part(identities(first)[0])
    assert bench.sensor.identity == identity
    assert bench.sensor.counters.other_parts == 1
    assert len(bench.wire.sent(0xB504)) == 2


@pytest.mark.parametrize("silicon", ["BMLZ", "AMLZ"])
def test_a_brown_out_that_loses_the_settings_is_found_and_repaired(silicon: str) -> None:
    bench = Bench(silicon=silicon)
    bench.run(2.0)
    bench.part._memory.restart()
    bench.part._update_signal(bench.clock.now_ns())
    lost_ns = bench.clock.now_ns()
    bench.run_to(State.RESET)
    # The checksum shows it in the next burst, else the round of the registers, one every 0.1 s.
    assert bench.clock.now_ns() - lost_ns < (0.02 if silicon == "BMLZ" else 0.32) * SECOND
    assert "the part lost its settings" in bench.sensor.condition.what
    bench.run_to(State.RUN)
    assert bench.clock.now_ns() - lost_ns < 0.5 * SECOND
    assert bench.sensor.counters.wrong_registers == 1
    assert len(bench.wire.sent(0xB504)) == 1
    assert bench.part._memory.gyro_range_dps == 500


def test_one_wrong_answer_to_a_register_read_is_the_wires_and_changes_nothing() -> None:
    bench = Bench()
    bench.run(1.0)
    answers = 0

    def tamper(data: bytes, answer: bytes) -> bytes:
        nonlocal answers
        answers += answer == b"\x00\x16"
        return b"\x00\x06" if answer == b"\x00\x16" and answers == 1 else answer

    bench.wire.tamper = tamper
    bench.run(2.0)
    assert answers > 3
    assert bench.sensor.counters.wrong_registers == 0
    assert bench.sensor.counters.starts == 1


def test_registers_are_checked_in_turn_ten_times_a_second_and_cost_no_sample() -> None:
    bench = Bench()
    bench.run_to(State.RUN)
    bench.wire.frames.clear()
    bench.run(3.0)
    for request in (0x3400, 0x3600, 0x3800):
        assert len(bench.wire.sent(request)) == pytest.approx(10, abs=1)
    assert bench.sensor.counters.missed == 0


def test_a_port_that_cannot_be_opened_is_tried_with_growing_pauses() -> None:
    bench = Bench()
    bench.wire.open_error = "there is no SPI port /dev/spidev0.0: enable SPI"
    tried: list[int] = []
    attempts = 0
    while bench.clock.now_ns() < 30 * SECOND:
        assert bench.step() == []
        if bench.sensor.counters.port_failures > attempts:
            attempts = bench.sensor.counters.port_failures
            tried.append(bench.clock.now_ns())
    assert np.diff(tried)[:6] / SECOND == pytest.approx([0.5, 1.0, 2.0, 4.0, 5.0, 5.0], abs=0.01)
    assert bench.longest_call_s <= 0.11
    condition = bench.sensor.condition
    assert (condition.word, condition.what) == (Wellness.WAITING, bench.wire.open_error)
    bench.wire.open_error = ""
    bench.run_to(State.RUN)


def test_a_port_that_dies_is_opened_anew_and_a_port_that_stumbles_is_not() -> None:
    bench = Bench()
    bench.run(2.0)
    bench.wire.error = "the SPI transfer failed"
    stumbled = bench.step()
    bench.wire.error = ""
    bench.run(1.0)
    assert {burst.fault for burst in bursts(stumbled)} == {Fault.SPI}
    assert (bench.wire.opened, bench.wire.closed) == (1, 0)

    bench.wire.error = bench.wire.open_error = "the port is gone"
    bench.run(3.0)
    assert bench.wire.closed == 1
    assert bench.sensor.condition.what == "the port is gone"
    bench.wire.error = bench.wire.open_error = ""
    back = bench.run_to(State.RUN)
    assert len(identities(back)) == 1
    assert bench.wire.opened == 2
    assert len(bench.lines) == 1  # the line was not the port's
    assert len(bench.wire.sent(0xB504)) == 2


def test_a_dead_port_under_a_running_line_does_not_spin() -> None:
    bench = Bench()
    bench.run(1.0)
    bench.wire.error = "the port is gone"
    calls = 0
    end_ns = bench.clock.now_ns() + 10 * SECOND
    while bench.clock.now_ns() < end_ns:
        bench.step()
        calls += 1
    assert calls < 200


def test_ports_stay_open_over_a_recovery_of_the_part() -> None:
    bench = Bench()
    bench.run(1.0)
    bench.part._memory.restart()
    bench.run(1.0)
    assert bench.sensor.counters.starts == 2
    assert (bench.wire.opened, bench.wire.closed, len(bench.lines), bench.lines[0].closed) == (1, 0, 1, 0)


def test_a_cut_line_is_paced_in_step_with_its_last_edge_and_taken_back() -> None:
    bench = Bench()
    before = bench.run(3.0)
    bench.part.is_line_cut = True
    cut_ns = bench.clock.now_ns()
    paced = bench.run(20.0)
    assert {burst.time_kind for burst in bursts(paced)} == {TimeKind.READ}
    # Not one lost but those before the line was given up, although the part's clock is 2.3 % slow.
    assert {burst.fault for burst in bursts(paced)} == {Fault.NONE}
    assert len(paced) == pytest.approx((20.0 - 0.05) * RATE_HZ, abs=10)
    phase_ns = np.array([burst.t_ns for burst in bursts(paced)]) % (SECOND / RATE_HZ)
    assert np.all(np.abs(phase_ns - 300_000) < 30_000)
    condition = bench.sensor.condition
    assert (condition.word, condition.what) == (Wellness.ILL, "the data-ready line is silent: reads are paced")
    assert "DIO1" in condition.advice
    bench.part.is_line_cut = False
    back_ns = bench.clock.now_ns()
    after = bench.run(6.0)
    first = next(burst for burst in bursts(after) if burst.time_kind is TimeKind.EDGE)
    assert first.t_ns - back_ns < 0.007 * SECOND  # four edges in step
    times = [burst.t_ns for burst in bursts(before + paced + after)]
    assert np.all(np.diff(times) > 0)
    counters = bench.sensor.counters
    assert (counters.silences, counters.missed, counters.missed_paced) == (1, 0, 0)
    assert counters.missed_silent == pytest.approx((bursts(paced)[0].t_ns - cut_ns) / SECOND * RATE_HZ, abs=2)
    assert bench.sensor.condition == OK


def test_a_line_that_fails_does_not_stop_sampling_and_is_opened_again() -> None:
    bench = Bench()
    bench.run(1.0)
    bench.lines[0].error = bench.line_error = "cannot read line 5: no such device"
    paced = bench.run(5.0)
    assert len(good(paced)) > 4.9 * RATE_HZ
    assert bench.sensor.condition.what.startswith("cannot read line 5: no such device: reads are paced")
    assert 4 <= bench.sensor.counters.line_failures <= 7
    assert bench.lines[0].closed == 1
    bench.line_error = ""
    back = bench.run(2.0)
    assert bursts(back)[-1].time_kind is TimeKind.EDGE
    assert len(bench.lines) == 2
    assert bench.sensor.counters.starts == 1


@pytest.mark.parametrize("rate_hz", [795.0, 819.2, 844.0])
def test_without_a_line_nearly_all_samples_are_read_whatever_the_parts_clock(rate_hz: float) -> None:
    from drivers.virtual.inertial_input import SteadyInput

    bench = Bench(source=SteadyInput(rate_hz), line=False)
    bench.run_to(State.RUN)
    items = bench.run(4.0)
    # Standing their ground the reads would lose the 0.37 ms of 1.2 ms in which a burst is torn: 30 %.
    assert len(good(items)) > 0.9 * 4 * min(rate_hz, 819.2)
    assert {burst.fault for burst in bursts(items)} <= {Fault.NONE, Fault.TORN, Fault.REPEATED}
    assert bench.sensor.counters.starts == 1
    assert bench.sensor.condition.word is not Wellness.WAITING


def test_a_heavy_filter_at_rest_and_a_cut_line_do_not_look_like_a_frozen_part() -> None:
    bench = Bench({"filter_taps_exponent": 7})
    bench.run(2.0)
    bench.part.is_line_cut = True
    items = bench.run(5.0)
    assert len(good(items)) > 4.8 * RATE_HZ
    assert bench.sensor.counters.starts == 1


def test_a_flapping_cable_does_not_flood_the_log_and_its_last_line_is_true(caplog: pytest.LogCaptureFixture) -> None:
    bench = Bench()
    with caplog.at_level(logging.INFO):
        bench.run(1.0)
        for _ in range(40):
            bench.part.stuck_byte = 0x00
            bench.run(0.3)
            bench.part.stuck_byte = None
            bench.run_to(State.RUN)
            bench.run(0.3)
        bench.run(25.0)
    lines = [record.getMessage() for record in caplog.records]
    assert len(lines) < 40
    assert any("times)" in line for line in lines)
    assert bench.sensor.condition == OK
    assert lines[-1].startswith("inertial sensor: the part restarted")
    assert bench.sensor.counters.starts == 41


def test_reset_is_never_mistaken_for_a_flash_command() -> None:
    bench = Bench()
    bench.run(1.0)
    for stuck in (0x00, 0xFF):
        bench.part.stuck_byte = stuck
        bench.run(3.0)
        bench.part.stuck_byte = None
        bench.run(1.0)
    commands = {data[1] for _, data in bench.wire.frames if data[0] == 0xBE}
    assert commands == {CMD_RESET}
    times = [t_ns for t_ns, data in bench.wire.frames]
    assert min(later - early for early, later in pairwise(times)) >= 40_000
