"""What a file says about itself: description, attachments and channels, taken from untrusted bytes."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from dataclasses import replace
from io import BytesIO
from typing import NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.records import Attachment, Header, Metadata
from mcap.records import Channel as ChannelRecord
from mcap.records import Schema as SchemaRecord

from daemon.recording import scan
from daemon.recording.cdr import fields
from daemon.recording.metadata import METADATA_NAME
from daemon.recording.scan import DamageLog, RawRecord
from daemon.recording.topics import TOPICS, Recorded
from daemon.recording.writer import OWN_CHANNELS, Channel

# Limits against hostile files; ours stay far below.
_MAX_RECORD_BYTES = 1024 * 1024
_MAX_SCHEMAS = _MAX_CHANNELS = 256
_MAX_TOPIC = 256  # characters
_MAX_ATTACHED_BYTES = 32 * 1024 * 1024

_CRC = struct.Struct("<I")
_UNPARSABLE = (McapError, ValueError, OverflowError, struct.error)


class KnownChannel(NamedTuple):
    """A channel of the file; `decode` is None when this version does not know its topic in that layout."""

    channel: Channel
    decode: Callable[[bytes], Recorded] | None


class Contents:
    """The descriptive records of a file as they are met."""

    def __init__(self) -> None:
        self.library: str | None = None  # program that wrote the file, None before the header was read
        self.metadata: dict[str, str] = {}
        self.attachments: dict[str, bytes] = {}
        self.channels: dict[int, KnownChannel] = {}
        self._schemas: dict[int, SchemaRecord] = {}

    @property
    def is_our_library(self) -> bool:
        """The header names this program."""
        return self.library is not None and self.library.startswith(METADATA_NAME)

    @property
    def is_ours(self) -> bool:
        """Some of the file can be understood, whoever wrote (or repaired) it."""
        return bool(self.metadata) or any(known.decode for known in self.channels.values())

    def describe(self, record: RawRecord, damage: DamageLog) -> None:
        """Take in one record; records that describe nothing are ignored, unreadable ones noted."""
        take = _TAKERS.get(record.opcode)
        if take is None:
            return
        if len(record.body) > (_MAX_ATTACHED_BYTES if record.opcode == scan.ATTACHMENT else _MAX_RECORD_BYTES):
            damage.add("description of absurd size skipped", record.offset)
            return
        try:
            take(self, record.body)
        except _UNPARSABLE:
            damage.add("damaged description skipped", record.offset)

    def _take_header(self, body: bytes) -> None:
        self.library = Header.read(ReadDataStream(BytesIO(body))).library

    def _take_metadata(self, body: bytes) -> None:
        record = Metadata.read(ReadDataStream(BytesIO(body)))
        if record.name == METADATA_NAME and not self.metadata:
            self.metadata = record.metadata

    def _take_attachment(self, body: bytes) -> None:
        record = Attachment.read(ReadDataStream(BytesIO(body)))
        (crc,) = _CRC.unpack(body[-_CRC.size :])
        if crc and crc != zlib.crc32(body[: -_CRC.size]):
            raise ValueError("checksum")
        attached = sum(map(len, self.attachments.values())) + len(record.data)
        if record.name not in self.attachments and attached <= _MAX_ATTACHED_BYTES:
            self.attachments[record.name] = record.data

    def _take_schema(self, body: bytes) -> None:
        record = SchemaRecord.read(ReadDataStream(BytesIO(body)))
        if record.id in self._schemas or len(self._schemas) < _MAX_SCHEMAS:
            self._schemas[record.id] = record

    def _take_channel(self, body: bytes) -> None:
        """The last word counts: the channels in a chunk are under its checksum, those before it are not."""
        record = ChannelRecord.read(ReadDataStream(BytesIO(body)))
        schema = self._schemas.get(record.schema_id)
        is_one_too_many = record.id not in self.channels and len(self.channels) >= _MAX_CHANNELS
        if schema is None or is_one_too_many or len(record.topic) > _MAX_TOPIC:
            raise ValueError("not a channel we could have written")
        channel = Channel(record.topic, record.message_encoding, schema.name, schema.encoding, schema.data)
        own = OWN_CHANNELS.get(record.topic)
        decode = TOPICS[record.topic].decode if own is not None and _is_readable(channel, own) else None
        self.channels[record.id] = KnownChannel(channel, decode)


def _is_readable(channel: Channel, own: Channel) -> bool:
    """The same fields; constants and comments may be those of another version."""
    theirs, ours = (replace(c, schema_text=b"") for c in (channel, own))
    return theirs == ours and fields(channel.schema_text.decode(errors="replace")) == fields(own.schema_text.decode())


_TAKERS: dict[int, Callable[[Contents, bytes], None]] = {
    scan.HEADER: Contents._take_header,
    scan.METADATA: Contents._take_metadata,
    scan.ATTACHMENT: Contents._take_attachment,
    scan.SCHEMA: Contents._take_schema,
    scan.CHANNEL: Contents._take_channel,
}
