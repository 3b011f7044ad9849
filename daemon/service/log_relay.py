"""Program log into the recording."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable

from daemon.recording.topics import LogLine


class LogRelay(logging.Handler):
    """Hands every log line to `write`, which may be called from any thread."""

    def __init__(self, write: Callable[[LogLine], None]) -> None:
        super().__init__()
        self._write = write

    def emit(self, record: logging.LogRecord) -> None:
        """Relay one line."""
        self._write(LogLine(time.monotonic_ns(), record.levelno, record.name, record.getMessage()))
