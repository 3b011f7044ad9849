"""The driver against the virtual part, and against wires that fail."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest

from drivers.adis16448.burst import Fault
from drivers.adis16448.configuration import ImuSettings
from drivers.adis16448.device import Adis16448, ChecksumMissing, ImuError
from drivers.clock import VirtualClock
from drivers.spi import SpiError
from drivers.virtual.adis16448 import VirtualAdis16448
from drivers.virtual.inertial_input import SteadyInput
from estimation.records import TimeKind
from tests.drivers.inertial_kit import Wire, bring_up, flip_bit


def bench(
    settings: ImuSettings | None = None, source: SteadyInput | None = None, **part: Any
) -> tuple[Adis16448, Wire, VirtualClock]:
    clock = VirtualClock()
    wire = Wire(VirtualAdis16448(source or SteadyInput(), clock, **part))
    return Adis16448(wire, clock, settings or ImuSettings()), wire, clock


def writes(wire: Wire) -> list[int]:
    return [int.from_bytes(data, "big") for _, data in wire.frames if data[0] & 0x80]


def test_the_way_to_data_writes_only_what_differs() -> None:
    device, wire, clock = bench(lot_id=0x1824_ABCD, serial=0xF321)
    identity = bring_up(device, clock)
    assert (identity.product_id, identity.lot_id, identity.serial) == (16448, 0x1824_ABCD, 0x321)
    assert device.crc_active
    # Reset, self-test in the high byte alone, range 500 (the only difference from the defaults), checksum.
    assert writes(wire) == [0xBE80, 0xB504, 0xB902, 0xB416]


def test_a_part_left_in_another_configuration_is_brought_to_ours_whatever_the_order_of_limits() -> None:
    device, wire, _ = bench(ImuSettings(gyro_range_dps=1000, filter_taps_exponent=1))
    device.write_register("SENS_AVG", 0x0106)
    device.write_register("SMPL_PRD", 0x0B01)
    wire.frames.clear()
    device.configure()
    assert device.read_register("SENS_AVG") == 0x0401
    assert device.read_register("SMPL_PRD") == 0x0001
    assert writes(wire) == [0xB700, 0xB904, 0xB801, 0xB416]


def test_the_second_data_ready_pin_is_configured_and_the_pin_stays_high_behind_an_inverter() -> None:
    device, _, clock = bench(ImuSettings(data_ready_pin=2, data_ready_active_high=False, burst_crc="off"))
    bring_up(device, clock)
    assert device.read_register("MSC_CTRL") == 0x0007
    assert not device.crc_active


def test_flash_is_never_written() -> None:
    device, _, clock = bench()
    bring_up(device, clock)
    bring_up(device, clock)
    assert device.read_register("FLASH_CNT") == 0


def test_old_silicon_is_read_without_a_checksum_and_says_so() -> None:
    device, _, _ = bench(silicon="AMLZ")
    assert device.configure() == [
        "the part sends no burst checksum (old silicon): only its time tells that a burst was torn"
    ]
    assert not device.crc_active
    burst = device.read_burst(1, TimeKind.EDGE)
    assert (burst.crc, burst.fault) == (None, Fault.NONE)


def test_silicon_that_takes_the_checksum_bit_but_sends_none_is_found_out() -> None:
    device, wire, _ = bench()
    bursts = 0

    def without_checksum(data: bytes, answer: bytes) -> bytes:
        nonlocal bursts
        bursts += len(data) == 28
        return answer[:-2] + b"\x5a\xa5" if len(data) == 28 else answer

    wire.tamper = without_checksum
    with pytest.raises(ChecksumMissing, match="check the wires"):
        device.configure()
    assert bursts == 64
    assert len(device.configure(may_lack_crc=True)) == 1
    assert not device.crc_active
    assert device.read_register("MSC_CTRL") == 0x0006


def test_a_bad_wire_does_not_talk_the_driver_out_of_the_checksum() -> None:
    device, wire, _ = bench()
    count = itertools.count()
    wire.tamper = lambda data, answer: flip_bit(answer) if len(data) == 28 and next(count) % 20 else answer
    assert device.configure() == []
    assert device.crc_active


def test_a_checksum_that_is_required_but_absent_stops_the_start() -> None:
    device, _, clock = bench(ImuSettings(burst_crc="on"), silicon="AMLZ")
    with pytest.raises(ImuError, match='set burst_crc = "auto"'):
        bring_up(device, clock)
    device, _, clock = bench(ImuSettings(burst_crc="on"))
    bring_up(device, clock)
    assert device.crc_active


def test_torn_bursts_during_the_probe_do_not_hide_the_checksum() -> None:
    outcomes = []
    for phase_ns in range(0, 1_200_000, 100_000):
        device, _, clock = bench(source=SteadyInput(start_ns=phase_ns))
        bring_up(device, clock)
        outcomes.append(device.crc_active)
    assert outcomes == [True] * 12


@pytest.mark.parametrize(("stuck", "reads", "cause"), [(0x00, "0x0000", "stays low"), (0xFF, "0xFFFF", "floats")])
def test_a_dead_data_wire_is_named(stuck: int, reads: str, cause: str) -> None:
    device, wire, clock = bench()
    wire.part.stuck_byte = stuck
    with pytest.raises(ImuError, match=rf"PROD_ID \(0x56\) reads {reads} instead of 0x4040: .*{cause}"):
        bring_up(device, clock)
    burst = device.read_burst(5, TimeKind.READ)
    assert burst.fault is (Fault.ALL_ONE if stuck else Fault.ALL_ZERO)


def test_another_part_on_the_bus_is_refused() -> None:
    device, wire, clock = bench()
    wire.tamper = lambda data, answer: b"\x40\x3d" if answer == b"\x40\x40" else answer
    with pytest.raises(ImuError, match=r"reads 0x403D instead of 0x4040: check the wires"):
        bring_up(device, clock)


def test_a_register_that_never_reads_the_same_twice_is_named() -> None:
    device, wire, clock = bench(lot_id=0x1824_0042)
    flips = itertools.cycle([b"\x18\x24", b"\x18\x00"])
    wire.tamper = lambda data, answer: next(flips) if answer == b"\x18\x24" else answer
    with pytest.raises(ImuError, match=r"LOT_ID1 \(0x52\) reads 0x1824, then 0x1800"):
        bring_up(device, clock)


def test_a_write_that_does_not_stick_names_register_and_values() -> None:
    device, wire, _ = bench(ImuSettings(decimation_exponent=2))
    wire.tamper = lambda data, answer: b"\x00\x01" if answer == b"\x02\x01" else answer
    with pytest.raises(ImuError, match=r"SMPL_PRD \(0x36\) was written 0x0201 and reads back 0x0001: check the wires"):
        device.configure()
    assert writes(wire).count(0xB702) == 3


def test_the_self_test_keeps_data_ready_and_checksum() -> None:
    device, _, clock = bench()
    bring_up(device, clock)
    assert device.read_register("MSC_CTRL") == 0x0016
    device.begin_self_test()
    assert device.self_test_verdict() is None
    clock.sleep(0.045)
    assert device.self_test_verdict() == []
    assert device.read_register("MSC_CTRL") == 0x0016


def test_register_words_keep_the_parts_pace_and_speed() -> None:
    clock = VirtualClock()
    twin = VirtualAdis16448(SteadyInput(), clock)
    starts: list[int] = []
    speeds: set[int] = set()

    class Timed:
        def transfer(self, data: bytes, speed_hz: int) -> bytes:
            starts.append(clock.now_ns())
            speeds.add(speed_hz)
            return twin.transfer(data, speed_hz)

        def close(self) -> None:
            pass

    device = Adis16448(Timed(), clock, ImuSettings())
    for name in ("PROD_ID", "LOT_ID1", "MSC_CTRL"):
        device.read_register(name)
    device.read_burst(0, TimeKind.EDGE)
    assert min(np.diff(starts)) >= 40_000
    assert max(speeds) <= 1_000_000


def test_several_registers_are_read_in_one_frame_more_than_there_are() -> None:
    device, wire, clock = bench()
    bring_up(device, clock)
    wire.frames.clear()
    assert device.read_registers("PROD_ID", "MSC_CTRL", "SMPL_PRD") == [0x4040, 0x0016, 0x0001]
    assert [data for _, data in wire.frames] == [b"\x56\x00", b"\x34\x00", b"\x36\x00", b"\x00\x00"]


def test_the_registers_are_checked_in_turn_and_a_lost_setting_is_named() -> None:
    device, _, clock = bench()
    bring_up(device, clock)
    assert [device.wrong_register() for _ in range(6)] == [None] * 6
    device.write_register("SENS_AVG", 0x0402)
    sentence = "register SENS_AVG (0x38) was set to 0x0202 and reads 0x0402"
    assert sorted(device.wrong_register() or "" for _ in range(3)) == ["", "", sentence]


def test_a_port_that_returns_too_little_is_an_error_of_the_port() -> None:
    device, wire, clock = bench()
    bring_up(device, clock)
    wire.tamper = lambda _, answer: answer[:-1]
    with pytest.raises(SpiError, match="returned 27 bytes of 28"):
        device.read_burst(0, TimeKind.EDGE)
