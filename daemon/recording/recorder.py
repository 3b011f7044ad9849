"""The recorder of the running program: a bounded queue between the event loop and one writer thread."""

from __future__ import annotations

import logging
import struct
import threading
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

from daemon.recording import retention
from daemon.recording.background_sync import BackgroundSync
from daemon.recording.metadata import Preamble
from daemon.recording.series import FileSeries, RecorderCounters, open_new
from daemon.recording.settings import RecorderSettings
from daemon.recording.topics import TOPICS, Recorded
from drivers.clock import Clock, SystemClock

_log = logging.getLogger(__name__)

# Some 20 s of a live support (1700 messages/s, 100 bytes each): longer than any pause of a healthy disk.
MAX_QUEUED_MESSAGES = 32_768
MAX_QUEUED_BYTES = 8_000_000

_CHANNELS = {topic: number for number, topic in enumerate(TOPICS, start=1)}
_Message = tuple[int, int, int, bytes]  # channel, t_ns, sequence, payload


class Recorder:
    """Records whatever `write` is given, in that order, without ever waiting for the disk.

    settings: see `RecorderSettings`.
    provide: returns the head of a file; called by `start`, and by `write` just before the record that opens
        the next file, so its snapshot is the state *before* that record. Write an input, then feed it.
    clock: times rotation, retries and syncs. open_file, free_bytes: the disk.

    A full queue drops the newest message and counts it; its sequence number stays missing in the file.
    """

    def __init__(
        self,
        settings: RecorderSettings,
        provide: Callable[[], Preamble],
        *,
        clock: Clock | None = None,
        open_file: Callable[[Path], BinaryIO] = open_new,
        free_bytes: Callable[[Path], int] = retention.free_bytes,
    ) -> None:
        self._settings = settings
        self._provide = provide
        self._series = FileSeries(
            settings,
            clock or SystemClock(),
            self._request_sync,
            open_file=open_file,
            free_bytes=free_bytes,
        )
        self._queue: deque[_Message | Preamble] = deque()
        self._bytes_in = self._bytes_out = 0  # each written on one side of the queue only
        self._sequences = dict.fromkeys(TOPICS, 0)
        # Messages may come from any thread (log lines do); held for microseconds, never over disk work.
        # Re-entrant: whoever provides a preamble may log, and log lines are recorded.
        self._lock = threading.RLock()
        self._file_ordered = False
        self._accepting = False
        self._stopping = threading.Event()
        self._reported_drops = 0
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._sync: BackgroundSync | None = None

    @property
    def counters(self) -> RecorderCounters:
        """What was written and lost so far."""
        return self._series.counters

    @property
    def queued(self) -> int:
        """Messages that wait for the disk."""
        return len(self._queue)

    @property
    def has_died(self) -> bool:
        """Whether the writing thread ended although it should not."""
        return self._accepting and not self._thread.is_alive()

    def start(self) -> None:
        """Begin the first file; does nothing when the settings say not to record."""
        if not self._settings.enabled:
            return
        self._sync = BackgroundSync(self._series.sync_failed)
        self._order_file()
        self._accepting = True
        self._thread.start()

    def write(self, topic: str, record: Recorded) -> None:
        """Record `record` on `topic`; never waits, never raises for what the disk does."""
        if not self._accepting:
            return
        row = TOPICS[topic]
        counters = self._series.counters
        with self._lock:
            if row.starts_file and self._series.wants_file and not self._file_ordered:
                self._order_file()
            sequence = self._sequences[topic]
            self._sequences[topic] = sequence + 1
            try:
                payload, t_ns = row.encode(record), row.time_ns(record)
                if t_ns < 0:
                    raise ValueError(f"time {t_ns} ns is before the clock's zero")
            except (ValueError, struct.error) as error:
                counters.refused += 1
                counters.last_error = f"{topic}: {error}"
                return
            waiting = self._bytes_in - self._bytes_out
            if len(self._queue) >= MAX_QUEUED_MESSAGES or waiting + len(payload) > MAX_QUEUED_BYTES:
                counters.dropped_queue_full += 1
                return
            self._bytes_in += len(payload)
            self._queue.append((_CHANNELS[topic], t_ns, sequence, payload))

    def close(self, timeout_s: float = 5.0) -> bool:
        """Write what is queued and finish the file; False when the disk did not answer in time."""
        self._accepting = False
        if self._sync is None:
            return True
        self._stopping.set()
        self._thread.join(timeout_s)
        return not self._thread.is_alive() and self._sync.close(timeout_s)

    def _order_file(self) -> None:
        self._file_ordered = True
        self._queue.append(self._provide())

    def _request_sync(self, descriptor: int) -> None:
        if self._sync is not None:
            self._sync.request(descriptor)

    def _run(self) -> None:
        stopping = False
        while not stopping:
            # Sampled before draining: what was written before `close` is drained in the last round.
            stopping = self._stopping.is_set()
            self._drain()
            self._series.flush()
            self._report_drops()
            self._stopping.wait(self._settings.flush_interval_ms / 1000)
        self._series.close()

    def _drain(self) -> None:
        for _ in range(len(self._queue)):
            item = self._queue.popleft()
            if isinstance(item, Preamble):
                self._series.begin(item)
                self._file_ordered = False
            else:
                self._series.add(*item)
                self._bytes_out += len(item[3])

    def _report_drops(self) -> None:
        dropped = self._series.counters.dropped_queue_full
        if dropped != self._reported_drops:
            _log.warning("disk too slow: %d messages not recorded", dropped - self._reported_drops)
            self._reported_drops = dropped
