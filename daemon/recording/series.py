"""The files of a running recorder, one after the other: cutting, tidying, and going on after disk errors.

Everything here runs in the writer thread and may wait for the disk.
"""

from __future__ import annotations

import errno
import logging
import os
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from daemon.recording import retention
from daemon.recording.metadata import Preamble
from daemon.recording.settings import RecorderSettings
from daemon.recording.writer import OWN_CHANNELS, Container
from drivers.clock import Clock

_log = logging.getLogger(__name__)

_RETRY_NS = 1_000_000_000  # a full disk is asked again this often
_MB = 1_000_000
_MINUTE_NS = 60_000_000_000


@dataclass(slots=True)
class RecorderCounters:
    """What the recorder did so far, for health; every number is written by one thread only."""

    file: str = ""  # being written, empty while there is none
    messages: int = 0  # handed to the kernel
    bytes: int = 0  # handed to the kernel, compressed
    dropped_queue_full: int = 0  # the disk was too slow
    dropped_no_disk: int = 0  # the disk was full, read-only or failed
    refused: int = 0  # a value did not fit its schema
    files: int = 0  # begun
    deleted_files: int = 0  # by the budget
    errors: int = 0  # refused writes, deletions, new files
    sync_errors: int = 0  # a power cut would take what was not synced
    last_error: str = ""

    @property
    def dropped(self) -> int:
        """Messages that are in no file."""
        return self.dropped_queue_full + self.dropped_no_disk + self.refused


def open_new(path: Path) -> BinaryIO:
    """Create `path` for writing; raises `FileExistsError` rather than overwrite.

    Buffered on purpose: the MCAP writer wraps an unbuffered file in a buffer of its own that nobody flushes.
    """
    return path.open("xb")


class FileSeries:
    """Writes messages to the current file and says when it wants the next one.

    sync: told the descriptor of a file whose data should reach the disk; must not wait.
    wants_file: the caller should provide a `Preamble` by `begin` (first file, rotation, or after an error).
    """

    def __init__(
        self,
        settings: RecorderSettings,
        clock: Clock,
        sync: Callable[[int], None],
        *,
        open_file: Callable[[Path], BinaryIO] = open_new,
        free_bytes: Callable[[Path], int] = retention.free_bytes,
    ) -> None:
        self.counters = RecorderCounters()
        self.wants_file = False
        self._settings = settings
        self._clock = clock
        self._sync = sync
        self._open_file = open_file
        self._free_bytes = free_bytes
        self._path: Path | None = None
        self._stream: BinaryIO
        self._container: Container
        self._pending = 0  # messages since the last flush
        self._flushed_messages = 0  # messages of this file that the kernel has
        self._flushed_bytes = 0
        self._retry_ns = 0
        self._sync_ns = 0
        self._rotate_ns = 0
        self._read_only: OSError | None = None  # a sync has found that
        self._said = ""  # the last complaint, so that a full disk is not reported every second

    def begin(self, preamble: Preamble) -> None:
        """Finish the current file and start the next one; on failure none is open and counters say why."""
        self.close()
        self.wants_file = False
        now_ns = self._clock.now_ns()
        try:
            self._settings.directory.mkdir(parents=True, exist_ok=True)
            if not self._has_room():
                return
            self._open(preamble)
        except OSError as error:
            self._fail(error)
            return
        self.counters.files += 1
        self._rotate_ns = now_ns + round(self._settings.rotate_minutes * _MINUTE_NS)
        self._sync_ns = now_ns + self._settings.sync_interval_ms * 1_000_000
        if self._said:
            _log.warning("recording again: %s; %d messages were lost", self._path, self.counters.dropped)
            self._said = ""

    def add(self, channel: int, t_ns: int, sequence: int, payload: bytes) -> None:
        """Append a message, or count it as lost while there is no file."""
        if self._path is None:
            self.counters.dropped_no_disk += 1
            return
        self._pending += 1
        try:
            self._container.add(channel, t_ns, sequence, payload)
        except OSError as error:
            self._fail(error)

    def sync_failed(self, error: OSError) -> None:
        """Called from any thread. A disk that turned read-only takes writes all the same; only this tells."""
        self.counters.sync_errors += 1
        self.counters.last_error = f"fdatasync: {error.strerror or error}"
        if error.errno == errno.EROFS:
            self._read_only = error

    def flush(self) -> None:
        """Hand everything to the kernel; now and then sync, tidy up, and see whether a new file is due."""
        now_ns = self._clock.now_ns()
        error, self._read_only = self._read_only, None
        if error is not None and self._path is not None:
            self._fail(error)
        if self._path is None:
            self.wants_file = now_ns >= self._retry_ns
            return
        try:
            self._container.flush()
            self._account()
            if now_ns >= self._sync_ns:
                self._sync_ns = now_ns + self._settings.sync_interval_ms * 1_000_000
                self._sync(self._stream.fileno())
                if not self._has_room():
                    self.close()
                    return
        except OSError as error:
            self._fail(error)
            return
        self.wants_file = self._flushed_bytes >= self._settings.rotate_mb * _MB or now_ns >= self._rotate_ns

    def close(self) -> None:
        """Write the index of the current file, if any, and close it."""
        if self._path is None:
            return
        try:
            self._container.flush()
            self._account()
            self._container.finish()
            self._sync(self._stream.fileno())
            self._stream.close()
        except OSError as error:
            self._fail(error)
        self._forget()

    def _open(self, preamble: Preamble) -> None:
        for name in retention.names(time.time_ns()):
            path = self._settings.directory / name
            try:
                self._stream = self._open_file(path)
            except FileExistsError:
                continue
            break
        self._path, self.counters.file = path, str(path)
        self._flushed_messages = self._flushed_bytes = 0
        self._container = Container(self._stream, preamble.metadata, preamble.attachments)
        for channel in OWN_CHANNELS.values():
            self._container.add_channel(channel)
        self._container.flush()
        self._account()
        # A power cut must not take the new file's name.
        directory = os.open(self._settings.directory, os.O_RDONLY)
        try:
            self._sync(directory)
        finally:
            os.close(directory)

    def _account(self) -> None:
        size = self._container.size()
        self.counters.messages += self._pending
        self.counters.bytes += size - self._flushed_bytes
        self._flushed_messages += self._pending
        self._flushed_bytes = size
        self._pending = 0

    def _has_room(self) -> bool:
        directory, keep_free = self._settings.directory, self._settings.keep_free_mb * _MB
        budget = self._settings.budget_mb * _MB
        if self._path is not None and not self._path.exists():
            raise FileNotFoundError(errno.ENOENT, f"{self._path} was deleted while being written")
        try:
            deleted = retention.make_room(directory, budget, keep_free, self._path, self._free_bytes)
        except OSError as error:  # one file that cannot be deleted is no reason to stop recording
            self.counters.errors += 1
            self.counters.last_error = f"cannot delete old recordings in {directory}: {error.strerror or error}"
            deleted = []
        self.counters.deleted_files += len(deleted)
        for path in deleted:
            _log.info("deleted the oldest recording %s to keep within the disk budget", path)
        if self._free_bytes(directory) >= keep_free:
            return True
        self._stop(
            f"less than keep_free_mb = {self._settings.keep_free_mb:g} MB free on the disk of {directory}: "
            "free some space"
        )
        return False

    def _fail(self, error: OSError) -> None:
        """The disk refused: cut the file back to what surely is in it, count the rest, try again later."""
        self.counters.errors += 1
        self._stop(f"cannot write to {self._settings.directory}: {error.strerror or error}")
        if self._path is None:
            return
        self.counters.dropped_no_disk += self._pending
        with suppress(OSError):
            self._stream.close()
        with suppress(OSError):
            if self._flushed_messages:
                os.truncate(self._path, self._flushed_bytes)
            else:
                self._path.unlink()
        self._forget()

    def _stop(self, reason: str) -> None:
        self.counters.last_error = reason
        self._retry_ns = self._clock.now_ns() + _RETRY_NS
        if reason != self._said:
            _log.error("recording stopped: %s", reason)
            self._said = reason

    def _forget(self) -> None:
        self._path, self.counters.file = None, ""
        self._pending = 0
