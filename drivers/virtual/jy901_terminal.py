"""The virtual JY901 for another process: a pseudo-terminal that pyserial opens as it opens a real port."""

from __future__ import annotations

import contextlib
import fcntl
import os
import pty
import select
import termios
import threading
import tty
from pathlib import Path
from typing import TextIO

from drivers.clock import Clock
from drivers.jy901.packets import BAUD_CODES
from drivers.jy901.port import PortError
from drivers.virtual.jy901_line import VirtualLine

_SLICE_S = 0.002
_OUTPUT_SPEED = 5  # place in what tcgetattr tells
_SPEEDS = {getattr(termios, f"B{baud}"): baud for baud in BAUD_CODES if hasattr(termios, f"B{baud}")}


class SerialTerminal:
    """Serves one part under the name `path`, a link to the pseudo-terminal, from `start` to `close`.

    Raises PortError if there is something else of that name.
    """

    def __init__(self, path: str, line: VirtualLine, clock: Clock) -> None:
        self.overflowed = 0  # bytes that nobody read in time
        self._path = Path(path)
        self._line = line
        self._clock = clock
        self._ends: tuple[int, int] | None = None
        self._lock: TextIO | None = None  # one server for one name
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="serial terminal", daemon=True)

    def start(self) -> None:
        """Make the terminal and serve it."""
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._lock = open(f"{self._path}.lock", "w")  # noqa: SIM115  held until `close`
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise PortError(f"another `ramstroke sim` serves {self._path}: end it, or name another port") from error
        except OSError as error:
            raise PortError(f"cannot make the serial port {self._path}: {error.strerror}") from error
        self._plug_in()
        self._thread.start()

    def close(self) -> None:
        """End it and take the name away."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join()
        self._pull_out()
        if self._lock is not None:
            self._lock.close()
            Path(self._lock.name).unlink(missing_ok=True)

    def _serve(self) -> None:
        while not self._stopping.is_set():
            now_ns = self._clock.now_ns()
            if self._line.is_gone(now_ns):
                self._pull_out()
                self._line.arrived(now_ns, 9600)
                self._stopping.wait(_SLICE_S)
                continue
            if self._ends is None:
                with contextlib.suppress(PortError):
                    self._plug_in()
            if self._ends is not None:
                self._move_bytes(self._ends[0])

    def _move_bytes(self, master: int) -> None:
        if select.select([master], [], [], _SLICE_S)[0]:
            with contextlib.suppress(OSError):
                self._line.write(os.read(master, 4096), self._clock.now_ns(), self._baud(master))
        data = self._line.arrived(self._clock.now_ns(), self._baud(master))
        while data:
            try:
                data = data[os.write(master, data) :]
            except OSError:  # nobody reads: as on a real line the bytes are gone
                self.overflowed += len(data)
                return

    def _baud(self, master: int) -> int:
        """What the other side has set its port to."""
        return _SPEEDS.get(termios.tcgetattr(master)[_OUTPUT_SPEED], 0)

    def _plug_in(self) -> None:
        if os.path.lexists(self._path) and not self._is_ours():
            raise PortError(f"{self._path} is there already and none of ours: name another port in [jy901]")
        master, slave = pty.openpty()
        tty.setraw(slave)
        os.set_blocking(master, False)
        self._ends = (master, slave)  # our own slave end keeps the terminal alive while nobody else has it open
        try:
            self._path.unlink(missing_ok=True)
            self._path.symlink_to(os.ttyname(slave))
        except OSError as error:
            self._pull_out()
            raise PortError(f"cannot make the serial port {self._path}: {error.strerror}") from error

    def _is_ours(self) -> bool:
        """Whether the name is a link to a pseudo-terminal, left by one that was killed."""
        return self._path.is_symlink() and os.readlink(self._path).startswith("/dev/pts/")

    def _pull_out(self) -> None:
        ends, self._ends = self._ends, None
        if ends is None:
            return
        with contextlib.suppress(OSError):
            if os.readlink(self._path) == os.ttyname(ends[1]):
                self._path.unlink()
        for end in ends:
            os.close(end)
