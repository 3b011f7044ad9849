"""The state of every part as people see it: a word, since when, what is wrong, what to do, and what was counted."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from typing import Any

from daemon.recording.recorder import Recorder
from daemon.service.loop_watch import Lateness
from drivers.condition import OFF, OK, Condition, Wellness
from estimation.records import CanState, Estimate

# The same part is not logged more often than this; a loose plug would fill the journal.
LOG_EVERY_S = 10.0
START_UP_S = 3.0  # until then every part may be waiting, without a word in the log
TOLD_S = 10.0  # after a loss
SLOW_DISK_MESSAGES = 4000  # some two seconds of them
LATE_S = 0.1  # an event loop later than this is worth a word
# Just below 1/√12, the sigma of a stroke that may be anything between the stops.
UNDETERMINED_SHARE = 0.28

_ORDER = (Wellness.OFF, Wellness.OK, Wellness.ILL, Wellness.WAITING)

_log = logging.getLogger(__name__)


@dataclass(slots=True)
class _Entry:
    condition: Condition
    since_s: float
    met_s: float
    logged: Condition = OK
    logged_s: float = float("-inf")
    untold: int = 0  # changes since the last line


@dataclass(slots=True)
class HealthBook:
    """Remembers since when each part is as it is, and logs the changes, not too often."""

    entries: dict[str, _Entry] = field(default_factory=dict)
    is_ending: bool = False  # the program closes its parts on purpose: nothing to tell

    def note(self, part: str, condition: Condition, now_s: float) -> dict[str, Any]:
        """Take in how a part is now; returns the row for the health record."""
        entry = self.entries.get(part)
        if entry is None:
            entry = self.entries[part] = _Entry(condition, now_s, now_s)
        elif kind_of(entry.condition) != kind_of(condition):
            entry.since_s, entry.untold = now_s, entry.untold + 1
        entry.condition = condition
        self._tell(part, entry, now_s)
        return {
            "state": str(condition.word),
            "since_s": round(entry.since_s, 3),
            "what": condition.what,
            "advice": condition.advice,
        }

    def worst(self) -> Wellness:
        """The state of the worst part."""
        return max((e.condition.word for e in self.entries.values()), key=_ORDER.index, default=Wellness.OK)

    def _tell(self, part: str, entry: _Entry, now_s: float) -> None:
        if kind_of(entry.condition) == kind_of(entry.logged) or now_s - entry.logged_s < LOG_EVERY_S or self.is_ending:
            return
        condition = entry.condition
        since_s = max(entry.logged_s, entry.met_s)
        flapping = f" ({entry.untold} changes in the last {now_s - since_s:.0f} s)" if entry.untold > 1 else ""
        if condition.word is Wellness.WAITING and now_s - entry.met_s < START_UP_S:
            return
        if condition.what:
            _log.warning("%s: %s; %s%s", part, condition.what, condition.advice, flapping)
        elif entry.logged_s > float("-inf"):
            _log.info("%s: well again%s", part, flapping)
        entry.logged, entry.logged_s, entry.untold = condition, now_s, 0


def kind_of(condition: Condition) -> tuple[Wellness, str]:
    """A condition without the numbers in its sentence: their change is no change of the state."""
    return condition.word, "".join(c for c in condition.what if not c.isdigit() and c != ".")


def displacement_condition(state: CanState | None, source: Condition) -> Condition:
    """How the displacement sensor is: what its frames say (`source`), else what the estimator makes of its values."""
    if source.word is not Wellness.OK or state is None:
        return source
    return _BY_STATE.get(state, OK)


def _ill(what: str, advice: str) -> Condition:
    return Condition(Wellness.ILL, what, advice)


_BY_STATE = {
    CanState.ABSENT: Condition(
        Wellness.WAITING, "no displacement has come yet", "check that the controller is on and sends the frame"
    ),
    CanState.SILENT: Condition(
        Wellness.WAITING,
        "the displacement has fallen silent",
        "check the CAN cable and that the controller is switched on",
    ),
    CanState.STUCK: _ill(
        "the displacement stands still although the ram moves", "check the magnet and the sensor's cable at the ram"
    ),
    CanState.OUT_OF_RANGE: _ill(
        "the displacement is outside the stroke", "check the sensor, and [support] stroke_mm and the frame's layout"
    ),
    CanState.INVALID: _ill("the controller marks the displacement as invalid", "check the sensor at the ram"),
    CanState.BIASED: _ill(
        "the displacement does not fit the motion that is felt", "drive to a stop and compare; check the sensor's rod"
    ),
}


def estimate_condition(last: Estimate | None, stroke_m: float) -> Condition:
    """Whether the stroke is known."""
    if last is None:
        return Condition(Wellness.WAITING, "no estimate yet", "wait for the sensors")
    if last.sigma_m >= UNDETERMINED_SHARE * stroke_m:
        return _ill("the stroke is undetermined", "drive to a mechanical stop, or get the displacement sensor to work")
    return OK


class RecorderHealth:
    """Whether everything reaches the disk."""

    def __init__(self, recorder: Recorder, enabled: bool) -> None:
        self._recorder = recorder
        self._enabled = enabled
        self._lost = 0
        self._lost_s = float("-inf")

    def condition(self, now_s: float) -> Condition:
        """How it is now; a loss is told for some seconds."""
        if not self._enabled:
            return OFF
        counters = self._recorder.counters
        if not counters.file:
            return Condition(
                Wellness.WAITING,
                f"nothing is recorded: {counters.last_error or 'no file yet'}",
                "check [recording] directory, its rights and the free space",
            )
        if counters.dropped != self._lost:
            self._lost, self._lost_s = counters.dropped, now_s
        if now_s - self._lost_s < TOLD_S:
            return _ill(f"{self._lost} messages are not recorded", "check the disk: it is full, failing or too slow")
        if self._recorder.queued > SLOW_DISK_MESSAGES:
            return _ill(
                f"{self._recorder.queued} messages wait for the disk",
                "use a faster disk or card, or see what keeps the computer busy",
            )
        return OK


def loop_condition(worst: Lateness) -> Condition:
    """Whether the program keeps pace."""
    if worst.late_s < LATE_S:
        return OK
    return _ill(
        f"the event loop was {worst.late_s * 1e3:.0f} ms late: {worst.culprit} ({worst.culprit_s * 1e3:.0f} ms)",
        "see what else the computer does",
    )


def status_line(health: dict[str, Any], laggards: dict[str, float]) -> str:
    """Stroke and ailing parts in one line, for `systemctl status`."""
    estimate = health["estimate"]
    words = [
        "no estimate yet"
        if estimate is None
        else f"{estimate['displacement_mm']:.1f} ± {estimate['sigma_mm']:.1f} mm, {estimate['segment']}"
    ]
    for name, part in health.items():
        if isinstance(part, dict) and part.get("what"):
            words.append(f"{name} {part['state']}: {part['what']}")
    words.extend(f"{name} has stood still for {seconds:.0f} s" for name, seconds in laggards.items())
    return "; ".join(words)
