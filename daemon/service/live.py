"""The Unix socket that viewers read: one JSON object a line, pushed; nothing is read from a viewer.

A viewer gets `hello` with the last moves and events, then `status` once a second, `estimate` ten times a second, and
every `move` and `event`: docs/live.md.
One that reads too slowly loses its oldest lines, is told how many, and disturbs nobody else.
"""

from __future__ import annotations

import asyncio
import json
import os
import stat
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

LINES_PER_VIEWER = 200
VIEWERS = 16
WRITE_BUFFER_BYTES = 64 * 1024


class _Viewer:
    def __init__(self, writer: asyncio.StreamWriter) -> None:
        self._writer = writer
        writer.transport.set_write_buffer_limits(high=WRITE_BUFFER_BYTES)
        self._lines: deque[bytes] = deque(maxlen=LINES_PER_VIEWER)
        self._wake = asyncio.Event()
        self.dropped = 0

    def push(self, line: bytes) -> None:
        self.dropped += len(self._lines) == LINES_PER_VIEWER
        self._lines.append(line)
        self._wake.set()

    async def serve(self) -> None:
        """Send until cancelled or the viewer has gone."""
        told = 0
        with suppress(OSError):
            while True:
                await self._wake.wait()
                self._wake.clear()
                while self._lines:
                    if self.dropped != told:
                        told = self.dropped
                        self._writer.write(_line("dropped", {"lines": told}))
                    self._writer.write(self._lines.popleft())
                    await self._writer.drain()

    def hang_up(self) -> None:
        self._writer.transport.abort()  # `close` would wait for a viewer that does not read


def _line(kind: str, content: dict[str, Any]) -> bytes:
    return json.dumps({"type": kind} | content, allow_nan=False, separators=(",", ":")).encode() + b"\n"


class LiveServer:
    """Serves the socket; `push` never waits."""

    def __init__(self, path: Path, hello: Callable[[], dict[str, Any]]) -> None:
        self._path = path
        self._hello = hello
        self._viewers: set[_Viewer] = set()
        self._server: asyncio.Server | None = None
        self._dropped_before = 0
        self.refused = 0

    @property
    def viewers(self) -> int:
        """How many are connected."""
        return len(self._viewers)

    @property
    def dropped(self) -> int:
        """Lines that slow viewers lost."""
        return self._dropped_before + sum(viewer.dropped for viewer in self._viewers)

    async def start(self) -> None:
        """Listen. Raises OSError with one sentence: no socket can be there, or another daemon listens on it."""
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            await self._remove_stale()
            self._server = await asyncio.start_unix_server(self._welcome, self._path)
            self._path.chmod(0o660)
        except OSError as error:
            reason = error.strerror or error
            raise OSError(f"cannot serve viewers on {self._path} ({reason}): correct service.socket") from error

    async def close(self) -> None:
        """Hang up on everybody and remove the socket."""
        if self._server is None:
            return
        self._server.close()
        for viewer in list(self._viewers):
            viewer.hang_up()
        while self._viewers:  # their tasks must not outlive the loop
            await asyncio.sleep(0)
        with suppress(OSError):
            self._path.unlink()

    def push(self, kind: str, content: dict[str, Any]) -> None:
        """Give one line to every viewer."""
        if self._viewers:
            line = _line(kind, content)
            for viewer in self._viewers:
                viewer.push(line)

    async def _remove_stale(self) -> None:
        """A socket that nobody answers is left over from a killed daemon."""
        try:
            is_socket = stat.S_ISSOCK(os.stat(self._path).st_mode)
        except FileNotFoundError:
            return
        if not is_socket:
            raise OSError("it exists and is no socket")
        try:
            _, writer = await asyncio.open_unix_connection(self._path)
        except ConnectionRefusedError:
            self._path.unlink()
            return
        writer.close()
        raise OSError("another daemon already serves it")

    async def _welcome(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if len(self._viewers) >= VIEWERS:
            self.refused += 1
            writer.write(_line("refused", {"viewers": VIEWERS}))
            writer.close()
            return
        viewer = _Viewer(writer)
        viewer.push(_line("hello", self._hello()))
        self._viewers.add(viewer)
        sending = asyncio.ensure_future(viewer.serve())
        try:
            # A viewer has nothing to say; what it says anyway is thrown away, and its end is noticed here.
            while await reader.read(4096):
                pass
        except OSError:
            pass
        finally:
            sending.cancel()
            self._viewers.discard(viewer)
            self._dropped_before += viewer.dropped
            writer.close()
