"""Writing one MCAP file: a container on an open stream, and the plain writer of the offline commands."""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Self

from mcap.data_stream import RecordBuilder
from mcap.records import Channel as ChannelRecord
from mcap.records import Schema as SchemaRecord
from mcap.writer import CompressionType, Writer

from daemon.recording.errors import failed
from daemon.recording.metadata import METADATA_NAME, program_version
from daemon.recording.topics import TOPICS, Recorded

PROFILE = "ros2"
MESSAGE_ENCODING, SCHEMA_ENCODING = "cdr", "ros2msg"
# Small chunks cost 1 % of size and bound what a torn or damaged chunk takes with it.
_CHUNK_BYTES = 64 * 1024
_SEQUENCE_MASK = 0xFFFF_FFFF


@dataclass(slots=True, frozen=True)
class Channel:
    """A topic as a file describes it."""

    topic: str
    encoding: str
    schema_name: str
    schema_encoding: str
    schema_text: bytes


OWN_CHANNELS = {
    topic: Channel(topic, MESSAGE_ENCODING, row.layout.name, SCHEMA_ENCODING, row.layout.text.encode())
    for topic, row in TOPICS.items()
}


class Container:
    """An MCAP file on a buffered stream that the caller opens and closes.

    Starts with metadata, attachments and channels; every method raises `OSError` as the stream does.
    """

    def __init__(self, stream: BinaryIO, metadata: Mapping[str, str], attachments: Mapping[str, bytes]) -> None:
        self._stream = stream
        self._writer = Writer(stream, chunk_size=_CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._schemas: dict[tuple[str, bytes], int] = {}
        self._writer.start(profile=PROFILE, library=f"ramstroke {program_version()}")
        if metadata:
            self._writer.add_metadata(METADATA_NAME, dict(metadata))
        for name, data in attachments.items():
            self._writer.add_attachment(0, 0, name, "application/json", data)

    def add_channel(self, channel: Channel) -> int:
        """Announce a topic; returns the number its messages carry.

        The announcement goes to the stream at once and again into the chunk: a file whose first chunk is
        damaged still says what its later messages are. (MCAP allows identical repetitions.)
        """
        name, text = channel.schema_name, channel.schema_text
        built = RecordBuilder()
        schema = self._schemas.get((name, text))
        if schema is None:
            schema = self._writer.register_schema(name, channel.schema_encoding, text)
            self._schemas[name, text] = schema
            SchemaRecord(id=schema, data=text, encoding=channel.schema_encoding, name=name).write(built)
        number = self._writer.register_channel(channel.topic, channel.encoding, schema)
        ChannelRecord(
            id=number, topic=channel.topic, message_encoding=channel.encoding, metadata={}, schema_id=schema
        ).write(built)
        self._stream.write(built.end())
        return number

    def add(self, channel: int, t_ns: int, sequence: int, payload: bytes) -> None:
        """Append one message."""
        self._writer.add_message(channel, t_ns, payload, t_ns, sequence & _SEQUENCE_MASK)

    def flush(self) -> None:
        """Close the chunk and hand all to the kernel: a killed program loses nothing from before."""
        self._writer.flush()

    def size(self) -> int:
        """Bytes written so far, without the open chunk."""
        return self._stream.tell()

    def finish(self) -> None:
        """Write index and footer and hand all to the kernel."""
        self._writer.finish()
        self._stream.flush()


class RecordingWriter:
    """Writes one recording to a given path, whole or not at all; for imports, replays, demos and repairs.

    A context manager. The data goes to a temporary file beside `path`, which replaces `path` (and an older
    file there) on leaving, and is removed when the block ends with an exception, Ctrl-C included.
    Raises `RecordingError` when the disk refuses.
    """

    def __init__(self, path: Path, metadata: Mapping[str, str], attachments: Mapping[str, bytes] | None = None) -> None:
        self._path = path
        self._part = path.with_name(f".{path.name}.part-{os.getpid()}")
        self._metadata = metadata
        self._attachments = attachments or {}
        self._numbers: dict[Channel, int] = {}
        self._sequences = dict.fromkeys(TOPICS, 0)

    def __enter__(self) -> Self:
        try:
            self._stream = self._part.open("wb")
            self._container = Container(self._stream, self._metadata, self._attachments)
            self._numbers = {channel: self._container.add_channel(channel) for channel in OWN_CHANNELS.values()}
        except BaseException as error:
            self._discard()
            if isinstance(error, OSError):
                raise failed("write", self._path, error) from error
            raise
        return self

    def write(self, topic: str, record: Recorded) -> None:
        """Append `record` to `topic`; raises `ValueError` or `struct.error` when a value does not fit."""
        row = TOPICS[topic]
        sequence = self._sequences[topic]
        self._sequences[topic] = sequence + 1
        self.write_raw(OWN_CHANNELS[topic], row.time_ns(record), sequence, row.encode(record))

    def write_raw(self, channel: Channel, t_ns: int, sequence: int, payload: bytes) -> None:
        """Append an encoded message of any channel."""
        try:
            number = self._numbers.get(channel)
            if number is None:
                number = self._numbers[channel] = self._container.add_channel(channel)
            self._container.add(number, t_ns, sequence, payload)
        except OSError as error:
            raise failed("write", self._path, error) from error

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is not None:
            self._discard()
            return
        try:
            self._container.finish()
            os.fdatasync(self._stream.fileno())
            self._stream.close()
            self._part.replace(self._path)
        except BaseException as problem:
            self._discard()
            if isinstance(problem, OSError):
                raise failed("write", self._path, problem) from problem
            raise

    def _discard(self) -> None:
        with suppress(OSError, AttributeError):  # there is none if it could not be opened
            self._stream.close()
        with suppress(OSError):
            self._part.unlink()
