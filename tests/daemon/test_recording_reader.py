"""Whatever happens to a file, what is still in it can be read, and what cannot is named."""

from __future__ import annotations

import random
import struct
import zlib
from dataclasses import replace
from pathlib import Path

import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from daemon.recording import scan, topics
from daemon.recording.errors import RecordingError
from daemon.recording.reader import Recording
from daemon.recording.recover import recover
from daemon.recording.topics import Recorded
from daemon.recording.writer import OWN_CHANNELS, Channel, RecordingWriter
from estimation.records import Event, Tick
from tests.daemon.recording_kit import (
    ATTACHMENTS,
    METADATA,
    SmallDisk,
    burst,
    chunks_of,
    passes_official_reader,
    records_of,
    stream_reader_count,
    write_recording,
)


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> tuple[bytes, list[tuple[str, Recorded]]]:
    """Bytes of a file of 40 bursts in 4 chunks, and its messages."""
    path = tmp_path_factory.mktemp("small") / "small.mcap"
    written = write_recording(path, 40)
    return path.read_bytes(), written


def read_all(path: Path) -> tuple[Recording, list[tuple[str, Recorded]]]:
    recording = Recording(path)
    return recording, list(recording.messages())


def test_a_file_cut_anywhere_gives_a_prefix_of_its_messages_and_the_recovered_file_the_same(
    small: tuple[bytes, list[tuple[str, Recorded]]], tmp_path: Path
) -> None:
    data, written = small
    cut, repaired = tmp_path / "cut.mcap", tmp_path / "repaired.mcap"
    last_count = 0
    for length in range(len(data)):
        cut.write_bytes(data[:length])
        try:
            recording, messages = read_all(cut)
        except RecordingError:
            assert last_count == 0, "longer files give no less"
            continue
        assert messages == written[: len(messages)]
        assert len(messages) >= last_count
        assert recording.metadata == METADATA
        assert not recording.complete
        assert recording.damage
        if len(messages) > last_count or length % 101 == 0:
            assert len(messages) >= stream_reader_count(cut)
            report = recover(cut, repaired)
            assert report.messages == len(messages) == passes_official_reader(repaired)
        last_count = len(messages)
    assert last_count == len(written)


def test_a_killed_file_loses_only_its_torn_chunk(
    small: tuple[bytes, list[tuple[str, Recorded]]], tmp_path: Path
) -> None:
    data, written = small
    path = tmp_path / "torn.mcap"
    start, end = chunks_of(data)[2]
    path.write_bytes(data[: (start + end) // 2])
    recording, messages = read_all(path)
    assert messages == written[:22]
    assert recording.attachments == ATTACHMENTS
    assert recording.damage == [
        f"incomplete record at byte {start}",
        "the index at the end is missing: the file was cut, damaged, or not yet finished",
    ]


def test_a_damaged_chunk_is_skipped_counted_by_its_index_and_reading_goes_on_behind_it(
    small: tuple[bytes, list[tuple[str, Recorded]]], tmp_path: Path
) -> None:
    data, written = small
    for place in range(4):
        start, end = chunks_of(data)[place]
        hurt = bytearray(data)
        hurt[end - 5] ^= 0x10
        path, repaired = tmp_path / f"hurt{place}.mcap", tmp_path / f"repaired{place}.mcap"
        path.write_bytes(hurt)
        recording, messages = read_all(path)
        assert messages == written[: 11 * place] + written[11 * (place + 1) :]
        assert recording.lost == 11
        assert recording.damage == [f"damaged chunk skipped at byte {start}"]
        report = recover(path, repaired)
        assert (report.messages, report.lost) == (33, 11)
        assert passes_official_reader(repaired) == 33
        again = Recording(repaired)
        assert list(again.messages()) == messages
        assert (again.metadata, again.attachments, again.complete) == (METADATA, ATTACHMENTS, True)


def test_a_damaged_record_length_costs_one_chunk_only(
    small: tuple[bytes, list[tuple[str, Recorded]]], tmp_path: Path
) -> None:
    data, written = small
    start, _ = chunks_of(data)[1]
    path = tmp_path / "length.mcap"
    for byte, bit in ((1, 0x01), (1, 0x80), (3, 0x40), (8, 0x80)):
        hurt = bytearray(data)
        hurt[start + byte] ^= bit
        path.write_bytes(hurt)
        recording, messages = read_all(path)
        assert messages == written[:11] + written[22:]
        assert recording.lost == 11
        assert recording.damage[0].endswith(f"record at byte {start}")


def test_messages_are_still_understood_when_chunk_and_announcements_at_the_start_are_damaged(
    small: tuple[bytes, list[tuple[str, Recorded]]], tmp_path: Path
) -> None:
    data, written = small
    hurt = bytearray(data)
    hurt[chunks_of(data)[0][1] - 5] ^= 1
    metadata = next(start for opcode, start, _ in records_of(data) if opcode == 0x0C)
    hurt[metadata + 9] ^= 0x80  # length of the record's name
    path = tmp_path / "head.mcap"
    path.write_bytes(hurt)
    recording, messages = read_all(path)
    assert messages == written[11:]
    assert recording.metadata == {}
    assert "the description at the head of the file is missing" in recording.damage


def test_damage_in_the_index_costs_no_message_and_is_noticed(
    small: tuple[bytes, list[tuple[str, Recorded]]], tmp_path: Path
) -> None:
    data, written = small
    path, repaired = tmp_path / "index.mcap", tmp_path / "repaired.mcap"
    data_end = next(start for opcode, start, _ in records_of(data) if opcode == 0x0F)
    footer = len(data) - 8 - 29
    # In a repeated schema; opcode, summary offset (little, large) and checksum of the footer; last magic.
    for at in (data_end + 30, footer, footer + 9, footer + 14, footer + 28, len(data) - 3):
        hurt = bytearray(data)
        hurt[at] ^= 1
        path.write_bytes(hurt)
        recording, messages = read_all(path)
        assert messages == written
        assert not recording.complete
        assert recover(path, repaired).messages == passes_official_reader(repaired) == len(written)


def test_a_damaged_attachment_is_left_out(small: tuple[bytes, list[tuple[str, Recorded]]], tmp_path: Path) -> None:
    data, written = small
    hurt = bytearray(data)
    hurt[data.index(b'{"step": 7}')] ^= 1
    path = tmp_path / "attachment.mcap"
    path.write_bytes(hurt)
    recording, messages = read_all(path)
    assert messages == written
    assert list(recording.attachments) == ["learned-state.json"]
    assert recording.damage[0].startswith("damaged description skipped at byte")


@settings(derandomize=True, deadline=None, max_examples=250)
@given(st.data())
def test_no_flipped_bytes_crash_the_reader_or_make_up_messages(
    small: tuple[bytes, list[tuple[str, Recorded]]],
    tmp_path_factory: pytest.TempPathFactory,
    draw: st.DataObject,
) -> None:
    data, written = small
    folder = tmp_path_factory.getbasetemp()
    path, repaired = folder / "flipped.mcap", folder / "flipped-repaired.mcap"
    hurt = bytearray(data)
    for _ in range(draw.draw(st.integers(1, 4))):
        hurt[draw.draw(st.integers(0, len(data) - 1))] ^= draw.draw(st.integers(1, 255))
    path.write_bytes(hurt)
    try:
        recording, messages = read_all(path)
    except RecordingError:
        return
    at = iter(written)
    assert all(message in at for message in messages), "a subsequence of what was written"
    assert len(messages) == len(written) or recording.damage
    report = recover(path, repaired)
    assert report.messages >= len(messages)
    assert passes_official_reader(repaired) == report.messages


@settings(derandomize=True, deadline=None, max_examples=100)
@given(st.binary(max_size=300))
def test_no_bytes_behind_the_magic_crash_the_reader(tmp_path_factory: pytest.TempPathFactory, rest: bytes) -> None:
    path = tmp_path_factory.getbasetemp() / "noise.mcap"
    path.write_bytes(scan.MAGIC + rest)
    with pytest.raises(RecordingError):
        Recording(path)


def test_messages_can_be_chosen_by_topic_and_read_again(
    small: tuple[bytes, list[tuple[str, Recorded]]], tmp_path: Path
) -> None:
    data, _ = small
    path = tmp_path / "small.mcap"
    path.write_bytes(data)
    recording = Recording(path)
    events = list(recording.messages([topics.EVENTS]))
    assert [record for _, record in events] == [Event(n, f"burst {n}") for n in (9, 19, 29, 39)]
    assert recording.counts == {topics.EVENTS: 4}
    assert len(list(recording.messages())) == 44
    assert recording.counts == {topics.IMU_RAW: 40, topics.EVENTS: 4}
    assert recording.damage == []


def test_missing_sequence_numbers_are_counted_per_topic(tmp_path: Path) -> None:
    path = tmp_path / "gaps.mcap"
    channel = OWN_CHANNELS[topics.TICK]
    payload = topics.TOPICS[topics.TICK].encode(Tick(0))
    with RecordingWriter(path, METADATA) as writer:
        for sequence in (2**32 - 2, 2**32 - 1, 0, 1, 5, 6, 4, 5, 8):  # wraps, gap of 3, jump back, gap of 2
            writer.write_raw(channel, 0, sequence, payload)
    recording, messages = read_all(path)
    assert len(messages) == 9
    assert recording.lost == 5


def foreign(path: Path, channels: list[Channel], payloads: list[bytes], compression: CompressionType) -> None:
    """A file by the official writer, without any of our description."""
    writer = Writer(str(path), compression=compression)
    writer.start(profile="", library="other tool")
    for channel, payload in zip(channels, payloads, strict=True):
        schema = writer.register_schema(channel.schema_name, channel.schema_encoding, channel.schema_text)
        number = writer.register_channel(channel.topic, channel.encoding, schema)
        writer.add_message(number, 5, payload, 5, 0)
    writer.finish()


OTHER = Channel("/lidar", "cdr", "a/msg/B", "ros2msg", b"uint8 x")
TICKS = OWN_CHANNELS[topics.TICK]
A_TICK = topics.TOPICS[topics.TICK].encode(Tick(5))


def test_a_file_of_another_program_is_refused_by_name(tmp_path: Path) -> None:
    path = tmp_path / "lidar.mcap"
    foreign(path, [OTHER], [b"\0"], CompressionType.ZSTD)
    with pytest.raises(RecordingError, match=r"lidar\.mcap comes from another program \(other tool\)"):
        Recording(path)


def test_our_topics_are_read_from_a_file_that_another_tool_put_together(tmp_path: Path) -> None:
    path = tmp_path / "merged.mcap"
    changed = Channel(topics.EVENTS, "cdr", "ramstroke_msgs/msg/Event", "ros2msg", b"int64 t_ns")
    bad = OWN_CHANNELS[topics.MOVES]
    foreign(path, [TICKS, OTHER, changed, bad], [A_TICK, b"\0", b"", b""], CompressionType.NONE)
    recording, messages = read_all(path)
    assert messages == [(topics.TICK, Tick(5))]
    assert recording.complete
    kinds = [sentence.rpartition(" at byte")[0] for sentence in recording.damage[:-1]]
    assert kinds == [
        "message on /lidar in a layout that this version cannot read",
        "message on /events in a layout that this version cannot read",
        "message on /moves with impossible content",
    ]
    repaired = tmp_path / "repaired.mcap"
    assert recover(path, repaired).messages == 4
    with repaired.open("rb") as stream:
        found = [(c.topic, m.data) for _, c, m in make_reader(stream).iter_messages()]
    assert sorted(found) == sorted(
        [(topics.TICK, A_TICK), ("/lidar", b"\0"), (topics.EVENTS, b""), (topics.MOVES, b"")]
    )


@pytest.mark.parametrize(
    ("text", "readable"),
    [
        (b"# older words\nuint8 OLD=7\nint64 t_ns", True),
        (b"int64 t_ns\nint64 t_ns", False),
        (b"int64 time_ns", False),
        (b"uint64 t_ns", False),
        (b"int64", False),
        (b"\xff\xfe", False),
    ],
)
def test_another_version_may_word_its_schema_otherwise_but_not_change_a_field(
    tmp_path: Path, text: bytes, readable: bool
) -> None:
    path = tmp_path / "older.mcap"
    event = topics.TOPICS[topics.EVENTS].encode(Event(5, "as ever"))
    channels = [OWN_CHANNELS[topics.EVENTS], replace(TICKS, schema_text=text)]
    foreign(path, channels, [event, A_TICK], CompressionType.NONE)
    assert read_all(path)[1] == [(topics.EVENTS, Event(5, "as ever")), (topics.TICK, Tick(5))][: 1 + readable]


def test_messages_outside_of_chunks_are_read(tmp_path: Path) -> None:
    path = tmp_path / "unchunked.mcap"
    writer = Writer(str(path), use_chunking=False)
    writer.start()
    schema = writer.register_schema(TICKS.schema_name, "ros2msg", TICKS.schema_text)
    number = writer.register_channel(topics.TICK, "cdr", schema)
    for sequence in range(3):
        writer.add_message(number, 5, A_TICK, 5, sequence)
    writer.finish()
    assert read_all(path)[1] == [(topics.TICK, Tick(5))] * 3


def test_an_unknown_compression_is_damage_not_a_crash(tmp_path: Path) -> None:
    path = tmp_path / "lz4.mcap"
    foreign(path, [TICKS], [A_TICK], CompressionType.LZ4)
    with pytest.raises(RecordingError):
        Recording(path)


def chunk(records: bytes, compressed: bytes, size: int, crc: int | None = None) -> bytes:
    """A chunk record that claims `size` bytes."""
    checksum = zlib.crc32(records) if crc is None else crc
    body = struct.pack("<QQQI", 0, 0, size, checksum) + struct.pack("<I4sQ", 4, b"zstd", len(compressed))
    return struct.pack("<BQ", 6, len(body) + len(compressed)) + body + compressed


def insert_chunk(data: bytes, inserted: bytes) -> bytes:
    """`data` with a chunk in front of its second one."""
    at = chunks_of(data)[1][0]
    return data[:at] + inserted + data[at:]


def hostile_chunks() -> dict[str, tuple[bytes, str]]:
    def packed(records: bytes) -> bytes:
        return chunk(records, zstandard.compress(records), len(records))

    zeros = bytes(scan.MAX_CHUNK_BYTES + 1)
    streamed = zstandard.ZstdCompressor(write_content_size=False).compress(bytes(10_000_000))
    message = struct.pack("<BQHIQQ", 5, 22, 999, 0, 0, 0)
    return {
        "a bomb that says so": (chunk(zeros, zstandard.compress(zeros), len(zeros)), "absurd size"),
        "a bomb that lies": (chunk(b"x", zstandard.compress(zeros), 1), "damaged chunk"),
        "a bomb that keeps silent": (chunk(b"x", streamed, 1), "damaged chunk"),
        "a bomb of no size": (chunk(b"", streamed, 0), "damaged chunk"),
        "no zstd": (chunk(b"x", b"plain", 1), "damaged chunk"),
        "wrong checksum": (chunk(b"x", zstandard.compress(b"x"), 1, crc=1), "damaged chunk"),
        "endless record": (packed(struct.pack("<BQ", 3, 2**63) + b"x"), "broken records"),
        "endless message": (packed(struct.pack("<BQHIQQ", 5, 2**60, 1, 0, 0, 0)), "broken records"),
        "tiny message": (packed(struct.pack("<BQ", 5, 3) + bytes(40)), "broken records"),
        "half a record": (packed(b"\x03\x00"), "broken records"),
        "half a message": (packed(message[:20]), "broken records"),
        "unknown channel": (packed(message), "unknown channel"),
        "absurd schema": (packed(struct.pack("<BQ", 3, 2_000_000) + bytes(2_000_000)), "absurd size"),
        "broken schema": (packed(struct.pack("<BQ", 3, 2) + b"ab"), "damaged description"),
        "channel without schema": (
            packed(struct.pack("<BQHHI", 4, 16, 77, 999, 0) + bytes(8)),
            "damaged description",
        ),
        "attachment that claims the world": (
            struct.pack("<BQQQIIQ", 9, 36, 0, 0, 0, 0, 2**63) + bytes(4),
            "damaged description",
        ),
        "end of data that is none": (struct.pack("<BQ", 0x0F, 5) + bytes(5), "unreadable record"),
        "record of absurd size": (struct.pack("<BQ", 0x03, 2**62), "unreadable record"),
        "tiny chunk": (struct.pack("<BQ", 6, 3) + b"abc", "unreadable record"),
    }


@pytest.mark.parametrize("name", hostile_chunks())
def test_a_hostile_part_is_named_and_costs_nothing_else(
    name: str, small: tuple[bytes, list[tuple[str, Recorded]]], tmp_path: Path
) -> None:
    data, written = small
    inserted, sentence = hostile_chunks()[name]
    path = tmp_path / "hostile.mcap"
    path.write_bytes(insert_chunk(data, inserted))
    recording, messages = read_all(path)
    assert messages == written
    assert any(sentence in damage for damage in recording.damage)


def test_a_thousand_faults_are_still_a_few_sentences(
    small: tuple[bytes, list[tuple[str, Recorded]]], tmp_path: Path
) -> None:
    data, written = small
    path = tmp_path / "many.mcap"
    path.write_bytes(insert_chunk(data, chunk(b"x", b"plain", 1) * 1000))
    recording, messages = read_all(path)
    assert messages == written
    at = chunks_of(data)[1][0]
    assert recording.damage[0] == f"damaged chunk skipped: 1000 times, first at byte {at}"
    assert len(recording.damage) == 2


def test_the_search_behind_damage_crosses_its_windows(
    small: tuple[bytes, list[tuple[str, Recorded]]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data, written = small
    path = tmp_path / "gap.mcap"
    for search in (1, 7, 64):
        monkeypatch.setattr(scan, "_SEARCH_BYTES", search)
        path.write_bytes(insert_chunk(data, b"\xff" * 150 + scan._ZSTD_NAME + b"\xff" * 50))
        assert read_all(path)[1] == written


def test_a_disk_that_fails_while_reading_gives_what_came_before(
    small: tuple[bytes, list[tuple[str, Recorded]]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data, written = small
    path = tmp_path / "sector.mcap"
    path.write_bytes(data)
    recording = Recording(path)
    opened, real = [], scan.open_chunk

    def second_fails(body: bytes) -> bytes:
        opened.append(1)
        if len(opened) == 2:
            raise OSError(5, "Input/output error")
        return real(body)

    monkeypatch.setattr(scan, "open_chunk", second_fails)
    assert list(recording.messages()) == written[:11]
    assert "the disk cannot read on: Input/output error" in recording.damage[0]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "does not exist"),
        (b"", "is empty"),
        (b"t_s,gyro_x_rad_s\n", "is not an MCAP file"),
        (scan.MAGIC[:5], "ends before its first message"),
        (scan.MAGIC, "ends before its first message"),
    ],
)
def test_a_file_that_cannot_be_a_recording_is_refused_in_one_sentence(
    content: bytes | None, words: str, tmp_path: Path
) -> None:
    path = tmp_path / "odd.mcap"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(RecordingError, match=words) as caught:
        Recording(path)
    assert str(path) in str(caught.value)


def test_a_folder_and_an_unreadable_file_are_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="is a folder"):
        Recording(tmp_path)
    (tmp_path / "file").write_bytes(b"x")
    with pytest.raises(RecordingError, match=r"cannot read .*Not a directory"):
        Recording(tmp_path / "file" / "inside.mcap")


def test_recover_does_not_write_over_its_source(
    small: tuple[bytes, list[tuple[str, Recorded]]], tmp_path: Path
) -> None:
    data, _ = small
    path, link = tmp_path / "a.mcap", tmp_path / "b.mcap"
    path.write_bytes(data)
    link.symlink_to(path)
    for target in (path, link):
        with pytest.raises(RecordingError, match="name another file"):
            recover(path, target)
    assert path.read_bytes() == data


def test_recover_tells_its_progress(tmp_path: Path) -> None:
    path = tmp_path / "long.mcap"
    dice = random.Random(1)
    with RecordingWriter(path, METADATA) as writer:
        for _ in range(40_001):
            writer.write(topics.TICK, Tick(dice.getrandbits(62)))
    told: list[float] = []
    assert recover(path, tmp_path / "out.mcap", told.append).messages == 40_001
    assert told == pytest.approx([0.25, 0.5, 0.75, 1.0], abs=0.06)


def test_a_recording_tells_which_share_of_it_was_read(tmp_path: Path) -> None:
    path = tmp_path / "long.mcap"
    dice = random.Random(1)
    with RecordingWriter(path, METADATA) as writer:
        for _ in range(40_000):
            writer.write(topics.TICK, Tick(dice.getrandbits(62)))
    recording = Recording(path)
    for _ in range(2):  # each reading from the beginning
        shares = [recording.share_read for _ in recording.messages()]
        assert shares == sorted(shares)
        assert shares[::10_000] == pytest.approx([0.0, 0.25, 0.5, 0.75], abs=0.06)
        assert recording.share_read == 1.0
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    cut = Recording(path)
    assert cut.share_read == 0.0
    for _ in cut.raw_messages():
        assert 0.0 <= cut.share_read <= 1.0
    assert cut.share_read == 1.0


def interrupted(path: Path, error: BaseException) -> None:
    with RecordingWriter(path, METADATA) as writer:
        writer.write(topics.TICK, Tick(1))
        assert len(list(path.parent.glob(".*part*"))) == 1
        raise error


def test_an_offline_file_appears_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "out.mcap"
    with pytest.raises(KeyboardInterrupt):
        interrupted(path, KeyboardInterrupt())
    assert list(tmp_path.iterdir()) == []
    with RecordingWriter(path, METADATA) as writer:
        writer.write(topics.TICK, Tick(1))
    assert list(tmp_path.iterdir()) == [path]
    before = path.read_bytes()
    with pytest.raises(ValueError, match="no good"):
        interrupted(path, ValueError("no good"))
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_that_does_not_exist_is_named(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"cannot write .*none/out\.mcap: No such file"):
        interrupted(tmp_path / "none" / "out.mcap", ValueError())


@pytest.mark.parametrize("room", [0, 50_000])
def test_a_full_disk_is_named_and_leaves_nothing_behind(
    room: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "out.mcap"
    SmallDisk(room).hold_what_is_written(monkeypatch)

    def fill() -> None:
        with RecordingWriter(path, METADATA, {"state": bytes(9000)}) as writer:
            for number in range(5000):
                writer.write(topics.IMU_RAW, burst(number))

    with pytest.raises(RecordingError, match=r"cannot write .*out\.mcap: No space left"):
        fill()
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_at_the_last_byte_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "out.mcap"

    def fill() -> None:
        with RecordingWriter(path, METADATA) as writer:
            writer.write(topics.TICK, Tick(1))

    fill()
    room = path.stat().st_size - 1
    path.unlink()
    SmallDisk(room).hold_what_is_written(monkeypatch)
    with pytest.raises(RecordingError, match="No space left"):
        fill()
    assert list(tmp_path.iterdir()) == []
