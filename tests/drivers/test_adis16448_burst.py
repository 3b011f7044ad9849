from __future__ import annotations

import struct
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.adis16448.burst import (
    REQUEST,
    REQUEST_WITH_CRC,
    Burst,
    BurstDecoder,
    Fault,
    RepetitionWatch,
    classify,
    failed,
    parse,
)
from drivers.adis16448.crc import CRC_TABLE, burst_crc
from drivers.adis16448.registers import DIAG_OVERRANGE
from estimation.records import TimeKind

about: Any = pytest.approx

PUBLISHED = (0x000F, 0xFFF8, 0x000A, 0xFE41, 0xFFCC, 0x0456, 0x0227, 0xFDA3, 0xF412, 0xC13C, 0xFF6C)
# Counts within every range: x gyro to z accelerometer within +-25 000, the others any.
COUNTS = st.integers(-25_000, 25_000).map(lambda count: count & 0xFFFF)
MEASURABLE = st.tuples(*[COUNTS] * 6, *[st.integers(0, 0xFFFF)] * 5).map(list)
WORDS = st.lists(st.integers(0, 0xFFFF), min_size=11, max_size=11)


def bitwise_crc(words: list[int]) -> int:
    """The checksum bit by bit over the serial stream of data bits, low byte and low bit first."""
    register = 0xFFFF
    for word in words:
        for bit in range(16):
            feed = (register ^ (word >> bit)) & 1
            register = (register >> 1) ^ (0x1021 * feed)
    inverted = ~register & 0xFFFF
    return int.from_bytes(inverted.to_bytes(2, "little"), "big")


@pytest.mark.parametrize(
    ("words", "crc"),
    [
        (PUBLISHED, 0x9AF4),
        ((0,) * 11, 0xA4E5),
        ((0xFFFF,) * 11, 0xE6E6),
        ((0, 0, 0, 0, 0, 0x04B0, 0, 0, 0, 0xC350, 0), 0x08E3),
        (tuple(range(1, 12)), 0x70F7),
        ((1, *[0] * 10), 0x63E0),
        ((*[0] * 10, 1), 0xFDE2),
        ((0x8000, *[0] * 10), 0x31F0),
    ],
)
def test_the_checksum_of_known_bursts(words: tuple[int, ...], crc: int) -> None:
    assert burst_crc(words) == crc


@settings(derandomize=True, deadline=None)
@given(WORDS)
def test_the_table_and_the_bitwise_checksum_agree(words: list[int]) -> None:
    assert burst_crc(words) == bitwise_crc(words)
    assert len(set(CRC_TABLE)) == 256


@settings(derandomize=True, deadline=None)
@given(WORDS, st.integers(0, 11 * 16 - 1))
def test_the_checksum_sees_every_single_bit_error(words: list[int], bit: int) -> None:
    damaged = list(words)
    damaged[bit // 16] ^= 1 << bit % 16
    assert burst_crc(damaged) != burst_crc(words)


@settings(derandomize=True, deadline=None)
@given(st.integers(0, 0xFFFF).map(lambda flags: flags & ~DIAG_OVERRANGE), MEASURABLE, st.integers(0, 0xFFFF))
def test_random_words_survive_a_frame_with_checksum(first: int, words: list[int], junk: int) -> None:
    frame = struct.pack(">14H", junk, first, *words, bitwise_crc(words))
    assert parse(frame, 5, TimeKind.READ) == Burst(5, TimeKind.READ, (first, *words), bitwise_crc(words), Fault.NONE)


@settings(derandomize=True, deadline=None)
@given(MEASURABLE.filter(any), st.integers(0, 0xFFFF))
def test_random_words_survive_a_frame_without_checksum(words: list[int], junk: int) -> None:
    frame = struct.pack(">13H", junk, 0x0080, *words)
    assert parse(frame, 7, TimeKind.EDGE) == Burst(7, TimeKind.EDGE, (0x0080, *words), None, Fault.NONE)


def test_requests_are_the_burst_command_and_room_for_the_answer() -> None:
    requests = [REQUEST, REQUEST_WITH_CRC]
    assert requests == [b"\x3e\x00" + bytes(24), b"\x3e\x00" + bytes(26)]


@pytest.mark.parametrize(
    ("frame", "fault"),
    [
        (bytes(26), Fault.ALL_ZERO),
        (bytes(28), Fault.ALL_ZERO),
        (b"\xff" * 26, Fault.ALL_ONE),
        (b"\xff" * 28, Fault.ALL_ONE),
        (struct.pack(">14H", 0, 0, *PUBLISHED, 0x9AF5), Fault.CRC),
        (struct.pack(">14H", 0, 0, *PUBLISHED, 0x9AF4), Fault.NONE),
        # The part's SPI flag is about an earlier frame: with a good checksum these words are good.
        (struct.pack(">14H", 0, 0x0008, *PUBLISHED, 0x9AF4), Fault.NONE),
        (struct.pack(">13H", 0, 0x0088, *PUBLISHED), Fault.SPI),
        (struct.pack(">13H", 0, 0x0080, *PUBLISHED), Fault.NONE),
    ],
)
def test_what_is_wrong_with_a_burst_is_told_apart(frame: bytes, fault: Fault) -> None:
    assert parse(frame, 0, TimeKind.EDGE).fault is fault


def test_a_frame_of_another_length_is_refused() -> None:
    with pytest.raises(ValueError, match="26 or 28 bytes, not 24"):
        parse(bytes(24), 0, TimeKind.EDGE)


def test_a_failed_read_keeps_its_time_and_says_so() -> None:
    burst = failed(9, TimeKind.READ)
    assert (burst.t_ns, burst.time_kind, burst.fault) == (9, TimeKind.READ, Fault.SPI)
    assert len(burst.words) == 12


def test_the_published_burst_decodes_to_its_physical_values() -> None:
    burst = parse(struct.pack(">14H", 0, 0, *PUBLISHED, 0x9AF4), 11, TimeKind.EDGE)
    decoder = BurstDecoder(1000)
    sample = decoder.sample(burst)
    degree = 0.017453292519943295
    assert sample.gyro == about((0.60 * degree, -0.32 * degree, 0.40 * degree))
    assert [a / 9.80665 for a in sample.accel] == about([-0.3725, -0.043333, 0.925], rel=1e-4)
    assert sample.temperature_c == about(20.07, abs=0.005)
    assert (sample.t_ns, sample.time_kind) == (11, TimeKind.EDGE)
    assert [m * 1e7 for m in decoder.magnetometer_tesla(burst)] == about([78.71, -86.43, -436.29], abs=0.01)
    assert decoder.pressure_pa(burst) == about(98936)


@pytest.mark.parametrize(("word", "celsius"), [(0x000, 31.0), (0x001, 31.07386), (0xFFF, 30.92614), (0xF800, -120.265)])
def test_the_temperature_has_twelve_signed_bits(word: int, celsius: float) -> None:
    burst = Burst(0, TimeKind.EDGE, (0,) * 11 + (word,), None)
    assert BurstDecoder(500).sample(burst).temperature_c == about(celsius, abs=0.001)


@pytest.mark.parametrize(("gyro_range", "dps"), [(1000, -40.0), (500, -20.0), (250, -10.0)])
def test_the_gyro_scale_follows_the_range(gyro_range: int, dps: float) -> None:
    burst = Burst(0, TimeKind.EDGE, (0, 0xFC18, *[0] * 10), None)  # -1000
    assert BurstDecoder(gyro_range).sample(burst).gyro[0] == about(dps * 3.141592653589793 / 180)


def equal_burst(t_ns: int, status: int = 0) -> Burst:
    return Burst(t_ns, TimeKind.EDGE, (status, *PUBLISHED), None)


def test_equal_samples_with_an_edge_each_are_honest() -> None:
    watch = RepetitionWatch(2)
    assert [watch.is_repeated(equal_burst(i), is_doubtful=False) for i in range(13)] == [False] * 13
    assert not watch.is_frozen


def test_an_equal_sample_of_doubtful_time_is_repeated_even_if_its_status_changed() -> None:
    watch = RepetitionWatch(2)
    assert not watch.is_repeated(equal_burst(0, 0x80), is_doubtful=True)
    assert watch.is_repeated(equal_burst(1), is_doubtful=True)
    other = Burst(2, TimeKind.EDGE, (0, *PUBLISHED[::-1]), None)
    assert not watch.is_repeated(other, is_doubtful=True)


def test_frozen_registers_show_after_a_run_that_no_noise_survives() -> None:
    watch = RepetitionWatch(0)
    verdicts = [watch.is_repeated(equal_burst(i), is_doubtful=False) for i in range(20)]
    assert verdicts == [False] * 13 + [True] * 7
    assert watch.is_frozen
    other = Burst(20, TimeKind.EDGE, (0, *PUBLISHED[::-1]), None)
    assert not watch.is_repeated(other, is_doubtful=False)
    assert not watch.is_repeated(equal_burst(21), is_doubtful=False)
    assert not watch.is_frozen


@pytest.mark.parametrize("word", range(1, 7))
@pytest.mark.parametrize(("missing", "fault"), [(1, Fault.NONE), (0, Fault.OUT_OF_RANGE)])
@pytest.mark.parametrize("sign", [1, -1])
def test_full_scale_is_out_of_range_once_the_part_says_so(word: int, missing: int, fault: Fault, sign: int) -> None:
    full_scale = 25_000 if word <= 3 else 21_600  # 1000 deg/s at 0.04, 18 g at 1200 a g
    words = [DIAG_OVERRANGE, *[7] * 11]
    words[word] = sign * (full_scale - missing) & 0xFFFF
    assert classify(tuple(words), bitwise_crc(words[1:])) is fault
    words[0] = 0
    assert classify(tuple(words), bitwise_crc(words[1:])) is Fault.NONE


@pytest.mark.parametrize("word", range(1, 7))
@pytest.mark.parametrize(("excess", "fault"), [(0, Fault.NONE), (1, Fault.OUT_OF_RANGE)])
@pytest.mark.parametrize("sign", [1, -1])
def test_counts_beyond_what_can_be_measured_are_told(word: int, excess: int, fault: Fault, sign: int) -> None:
    limit = 32_500 if word <= 3 else 25_920  # 1.3 x 1000 deg/s at 0.04, 1.2 x 18 g at 1200 a g
    words = [0x80, *[7] * 11]
    words[word] = sign * (limit + excess) & 0xFFFF
    for crc in (None, bitwise_crc(words[1:])):
        assert classify(tuple(words), crc) is fault
