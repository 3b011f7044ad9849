"""What the daemon has told so far, as the live view shows it."""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass, field
from math import isfinite, nan
from typing import Any, Literal

from daemon.service.health import UNDETERMINED_SHARE
from daemon.service.live_client import SILENT_S, Gone, Line, Silent

PARTS = ("imu", "jy901", "can", "displacement", "estimator", "recorder", "loop")
HISTORY_S = 600.0

LinkState = Literal["waiting", "live", "silent", "gone"]


@dataclass(slots=True, frozen=True)
class Stroke:
    """The present estimate."""

    t_s: float
    displacement_mm: float
    sigma_mm: float
    velocity_mm_s: float
    segment: str
    can_state: str
    move: int


@dataclass(slots=True, frozen=True)
class Part:
    """How one part is, and since when (wall clock)."""

    name: str
    state: str
    since: float
    what: str
    advice: str


@dataclass(slots=True, frozen=True)
class Moved:
    """A finished move; times by the wall clock."""

    kind: str
    onset: float
    stop: float
    start_mm: float
    end_mm: float
    sigma_mm: float
    velocity_mm_s: float
    can_state: str


@dataclass(slots=True, frozen=True)
class Happened:
    """An event, at a time by the wall clock."""

    at: float
    what: str


@dataclass(slots=True)
class Scene:
    """Grows with each line.

    damaged: lines that were no lines of a daemon, though they were JSON. lost: lines that this viewer was too slow for.
    """

    version: str = ""
    stroke_mm: float = 500.0
    stroke: Stroke | None = None
    parts: tuple[Part, ...] = ()
    moves: deque[Moved] = field(default_factory=lambda: deque(maxlen=20))
    events: deque[Happened] = field(default_factory=lambda: deque(maxlen=50))
    history: deque[tuple[float, float]] = field(default_factory=deque)
    gone: str | None = None
    heard: float | None = None  # wall clock of the last line
    damaged: int = 0
    lost: int = 0
    _heard_s: float | None = None  # the same by a clock that nobody sets
    _wall_minus_t: float = 0.0

    def take(self, told: Line | Silent | Gone) -> None:
        """One line, or that nobody is there."""
        if isinstance(told, Silent):
            return
        if isinstance(told, Gone):
            self.gone = told.why
            return
        self.gone, self.heard, self._heard_s = None, time.time(), time.monotonic()
        try:
            self._take(told.kind, told.content)
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError):
            self.damaged += 1

    def link(self) -> LinkState:
        """How the connection is now."""
        if self.gone is not None:
            return "gone"
        if self._heard_s is None:
            return "waiting"
        return "live" if self.silent_s() <= SILENT_S else "silent"

    def silent_s(self) -> float:
        """Since the last line."""
        return 0.0 if self._heard_s is None else time.monotonic() - self._heard_s

    @property
    def is_undetermined(self) -> bool:
        """The stroke may be anything."""
        return self.stroke is not None and self.stroke.sigma_mm >= UNDETERMINED_SHARE * self.stroke_mm

    def _take(self, kind: str, content: dict[str, Any]) -> None:
        if kind == "hello":
            self.version, self.stroke_mm = _text(content["version"]), _positive(content["stroke_mm"])
            self.lost = 0
        if kind in ("hello", "status"):
            self._wall_minus_t = time.time() - _number(content["t_s"])
            self.parts = tuple(self._part(name, content[name]) for name in PARTS if name in content)
            if content["estimate"] is not None:
                self._take_estimate(content["estimate"])
            if kind == "hello":
                self._take_what_was(content)
        elif kind == "estimate":
            self._take_estimate(content)
        elif kind == "move":
            self.moves.append(self._moved(content))
        elif kind == "event":
            self.events.append(self._happened(content))
        elif kind == "dropped":
            self.lost = int(_number(content["lines"]))

    def _take_what_was(self, content: dict[str, Any]) -> None:
        self.moves.clear()
        self.moves.extend(self._moved(row) for row in content["moves"])
        self.events.clear()
        self.events.extend(self._happened(row) for row in content["events"])

    def _take_estimate(self, row: dict[str, Any]) -> None:
        self.stroke = Stroke(
            _number(row["t_s"]),
            _number(row["displacement_mm"]),
            _number(row["sigma_mm"]),
            _number(row["velocity_mm_s"]),
            _text(row["segment"]),
            _text(row["can_state"]),
            int(_number(row["move"])),
        )
        t_s = self.stroke.t_s
        if self.history and t_s < self.history[-1][0]:
            self.history.clear()  # the computer was started anew
        if not self.is_undetermined:
            self.history.append((t_s, self.stroke.displacement_mm))
        while self.history and self.history[0][0] < t_s - HISTORY_S:
            self.history.popleft()

    def _part(self, name: str, row: dict[str, Any]) -> Part:
        return Part(name, _text(row["state"]), self._wall(row["since_s"]), _text(row["what"]), _text(row["advice"]))

    def _happened(self, row: dict[str, Any]) -> Happened:
        return Happened(self._wall(row["t_s"]), _text(row["what"]))

    def _moved(self, row: dict[str, Any]) -> Moved:
        return Moved(
            _text(row["kind"]),
            self._wall(row["onset_s"]),
            self._wall(row["stop_s"]),
            _known(row["start_mm"]),
            _known(row["end_mm"]),
            _known(row["sigma_mm"]),
            _known(row["velocity_mm_s"]),
            _text(row["can_state"]),
        )

    def _wall(self, t_s: object) -> float:
        return _number(t_s) + self._wall_minus_t


def _known(value: object) -> float:
    """Of a move that was not seen whole some numbers are not known: NaN."""
    return nan if value is None else _number(value)


def _number(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value) or abs(value) > 1e12:
        raise ValueError(f"{value!r} is no number")
    return float(value)


def _positive(value: object) -> float:
    number = _number(value)
    if number <= 0:
        raise ValueError(f"{value!r} is not positive")
    return number


def _text(value: object) -> str:
    """Without anything that would command the terminal."""
    if not isinstance(value, str):
        raise TypeError(f"{value!r} is no text")
    return "".join(character if character.isprintable() else "?" for character in value)
