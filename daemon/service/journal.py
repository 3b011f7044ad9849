"""Log lines as entries of the systemd journal, with fields (systemd.journal-fields(7), native protocol)."""

from __future__ import annotations

import logging
import os
import socket
import struct
import sys

SOCKET = "/run/systemd/journal/socket"
_PRIORITIES = ((logging.CRITICAL, 2), (logging.ERROR, 3), (logging.WARNING, 4), (logging.INFO, 6))
_DEBUG = 7
_LONGEST = 32_000  # bytes of a field; a datagram holds some 200,000


def is_ours() -> bool:
    """Whether standard error goes into the journal (systemd.exec(5), JOURNAL_STREAM)."""
    stream = os.environ.get("JOURNAL_STREAM", "")
    try:
        status = os.fstat(sys.stderr.fileno())
    except (OSError, ValueError):  # closed, or replaced by something without a descriptor
        return False
    return stream == f"{status.st_dev}:{status.st_ino}"


class JournalHandler(logging.Handler):
    """One entry for each line of the log: MESSAGE, PRIORITY, LOGGER, THREAD_NAME, and what the line is about.

    A record's extra `fields` (name -> text) become fields RAMSTROKE_NAME. An entry that the journal does not take goes
    to standard error.
    """

    def __init__(self, address: str = SOCKET) -> None:
        super().__init__()
        self._address = address
        self._channel = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC | socket.SOCK_NONBLOCK)

    def emit(self, record: logging.LogRecord) -> None:
        """Send one entry; a journal that hangs must not hang us."""
        text = self.format(record)
        fields = {
            "MESSAGE": text,
            "PRIORITY": str(next((number for level, number in _PRIORITIES if record.levelno >= level), _DEBUG)),
            "SYSLOG_IDENTIFIER": "ramstroke",
            "LOGGER": record.name,
            "THREAD_NAME": record.threadName or "",
        }
        for name, value in getattr(record, "fields", {}).items():
            fields[f"RAMSTROKE_{name.upper()}"] = str(value)
        try:
            self._channel.sendto(b"".join(_encoded(name, value) for name, value in fields.items()), self._address)
        except OSError:
            print(f"{record.levelname} {record.name}: {text}", file=sys.stderr)

    def close(self) -> None:
        """Give the socket back."""
        self._channel.close()
        super().close()


def _encoded(name: str, value: str) -> bytes:
    data = value.encode(errors="replace")[:_LONGEST]
    if b"\n" in data:
        return name.encode() + b"\n" + struct.pack("<Q", len(data)) + data + b"\n"
    return name.encode() + b"=" + data + b"\n"
