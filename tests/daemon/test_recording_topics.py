"""Every topic survives a recording bit for bit, and an independent decoder reads what the schema promises."""

from __future__ import annotations

import math
import struct
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory

from daemon.recording import schemas, topics
from daemon.recording.cdr import DecodeError, Layout
from daemon.recording.reader import Recording
from daemon.recording.topics import TOPICS, UNDECODABLE, Health, LogLine, Recorded, RecordedDisplacement
from daemon.recording.writer import RecordingWriter
from drivers.adis16448.burst import Burst, Fault
from drivers.adis16448.identity import Identity
from drivers.can.frame import Frame
from drivers.jy901.identity import Jy901Identity
from drivers.jy901.reading import Reading
from estimation.records import (
    CanState,
    Displacement,
    Estimate,
    Event,
    ImuSample,
    Move,
    MoveKind,
    ReadingFault,
    Segment,
    Tick,
    Tier,
    TimeKind,
)
from tests.daemon.recording_kit import ATTACHMENTS, METADATA, ONE_OF_EACH

times = st.integers(0, 2**63 - 1)
int16 = st.integers(-(2**15), 2**15 - 1)
words16 = st.integers(0, 2**16 - 1)
words32 = st.integers(0, 2**32 - 1)
numbers = st.floats(allow_nan=True, allow_infinity=True, width=64)
flags = st.booleans()
vectors = st.tuples(numbers, numbers, numbers)
tiers, can_states = st.sampled_from(Tier), st.sampled_from(CanState)
frames = st.builds(Frame, times, words32, st.binary(max_size=64), flags, flags, flags, flags)
estimates = st.builds(
    Estimate,
    times,
    *[numbers] * 4,
    st.sampled_from(Segment),
    tiers,
    can_states,
    words32,
    *[numbers] * 6,
)


def displacements(is_reference: bool) -> st.SearchStrategy[RecordedDisplacement]:
    readings = st.builds(Displacement, times, numbers, st.sampled_from(ReadingFault), st.just(is_reference))
    return st.builds(RecordedDisplacement, readings, flags)


STRATEGIES: dict[str, st.SearchStrategy[Any]] = {
    topics.IMU_RAW: st.builds(
        Burst,
        times,
        st.sampled_from(TimeKind),
        st.tuples(*[words16] * 12),
        st.none() | words16,
        st.sampled_from(Fault),
    ),
    topics.IMU_IDENTITY: st.builds(Identity, times, words16, words32, words16),
    topics.IMU_SAMPLE: st.builds(ImuSample, times, vectors, vectors, numbers, st.sampled_from(TimeKind)),
    topics.CAN_RX: frames,
    topics.CAN_TX: frames,
    topics.OBSERVED: displacements(False),
    topics.REFERENCE: displacements(True),
    topics.TICK: st.builds(Tick, times),
    topics.PROVISIONAL: estimates,
    topics.SETTLED: estimates,
    topics.MOVES: st.builds(Move, words32, st.sampled_from(MoveKind), times, times, *[numbers] * 6, can_states, tiers),
    topics.EVENTS: st.builds(Event, times, st.text()),
    topics.LOG: st.builds(LogLine, st.integers(0, 2**31 * 10**9 - 1), st.integers(0, 255), st.text(), st.text()),
    topics.HEALTH: st.builds(Health, times, st.text()),
    topics.JY901: st.builds(Reading, times, st.tuples(*[int16] * 4), st.tuples(*[int16] * 4), st.booleans()),
    topics.JY901_IDENTITY: st.builds(Jy901Identity, times, words16, words32, numbers),
}


def exact(value: object) -> object:
    """`value` with floats as their bits, so that NaN equals NaN and -0.0 differs from 0.0."""
    if isinstance(value, float):
        return struct.pack("<d", value)
    if isinstance(value, tuple):
        return tuple(exact(item) for item in value)
    if hasattr(value, "__slots__") and not isinstance(value, (int, str)):
        return type(value), tuple(exact(getattr(value, name)) for name in value.__slots__)
    return type(value), value


def test_the_samples_and_strategies_of_these_tests_cover_the_whole_table() -> None:
    assert list(STRATEGIES) == list(ONE_OF_EACH) == list(TOPICS)


@pytest.mark.parametrize("topic", TOPICS)
def test_every_record_comes_back_bit_for_bit(topic: str) -> None:
    row = TOPICS[topic]

    @settings(derandomize=True, deadline=None, max_examples=60)
    @given(STRATEGIES[topic])
    def comes_back(record: Recorded) -> None:
        assert exact(row.decode(row.encode(record))) == exact(record)

    comes_back()


def independent(topic: str, record: Recorded) -> Any:
    """The record as the ROS 2 decoder of another project sees it, by schema text and bytes alone."""
    row = TOPICS[topic]
    schema = Schema(1, row.layout.text.encode(), "ros2msg", row.layout.name)
    decoder = DecoderFactory().decoder_for("cdr", schema)
    assert decoder is not None
    return decoder(row.encode(record))


def test_an_independent_decoder_sees_register_words_signed_where_the_register_is_signed() -> None:
    seen = independent(topics.IMU_RAW, ONE_OF_EACH[topics.IMU_RAW])
    assert (seen.t_ns, seen.diag_stat, seen.x_gyro, seen.z_accl) == (1, 0x8001, -1, -32768)
    assert (seen.baro, seen.temp, seen.crc, seen.has_crc) == (50_000, 0x0FFF, 0xBEEF, True)
    assert (seen.time_kind, seen.fault) == (TimeKind.READ.value, Fault.CRC.value)


@settings(derandomize=True, deadline=None, max_examples=60)
@given(STRATEGIES[topics.PROVISIONAL])
def test_an_independent_decoder_reads_estimates_by_the_names_and_codes_of_the_schema(
    record: Estimate,
) -> None:
    seen = independent(topics.PROVISIONAL, record)
    names = ["displacement", "sigma", "velocity", "velocity_sigma", "acceleration"]
    names += ["chart_lower", "chart_upper", "step", "innovation", "gate"]
    units = ["_m", "_m", "_m_s", "_m_s", "_m_s2", "_m_s2", "_m_s2", "_m_s", "_m", "_m"]
    for name, unit in zip(names, units, strict=True):
        assert exact(getattr(seen, name)) == exact(getattr(record, name + unit))
    assert (seen.t_ns, seen.move) == (record.t_ns, record.move)
    text = schemas.ESTIMATE.text
    assert f"SEGMENT_{record.segment.name}={seen.segment}\n" in text
    assert f"TIER_{record.tier.name}={seen.tier}\n" in text
    assert f"CANSTATE_{record.can_state.name}={seen.can_state}\n" in text


@settings(derandomize=True, deadline=None, max_examples=60)
@given(STRATEGIES[topics.LOG])
def test_an_independent_decoder_reads_strings_and_what_follows_them(record: LogLine) -> None:
    seen = independent(topics.LOG, record)
    assert (seen.stamp.sec, seen.stamp.nanosec) == divmod(record.t_ns, 10**9)
    assert (seen.level, seen.name, seen.msg, seen.line) == (record.level, record.logger, record.text, 0)


@settings(derandomize=True, deadline=None, max_examples=40)
@given(frames)
def test_an_independent_decoder_reads_frames_of_any_length(record: Frame) -> None:
    seen = independent(topics.CAN_RX, record)
    assert (seen.arbitration_id, bytes(seen.data)) == (record.arbitration_id, record.data)
    assert (seen.is_extended, seen.is_fd) == (record.is_extended, record.is_fd)


def test_an_independent_decoder_reads_moves_samples_and_displacements() -> None:
    move = independent(topics.MOVES, ONE_OF_EACH[topics.MOVES])
    assert (move.onset_ns, move.stop_ns, move.number, move.velocity) == (8, 9, 9, -0.125)
    assert (move.kind, move.can_state, move.tier) == (1, 3, 0)
    sample = independent(topics.IMU_SAMPLE, ONE_OF_EACH[topics.IMU_SAMPLE])
    assert (sample.gyro_y, sample.accel_z, sample.temperature, sample.time_kind) == (-0.25, -1.5, 21.5, 2)
    reading = independent(topics.OBSERVED, ONE_OF_EACH[topics.OBSERVED])
    assert (reading.value, reading.decoded) == (0.25, True)
    assert f"FAULT_CHECKSUM={reading.fault}\n" in schemas.DISPLACEMENT.text


def test_a_whole_file_is_read_by_the_official_reader_and_by_ours_in_the_order_written(tmp_path: Path) -> None:
    path = tmp_path / "all.mcap"
    with RecordingWriter(path, METADATA, ATTACHMENTS) as writer:
        for _ in range(3):
            for topic, record in ONE_OF_EACH.items():
                writer.write(topic, record)
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        decoded = list(reader.iter_decoded_messages(log_time_order=False))
        assert [item.channel.topic for item in decoded] == list(ONE_OF_EACH) * 3
        assert [item.message.sequence for item in decoded] == [0] * 16 + [1] * 16 + [2] * 16
        for item in decoded:
            expected = TOPICS[item.channel.topic].time_ns(ONE_OF_EACH[item.channel.topic])
            assert item.message.log_time == item.message.publish_time == expected
        assert reader.get_header().profile == "ros2"
        assert [(item.name, item.metadata) for item in reader.iter_metadata()] == [("ramstroke", METADATA)]
        assert {item.name: item.data for item in reader.iter_attachments()} == ATTACHMENTS
    recording = Recording(path)
    assert exact(tuple(recording.messages())) == exact(tuple(ONE_OF_EACH.items()) * 3)
    assert recording.counts == dict.fromkeys(TOPICS, 3)
    assert (recording.metadata, recording.attachments) == (METADATA, ATTACHMENTS)
    assert (recording.complete, recording.damage, recording.lost) == (True, [], 0)


@pytest.mark.parametrize("topic", TOPICS)
def test_bytes_that_are_not_such_a_record_are_refused_by_a_foreseen_error(topic: str) -> None:
    row = TOPICS[topic]
    good = row.encode(ONE_OF_EACH[topic])
    for bad in (b"", good[:-1], good + b"\0", b"\0\0\0\0" + good[4:]):
        with pytest.raises(UNDECODABLE):
            row.decode(bad)


@pytest.mark.parametrize("topic", [topics.IMU_RAW, topics.IMU_SAMPLE, topics.PROVISIONAL, topics.MOVES])
def test_an_enum_code_that_nobody_gave_out_is_refused(topic: str) -> None:
    good = TOPICS[topic].encode(ONE_OF_EACH[topic])
    with pytest.raises(LookupError):
        TOPICS[topic].decode(good[:-1] + b"\xff")


def test_a_fault_of_a_reading_that_nobody_gave_out_is_refused() -> None:
    good = TOPICS[topics.OBSERVED].encode(ONE_OF_EACH[topics.OBSERVED])
    with pytest.raises(LookupError):
        TOPICS[topics.OBSERVED].decode(good[:-2] + b"\xff\x01")


def test_a_frame_longer_than_any_bus_carries_is_refused() -> None:
    long = schemas.CAN_FRAME.pack(0, 1, False, True, False, False, bytes(65))
    with pytest.raises(DecodeError, match="65 bytes"):
        TOPICS[topics.CAN_RX].decode(long)


def test_a_displacement_on_the_other_topic_is_refused() -> None:
    with pytest.raises(ValueError, match="is_reference=True"):
        TOPICS[topics.OBSERVED].encode(ONE_OF_EACH[topics.REFERENCE])


def test_text_with_bytes_that_are_not_text_is_recorded_readably() -> None:
    row = TOPICS[topics.EVENTS]
    event = row.decode(row.encode(Event(1, "file \udcff.csv")))
    assert event == Event(1, "file \\udcff.csv")


def test_fields_behind_a_string_are_aligned_to_their_size() -> None:
    layout = Layout("p/msg/T", "uint8 a\nstring s\nfloat64 x\n")
    for text in ("", "a", "abcd", "abcdefgh"):
        data = layout.pack(7, text, 0.5)
        assert (len(data) - 4) % 8 == 0
        schema = Schema(1, layout.text.encode(), "ros2msg", layout.name)
        decoder = DecoderFactory().decoder_for("cdr", schema)
        assert decoder is not None
        assert (decoder(data).s, decoder(data).x) == (text, 0.5)
        assert layout.unpack(data) == (7, text, 0.5)


def test_every_number_of_every_schema_states_its_unit() -> None:
    for row in TOPICS.values():
        for line in row.layout.text.splitlines():
            kind = line.split(" ")[0]
            if "=" in line or kind not in {"float64", "int16", "int64", "uint16", "uint32", "string"}:
                continue
            assert "# [" in line, f"{row.name}: {line}"


def test_nan_keeps_its_bits() -> None:
    payload = struct.unpack("<d", b"\x01\x00\x00\x00\x00\x00\xf8\x7f")[0]
    row = TOPICS[topics.IMU_SAMPLE]
    back = row.decode(row.encode(ImuSample(0, (payload, 0.0, -0.0), (0.0, 0.0, 0.0))))
    assert isinstance(back, ImuSample)
    assert math.isnan(back.gyro[0])
    assert exact(back.gyro) == exact((payload, 0.0, -0.0))
