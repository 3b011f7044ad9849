"""What the decoder checks about each frame, and in which order."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from crccheck.crc import Crc8Autosar, Crc8SaeJ1850  # type: ignore[import-untyped]  # has no annotations
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.can.checksums import CHECKSUMS
from drivers.can.displacement import DisplacementDecoder
from drivers.can.frame import Frame
from drivers.can.presets import PRESETS
from drivers.can.settings import CanConfigError, ChecksumName
from drivers.condition import OK
from estimation.records import ReadingFault
from tests.drivers.can_kit import MS, decoder, emergency, position, read, status, taken

NONE, INVALID, OUT_OF_RANGE, MALFORMED, CHECKSUM, REPEATED = (
    ReadingFault.NONE,
    ReadingFault.INVALID,
    ReadingFault.OUT_OF_RANGE,
    ReadingFault.MALFORMED,
    ReadingFault.CHECKSUM,
    ReadingFault.REPEATED,
)

# Protected in every way; the counter runs from 1 to 14, the checksum stands in front.
DBC = """VERSION ""
BU_: A
BO_ 291 Guarded: 10 A
 SG_ Crc : 7|8@0+ (1,0) [0|255] "" A
 SG_ Stroke : 8|32@1- (1,0) [0|0] "mm" A
 SG_ Count : 40|4@1+ (1,0) [1|14] "" A
 SG_ Nibble : 44|8@1+ (1,0) [0|0] "" A
 SG_ State : 56|8@1+ (1,0) [0|0] "" A
 SG_ Last : 79|8@0+ (1,0) [0|0] "" A
BO_ 292 Paged: 5 A
 SG_ Page M : 0|8@1+ (1,0) [0|0] "" A
 SG_ Count : 8|2@1+ (1,0) [0|0] "" A
 SG_ Stroke m0 : 16|16@1+ (1,0) [0|0] "mm" A
 SG_ Health m1 : 16|16@1+ (1,0) [0|0] "" A
 SG_ Sum : 32|8@1+ (1,0) [0|0] "" A
BO_ 293 Real: 4 A
 SG_ Stroke : 0|32@1- (1,0) [0|0] "m" A
SIG_VALTYPE_ 293 Stroke : 1;
VAL_ 291 State 0 "sound" 3 "sensor_cable_broken" ;
"""

REFERENCE: dict[ChecksumName, Callable[[bytes], int]] = {
    "crc8_j1850": Crc8SaeJ1850.calc,
    "crc8_autosar": Crc8Autosar.calc,
    "sum8": lambda data: sum(data) % 256,
    "xor8": lambda data: sum(sum(byte >> bit & 1 for byte in data) % 2 << bit for bit in range(8)),
}


@pytest.fixture
def dbc(tmp_path: Path) -> Path:
    path = tmp_path / "own.dbc"
    path.write_text(DBC, encoding="cp1252")
    return path


def guarded(dbc: Path, checksum: ChecksumName = "crc8_autosar", **options: Any) -> DisplacementDecoder:
    return decoder(
        dbc=dbc,
        message="Guarded",
        signal="Stroke",
        valid_signal="State",
        valid_value=0,
        counter_signal="Count",
        checksum_signal="Crc",
        checksum=checksum,
        **options,
    )


def guarded_bytes(value_mm: int, count: int, state: int = 0, checksum: ChecksumName = "crc8_autosar") -> bytes:
    body = struct.pack("<iBxB2x", value_mm, count, state)
    return bytes([REFERENCE[checksum](body)]) + body


def test_the_published_check_values_of_the_checksums() -> None:
    text = b"123456789"
    # 0x4B and 0xDF: SAE J1850, AUTOSAR CRC library; the digits add up to 477 and their exclusive or is 0x31.
    assert {name: calculate(text) for name, calculate in CHECKSUMS.items()} == {
        "crc8_j1850": 0x4B,
        "crc8_autosar": 0xDF,
        "sum8": 477 - 256,
        "xor8": 0x31,
    }


@settings(derandomize=True, deadline=None)
@given(name=st.sampled_from(sorted(CHECKSUMS)), data=st.binary(max_size=64))
def test_checksums_agree_with_independent_implementations(name: ChecksumName, data: bytes) -> None:
    assert CHECKSUMS[name](data) == REFERENCE[name](data)


@pytest.mark.parametrize("checksum", sorted(CHECKSUMS))
def test_any_flipped_bit_is_caught_by_every_kind_of_checksum(dbc: Path, checksum: ChecksumName) -> None:
    good = guarded_bytes(250, 5, checksum=checksum)
    for bit in range(80):
        flipped = bytearray(good)
        flipped[bit // 8] ^= 1 << bit % 8
        assert taken(guarded(dbc, checksum), bytes(flipped)).fault is CHECKSUM
    assert taken(guarded(dbc, checksum), good).fault is NONE


def test_the_support_controllers_frame_is_covered_by_a_checksum() -> None:
    reader, good = decoder(), status(347, 3)
    reading = taken(reader, bytes([good[0] ^ 1]) + good[1:])
    assert (reading.fault, reading.value_m) == (CHECKSUM, 0.346)
    assert reader.faults[CHECKSUM] == 1
    assert taken(reader, good).fault is NONE


def test_a_counter_that_stands_still_is_told_from_the_second_frame_on() -> None:
    reader = decoder()
    frames = [status(100, 4), status(100, 4), status(160, 4), status(161, 5), status(161, 5)]
    faults = [taken(reader, data, number * 60 * MS).fault for number, data in enumerate(frames)]
    assert faults == [NONE, REPEATED, REPEATED, NONE, REPEATED]
    assert (reader.faults[REPEATED], reader.report(0).lost_frames) == (3, 0)


def test_the_last_frame_in_a_burst_of_copies_is_the_same_case() -> None:
    reader = decoder()
    assert [taken(reader, status(100, 4), number).fault for number in range(4)] == [NONE, *[REPEATED] * 3]


def test_a_silence_longer_than_the_timeout_excuses_any_counter() -> None:
    for counter in (4, 9):
        reader = decoder(timeout_ms=500)
        first = taken(reader, status(100, 4), 0)
        later = taken(reader, status(100, counter), 501 * MS)
        assert (first.fault, later.fault, reader.report(0).lost_frames) == (NONE, NONE, 0)
    reader = decoder(timeout_ms=500)
    taken(reader, status(100, 4), 0)
    assert taken(reader, status(100, 4), 500 * MS).fault is REPEATED


@settings(derandomize=True, deadline=None)
@given(st.lists(st.integers(0, 14), max_size=30), st.integers(0, 15))
def test_lost_frames_are_counted_exactly_modulo_the_range_of_the_counter(losses: list[int], first: int) -> None:
    reader, number = decoder(), first
    for index, lost in enumerate([0, *losses]):
        number += 1 + lost
        assert taken(reader, status(100, number % 16), index).fault is NONE
    assert reader.report(0).lost_frames == sum(losses)


def test_a_counter_turns_over_where_the_dbc_file_says(dbc: Path) -> None:
    reader = guarded(dbc)
    for index, count in enumerate([13, 14, 1, 2, 14, 3]):  # 11 lost before the second 14, 1 and 2 after it
        assert taken(reader, guarded_bytes(100, count), index).fault is NONE
    assert reader.report(0).lost_frames == 11 + 2


def test_a_frame_with_a_wrong_checksum_does_not_move_the_counter() -> None:
    reader = decoder()
    frames = [status(100, 4), b"\0" + status(100, 9)[1:], status(100, 5)]
    assert [taken(reader, data, index).fault for index, data in enumerate(frames)] == [NONE, CHECKSUM, NONE]
    assert reader.report(0).lost_frames == 0


def test_of_several_faults_the_one_that_makes_the_others_meaningless_is_told(dbc: Path) -> None:
    reader = guarded(dbc, maximum_mm=600)
    taken(reader, guarded_bytes(100, 1))
    everything = bytes([guarded_bytes(9000, 1, 3)[0] ^ 1]) + guarded_bytes(9000, 1, 3)[1:]
    frames = [
        everything + b"\0",
        everything,
        guarded_bytes(9000, 1, 3),
        guarded_bytes(9000, 2, 3),
        guarded_bytes(9000, 3, 0),
        guarded_bytes(300, 4, 0),
    ]
    readings = [taken(reader, data) for data in frames]
    assert [reading.fault for reading in readings] == [MALFORMED, CHECKSUM, REPEATED, INVALID, OUT_OF_RANGE, NONE]
    assert math.isnan(readings[0].value_m)
    assert [reading.value_m for reading in readings[1:]] == [9.0, 9.0, 9.0, 9.0, 0.3]
    assert (reader.frames, sum(reader.faults.values())) == (7, 5)


def test_an_emergency_goes_before_the_limits() -> None:
    reader = decoder(preset="cia406", maximum_mm=100)
    reader.decode(emergency(0x5000, 1))
    assert taken(reader, position(2000)).fault is INVALID


def test_the_reference_is_checked_like_the_observed_displacement() -> None:
    reader = decoder(True)
    readings = [taken(reader, data) for data in (status(100, 1), status(100, 1), status(100, 2, valid=0))]
    assert [(reading.fault, reading.is_reference) for reading in readings] == [
        (NONE, True),
        (REPEATED, True),
        (INVALID, True),
    ]


def test_every_page_of_a_message_moves_its_counter(dbc: Path) -> None:
    options: dict[str, Any] = {"counter_signal": "Count", "checksum_signal": "Sum", "checksum": "sum8"}
    reader = decoder(dbc=dbc, message="Paged", signal="Stroke", **options)

    def page(number: int, count: int, value: int) -> bytes:
        body = struct.pack("<BBH", number, count, value)
        return body + bytes([sum(body) % 256])

    pages = [page(0, 0, 100), page(1, 1, 7), page(0, 2, 101), page(1, 3, 7), page(0, 0, 102), page(1, 0, 7)]
    readings = [read(reader, data, index) for index, data in enumerate(pages)]
    assert [reading.value_m for reading in readings if reading] == [0.1, 0.101, 0.102]
    assert [reading.fault for reading in readings if reading] == [NONE] * 3
    # The last page repeats the counter: no reading of ours, but not lost either.
    assert (reader.report(0).lost_frames, reader.faults[REPEATED]) == (0, 1)


@pytest.mark.parametrize(
    ("length", "is_fd", "accepted"),
    [(10, False, True), (10, True, True), (12, True, True), (12, False, False), (11, True, False), (16, True, False)],
)
def test_an_fd_frame_may_be_padded_to_the_next_length_that_fd_knows(
    dbc: Path, length: int, is_fd: bool, accepted: bool
) -> None:
    data = guarded_bytes(100, 1) + b"\xcc" * (length - 10)
    assert taken(guarded(dbc), data, is_fd=is_fd).fault is (NONE if accepted else MALFORMED)


def test_the_short_status_frame_may_come_padded_on_an_fd_bus() -> None:
    assert taken(decoder(), status(347) + bytes(3), is_fd=True).value_m == 0.347
    assert taken(decoder(), status(347) + bytes(3)).fault is MALFORMED


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"counter_signal": "Nope"}, ['"Nope"', "`counter_signal`", "Count, Crc, Last, Nibble, State, Stroke"]),
        ({"counter_signal": "Stroke"}, ['"Stroke"', "`counter_signal`", "name another one"]),
        ({"checksum_signal": "Nibble", "checksum": "sum8"}, ['"Nibble"', "`checksum_signal`", "one whole byte"]),
        ({"checksum_signal": "Count", "checksum": "sum8"}, ['"Count"', "one whole byte", "8-bit checksum"]),
        (
            {"message": "Paged", "valid_signal": "Health"},
            ['"Health"', "`valid_signal`", 'does not stand beside "Stroke" in the same frame'],
        ),
        (
            {"preset": "support_controller", "dbc": None, "message": None, "signal": None, "valid_signal": "counters"},
            ['"counters"', "`valid_signal`"],
        ),
    ],
)
def test_protection_that_does_not_fit_the_dbc_file_is_refused_in_one_sentence(
    dbc: Path, options: dict[str, Any], words: list[str]
) -> None:
    with pytest.raises(CanConfigError) as refusal:
        decoder(**{"dbc": dbc, "message": "Guarded", "signal": "Stroke", **options})
    text = str(refusal.value)
    assert [word for word in words if word not in text] == []
    assert "\n" not in text


def test_a_counter_must_be_an_integer(tmp_path: Path) -> None:
    path = tmp_path / "real.dbc"
    path.write_text(
        'VERSION ""\nBU_: A\nBO_ 1 M: 8 A\n SG_ Stroke : 0|32@1- (1,0) [0|0] "mm" A\n'
        ' SG_ Clock : 32|32@1- (1,0) [0|0] "" A\nSIG_VALTYPE_ 1 Clock : 1;\n'
    )
    with pytest.raises(CanConfigError, match=r'"Clock" \(option `counter_signal`\) is no integer of up to 64 bits'):
        decoder(dbc=path, message="M", signal="Stroke", counter_signal="Clock")


def test_checksums_in_both_byte_orders_and_anywhere_in_the_frame_are_found(dbc: Path) -> None:
    reader = decoder(dbc=dbc, message="Guarded", signal="Stroke", checksum_signal="Last", checksum="xor8")
    assert taken(reader, bytes([0x55, 100, 0, 0, 0, 0, 0, 0, 0, 0x55 ^ 100])).fault is NONE
    assert taken(reader, bytes([0x55, 100, 0, 0, 0, 0, 0, 0, 0, 0x55])).fault is CHECKSUM


def test_what_belongs_to_the_presets_message_does_not_belong_to_another_one_of_its_file() -> None:
    reader = decoder(message="LaboratorySensor", signal="reference_stroke")
    source = reader.source
    assert (source.valid_signal, source.counter, source.checksum) == (None, None, None)
    for _ in range(2):
        assert taken(reader, struct.pack("<i", 34_712)).fault is NONE


DECODERS = [decoder(preset=preset) for preset in PRESETS]


@settings(derandomize=True, deadline=None, max_examples=300)
@given(
    data=st.binary(max_size=64),
    which=st.sampled_from(DECODERS),
    own=st.integers(0, 2),
    flags=st.integers(0, 7),
    t_ns=st.integers(-(2**63), 2**63 - 1),
)
def test_no_bytes_whatever_make_the_decoder_or_its_report_raise(
    data: bytes, which: DisplacementDecoder, own: int, flags: int, t_ns: int
) -> None:
    ids = which.arbitration_ids
    arbitration_id, is_extended = ids[own % len(ids)]
    kinds = {"is_error": bool(flags & 1), "is_remote": bool(flags & 2), "is_fd": bool(flags & 4)}
    reading = which.decode(Frame(t_ns, arbitration_id, data, is_extended, **kinds))
    assert reading is None or reading.valid <= (-0.05 <= reading.value_m <= 1.0)
    condition = which.report(t_ns).condition
    assert bool(condition.what) == bool(condition.advice) == (condition != OK)


@settings(derandomize=True, deadline=None, max_examples=200)
@given(data=st.binary(min_size=4, max_size=12), page=st.booleans(), is_fd=st.booleans())
def test_no_bytes_whatever_make_a_decoder_of_an_own_dbc_file_raise(
    own_decoders: list[DisplacementDecoder], data: bytes, page: bool, is_fd: bool
) -> None:
    for reader in own_decoders:
        length = reader.source.message.length
        read(reader, (data if page else data + bytes(12))[:length], is_fd=is_fd)


@pytest.fixture(scope="module")
def own_decoders(tmp_path_factory: pytest.TempPathFactory) -> list[DisplacementDecoder]:
    path = tmp_path_factory.mktemp("own") / "own.dbc"
    path.write_text(DBC, encoding="cp1252")
    paged = decoder(dbc=path, message="Paged", signal="Stroke", counter_signal="Count")
    return [guarded(path), paged, decoder(dbc=path, message="Real", signal="Stroke", minimum_mm=-1e6, maximum_mm=1e6)]
