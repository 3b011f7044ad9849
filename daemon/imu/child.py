"""The acquiring process: `python -m daemon.imu.child`, started by the daemon, with which it lives and dies."""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import sys
import threading
from collections import deque

from daemon.imu.messages import Health, LogLine, Orders, receive, send
from daemon.imu.ports import inertial_sensor
from daemon.service.process import settle_process
from daemon.settings import Settings
from drivers.acquisition import Acquisition, Block, Sensor
from drivers.adis16448.identity import Identity
from drivers.clock import SystemClock
from drivers.jy901.identity import Jy901Identity

BUFFER_S = 60.0  # a parent stalled that long loses nothing
HEALTH_S = 0.25
_MOST_LOG_LINES = 1000


class Outbox:
    """What waits to be sent: at most `most_samples`, then the oldest samples go; identities never do."""

    def __init__(self, most_samples: int) -> None:
        self.dropped = 0  # samples
        self._most_samples = most_samples
        self._samples = 0
        self._blocks: deque[Block] = deque()
        self._log_lines: deque[LogLine] = deque(maxlen=_MOST_LOG_LINES)
        self._lock = threading.Lock()
        self._filled = threading.Event()

    def put(self, block: Block) -> None:
        """Add a block; called in the acquisition thread."""
        with self._lock:
            self._blocks.append(block)
            self._samples += len(block)
            while self._samples > self._most_samples and len(self._blocks) > 1:
                oldest = self._blocks.popleft()
                identities: Block = [item for item in oldest if isinstance(item, Identity | Jy901Identity)]
                self._blocks[0] = identities + self._blocks[0]
                self._samples -= len(oldest) - len(identities)
                self.dropped += len(oldest) - len(identities)
        self._filled.set()

    def put_line(self, line: LogLine) -> None:
        """Add a line of the log; the oldest goes if there are too many."""
        self._log_lines.append(line)
        self._filled.set()

    def take(self, timeout_s: float) -> list[Block | LogLine]:
        """All that waits, the log first; waits for something until then."""
        self._filled.wait(timeout_s)
        self._filled.clear()
        with self._lock:
            blocks: list[Block | LogLine] = list(self._blocks)
            self._blocks.clear()
            self._samples = 0
        lines: list[Block | LogLine] = []
        while self._log_lines:
            lines.append(self._log_lines.popleft())
        return lines + blocks


class _Relay(logging.Handler):
    """Lets the parent's log say what this process has to say."""

    def __init__(self, outbox: Outbox) -> None:
        super().__init__()
        self._outbox = outbox
        self.setFormatter(logging.Formatter())  # with the traceback if there is one

    def emit(self, record: logging.LogRecord) -> None:
        self._outbox.put_line(LogLine(record.name, record.levelno, self.format(record)))


def main() -> None:
    """Acquire until the parent closes our standard input, by will or by its end."""
    # Ctrl-C in a terminal and the end of a service reach the whole group; the parent decides.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    orders_in, messages_out = sys.stdin.fileno(), os.dup(sys.stdout.fileno())
    # Nobody's print shall spoil the messages.
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    orders = receive(orders_in)
    if not isinstance(orders, Orders):
        return
    settings = Settings.model_validate_json(orders.settings_json)
    outbox = Outbox(round(BUFFER_S * settings.nominal_rate_hz))
    logging.getLogger().addHandler(_Relay(outbox))
    logging.getLogger().setLevel(logging.INFO)
    support = None
    if settings.needs_support:
        from daemon.simulation.virtual import virtual_support

        support = virtual_support(settings, start_ns=orders.start_ns)
    sensor = inertial_sensor(settings, SystemClock(), support)
    acquisition = Acquisition(sensor, outbox.put, settings.imu.realtime_priority)
    stopping = threading.Event()
    threading.Thread(target=_wait_for_end, args=(orders_in, stopping), name="parent", daemon=True).start()
    settle_process()
    acquisition.start()
    with contextlib.suppress(OSError):  # the parent is gone
        _send_all(messages_out, outbox, sensor, acquisition, stopping)
    acquisition.stop()
    # Without the interpreter's tidying up: threads of the virtual support may be in the middle of something.
    os._exit(0)


def _send_all(out: int, outbox: Outbox, sensor: Sensor, acquisition: Acquisition, stopping: threading.Event) -> None:
    clock, due_ns, told = SystemClock(), 0, (sensor.condition, sensor.identity)
    while not stopping.is_set():
        for message in outbox.take(HEALTH_S):
            send(out, message)
        now = (sensor.condition, sensor.identity)
        if clock.now_ns() >= due_ns or now != told:
            due_ns, told = clock.now_ns() + round(HEALTH_S * 1e9), now
            send(out, _health(outbox, sensor))
    acquisition.stop()
    for message in outbox.take(0.0):
        send(out, message)
    send(out, _health(outbox, sensor))


def _health(outbox: Outbox, sensor: Sensor) -> Health:
    return Health(sensor.condition, sensor.counters, sensor.identity, sensor.notes, sensor.progress, outbox.dropped)


def _wait_for_end(orders_in: int, stopping: threading.Event) -> None:
    """The parent writes nothing more: the next thing to read is its end."""
    os.read(orders_in, 1)
    stopping.set()
    # If sending is stuck (a parent that hangs before it dies), leave all the same.
    threading.Event().wait(2.0)
    os._exit(1)


if __name__ == "__main__":
    main()
