"""Records of every topic, and files made of them, for the tests of the recording."""

from __future__ import annotations

import errno
import io
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import pytest
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader

from daemon.recording import topics
from daemon.recording.metadata import LEARNED, SNAPSHOT
from daemon.recording.topics import EVENTS, IMU_RAW, TOPICS, Health, LogLine, Recorded, RecordedDisplacement
from daemon.recording.writer import OWN_CHANNELS, Container
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

METADATA = {"kind": "recording", "settings": '{"stroke_mm": 500}'}
ATTACHMENTS = {SNAPSHOT: b'{"step": 7}', LEARNED: b'{"rate_hz": 815.25}'}

ESTIMATE = Estimate(
    11,
    0.125,
    0.002,
    0.25,
    0.01,
    Segment.CVS,
    Tier.SETTLED,
    CanState.BIASED,
    3,
    -0.5,
    -0.2,
    0.2,
    0.125,
    math.nan,
    0.006,
)
ONE_OF_EACH: dict[str, Recorded] = {
    topics.IMU_RAW: Burst(
        1, TimeKind.READ, (0x8001, 0xFFFF, 2, 3, 4, 5, 0x8000, 7, 8, 9, 50_000, 0x0FFF), 0xBEEF, Fault.CRC
    ),
    topics.IMU_IDENTITY: Identity(13, 16448, 0x12345678, 0xABC),
    topics.IMU_SAMPLE: ImuSample(2, (0.5, -0.25, 3.0), (9.75, 0.0, -1.5), 21.5, TimeKind.IMPORTED),
    topics.CAN_RX: Frame(3, 0x1ABCDEF0, b"\x01\x02\x03", is_extended=True),
    topics.CAN_TX: Frame(4, 0x123, bytes(range(64)), is_fd=True),
    topics.OBSERVED: RecordedDisplacement(Displacement(5, 0.25, ReadingFault.CHECKSUM), decoded=True),
    topics.REFERENCE: RecordedDisplacement(Displacement(6, 0.375, is_reference=True), decoded=False),
    topics.TICK: Tick(7),
    topics.PROVISIONAL: ESTIMATE,
    topics.SETTLED: ESTIMATE,
    topics.MOVES: Move(
        9, MoveKind.RETRACT, 8, 9, 0.5, 0.0, 0.003, 0.004, 0.005, -0.125, CanState.STUCK, Tier.PROVISIONAL
    ),
    topics.EVENTS: Event(10, "wire broken \N{LIGHTNING}"),
    topics.LOG: LogLine(1_234_567_890_123, 30, "drivers.can", "bus off; 15 °C"),
    topics.HEALTH: Health(12, '{"dropped": 0}'),
    topics.JY901: Reading(17, (-1, 2, 2048, 2512), (-32768, 32767, 5, 2513), is_frozen=True),
    topics.JY901_IDENTITY: Jy901Identity(16, 4711, 115200, 200.0),
}


def burst(number: int) -> Burst:
    """The `number`-th burst of a test file, 819.2 Hz, recognisable by its words."""
    words = (0, *((number >> shift) & 0xFFFF for shift in (0, 16)), *range(9))
    return Burst(number * 1_220_703, TimeKind.EDGE, words, None)


def number_of(record: Recorded) -> int:
    """Which burst this is."""
    assert isinstance(record, Burst)
    return record.words[1] | record.words[2] << 16


def write_recording(path: Path, bursts: int, flush_every: int = 10) -> list[tuple[str, Recorded]]:
    """A file of `bursts` bursts with an event after each tenth, a chunk per `flush_every` bursts."""
    written: list[tuple[str, Recorded]] = []
    with path.open("wb") as stream:
        container = Container(stream, METADATA, ATTACHMENTS)
        channels = {topic: container.add_channel(OWN_CHANNELS[topic]) for topic in (IMU_RAW, EVENTS)}
        sequences = dict.fromkeys(channels, 0)
        for number in range(bursts):
            records: list[tuple[str, Recorded]] = [(IMU_RAW, burst(number))]
            if number % 10 == 9:
                records.append((EVENTS, Event(number, f"burst {number}")))
            for topic, record in records:
                container.add(channels[topic], number, sequences[topic], TOPICS[topic].encode(record))
                sequences[topic] += 1
            written += records
            if number % flush_every == flush_every - 1:
                container.flush()
        container.finish()
    return written


def records_of(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Opcode, start and end of every top-level record of a whole file, by our own reading of the format."""
    at = 8
    while at < len(data) - 8:
        end = at + 9 + int.from_bytes(data[at + 1 : at + 9], "little")
        yield data[at], at, end
        at = end


def chunks_of(data: bytes) -> list[tuple[int, int]]:
    """Start and end of every chunk record."""
    return [(start, end) for opcode, start, end in records_of(data) if opcode == 6]


def stream_reader_count(path: Path) -> int:
    """Messages that the official stream reader gives before it gives up."""
    count = 0
    with path.open("rb") as stream:
        try:
            for record in StreamReader(stream, validate_crcs=True).records:
                count += type(record).__name__ == "Message"
        except Exception:
            return count
    return count


class SmallDisk:
    """A disk that takes `room` more bytes, in all its files, and then says that it is full."""

    def __init__(self, room: int) -> None:
        self.room = room

    def open(self, path: Path) -> BinaryIO:
        """A new file on this disk."""
        return io.BufferedWriter(_SmallFile(self, path))

    def hold_what_is_written(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Let every file that is opened for writing in binary lie on this disk."""
        real = Path.open

        def opened(path: Path, mode: str = "r", *args: Any, **options: Any) -> Any:
            return self.open(path) if mode == "wb" else real(path, mode, *args, **options)

        monkeypatch.setattr(Path, "open", opened)


class _SmallFile(io.FileIO):
    def __init__(self, disk: SmallDisk, path: Path) -> None:
        super().__init__(path, "xb")
        self._disk = disk

    def write(self, data: Any) -> int:
        taken = min(len(data), self._disk.room)
        if taken == 0 and len(data):
            raise OSError(errno.ENOSPC, "No space left on device")
        self._disk.room -= taken
        return super().write(data[:taken])


def passes_official_reader(path: Path) -> int:
    """Number of messages by the official reader with all checks; raises when it objects."""
    with path.open("rb") as stream:
        return len(list(make_reader(stream, validate_crcs=True).iter_messages()))
