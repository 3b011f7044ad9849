"""Reading recordings: whole, cut short, damaged, or still being written."""

from __future__ import annotations

import os
import struct
from collections import Counter
from collections.abc import Collection, Generator, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import BinaryIO

from daemon.recording import scan
from daemon.recording.contents import Contents
from daemon.recording.errors import RecordingError, failed
from daemon.recording.scan import ChunkDamage, DamageLog, RawRecord
from daemon.recording.topics import UNDECODABLE, Recorded
from daemon.recording.writer import Channel

_MESSAGE = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log time, publish time
_SHORTEST_MESSAGE = _MESSAGE.size - scan.RECORD.size
_INDEX_HEAD, _INDEX_ENTRY_BYTES = struct.Struct("<HI"), 16
_SEQUENCE_MASK = 0xFFFF_FFFF

_Located = tuple[int, int, int, bytes, int]  # channel, sequence, t_ns, payload, offset of the chunk


class Recording:
    """One recording on disk.

    complete: the file has its index, so that every MCAP tool can open it.
    counts: messages per topic that `messages` has given so far.
    share_read: of the file's bytes, how much `messages` or `raw_messages` has gone through, 0 to 1.
    lost: messages known to be missing, by sequence numbers and by the index behind a damaged chunk; grows
        while messages are read.
    Raises `RecordingError` when the file cannot be read or is no recording of this program.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.counts: Counter[str] = Counter()
        self.lost = 0
        self._damage = DamageLog()
        self._contents = Contents()
        with self._open() as (stream, size):
            self.complete = scan.has_index(stream, size)
        self.share_read = 0.0
        with closing(self._walk()) as walk:
            next(walk, None)  # all that describes the file stands before its first message
        self.share_read = 0.0
        if not self._contents.is_ours:
            raise RecordingError(self._why_not_ours())

    @property
    def metadata(self) -> dict[str, str]:
        """Description of the file, see `metadata.describe`; empty when it was damaged."""
        return self._contents.metadata

    @property
    def attachments(self) -> dict[str, bytes]:
        """State of the program at the first message, by name (`SNAPSHOT`, `LEARNED`)."""
        return self._contents.attachments

    @property
    def damage(self) -> list[str]:
        """What is wrong with the file, as sentences; all of it once the messages have been read."""
        sentences = self._damage.sentences()
        if not self.metadata:
            sentences.append("the description at the head of the file is missing")
        if not self.complete:
            sentences.append("the index at the end is missing: the file was cut, damaged, or not yet finished")
        return sentences

    def messages(self, topics: Collection[str] | None = None) -> Iterator[tuple[str, Recorded]]:
        """Topic and record of every readable message in file order, the order in which they were recorded.

        topics: only these. What cannot be read is skipped and named in `damage`.
        """
        counts = self.counts = Counter()
        channels = self._contents.channels
        for number, _, _, payload, offset in self._walk():
            channel, decode = channels[number]
            topic = channel.topic
            if topics is not None and topic not in topics:
                continue
            if decode is None:
                self._damage.add(f"message on {topic} in a layout that this version cannot read", offset)
                continue
            try:
                record = decode(payload)
            except UNDECODABLE:
                self._damage.add(f"message on {topic} with impossible content", offset)
                continue
            counts[topic] += 1
            yield topic, record

    def raw_messages(self) -> Iterator[tuple[Channel, int, int, bytes]]:
        """Channel, sequence number, t_ns and encoded bytes of every readable message in file order."""
        for number, sequence, t_ns, payload, _ in self._walk():
            yield self._contents.channels[number].channel, sequence, t_ns, payload

    @contextmanager
    def _open(self) -> Iterator[tuple[BinaryIO, int]]:
        try:
            stream = self.path.open("rb")
        except FileNotFoundError as error:
            raise RecordingError(f"{self.path} does not exist: check the path") from error
        except IsADirectoryError as error:
            raise RecordingError(f"{self.path} is a folder: name one recording (.mcap) in it") from error
        except OSError as error:
            raise failed("read", self.path, error) from error
        with stream:
            # The size now: what a running recorder appends while we read belongs to the next reading.
            size = os.fstat(stream.fileno()).st_size
            if size == 0:
                raise RecordingError(f"{self.path} is empty: nothing was recorded, it can be deleted")
            magic = stream.read(len(scan.MAGIC))
            if magic != scan.MAGIC[: len(magic)]:
                raise RecordingError(
                    f"{self.path} is not an MCAP file: name a recording, or turn a CSV file into one with "
                    "`ramstroke import`"
                )
            yield stream, size

    def _why_not_ours(self) -> str:
        if self._contents.library is None or self._contents.is_our_library:
            return f"{self.path} ends before its first message: there is nothing to read, it can be deleted"
        return (
            f"{self.path} comes from another program ({self._contents.library}): only recordings made by "
            "ramstroke can be read"
        )

    def _walk(self) -> Generator[_Located, None, None]:
        """Every message of a known channel."""
        self.lost = 0
        damage = self._damage = DamageLog()
        gaps = _Gaps()
        behind_damage = False
        with self._open() as (stream, size):
            try:
                for record in scan.walk(stream, size, damage):
                    self.share_read = record.offset / size
                    if record.opcode == scan.CHUNK:
                        try:
                            data = scan.open_chunk(record.body)
                        except ChunkDamage as fault:
                            damage.add(str(fault), record.offset)
                            behind_damage = True
                            continue
                        behind_damage = False
                    elif record.opcode == scan.MESSAGE:
                        data = scan.RECORD.pack(record.opcode, len(record.body)) + record.body
                    else:
                        if record.opcode == scan.MESSAGE_INDEX and behind_damage:
                            gaps.expect(record.body)
                        self._contents.describe(record, damage)
                        continue
                    yield from self._messages_in(data, record.offset, gaps)
                    self.lost = gaps.lost
            except OSError as error:
                damage.add(f"the disk cannot read on: {error.strerror or error}; unreadable", stream.tell())
        self.lost = gaps.total()
        self.share_read = 1.0

    def _messages_in(self, data: bytes, offset: int, gaps: _Gaps) -> Iterator[_Located]:
        """Messages among the records `data` of a chunk at `offset`."""
        channels, following = self._contents.channels, gaps.following
        at, end = 0, len(data)
        while at < end:
            if data[at] == scan.MESSAGE and end - at >= _MESSAGE.size:
                _, length, number, sequence, t_ns, _ = _MESSAGE.unpack_from(data, at)
                stop = at + scan.RECORD.size + length
                if length < _SHORTEST_MESSAGE or stop > end:
                    break
                if sequence != following.get(number):
                    gaps.jump(number, sequence)
                following[number] = (sequence + 1) & _SEQUENCE_MASK
                if number in channels:
                    yield number, sequence, t_ns, data[at + _MESSAGE.size : stop], offset
                else:
                    self._damage.add("message of an unknown channel", offset)
            else:
                if end - at < scan.RECORD.size:
                    break
                opcode, length = scan.RECORD.unpack_from(data, at)
                stop = at + scan.RECORD.size + length
                if opcode == scan.MESSAGE or stop > end:
                    break
                record = RawRecord(opcode, offset, data[at + scan.RECORD.size : stop])
                self._contents.describe(record, self._damage)
            at = stop
        if at < end:
            self._damage.add("chunk with broken records", offset)


class _Gaps:
    """Counts missing messages per channel from sequence numbers, and from indexes behind damaged chunks."""

    def __init__(self) -> None:
        self.lost = 0
        self.following: dict[int, int] = {}  # sequence number that should come next
        self._indexed: Counter[int] = Counter()  # in damaged chunks since the channel's last readable message

    def expect(self, index: bytes) -> None:
        """A message index tells what the damaged chunk before it held."""
        if len(index) >= _INDEX_HEAD.size:
            number, length = _INDEX_HEAD.unpack_from(index)
            self._indexed[number] += min(length, len(index)) // _INDEX_ENTRY_BYTES

    def jump(self, number: int, sequence: int) -> None:
        """A message of the channel came with another sequence number than the one that follows."""
        indexed = self._indexed.pop(number, 0)
        following = self.following.get(number)
        missing = 0 if following is None else (sequence - following) & _SEQUENCE_MASK
        # A jump back is no gap (files put together by other tools).
        self.lost += max(indexed, missing if missing <= _SEQUENCE_MASK // 2 else 0)

    def total(self) -> int:
        """All missing messages, those of damaged chunks at the end included."""
        return self.lost + sum(self._indexed.values())
