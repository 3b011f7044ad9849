"""What a careless driver gets from the twin, seen with the real driver's eyes: never a good sample that is wrong."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from drivers.adis16448.burst import Fault
from drivers.adis16448.machine import State
from drivers.condition import OK, Wellness
from drivers.virtual.adis16448 import VirtualAdis16448
from tests.drivers.inertial_kit import BURST_BYTES, Bench, bursts

Transfer = Callable[[bytes, int], bytes]


def too_fast(part: VirtualAdis16448) -> Transfer:
    """Bursts at 2 MHz, beyond their limit of 1 MHz."""
    return lambda data, hz: VirtualAdis16448.transfer(part, data, 2 * hz if len(data) in BURST_BYTES else hz)


def without_stall(part: VirtualAdis16448) -> Transfer:
    """A word 2 us before each burst instead of 9 us."""

    def transfer(data: bytes, hz: int) -> bytes:
        if len(data) in BURST_BYTES:
            VirtualAdis16448.transfer(part, b"\x56\x00", hz)
            part.clock.sleep(2e-6)
        return VirtualAdis16448.transfer(part, data, hz)

    return transfer


@pytest.mark.parametrize("habit", [too_fast, without_stall])
def test_bursts_against_the_timing_fail_their_checksum(habit: Callable[[VirtualAdis16448], Transfer]) -> None:
    bench = Bench()
    bench.run(1.0)
    bench.part.transfer = habit(bench.part)  # type: ignore[method-assign,assignment]
    faults = {burst.fault for burst in bursts(bench.run(0.05))}
    assert faults == {Fault.CRC}


def test_a_burst_cut_within_a_word_is_junk_and_the_part_says_so_in_the_next() -> None:
    bench = Bench({"burst_crc": "off"})
    bench.run(1.0)
    cut = 0

    def transfer(data: bytes, hz: int) -> bytes:
        nonlocal cut
        if len(data) in BURST_BYTES and cut == 0:
            cut += 1
            return VirtualAdis16448.transfer(bench.part, data[:-1], hz) + b"\0"
        return VirtualAdis16448.transfer(bench.part, data, hz)

    bench.part.transfer = transfer  # type: ignore[method-assign,assignment]
    first, second, *rest = bursts(bench.step())
    assert first.fault is not Fault.NONE
    # Without a checksum the flag is all that speaks against the words.
    assert second.fault is Fault.SPI
    assert {burst.fault for burst in rest} == {Fault.NONE}
    (sentence,) = [said for said, count in bench.sensor.counters.diagnoses.items() if count]
    assert "no multiple of 16 clocks" in sentence
    bench.run(0.5)
    assert bench.sensor.condition == OK  # once is no fault that lasts


def test_register_words_that_follow_too_fast_are_not_believed() -> None:
    """20 us from start to start: every answer is that of the word before."""
    bench = Bench()

    def transfer(data: bytes, hz: int) -> bytes:
        answer = VirtualAdis16448.transfer(bench.part, data, hz)
        if len(data) == 2:
            # Another word at once, as from a second master or a driver without pauses.
            VirtualAdis16448.transfer(bench.part, b"\x34\x00", hz)
        return answer

    bench.part.transfer = transfer  # type: ignore[method-assign,assignment]
    assert bench.run(3.0) == []
    assert bench.sensor.state in (State.IDENTIFY, State.RESET)
    assert bench.sensor.condition.word is Wellness.WAITING
    assert "PROD_ID" in bench.sensor.condition.what


@pytest.mark.parametrize("surplus", [-2, 2])
def test_a_port_that_returns_another_length_is_a_failing_port(surplus: int) -> None:
    bench = Bench()
    bench.run(1.0)
    bench.wire.tamper = lambda data, answer: (answer + b"\0\0")[: len(data) + surplus] if len(data) > 2 else answer
    assert {burst.fault for burst in bursts(bench.step())} == {Fault.SPI}
