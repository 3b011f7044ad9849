"""The driver against the virtual part, and against wires that fail."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest

from drivers.adis16448.burst import BurstDecoder, Fault
from drivers.adis16448.configuration import ImuSettings
from drivers.adis16448.device import Adis16448, ImuError, State
from drivers.clock import VirtualClock
from drivers.data_ready import Edge
from drivers.spi import SpiError
from drivers.virtual.adis16448 import VirtualAdis16448
from drivers.virtual.inertial_input import SteadyInput
from estimation.records import TimeKind

about: Any = pytest.approx
RANGES_AND_TAPS = [
    (gyro_range, taps) for gyro_range, least in ((1000, 0), (500, 2), (250, 4)) for taps in range(least, 8)
]


class Recorder:
    """A transport that notes the frames on their way, and may change answers."""

    def __init__(self, inner: VirtualAdis16448) -> None:
        self.inner = inner
        self.frames: list[bytes] = []
        self.tamper: Any = lambda _data, answer: answer

    def transfer(self, data: bytes, speed_hz: int) -> bytes:
        self.frames.append(data)
        answer: bytes = self.tamper(data, self.inner.transfer(data, speed_hz))
        return answer

    def close(self) -> None:
        self.inner.close()

    def writes(self) -> list[int]:
        return [int.from_bytes(f, "big") for f in self.frames if len(f) == 2 and f[0] & 0x80]


def bench(
    settings: ImuSettings | None = None, source: SteadyInput | None = None, **part: Any
) -> tuple[Adis16448, Recorder, VirtualAdis16448]:
    clock = VirtualClock()
    twin = VirtualAdis16448(source or SteadyInput(), clock, **part)
    recorder = Recorder(twin)
    return Adis16448(recorder, clock, settings or ImuSettings()), recorder, twin


def test_start_tells_who_the_part_is_and_ends_ready_to_read() -> None:
    device, recorder, _ = bench(lot_id=0x1824_ABCD, serial=0xF321)
    identity = device.start()
    assert (identity.product_id, identity.lot_id, identity.serial) == (16448, 0x1824_ABCD, 0x321)
    assert device.state is State.READ
    assert device.crc_active
    assert device.notes == []
    # Reset, self-test in the high byte alone, range 500 (the only difference from the defaults), checksum.
    assert recorder.writes() == [0xBE80, 0xB504, 0xB902, 0xB416]


@pytest.mark.parametrize(("gyro_range", "taps"), RANGES_AND_TAPS)
def test_every_allowed_configuration_reads_back_as_set(gyro_range: int, taps: int) -> None:
    for decimation in range(6):
        settings = ImuSettings.model_validate(
            {
                "gyro_range_dps": gyro_range,
                "filter_taps_exponent": taps,
                "decimation_exponent": decimation,
            }
        )
        device, _, _ = bench(settings)
        device.configure()
        code = {1000: 4, 500: 2, 250: 1}[gyro_range]
        assert device.read_register("SENS_AVG") == code << 8 | taps
        assert device.read_register("SMPL_PRD") == decimation << 8 | 1
        assert device.read_register("MSC_CTRL") == 0x0016


def test_a_part_left_in_another_configuration_is_brought_to_ours_whatever_the_order_of_limits() -> None:
    device, recorder, _ = bench(ImuSettings(gyro_range_dps=1000, filter_taps_exponent=1))
    device.write_register("SENS_AVG", 0x0106)
    device.write_register("SMPL_PRD", 0x0B01)
    recorder.frames.clear()
    device.configure()
    assert device.read_register("SENS_AVG") == 0x0401
    assert device.read_register("SMPL_PRD") == 0x0001
    assert recorder.writes() == [0xB700, 0xB904, 0xB801, 0xB416]


def test_the_second_data_ready_pin_and_the_low_level_are_configured() -> None:
    device, _, _ = bench(ImuSettings(data_ready_pin=2, data_ready_active_high=False, burst_crc="off"))
    device.start()
    assert device.read_register("MSC_CTRL") == 0x0005
    assert not device.crc_active


def test_flash_is_never_written() -> None:
    device, _, _ = bench()
    device.start()
    device.start()
    assert device.read_register("FLASH_CNT") == 0


def test_old_silicon_is_read_without_a_checksum_and_says_so() -> None:
    device, _, _ = bench(silicon="AMLZ")
    device.start()
    assert not device.crc_active
    assert device.notes == ["the part sends no burst checksum (old silicon): torn bursts cannot be seen"]
    burst = device.read_burst(Edge(1, TimeKind.EDGE))
    assert (burst.crc, burst.fault) == (None, Fault.NONE)


def test_silicon_that_takes_the_checksum_bit_but_sends_none_is_found_out() -> None:
    device, recorder, _ = bench()
    recorder.tamper = lambda data, answer: answer[:-2] + b"\x5a\xa5" if len(data) == 28 else answer
    device.start()
    assert not device.crc_active
    assert device.read_register("MSC_CTRL") == 0x0006
    assert len(device.notes) == 1
    assert sum(len(frame) == 28 for frame in recorder.frames) == 64


def test_a_checksum_that_is_required_but_absent_stops_the_start() -> None:
    device, _, _ = bench(ImuSettings(burst_crc="on"), silicon="AMLZ")
    with pytest.raises(ImuError, match='set burst_crc = "auto"'):
        device.start()
    assert device.state is State.CONFIGURE
    bench(ImuSettings(burst_crc="on"))[0].start()


def test_torn_bursts_during_the_probe_do_not_hide_the_checksum() -> None:
    outcomes = []
    for phase_ns in range(0, 1_200_000, 100_000):
        device, _, _ = bench(source=SteadyInput(start_ns=phase_ns))
        device.start()
        outcomes.append(device.crc_active)
    assert outcomes == [True] * 12


@pytest.mark.parametrize(("stuck", "reads", "cause"), [(0x00, "0x0000", "stays low"), (0xFF, "0xFFFF", "floats")])
def test_a_dead_data_wire_is_named(stuck: int, reads: str, cause: str) -> None:
    device, _, twin = bench()
    twin.stuck_byte = stuck
    with pytest.raises(ImuError, match=rf"PROD_ID \(0x56\) reads {reads} instead of 0x4040: .*{cause}"):
        device.start()
    assert device.state is State.IDENTIFY
    burst = device.read_burst(Edge(5, TimeKind.READ))
    assert burst.fault is (Fault.ALL_ONE if stuck else Fault.ALL_ZERO)


def test_another_part_on_the_bus_is_refused() -> None:
    device, recorder, _ = bench()
    recorder.tamper = lambda data, answer: b"\x40\x3d" if answer == b"\x40\x40" else answer
    with pytest.raises(ImuError, match=r"reads 0x403D instead of 0x4040: check the wires"):
        device.start()


def test_a_part_that_wakes_up_late_is_waited_for() -> None:
    device, recorder, _ = bench()
    count = itertools.count()
    recorder.tamper = lambda data, answer: b"\0\0" if answer == b"\x40\x40" and next(count) < 7 else answer
    assert device.start().product_id == 16448


def test_a_register_that_never_reads_the_same_twice_is_named() -> None:
    device, recorder, _ = bench(lot_id=0x1824_0042)
    flips = itertools.cycle([b"\x18\x24", b"\x18\x00"])
    recorder.tamper = lambda data, answer: next(flips) if answer == b"\x18\x24" else answer
    with pytest.raises(ImuError, match=r"LOT_ID1 \(0x52\) reads 0x1824, then 0x1800"):
        device.start()


def test_a_write_that_does_not_stick_names_register_and_values() -> None:
    device, recorder, _ = bench(ImuSettings(decimation_exponent=2))
    recorder.tamper = lambda data, answer: b"\x00\x01" if answer == b"\x02\x01" else answer
    with pytest.raises(ImuError, match=r"SMPL_PRD \(0x36\) was written 0x0201 and reads back 0x0001: check the wires"):
        device.configure()
    assert recorder.writes().count(0xB702) == 3


@pytest.mark.parametrize(
    ("failing", "words"),
    [
        (0x2000, "the x accelerometer failed its self-test"),
        (0x0C00, "the y gyroscope failed its self-test and the x gyroscope failed its self-test"),
        (0x0020, "the self-test failed"),
    ],
)
def test_a_failed_inertial_part_stops_the_start(failing: int, words: str) -> None:
    device, _, _ = bench(failing_parts=failing)
    with pytest.raises(ImuError, match=rf"^{words} \(DIAG_STAT 0x{failing | 0xA0:04X}\)"):
        device.start()


def test_a_failed_magnetometer_is_only_noted() -> None:
    device, _, _ = bench(failing_parts=0x0003)
    device.start()
    assert device.notes == [
        "the barometer failed its self-test",
        "the magnetometer failed its self-test",
    ]
    assert device.state is State.READ


def test_a_self_test_that_never_ends_is_given_up() -> None:
    device, recorder, _ = bench()
    recorder.tamper = lambda data, answer: b"\x04\x06" if answer == b"\x00\x06" else answer
    with pytest.raises(ImuError, match=r"did not end within 1 s"):
        device.self_test()


def test_the_self_test_keeps_data_ready_and_checksum() -> None:
    device, _, _ = bench()
    device.start()
    assert device.read_register("MSC_CTRL") == 0x0016
    assert device.self_test() == []
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
    device.read_burst(Edge(0, TimeKind.EDGE))
    assert min(np.diff(starts)) >= 40_000
    assert max(speeds) <= 1_000_000


def test_a_failing_port_gives_a_marked_burst_and_keeps_the_reason() -> None:
    device, recorder, _ = bench()
    device.start()

    def fail(_data: bytes, _answer: bytes) -> bytes:
        raise SpiError("the port is gone")

    recorder.tamper = fail
    burst = device.read_burst(Edge(3, TimeKind.EDGE))
    assert (burst.t_ns, burst.fault) == (3, Fault.SPI)
    assert device.last_spi_error == "the port is gone"
    with pytest.raises(SpiError):
        device.read_register("PROD_ID")


@pytest.mark.parametrize(("gyro_range", "taps"), [(1000, 0), (500, 2), (250, 4)])
@pytest.mark.parametrize("silicon", ["BMLZ", "AMLZ"])
def test_a_steady_input_is_read_to_half_a_step(gyro_range: int, taps: int, silicon: str) -> None:
    gyro, accel = (0.1234, -0.5, 3.0), (1.0, -2.5, 9.7)
    settings = ImuSettings.model_validate({"gyro_range_dps": gyro_range, "filter_taps_exponent": taps})
    source = SteadyInput(gyro=gyro, accel=accel, temperature_c=40.0)
    device, _, twin = bench(settings, source, silicon=silicon)
    device.start()
    line = twin.data_ready()
    edge = line.wait(1.0)
    assert edge is not None
    burst = device.read_burst(edge)
    sample = BurstDecoder(gyro_range).sample(burst)
    half_step = {1000: 0.02, 500: 0.01, 250: 0.005}[gyro_range] * np.pi / 180
    assert sample.gyro == about(gyro, abs=half_step * 1.0001)
    assert sample.accel == about(accel, abs=9.80665 / 2400 * 1.0001)
    assert sample.temperature_c == about(40.0, abs=0.03694)
    assert BurstDecoder(gyro_range).pressure_pa(burst) == 100_000
