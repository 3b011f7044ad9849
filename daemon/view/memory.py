"""What a page that opens now must know: the last greeting, status, estimates, moves and events. All of it bounded."""

from __future__ import annotations

from collections import deque
from typing import Any

ESTIMATES, MOVES, EVENTS = 660, 50, 100  # a minute of estimates, as the plots show


class Memory:
    """Takes the daemon's lines in; `snapshot` is what a browser gets first."""

    def __init__(self) -> None:
        self._greeting: dict[str, Any] | None = None
        self._status: dict[str, Any] | None = None
        self._estimates: deque[dict[str, Any]] = deque(maxlen=ESTIMATES)
        self._moves: deque[dict[str, Any]] = deque(maxlen=MOVES)
        self._events: deque[dict[str, Any]] = deque(maxlen=EVENTS)

    def take(self, line: dict[str, Any]) -> None:
        """One line of the daemon."""
        kind = line.get("type")
        content = {name: value for name, value in line.items() if name != "type"}
        if kind == "hello":
            moves, events = content.pop("moves", []), content.pop("events", [])
            self._greeting = {name: content.get(name) for name in ("version", "stroke_mm")}
            self._status = content
            _join(self._moves, moves)
            _join(self._events, events)
        elif kind == "status":
            self._status = content
        elif kind == "estimate":
            self._estimates.append(content)
        elif kind == "move":
            self._moves.append(content)
        elif kind == "event":
            self._events.append(content)

    def snapshot(self) -> dict[str, Any]:
        """Everything, for a page that knows nothing."""
        return {
            "hello": self._greeting,
            "status": self._status,
            "estimates": list(self._estimates),
            "moves": list(self._moves),
            "events": list(self._events),
        }

    @property
    def recording(self) -> str:
        """Path of the file that the daemon writes, as far as is known."""
        recorder = (self._status or {}).get("recorder")
        return str(recorder.get("file") or "") if isinstance(recorder, dict) else ""


def _join(known: deque[dict[str, Any]], told: list[dict[str, Any]]) -> None:
    """A daemon that was started anew remembers less than we do; one that we lost sight of, more."""
    known.extend(row for row in told if row not in known)
