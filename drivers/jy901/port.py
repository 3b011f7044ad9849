"""The serial port of a JY901."""

from __future__ import annotations

import contextlib
import errno
import os
import termios
from typing import Protocol

READ_S = 0.05  # a read waits that long


class PortError(OSError):
    """The serial port cannot be opened or used; the text is one sentence for a person."""


class SerialPort(Protocol):
    """A serial port whose baud rate can be changed. Every call may raise PortError."""

    @property
    def baudrate(self) -> int:
        """The computer's side of it."""

    @baudrate.setter
    def baudrate(self, baud: int) -> None: ...

    def read(self) -> bytes:
        """What has come; waits 0.05 s at most, and not longer than until there is as much as a sample."""

    def write(self, data: bytes) -> None:
        """All of it."""

    def close(self) -> None:
        """Release it."""


class PySerialPort:
    """A port of this computer, by pyserial."""

    _SAMPLE = 22  # bytes

    def __init__(self, path: str) -> None:
        try:
            import serial
        except ImportError:
            raise PortError(f"cannot use {path}: pyserial is missing, install ramstroke[hardware]") from None
        self._path = path
        try:
            self._port = serial.Serial(path, timeout=READ_S, write_timeout=READ_S, exclusive=True)
        except (OSError, ValueError, termios.error) as error:
            raise PortError(f"cannot open the serial port {path}: {_reason(error)}") from error
        # A USB adapter that collects bytes for 16 ms can be told not to; not every driver listens.
        with contextlib.suppress(OSError, ValueError, NotImplementedError, termios.error):
            self._port.set_low_latency_mode(True)

    @property
    def baudrate(self) -> int:
        """The computer's side of it."""
        return int(self._port.baudrate)

    @baudrate.setter
    def baudrate(self, baud: int) -> None:
        try:
            self._port.baudrate = baud
            self._port.reset_input_buffer()
        except (OSError, ValueError, termios.error) as error:
            raise PortError(f"the serial port {self._path} does not take {baud} baud: {_reason(error)}") from error

    def read(self) -> bytes:
        """What has come."""
        try:
            data: bytes = self._port.read(self._SAMPLE)
            # Bytes that lie there have come no later than these: one time stamp serves both.
            more: bytes = self._port.read(self._port.in_waiting) if self._port.in_waiting else b""
        except (OSError, TypeError, termios.error) as error:  # TypeError: closed meanwhile
            raise PortError(f"the serial port {self._path} failed: {_reason(error)}") from error
        return data + more

    def write(self, data: bytes) -> None:
        """All of it."""
        try:
            self._port.write(data)
        except (OSError, termios.error) as error:
            raise PortError(f"cannot write to the serial port {self._path}: {_reason(error)}") from error

    def close(self) -> None:
        """Release it; a port that failed may refuse even that."""
        with contextlib.suppress(OSError, termios.error):
            self._port.close()


def _reason(error: BaseException) -> str:
    number = getattr(error, "errno", None)  # pyserial's errors have it, but no words of their own
    if number == errno.ENOTTY or (isinstance(error, termios.error) and error.args[:1] == (errno.ENOTTY,)):
        return "it is no serial port"
    if "readiness to read" in str(error):
        return "it was pulled out, or another program reads it too"
    return os.strerror(number) if isinstance(number, int) else str(error)
