"""Who still makes progress: systemd's watchdog is fed only while every part that should does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

PATIENCE_S = 4.0  # without progress; systemd then waits WatchdogSec more before it acts
USUAL_LIMIT_S = 10.0  # WatchdogSec of the shipped unit


@dataclass(slots=True)
class _Part:
    progress: Callable[[], int]
    expected: Callable[[], bool]
    count: int = -1
    since_s: float = 0.0


@dataclass(slots=True)
class Watchdog:
    """Counts of work done, one for each part.

    A part whose device is ill still makes progress: it tries again, and counts that. Only one that hangs does not;
    one that is slow, such as a port whose transfers time out, stands still and goes on before systemd acts.
    """

    parts: dict[str, _Part] = field(default_factory=dict)

    def watch(
        self,
        name: str,
        progress: Callable[[], int],
        *,
        expected: Callable[[], bool] = lambda: True,
    ) -> None:
        """Expect `progress()` to move while `expected()`."""
        self.parts[name] = _Part(progress, expected)

    def laggards(self, now_s: float) -> dict[str, float]:
        """The parts that stand still, and for how long [s]; look once a second."""
        standing: dict[str, float] = {}
        for name, part in self.parts.items():
            count = part.progress()
            if count != part.count or not part.expected():
                part.count, part.since_s = count, now_s
            elif now_s - part.since_s >= PATIENCE_S:
                standing[name] = now_s - part.since_s
        return standing


def hanging(standing: dict[str, float], limit_s: float | None) -> dict[str, str]:
    """The laggards that have used up half of systemd's patience, and what that leads to, in words.

    Args:
        standing: of `Watchdog.laggards`.
        limit_s: systemd's WatchdogSec; None: it does not wait for signs of life.
    """
    told_s = PATIENCE_S + (limit_s or USUAL_LIMIT_S) / 2
    follows = "no watchdog starts the program anew"
    if limit_s is not None and standing:
        left_s = max(PATIENCE_S + limit_s - max(standing.values()), 0.0)
        follows = f"unless it goes on, systemd starts the program anew in {left_s:.0f} s"
    return {
        name: f"{name} has stood still for {seconds:.0f} s: {follows}"
        for name, seconds in standing.items()
        if seconds >= told_s
    }
