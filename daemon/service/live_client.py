"""Reading the daemon's Unix socket: its greeting, or its lines for as long as one wants them."""

from __future__ import annotations

import asyncio
import json
import socket
from collections.abc import AsyncIterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from daemon.errors import CommandError

TIMEOUT_S = 5.0
RETRY_S = 1.0
LONGEST_LINE = 1_000_000  # bytes; ours have some thousand


class NoDaemonError(CommandError):
    """No daemon serves this viewer; the text is one sentence."""


class ForbiddenError(NoDaemonError):
    """The socket is not for this user; waiting does not help."""


@dataclass(slots=True, frozen=True)
class Line:
    """One line of the daemon: an object with a word for its `type`."""

    content: dict[str, Any]
    raw: bytes

    @property
    def kind(self) -> str:
        """`hello`, `status`, `estimate`, `move`, `event` or `dropped`."""
        return str(self.content["type"])


@dataclass(slots=True, frozen=True)
class Gone:
    """Nobody is connected from here on, until the next line; why, and what to do."""

    why: str


class LiveLink:
    """A viewer's link to the daemon; connects anew by itself, for ever.

    damaged: lines that could not be read, and were left out.
    """

    def __init__(self, path: Path, retry_s: float = RETRY_S) -> None:
        self._path = path
        self._retry_s = retry_s
        self.damaged = 0

    async def follow(self) -> AsyncIterator[Line | Gone]:
        """Every line, the greeting first, and a `Gone` whenever nobody is there, for another reason than before.

        Raises ForbiddenError if the first attempt shows that this user may not.
        """
        told: str | None = None
        while True:
            try:
                async for line in self._lines():
                    told = ""
                    yield line
                why = f"the daemon on {self._path} has ended"
            except NoDaemonError as error:
                if isinstance(error, ForbiddenError) and told is None:
                    raise
                why = str(error)
            if why != told:
                told = why
                yield Gone(why)
            await asyncio.sleep(self._retry_s)

    async def _lines(self) -> AsyncIterator[Line]:
        """The lines of one connection, up to its end. Raises NoDaemonError if it is none or none of a daemon."""
        try:
            reader, writer = await asyncio.open_unix_connection(self._path, limit=LONGEST_LINE)
        except OSError as error:
            raise _refusal(self._path, error) from error
        try:
            greeting = await _read_greeting(reader, self._path)
            yield greeting
            while True:
                try:
                    raw = await reader.readline()
                except ValueError:  # longer than any of ours
                    self.damaged += 1
                    continue
                if not raw:
                    return
                line = _parsed(raw)
                if line is None:
                    self.damaged += 1
                else:
                    yield line
        except OSError:
            return  # the connection broke: the same as its end
        finally:
            writer.close()
            with suppress(OSError):
                await writer.wait_closed()


async def _read_greeting(reader: asyncio.StreamReader, path: Path) -> Line:
    try:
        raw = await asyncio.wait_for(reader.readline(), TIMEOUT_S)
    except TimeoutError as error:
        raise NoDaemonError(f"what answers on {path} says nothing") from error
    except (OSError, ValueError) as error:
        raise NoDaemonError(f"what answers on {path} is no ramstroke daemon") from error
    return _greeting(raw, path)


def first_line(path: Path) -> dict[str, Any]:
    """The greeting of the daemon, which holds its whole status. Raises NoDaemonError."""
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as channel:
            channel.settimeout(TIMEOUT_S)
            channel.connect(str(path))
            with channel.makefile("rb") as lines:
                raw = lines.readline(LONGEST_LINE)
    except OSError as error:
        raise _refusal(path, error) from error
    return _greeting(raw, path).content


def _refusal(path: Path, error: OSError) -> NoDaemonError:
    if isinstance(error, PermissionError):
        return ForbiddenError(
            f"you may not read {path}: join the group ramstroke (`sudo usermod -aG ramstroke $USER`) and log in again"
        )
    return NoDaemonError(
        f"no daemon answers on {path} ({error.strerror or error}): start `ramstroke run`, "
        "or name its configuration with --config"
    )


def _greeting(raw: bytes, path: Path) -> Line:
    line = _parsed(raw)
    if line is not None and line.kind == "refused":
        raise NoDaemonError(f"the daemon on {path} serves as many viewers as it can: close one of them")
    if line is None or line.kind != "hello":
        raise NoDaemonError(f"what answers on {path} is no ramstroke daemon")
    return line


def _parsed(raw: bytes) -> Line | None:
    try:
        content = json.loads(raw)
    except (ValueError, RecursionError):
        return None
    return Line(content, raw) if isinstance(content, dict) and isinstance(content.get("type"), str) else None
