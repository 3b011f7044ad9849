"""The data-ready line of the virtual ADIS16448 as a listener sees it."""

from __future__ import annotations

from typing import Protocol

from drivers.adis16448.registers import INVALID_NS
from drivers.clock import Clock
from drivers.data_ready import Edge
from estimation.records import TimeKind


class EdgeSource(Protocol):
    """What the line needs of the part."""

    clock: Clock

    @property
    def is_high_when_valid(self) -> bool:
        """Polarity of the line."""

    def edge_state(self, pin: int, now_ns: int, until_ns: int) -> tuple[int, int, int | None]:
        """Valid edges of `pin` so far, time of the newest, and of the next one if it comes by `until_ns`."""


class VirtualDataReady:
    """A DataReady on the part's clock: simulated time jumps to the next edge, real time is slept through."""

    def __init__(self, part: EdgeSource, pin: int, *, active_high: bool) -> None:
        self._part = part
        self._pin = pin
        self._active_high = active_high
        now_ns = part.clock.now_ns()
        self._seen = part.edge_state(pin, now_ns, now_ns)[0]

    def wait(self, timeout_s: float) -> Edge | None:
        """The newest edge not yet seen, else the next one; None after `timeout_s` without."""
        clock = self._part.clock
        now_ns = clock.now_ns()
        deadline_ns = now_ns + round(timeout_s * 1e9)
        while True:
            # With the wrong polarity the listener takes the start of the invalid phase for its end.
            lead_ns = 0 if self._part.is_high_when_valid == self._active_high else INVALID_NS
            count, newest_ns, next_ns = self._part.edge_state(self._pin, now_ns, deadline_ns + lead_ns)
            if next_ns is not None and next_ns - lead_ns <= now_ns:
                count, newest_ns = count + 1, next_ns
            if count > self._seen:
                missed, self._seen = count - self._seen - 1, count
                return Edge(newest_ns - lead_ns, TimeKind.EDGE, missed)
            if now_ns >= deadline_ns:
                return None
            wake_ns = deadline_ns if next_ns is None else min(deadline_ns, next_ns - lead_ns)
            clock.sleep((wake_ns - now_ns) / 1e9)
            now_ns = clock.now_ns()

    def close(self) -> None:
        """Nothing to release."""
