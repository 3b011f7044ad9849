"""The JY901 driver against its twin: found at any baud rate, set up, read back; and samples as they were felt."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest

from drivers.jy901.device import Jy901Error, find, set_up
from drivers.jy901.packets import ACCEL_LSB, BAUD_CODES, GYRO_LSB, SIZE, UNLOCK, Kind, encode, write_register
from drivers.jy901.samples import SampleReader
from drivers.virtual.inertial_input import RecordedInput
from drivers.virtual.jy901 import UNLOCKED_NS, VirtualJy901
from estimation.records import ImuSample


@dataclass
class Line:
    """A serial port with the twin at its other end; its clock goes on with each read."""

    twin: VirtualJy901
    baudrate: int = 115200
    now_ns: int = 0
    deaf: bool = False  # nothing reaches the part
    cut: bool = False
    _wire: bytearray = field(default_factory=bytearray)
    _coming: list[tuple[int, bytes]] = field(default_factory=list)

    def clock_s(self) -> float:
        return self.now_ns * 1e-9

    def write(self, data: bytes) -> None:
        if not self.deaf and self.baudrate == self.twin.baud:
            self.twin.write(data, self.now_ns)

    def read(self, size: int) -> bytes:
        self.now_ns += 10_000_000
        baud = self.twin.baud
        self._coming += self.twin.read(self.now_ns)
        while self._coming and self._coming[0][0] <= self.now_ns:
            _, packet = self._coming.pop(0)
            if not self.cut:
                # At another pace the bits fall into other bytes.
                self._wire += packet if baud == self.baudrate else bytes(b ^ 0x5A for b in packet[::2])
        given = bytes(self._wire[:size])
        del self._wire[:size]
        return given


def motion(seconds: float = 60.0) -> RecordedInput:
    """Every value another."""
    n = round(seconds * 800)
    t_ns = (np.arange(n) * 1_250_000).astype(np.int64)
    wave = np.sin(np.arange(n)[:, None] * np.array([0.01, 0.013, 0.017]))
    return RecordedInput(t_ns, 2.0 * wave, 9.0 * wave + np.array([0, 0, 9.8]), 31.0)


def line(baud: int = 9600, *, deaf: bool = False, cut: bool = False) -> Line:
    twin = VirtualJy901(motion())
    twin.registers[0x04] = BAUD_CODES[baud]
    return Line(twin, deaf=deaf, cut=cut)


@pytest.mark.parametrize("baud", [4800, 9600, 115200, 921600])
def test_found_at_any_baud_rate(baud: int) -> None:
    port = line(baud)
    assert find(port, port.clock_s) == baud


def test_set_up_as_wanted_and_nothing_is_saved() -> None:
    port = line()
    found = set_up(port, 100, port.clock_s, baud=115200)
    assert (found.baud, port.baudrate, port.twin.baud) == (115200, 115200, 115200)
    assert port.twin.registers[0x02] == 0x0006
    port.twin.power_cycle(port.now_ns)
    assert port.twin.baud == 9600
    assert port.twin.registers[0x02] == 0x001E


@pytest.mark.parametrize(
    ("port", "arguments", "words"),
    [
        (line(), {"rate_hz": 33}, "rate 33 Hz: the JY901 knows"),
        (line(), {"rate_hz": 100}, "at 9600 baud the line carries 43 samples a second, not 100"),
        (line(), {"rate_hz": 10, "baud": 12345}, "baud rate 12345"),
        (line(deaf=True), {"rate_hz": 20}, "did not take its settings (no answer"),
        (line(cut=True), {"rate_hz": 10}, "nothing comes on the line"),
    ],
)
def test_what_cannot_be_is_said_in_one_sentence(port: Line, arguments: dict[str, float], words: str) -> None:
    with pytest.raises(Jy901Error) as told:
        set_up(port, clock_s=port.clock_s, **arguments)  # type: ignore[arg-type]  # whole numbers as floats
    assert words in str(told.value)


def test_a_locked_part_ignores_writes_and_locks_itself_again() -> None:
    twin = VirtualJy901(motion())
    twin.write(write_register(0x03, 9), 0)
    assert twin.registers[0x03] == 6
    twin.write(b"\x00\xff" + UNLOCK + write_register(0x03, 9), 0)
    assert twin.registers[0x03] == 9
    twin.write(write_register(0x03, 6), UNLOCKED_NS + 1)
    assert twin.registers[0x03] == 9


def samples_of(port: Line, seconds: float) -> list[ImuSample]:
    reader = SampleReader(port.baudrate)
    until_ns = port.now_ns + round(seconds * 1e9)
    samples = []
    while port.now_ns < until_ns:
        given = port.read(4096)
        # Bytes lie in the computer since they came: the last of them has just done so.
        samples += reader.feed(given, port.now_ns) if given else []
    return samples


def test_samples_are_what_was_felt_a_hundred_times_a_second() -> None:
    port = line()
    set_up(port, 100, port.clock_s, baud=115200)
    samples = samples_of(port, 5.0)
    assert len(samples) == pytest.approx(500, abs=3)
    times = np.array([one.t_ns for one in samples])
    assert (np.diff(times) > 0).all()
    phase = np.round(times / 1_250_000)
    # Stamped within the 10 ms of a read: find each value in the motion near its time.
    for one, k in list(zip(samples, phase, strict=True))[::50]:
        near = np.arange(k - 12, k + 3)
        accel = 9.0 * np.sin(near[:, None] * np.array([0.01, 0.013, 0.017])) + np.array([0, 0, 9.8])
        gyro = 2.0 * np.sin(near[:, None] * np.array([0.01, 0.013, 0.017]))
        off = np.abs(accel - one.accel).max(axis=1) / ACCEL_LSB
        assert off.min() <= 0.51
        assert np.abs(gyro[int(np.argmin(off))] - one.gyro).max() <= 0.51 * GYRO_LSB
        assert one.temperature_c == pytest.approx(31.0)


def test_a_slow_line_lowers_the_rate() -> None:
    port = line()
    port.baudrate = 9600
    port.twin.registers[0x02], port.twin.registers[0x03] = 0x0006, 9  # 100 Hz of two packets: 43 are carried
    assert len(samples_of(port, 4.0)) == pytest.approx(4 * 43.6, abs=3)


def test_half_a_group_is_counted_and_left_out() -> None:
    reader = SampleReader(115200)
    accel, gyro = encode(Kind.ACCEL, (0, 0, 2048, 2500)), encode(Kind.GYRO, (1, 2, 3, 2500))
    data = [accel + gyro, gyro, accel, accel + gyro, b"\x55" * 5 + accel + gyro[:-1], b"\x00" + accel + gyro]
    samples = [one for i, piece in enumerate(data) for one in reader.feed(piece, (i + 1) * 10_000_000)]
    assert len(samples) == 3
    assert reader.halves == 3
    assert reader.parser.skipped >= SIZE


def test_time_never_goes_back_when_bytes_come_in_heaps() -> None:
    reader = SampleReader(9600)
    heap = b"".join(encode(Kind.ACCEL, (0, 0, k, 0)) + encode(Kind.GYRO, (k, 0, 0, 0)) for k in range(20))
    samples = reader.feed(heap, 1_000_000_000) + reader.feed(heap, 1_000_000_001)
    times = [one.t_ns for one in samples]
    assert times == sorted(set(times))
    spread = np.diff([one.t_ns for one in samples[:20]])
    np.testing.assert_allclose(spread, 2 * SIZE * 10 / 9600 * 1e9, rtol=1e-6)
