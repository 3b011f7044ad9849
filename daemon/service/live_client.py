"""Reading the daemon's Unix socket: its greeting, or its lines for as long as one wants them."""

from __future__ import annotations

import asyncio
import json
import socket
import time
from collections.abc import AsyncIterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from daemon.errors import CommandError

TIMEOUT_S = 5.0
RETRY_S = 1.0
SILENT_S = 3.0  # the daemon writes eleven lines a second
LONGEST_LINE = 1_000_000  # bytes; ours have some thousand


Reason = Literal["absent", "ended", "foreign", "full", "permission"]


class NoDaemonError(CommandError):
    """No daemon serves this viewer; the text is one sentence."""

    def __init__(self, text: str, reason: Reason) -> None:
        super().__init__(text)
        self.reason: Reason = reason


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
    """Nobody is connected from here on, until the next line; why, and what to do: as a sentence and as a word."""

    why: str
    reason: Reason


@dataclass(slots=True, frozen=True)
class Silent:
    """The daemon is connected and has said nothing since then (monotonic)."""

    since_s: float


class LiveLink:
    """A viewer's link to the daemon; connects anew by itself, for ever.

    is_patient: goes on trying even where this user may not read. damaged: lines that could not be read, and were left
    out.
    """

    def __init__(
        self, path: Path, retry_s: float = RETRY_S, silent_s: float = SILENT_S, *, is_patient: bool = False
    ) -> None:
        self._path = path
        self._retry_s = retry_s
        self._silent_s = silent_s
        self._is_patient = is_patient
        self.damaged = 0

    async def follow(self) -> AsyncIterator[Line | Silent | Gone]:
        """Every line, the greeting first; a `Gone` whenever nobody is there, for another reason than before; a
        `Silent` each time that nothing has come for so long.

        Raises ForbiddenError if the first attempt shows that this user may not, unless the link is patient.
        """
        told: Gone | None = None
        is_first = True
        while True:
            try:
                async for heard in self._lines():
                    told = None
                    yield heard
                gone = _ended(self._path)
            except NoDaemonError as error:
                if isinstance(error, ForbiddenError) and is_first and not self._is_patient:
                    raise
                gone = Gone(str(error), error.reason)
            is_first = False
            if gone != told:
                told = gone
                yield gone
            await asyncio.sleep(self._retry_s)

    async def _lines(self) -> AsyncIterator[Line | Silent]:
        """The lines of one connection, up to its end. Raises NoDaemonError if it is none or none of a daemon."""
        try:
            reader, writer = await asyncio.open_unix_connection(self._path, limit=LONGEST_LINE)
        except OSError as error:
            raise _refusal(self._path, error) from error
        try:
            greeting = await _read_greeting(reader, self._path)
            yield greeting
            heard_s = time.monotonic()
            while True:
                reading = asyncio.ensure_future(reader.readline())
                try:
                    while not (await asyncio.wait([reading], timeout=self._silent_s))[0]:
                        yield Silent(heard_s)
                    raw = reading.result()
                except ValueError:  # longer than any of ours
                    self.damaged += 1
                    continue
                finally:
                    reading.cancel()
                heard_s = time.monotonic()
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
        raise NoDaemonError(f"what answers on {path} says nothing", "foreign") from error
    except OSError as error:
        raise NoDaemonError(_ended(path).why, "ended") from error
    except ValueError as error:
        raise _foreign(path) from error
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
            f"you may not read {path}: join the group ramstroke (`sudo usermod -aG ramstroke $USER`) and log in again",
            "permission",
        )
    return NoDaemonError(
        f"no daemon answers on {path} ({error.strerror or error}): start `ramstroke run`, "
        "or name its configuration with --config",
        "absent",
    )


def _ended(path: Path) -> Gone:
    return Gone(f"the daemon on {path} has ended", "ended")


def _foreign(path: Path) -> NoDaemonError:
    return NoDaemonError(f"what answers on {path} is no ramstroke daemon", "foreign")


def _greeting(raw: bytes, path: Path) -> Line:
    if not raw:
        raise NoDaemonError(_ended(path).why, "ended")
    line = _parsed(raw)
    if line is not None and line.kind == "refused":
        raise NoDaemonError(f"the daemon on {path} serves as many viewers as it can: close one of them", "full")
    if line is None or line.kind != "hello":
        raise _foreign(path)
    return line


def _parsed(raw: bytes) -> Line | None:
    try:
        content = json.loads(raw, parse_constant=_refuse)
    except (ValueError, RecursionError):
        return None
    if not isinstance(content, dict) or not isinstance(content.get("type"), str):
        return None
    if not all(isinstance(content.get(name, []), list) for name in ("moves", "events")):
        return None
    return Line(content, raw)


def _refuse(constant: str) -> None:
    """NaN and infinity are no JSON; no browser takes them."""
    raise ValueError(constant)
