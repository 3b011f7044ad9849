"""The JY901 found at any baud rate, set up, read back, saved; and what is said when that cannot be."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from drivers.jy901.packets import BANDWIDTH, CONTENT, OLD_200_HZ, RATE, UNLOCK, write_register
from drivers.jy901.set_up import Jy901Error, find, set_up
from drivers.virtual.jy901 import FIRMWARE, UNLOCKED_NS, VirtualJy901
from tests.drivers.jy901_kit import Bench, finished, motion, settings


@pytest.mark.parametrize("baud", [4800, 9600, 115200, 921600])
def test_found_at_any_baud_rate(baud: int) -> None:
    bench = Bench(found_at=baud)
    assert finished(find(bench.port(), 115200, bench.clock)) == baud


def test_a_part_that_sends_nothing_by_itself_is_found_by_asking() -> None:
    bench = Bench(found_at=38400)
    bench.part.registers[RATE] = 0x0D
    assert finished(find(bench.port(), 115200, bench.clock)) == 38400


def test_set_up_as_wanted_and_nothing_is_saved() -> None:
    bench = Bench(rate_hz=100)
    port = bench.port()
    found = finished(set_up(port, bench.settings, bench.clock))
    assert (found.baud, port.baudrate, bench.part.baud) == (115200, 115200, 115200)
    assert found.firmware == FIRMWARE
    assert found.was_changed
    assert bench.part.registers[CONTENT] == 0x0006
    assert bench.part.rate_hz == 100
    assert bench.part.registers[BANDWIDTH] == 3  # 44 Hz, the next below half the rate
    assert bench.part.saves == 0
    bench.part.power_cycle(bench.clock.now_ns())
    assert bench.part.baud == 9600
    assert bench.part.registers[CONTENT] == 0x001E


def test_saved_when_wanted_and_only_once() -> None:
    bench = Bench(save=True, bandwidth_hz=44)
    finished(set_up(bench.port(), bench.settings, bench.clock))
    bench.part.power_cycle(bench.clock.now_ns())
    assert (bench.part.baud, bench.part.rate_hz, bench.part.registers[BANDWIDTH]) == (115200, 200, 3)
    found = finished(set_up(bench.port(), bench.settings, bench.clock))
    assert not found.was_changed
    assert bench.part.saves == 1  # the part's memory wears out


@pytest.mark.parametrize("old", [False, True])
def test_the_parts_memory_is_written_when_any_setting_is_another_and_then_no_more(old: bool) -> None:
    bench = Bench(save=True, old=old)
    for _ in range(3):
        finished(set_up(bench.port(), bench.settings, bench.clock))
        bench.part.power_cycle(bench.clock.now_ns())
    assert bench.part.saves == 1
    bench.part.registers[BANDWIDTH] = bench.part.saved[BANDWIDTH] = 0
    finished(set_up(bench.port(), bench.settings, bench.clock))
    assert (bench.part.saves, bench.part.saved[BANDWIDTH]) == (2, 2)  # 94 Hz


def test_firmware_of_before_counts_its_rates_otherwise() -> None:
    bench = Bench(old=True)
    finished(set_up(bench.port(), bench.settings, bench.clock))
    assert bench.part.registers[RATE] == OLD_200_HZ
    assert bench.part.rate_hz == 200


def test_a_deaf_part_is_told() -> None:
    bench = Bench()
    port = bench.port()
    port.write = lambda data: None  # type: ignore[method-assign]  # the wire from here to there is broken
    with pytest.raises(Jy901Error, match="sends, but does not answer: check the wire from the computer's TX"):
        finished(set_up(port, bench.settings, bench.clock))


def test_nothing_on_the_line_is_told() -> None:
    bench = Bench({"kind": "serial_cut", "at_s": 0, "for_s": 100})
    with pytest.raises(Jy901Error, match="nothing comes on the serial line"):
        finished(set_up(bench.port(), bench.settings, bench.clock))


def test_noise_alone_is_told() -> None:
    bench = Bench(
        {"kind": "serial_cut", "at_s": 0, "for_s": 100},
        {"kind": "serial_garbage", "at_s": 0, "for_s": 100, "rate_hz": 100},
    )
    with pytest.raises(Jy901Error, match="bytes come, but no packet at any baud rate"):
        finished(set_up(bench.port(), bench.settings, bench.clock))


@pytest.mark.parametrize(
    ("chosen", "words"),
    [
        ({"rate_hz": 33}, "rate_hz"),
        ({"baud": 12345}, "baud"),
        ({"rate_hz": 200, "baud": 38400}, "rate_hz = 200 is too much for baud = 38400, which carries 174 samples"),
        ({"bandwidth_hz": 100}, "bandwidth_hz"),
    ],
)
def test_settings_that_cannot_be_are_refused(chosen: dict[str, int], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        settings(**chosen)


def test_a_part_that_keeps_its_baud_rate_is_told() -> None:
    bench = Bench()
    port = bench.port()
    write = port.write
    port.write = lambda data: None if data[2:3] == b"\x04" else write(data)  # type: ignore[method-assign]
    with pytest.raises(Jy901Error, match="stays at 9600 baud, which carries 43 samples a second: set baud = 9600 and"):
        finished(set_up(port, bench.settings, bench.clock))


def test_a_locked_part_ignores_writes_and_locks_itself_again() -> None:
    part = VirtualJy901(motion())
    part.write(write_register(RATE, 9), 0)
    assert part.registers[RATE] == 6
    part.write(b"\x00\xff" + UNLOCK + write_register(RATE, 9), 0)
    assert part.registers[RATE] == 9
    part.write(write_register(RATE, 6), UNLOCKED_NS + 1)
    assert part.registers[RATE] == 9
