"""A program at a terminal of its own: a pseudo-terminal, and a small terminal that shows what it would look like."""

from __future__ import annotations

import codecs
import fcntl
import os
import pty
import re
import select
import signal
import struct
import subprocess
import termios
import time
import unicodedata
from collections.abc import Mapping, Sequence
from types import TracebackType
from typing import Self

PATIENCE_S = 30.0
_CODE = re.compile(r"\x1b\[(\??)([0-9;]*)([A-Za-z])")


class Sheet:
    """What a terminal shows; knows the codes that full-screen programs need, and fails on any other."""

    def __init__(self, columns: int, lines: int) -> None:
        self.columns, self.lines = columns, lines
        self.modes: set[str] = set()
        self.codes: set[str] = set()  # of styles that were used
        self.row = self.column = 0
        self._rest = ""
        self._is_resizing = False  # what comes may still be meant for the size before
        self._clear()

    def _clear(self) -> None:
        self.cells = [[" "] * self.columns for _ in range(self.lines)]

    def resize(self, columns: int, lines: int) -> None:
        self.columns, self.lines = columns, lines
        self._is_resizing = True
        self._clear()

    def write(self, text: str) -> None:
        text = self._rest + text
        self._rest = ""
        at = 0
        while at < len(text):
            if text[at] == "\x1b":
                found = _CODE.match(text, at)
                if found is None:
                    assert len(text) - at < 20, f"unknown code {text[at : at + 20]!r}"
                    self._rest = text[at:]
                    return
                self._obey(*found.groups())
                at = found.end()
                continue
            self._put(text[at])
            at += 1

    def _put(self, character: str) -> None:
        if character == "\r":
            self.column = 0
        elif character == "\n":
            self.row += 1
        else:
            width = 2 if unicodedata.east_asian_width(character) in "WF" else 1
            is_inside = self.column + width <= self.columns and self.row < self.lines
            assert is_inside or self._is_resizing, f"{character!r} at {self.row}, {self.column} is beyond the edge"
            if not is_inside:
                return
            self.cells[self.row][self.column] = character
            if width == 2:
                self.cells[self.row][self.column + 1] = ""
            self.column += width

    def _obey(self, private: str, numbers: str, letter: str) -> None:
        if private:
            (self.modes.add if letter == "h" else self.modes.discard)(numbers)
        elif letter == "m":
            self.codes.add(numbers)
        elif letter == "H":
            row, column = (int(number) for number in numbers.split(";"))
            self.row, self.column = row - 1, column - 1
        elif letter == "J":
            assert numbers == "2"
            self._is_resizing = False
            self._clear()
        elif letter == "K":
            if self.row < self.lines:
                self.cells[self.row][self.column :] = [" "] * (self.columns - self.column)
        else:
            raise AssertionError(f"unknown code {letter}")

    @property
    def text(self) -> str:
        return "\n".join("".join(row).rstrip() for row in self.cells)


class AtTerminal:
    """A context manager: the program, its keyboard, and its screen."""

    def __init__(
        self,
        command: Sequence[str],
        size: tuple[int, int] = (80, 24),
        environment: Mapping[str, str] | None = None,
    ) -> None:
        self.sheet = Sheet(*size)
        self.raw = b""
        # A signal in the midst of a write may cut a character here; what follows a resize is drawn anew.
        self._decoder = codecs.getincrementaldecoder("utf-8")("replace")
        self._command = command
        self._environment = {
            **{name: value for name, value in os.environ.items() if name not in ("NO_COLOR", "LC_ALL")},
            "TERM": "xterm-256color",
            "LANG": "C.UTF-8",
            **(environment or {}),
        }

    def __enter__(self) -> Self:
        self.master, slave = pty.openpty()
        self._set_size(self.sheet.columns, self.sheet.lines)
        self.before = termios.tcgetattr(self.master)
        self.process = subprocess.Popen(
            self._command,
            stdin=slave,
            stdout=slave,
            stderr=slave,
            env=self._environment,
            start_new_session=True,
            preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),
        )
        os.close(slave)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        os.close(self.master)

    def _set_size(self, columns: int, lines: int) -> None:
        fcntl.ioctl(self.master, termios.TIOCSWINSZ, struct.pack("HHHH", lines, columns, 0, 0))

    def resize(self, columns: int, lines: int) -> None:
        self.read(0.0)
        self.sheet.resize(columns, lines)
        self._set_size(columns, lines)

    def press(self, keys: bytes) -> None:
        os.write(self.master, keys)

    def read(self, seconds: float) -> None:
        """Take in what the program writes during `seconds`."""
        until = time.monotonic() + seconds
        while True:
            ready, _, _ = select.select([self.master], [], [], max(until - time.monotonic(), 0.0))
            if not ready:
                return
            try:
                data = os.read(self.master, 65536)
            except OSError:  # the program has gone
                return
            if not data:
                return
            self.raw += data
            self.sheet.write(self._decoder.decode(data))

    def shows(self, *wanted: str) -> str:
        """The screen, once all of `wanted` are on it."""
        until = time.monotonic() + PATIENCE_S
        while not all(text in self.sheet.text for text in wanted):
            assert time.monotonic() < until, f"{wanted} not on\n{self.sheet.text}"
            assert self.process.poll() is None, f"ended with {wanted} not on\n{self.sheet.text}"
            self.read(0.05)
        return self.sheet.text

    def shows_no(self, unwanted: str) -> str:
        until = time.monotonic() + PATIENCE_S
        while unwanted in self.sheet.text:
            assert time.monotonic() < until, f"{unwanted!r} still on\n{self.sheet.text}"
            self.read(0.05)
        return self.sheet.text

    def ends(self) -> int:
        """Its exit code, once it has ended."""
        until = time.monotonic() + PATIENCE_S
        while self.process.poll() is None:
            assert time.monotonic() < until, f"goes on\n{self.sheet.text}"
            self.read(0.02)
        self.read(0.0)
        return self.process.wait()

    def interrupt(self, number: signal.Signals = signal.SIGINT) -> None:
        self.process.send_signal(number)
