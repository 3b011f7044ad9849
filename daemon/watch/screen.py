"""A terminal as a sheet of lines: only what has changed is written, which is kind to a slow connection."""

from __future__ import annotations

import os
import termios
import tty
from collections.abc import Sequence
from contextlib import suppress
from typing import Any, TextIO

from rich.console import Console
from rich.text import Text

_ENTER = "\x1b[?1049h\x1b[?25l"  # the other screen; no cursor
_LEAVE = "\x1b[?25h\x1b[?1049l"


class Screen:
    """A context manager: the terminal is as before once it is left, whatever happened."""

    def __init__(self, out: TextIO, keyboard: int | None) -> None:
        self._out = out
        self._keyboard = keyboard
        # Out of rich only the codes for styles: it knows what the terminal can do, and NO_COLOR.
        self._console = Console(file=out, force_terminal=True, highlight=False, legacy_windows=False)
        self._before: list[Any] | None = None
        self._shown: list[Text] = []
        self._size = (0, 0)

    def __enter__(self) -> Screen:
        self.enter()
        return self

    def __exit__(self, *_: object) -> None:
        self.leave()

    def enter(self) -> None:
        """Take the terminal: keys come one by one and unseen; Ctrl-C still interrupts."""
        if self._keyboard is not None:
            self._before = termios.tcgetattr(self._keyboard)
            tty.setcbreak(self._keyboard, termios.TCSADRAIN)
        self._shown = []
        self._write(_ENTER)

    def leave(self) -> None:
        """Give the terminal back."""
        with suppress(OSError):  # it may be gone
            self._write(_LEAVE)
        if self._keyboard is not None and self._before is not None:
            with suppress(termios.error):
                termios.tcsetattr(self._keyboard, termios.TCSADRAIN, self._before)

    def size(self) -> tuple[int, int]:
        """Columns and lines."""
        try:
            columns, lines = os.get_terminal_size(self._out.fileno())
        except OSError:
            columns = lines = 0
        return columns or 80, lines or 24  # some terminals do not tell

    def draw(self, lines: Sequence[Text], size: tuple[int, int]) -> None:
        """Show `lines`, made for `size`, the first at the top."""
        said = []
        if self._size != size or not self._shown:
            self._size, self._shown = size, []
            said.append("\x1b[0m\x1b[2J")
        for row, line in enumerate(lines):
            if row >= len(self._shown) or self._shown[row] != line:
                said.append(f"\x1b[{row + 1};1H{self._styled(line)}\x1b[0m\x1b[K")
        self._shown = list(lines)
        if said:
            self._write("".join(said))

    def _styled(self, line: Text) -> str:
        with self._console.capture() as captured:
            self._console.print(line, end="", soft_wrap=True)
        return captured.get()

    def _write(self, text: str) -> None:
        self._out.write(text)
        self._out.flush()
