"""Walking through the bytes of an MCAP file that may be cut, damaged or hostile (MCAP specification 0).

Nothing here trusts a length: records and chunks beyond a limit are damage, and after damage the walk goes on
at the next bytes that look like a chunk of ours.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from typing import BinaryIO, NamedTuple

import zstandard

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX = range(1, 8)
ATTACHMENT, METADATA, DATA_END = 0x09, 0x0C, 0x0F

RECORD = struct.Struct("<BQ")  # opcode, length of the body
MAX_CHUNK_BYTES = 64 * 1024 * 1024  # uncompressed; ours have 64 KiB
_MAX_RECORD_BYTES = MAX_CHUNK_BYTES + 4096

_CHUNK_HEAD = struct.Struct("<QQQII")  # first and last log time, size, CRC, length of the compression's name
_SIZE = struct.Struct("<Q")
_FOOTER = struct.Struct("<BQQQI")  # opcode, length, summary start, offset section start, CRC
_ZSTD_NAME = struct.pack("<I4s", 4, b"zstd")
# The name of the compression stands this far behind the start of its chunk record.
_NAME_OFFSET = RECORD.size + _CHUNK_HEAD.size - 4
_SEARCH_BYTES = 1024 * 1024


class ChunkDamage(Exception):
    """A chunk cannot be opened; the text says what is wrong with it."""


class DamageLog:
    """Counts what is wrong with a file by kind, so that a thousand faults are still a few sentences."""

    def __init__(self) -> None:
        self._kinds: dict[str, tuple[int, int]] = {}

    def add(self, what: str, offset: int) -> None:
        """Count one `what`, seen at byte `offset`."""
        count, first = self._kinds.get(what, (0, offset))
        self._kinds[what] = count + 1, first

    def sentences(self) -> list[str]:
        """One sentence per kind of damage, in the order they were met."""
        return [
            f"{what} at byte {first}" if count == 1 else f"{what}: {count} times, first at byte {first}"
            for what, (count, first) in self._kinds.items()
        ]


class RawRecord(NamedTuple):
    """One record of the file: its kind, where it starts, and its body."""

    opcode: int
    offset: int
    body: bytes


def walk(stream: BinaryIO, size: int, damage: DamageLog) -> Iterator[RawRecord]:
    """Records of the data section in file order, behind the magic, up to and including DATA_END.

    What cannot be a record is skipped up to the next chunk and noted in `damage`.
    """
    at = len(MAGIC)
    while at < size:
        record = _read_record(stream, at, size, damage)
        if record is None:
            at = _next_chunk(stream, at + 1, size)
            continue
        yield record
        if record.opcode == DATA_END:
            return
        at += RECORD.size + len(record.body)


def _read_record(stream: BinaryIO, at: int, size: int, damage: DamageLog) -> RawRecord | None:
    stream.seek(at)
    head = stream.read(RECORD.size)
    if len(head) < RECORD.size:
        damage.add("incomplete record", at)
        return None
    opcode, length = RECORD.unpack(head)
    if not HEADER <= opcode <= DATA_END or length > _MAX_RECORD_BYTES:
        damage.add("unreadable record", at)
        return None
    if at + RECORD.size + length > size:
        damage.add("incomplete record", at)
        return None
    body = stream.read(length)
    if (opcode == CHUNK and not _is_chunk(body, length)) or (opcode == DATA_END and length != 4):
        damage.add("unreadable record", at)
        return None
    return RawRecord(opcode, at, body)


def _is_chunk(body: bytes, length: int) -> bool:
    """The lengths inside a chunk record agree with `length`; `body` needs to hold no more than its head."""
    if len(body) < _CHUNK_HEAD.size:
        return False
    data_at = _CHUNK_HEAD.size + _CHUNK_HEAD.unpack_from(body)[4] + _SIZE.size
    return data_at <= len(body) and _SIZE.unpack_from(body, data_at - _SIZE.size) == (length - data_at,)


def _next_chunk(stream: BinaryIO, at: int, size: int) -> int:
    """Offset of the next complete zstd chunk at or behind `at`, or `size`."""
    while at < size:
        stream.seek(at)
        window = stream.read(_SEARCH_BYTES + _NAME_OFFSET + len(_ZSTD_NAME) + _SIZE.size)
        found = window.find(_ZSTD_NAME, _NAME_OFFSET)
        while found >= 0:
            start = found - _NAME_OFFSET
            opcode, length = RECORD.unpack_from(window, start)
            complete = length <= min(size - at - start - RECORD.size, _MAX_RECORD_BYTES)
            # The lengths must agree here already: a hostile file could make every second byte a candidate.
            if opcode == CHUNK and complete and _is_chunk(window[start + RECORD.size : found + 16], length):
                return at + start
            found = window.find(_ZSTD_NAME, found + 1)
        at += _SEARCH_BYTES
    return size


def open_chunk(body: bytes) -> bytes:
    """Uncompressed, checked records of a chunk whose lengths agree; raises `ChunkDamage`."""
    _, _, size, crc, name_length = _CHUNK_HEAD.unpack_from(body)
    name = body[_CHUNK_HEAD.size : _CHUNK_HEAD.size + name_length]
    data = body[_CHUNK_HEAD.size + name_length + _SIZE.size :]
    if size > MAX_CHUNK_BYTES:
        raise ChunkDamage("chunk of absurd size skipped")
    if name == b"zstd":
        data = _decompress(data, size)
    elif name:
        raise ChunkDamage("chunk with an unknown compression skipped")
    if len(data) != size or (crc and zlib.crc32(data) != crc):
        raise ChunkDamage("damaged chunk skipped")
    return data


def _decompress(data: bytes, size: int) -> bytes:
    try:
        # The library allocates what the frame itself claims: look at the claim first.
        claimed = zstandard.frame_content_size(data)
        if claimed not in (size, -1):
            raise ChunkDamage("damaged chunk skipped")
        return zstandard.ZstdDecompressor().decompress(data, max_output_size=size)
    except zstandard.ZstdError as error:
        raise ChunkDamage("damaged chunk skipped") from error


def has_index(stream: BinaryIO, size: int) -> bool:
    """The file ends with an intact summary and footer, so every MCAP tool can open it."""
    tail = _FOOTER.size + len(MAGIC)
    if size < len(MAGIC) + tail:
        return False
    stream.seek(size - tail)
    footer = stream.read(_FOOTER.size)
    opcode, length, summary, _, crc = _FOOTER.unpack(footer)
    if opcode != FOOTER or length != _FOOTER.size - RECORD.size or stream.read(len(MAGIC)) != MAGIC:
        return False
    if not summary or not crc:
        return True
    if not len(MAGIC) <= summary <= size - tail or size - tail - summary > _MAX_RECORD_BYTES:
        return False
    stream.seek(summary)
    computed = zlib.crc32(stream.read(size - tail - summary))
    return bool(zlib.crc32(footer[:-4], computed) == crc)
