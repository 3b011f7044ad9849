"""Who still makes progress: systemd's watchdog is fed only while every part that should does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

PATIENCE_S = 4.0  # without progress; systemd then waits WatchdogSec more before it acts


@dataclass(slots=True)
class _Part:
    progress: Callable[[], int]
    expected: Callable[[], bool]
    count: int = -1
    since_s: float = 0.0


@dataclass(slots=True)
class Watchdog:
    """Counts of work done, one for each part.

    A part whose device is ill still makes progress: it tries again, and counts that. Only one that hangs does not.
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
