"""The connection to the daemon: made again and again, watched for silence."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncIterator, Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.2, 3.0
SILENT_S = 3.0  # without a line; the daemon writes eleven a second
LONGEST_LINE = 1 << 20


class _NotTheDaemonError(Exception):
    """What answers speaks another language."""


class _FullError(Exception):
    """The daemon serves as many viewers as it can."""


@dataclass(frozen=True)
class LinkState:
    """How the connection is: `up`, `silent` or `down`, since when (monotonic), and why, as a word."""

    word: str
    since_s: float
    why: str = ""


class DaemonLink:
    """Reads the socket for ever; told: each line as it came and as an object, and each change of the state."""

    def __init__(
        self,
        path: Path,
        on_line: Callable[[str, dict[str, Any]], object],
        on_state: Callable[[LinkState], object],
        silent_s: float = SILENT_S,
    ) -> None:
        self._path = path
        self._on_line = on_line
        self._on_state = on_state
        self._silent_s = silent_s
        self.state = LinkState("down", time.monotonic(), "starting")

    async def run(self) -> None:
        """Until cancelled."""
        pause_s = FIRST_PAUSE_S
        while True:
            met = False
            try:
                async for line in self._lines():
                    met = True
                    self._become("up")
                    self._on_line(*line)
                why = "ended"
            except PermissionError:
                why = "permission"
            except (FileNotFoundError, ConnectionRefusedError):
                why = "absent"
            except _NotTheDaemonError:
                why = "foreign"
            except _FullError:
                why = "full"
            except OSError:
                why = "ended"
            self._become("down", why)
            pause_s = FIRST_PAUSE_S if met else min(2 * pause_s, LONGEST_PAUSE_S)
            await asyncio.sleep(pause_s)

    async def _lines(self) -> AsyncIterator[tuple[str, dict[str, Any]]]:
        reader, writer = await asyncio.open_unix_connection(self._path, limit=LONGEST_LINE)
        try:
            while raw := await self._next(reader):
                line = _parsed(raw)
                if line["type"] == "refused":
                    raise _FullError
                yield raw.decode().rstrip("\n"), line
        finally:
            writer.close()
            with suppress(OSError):
                await writer.wait_closed()

    async def _next(self, reader: asyncio.StreamReader) -> bytes:
        """The next line; meanwhile tells that the daemon is silent if it is."""
        waiting = asyncio.ensure_future(reader.readline())
        try:
            done, _ = await asyncio.wait({waiting}, timeout=self._silent_s)
            if not done:
                self._become("silent", since_s=time.monotonic() - self._silent_s)
            return await waiting
        except ValueError as error:  # longer than any line of ours
            raise _NotTheDaemonError from error
        finally:
            waiting.cancel()

    def _become(self, word: str, why: str = "", since_s: float | None = None) -> None:
        if (self.state.word, self.state.why) != (word, why):
            if word == self.state.word:  # trying again and failing otherwise does not make the daemon gone anew
                since_s = self.state.since_s
            self.state = LinkState(word, time.monotonic() if since_s is None else since_s, why)
            self._on_state(self.state)


def _parsed(raw: bytes) -> dict[str, Any]:
    try:
        line = json.loads(raw, parse_constant=_refuse)
    except ValueError as error:
        raise _NotTheDaemonError from error
    if not isinstance(line, dict) or not isinstance(line.get("type"), str):
        raise _NotTheDaemonError
    if not all(isinstance(line.get(name, []), list) for name in ("moves", "events")):
        raise _NotTheDaemonError
    return line


def _refuse(constant: str) -> None:
    """NaN and infinity are no JSON; no browser takes them."""
    raise ValueError(constant)
