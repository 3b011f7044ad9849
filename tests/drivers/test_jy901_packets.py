"""The JY901's packets: frames worked out by hand, and a parser that finds every one of them among anything."""

from __future__ import annotations

import math
import struct
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import settings as rules
from hypothesis import strategies as st

from drivers.jy901.packets import (
    BAUD_CODES,
    KINDS,
    RATE_CODES,
    SAVE,
    SIZE,
    UNLOCK,
    Kind,
    Packet,
    Parser,
    content_bits,
    encode,
    highest_rate_hz,
    read_registers,
    write_register,
)

word = st.integers(-32768, 32767)
packet = st.tuples(st.sampled_from(Kind), st.tuples(word, word, word, word))
BY_HAND = {
    "55 51 00 00 00 00 00 08 C4 09 7B": (Kind.ACCEL, (0.0, 0.0, 9.80665)),
    "55 51 00 F8 00 04 00 00 C4 09 6F": (Kind.ACCEL, (-9.80665, 4.903325, 0.0)),
    "55 52 00 00 00 00 C3 05 C4 09 3C": (Kind.GYRO, (0.0, 0.0, math.radians(90.03))),
    "55 52 9A F9 00 00 00 00 C4 09 07": (Kind.GYRO, (math.radians(-99.98), 0.0, 0.0)),
    "55 53 55 15 55 F5 00 40 00 00 9C": (Kind.ANGLE, (math.radians(30), math.radians(-15), math.radians(90))),
}


def found(*pieces: bytes) -> tuple[list[Packet], Parser]:
    parser = Parser()
    packets = [one for piece in pieces for one in parser.feed(piece)]
    return packets, parser


@pytest.mark.parametrize("frame", BY_HAND)
def test_frames_of_the_fact_sheet(frame: str) -> None:
    data = bytes.fromhex(frame)
    kind, values = BY_HAND[frame]
    (one,), parser = found(data)
    assert one.kind is kind
    assert encode(kind, one.words) == data
    decoded = {Kind.ACCEL: one.accel, Kind.GYRO: one.gyro, Kind.ANGLE: one.angles}[kind]
    assert decoded == pytest.approx(values, abs=2e-4)
    if kind is not Kind.ANGLE:
        assert one.temperature_c == pytest.approx(25.0)
    assert (parser.skipped, parser.bad_checksums) == (0, 0)


@rules(max_examples=200, deadline=None, derandomize=True)
@given(packets=st.lists(packet, max_size=8), cuts=st.lists(st.integers(0, 100), max_size=12))
def test_packets_arrive_whole_however_the_bytes_are_cut(
    packets: list[tuple[Kind, tuple[int, int, int, int]]], cuts: list[int]
) -> None:
    data = b"".join(encode(kind, words) for kind, words in packets)
    edges = sorted({min(cut, len(data)) for cut in cuts} | {0, len(data)})
    told, parser = found(*(data[a:b] for a, b in pairwise(edges)))
    assert [(one.kind, one.words) for one in told] == packets
    assert [one.at for one in told] == [i * SIZE for i in range(len(packets))]
    assert parser.skipped == 0


@rules(max_examples=200, deadline=None, derandomize=True)
@given(
    before=st.lists(packet, max_size=3),
    garbage=st.binary(max_size=40),
    after=st.lists(packet, min_size=1, max_size=4),
)
def test_garbage_costs_no_packet_but_by_chance(
    before: list[tuple[Kind, tuple[int, int, int, int]]],
    garbage: bytes,
    after: list[tuple[Kind, tuple[int, int, int, int]]],
) -> None:
    """Only a false packet, one of garbage or over an edge whose sum happens to be right, may swallow a true one."""
    head, tail = (b"".join(encode(kind, words) for kind, words in part) for part in (before, after))
    data = head + garbage + tail
    true = {i * SIZE for i in range(len(before))} | {len(head) + len(garbage) + i * SIZE for i in range(len(after))}
    judge(data, true)


@rules(max_examples=100, deadline=None, derandomize=True)
@given(packets=st.lists(packet, min_size=3, max_size=6), drop=st.integers(0, 65))
def test_a_lost_byte_costs_the_packet_it_was_of(
    packets: list[tuple[Kind, tuple[int, int, int, int]]], drop: int
) -> None:
    data = b"".join(encode(kind, words) for kind, words in packets)
    drop = min(drop, len(data) - 1)
    torn = drop // SIZE
    true = {i * SIZE - (i > torn) for i in range(len(packets)) if i != torn}
    judge(data[:drop] + data[drop + 1 :], true)


def judge(data: bytes, true: set[int]) -> None:
    """Every packet that stands at `true` is found, but where a false one, whose sum is right by chance, overlaps it."""
    told, parser = found(data)
    places = [one.at for one in told]
    false = [at for at in places if at not in true]
    for at in false:
        assert sum(data[at : at + SIZE - 1]) & 0xFF == data[at + SIZE - 1]
    for missed in true - set(places):
        assert any(abs(missed - at) < SIZE for at in false)
    assert all(b - a >= SIZE for a, b in pairwise(places))
    assert len(data) - len(told) * SIZE - SIZE < parser.skipped <= len(data) - len(told) * SIZE


def test_a_lost_byte_between_plain_packets_costs_one() -> None:
    frames = [bytes.fromhex(frame) for frame in BY_HAND]
    for drop in range(SIZE):
        told, parser = found(b"".join((frames[0], frames[1][:drop] + frames[1][drop + 1 :], *frames[2:])))
        assert [one.kind for one in told] == [Kind.ACCEL, Kind.GYRO, Kind.GYRO, Kind.ANGLE]
        assert parser.skipped == SIZE - 1


def test_memory_stays_small_whatever_is_fed() -> None:
    parser = Parser()
    for _ in range(100):
        parser.feed(bytes([0x55, 0x51]) * 500)
        assert len(parser._rest) < SIZE
    assert parser.bad_checksums > 0


def test_words_beyond_the_range_saturate() -> None:
    (one,), _ = found(encode(Kind.ACCEL, (40_000, -40_000, 0, 0)))
    assert one.words == (32767, -32768, 0, 0)


def test_commands() -> None:
    assert write_register(0x69, 0xB588) == UNLOCK
    assert write_register(0, 0) == SAVE
    assert write_register(0x03, RATE_CODES[100]) == bytes.fromhex("FFAA030900")
    assert read_registers(0x03) == bytes.fromhex("FFAA270300")
    assert content_bits(Kind.ACCEL, Kind.GYRO, Kind.ANGLE, Kind.MAGNETIC) == 0x001E  # the part's default
    for bad in ((256, 0), (0, 65536), (-1, 0)):
        with pytest.raises(ValueError, match="does not fit"):
            write_register(*bad)
    assert set(BAUD_CODES.values()) == set(range(10))


def test_what_a_line_carries() -> None:
    """The fact sheet's table."""
    assert [highest_rate_hz(baud, 3) for baud in (9600, 57600, 115200, 230400)] == [29, 174, 349, 698]
    assert highest_rate_hz(115200, 2) == 523


def test_kinds_are_those_of_the_wire() -> None:
    assert frozenset({*range(0x50, 0x5B), 0x5F}) == KINDS
    assert struct.calcsize("<4h") + 3 == SIZE
