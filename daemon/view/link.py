"""How the page's connection to the daemon is: up, silent or down, since when and why."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from daemon.service.live_client import SILENT_S, Line, LiveLink, Reason, Silent

Word = Literal["up", "silent", "down"]


@dataclass(frozen=True)
class LinkState:
    """Since when (monotonic), and if it is down, why."""

    word: Word
    since_s: float
    why: Reason | Literal["starting", ""] = ""


class DaemonLink:
    """Follows the daemon for ever; told: each line, and each change of the state."""

    def __init__(
        self,
        path: Path,
        on_line: Callable[[Line], object],
        on_state: Callable[[LinkState], object],
        silent_s: float = SILENT_S,
    ) -> None:
        self._link = LiveLink(path, silent_s=silent_s, is_patient=True)
        self._on_line = on_line
        self._on_state = on_state
        self.state = LinkState("down", time.monotonic(), "starting")

    @property
    def damaged(self) -> int:
        """Lines that could not be read, and were left out."""
        return self._link.damaged

    async def run(self) -> None:
        """Until cancelled."""
        async for told in self._link.follow():
            if isinstance(told, Line):
                self._become(LinkState("up", time.monotonic()))
                self._on_line(told)
            elif isinstance(told, Silent):
                self._become(LinkState("silent", told.since_s))
            else:
                self._become(LinkState("down", time.monotonic(), told.reason))

    def _become(self, state: LinkState) -> None:
        was = self.state
        if (was.word, was.why) == (state.word, state.why):
            return
        # Trying again and failing otherwise does not make the daemon gone anew.
        since_s = was.since_s if was.word == state.word else state.since_s
        self.state = LinkState(state.word, since_s, state.why)
        self._on_state(self.state)
