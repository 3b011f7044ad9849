"""Real and simulated time behind one face, so that a simulated minute need not last one."""

from __future__ import annotations

import time
from typing import Protocol


class Clock(Protocol):
    """Monotonic time of one run."""

    def now_ns(self) -> int:
        """Monotonic time [ns]."""

    def sleep(self, seconds: float) -> None:
        """Let `seconds` pass."""


class SystemClock:
    """The host's CLOCK_MONOTONIC, the clock of the kernel's data-ready stamps."""

    def now_ns(self) -> int:
        """Monotonic time [ns]."""
        return time.monotonic_ns()

    def sleep(self, seconds: float) -> None:
        """Sleep for `seconds`."""
        time.sleep(seconds)


class VirtualClock:
    """Simulated time: passes only when somebody sleeps, and then at once."""

    def __init__(self, start_ns: int = 0) -> None:
        self._now_ns = start_ns

    def now_ns(self) -> int:
        """Simulated time [ns]."""
        return self._now_ns

    def sleep(self, seconds: float) -> None:
        """Advance the simulated time by `seconds`."""
        self._now_ns += round(seconds * 1e9)

    def advance_to(self, t_ns: int) -> None:
        """Advance to `t_ns`; time never goes back."""
        self._now_ns = max(self._now_ns, t_ns)
