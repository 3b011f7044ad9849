"""The data-ready line of the virtual ADIS16448 as a listener sees it."""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from drivers.adis16448.registers import INVALID_NS
from drivers.clock import Clock
from drivers.data_ready import Edge
from estimation.records import TimeKind


class Arrival(NamedTuple):
    """An edge at the listener's end of the wire."""

    t_ns: int  # when the listener can hear of it
    stamp_ns: int  # when it happened


class EdgeWire(Protocol):
    """What becomes of an edge on its way."""

    def arrivals(self, edge_ns: int) -> Sequence[Arrival]:
        """None, one or several for one edge; the same at every call, none before the edge."""


@dataclass(slots=True, frozen=True)
class LineState:
    """A line up to now, and what is known of its future."""

    count: int  # edges arrived
    newest_ns: int  # stamp of the newest one
    next: Arrival | None
    known_until_ns: int  # without a next one: none comes before


class EdgeSource(Protocol):
    """What the line needs of the part."""

    clock: Clock

    @property
    def is_high_when_valid(self) -> bool:
        """Polarity of the line."""

    def line_state(self, pin: int, now_ns: int, until_ns: int) -> LineState:
        """The line of `pin` at `now_ns`, with its next edge if that comes by `until_ns`."""


class PinHistory:
    """Counts the edges of one pin, those made and those that arrived."""

    def __init__(self, wire: EdgeWire | None) -> None:
        self.arrived = 0
        self.lost = 0  # on the wire
        self.added = 0
        self._wire = wire
        self._newest_ns = 0
        self._under_way: list[Arrival] = []  # a heap

    def make(self, edges_ns: Sequence[int]) -> None:
        """The part has made these edges."""
        if self._wire is None:
            self.arrived += len(edges_ns)
            self._newest_ns = edges_ns[-1]
            return
        for edge_ns in edges_ns:
            arrivals = self._wire.arrivals(edge_ns)
            self.lost += not arrivals
            self.added += max(0, len(arrivals) - 1)
            for arrival in arrivals:
                heapq.heappush(self._under_way, arrival)

    def pass_time(self, now_ns: int) -> None:
        """Let those arrive that should have by now."""
        while self._under_way and self._under_way[0].t_ns <= now_ns:
            self._newest_ns = heapq.heappop(self._under_way).stamp_ns
            self.arrived += 1

    def state(self, now_ns: int, upcoming_ns: int | None, known_until_ns: int) -> LineState:
        """The line at `now_ns` if the part's next edge, not before `known_until_ns`, is `upcoming_ns`."""
        self.pass_time(now_ns)
        candidates = self._under_way[:1]
        if upcoming_ns is not None:
            direct = [Arrival(upcoming_ns, upcoming_ns)]
            candidates = [*candidates, *(direct if self._wire is None else self._wire.arrivals(upcoming_ns))]
            known_until_ns = upcoming_ns
        return LineState(self.arrived, self._newest_ns, min(candidates, default=None), known_until_ns)


class VirtualDataReady:
    """A DataReady on the part's clock: simulated time jumps to the next edge, real time is slept through."""

    def __init__(self, part: EdgeSource, pin: int, *, active_high: bool) -> None:
        self._part = part
        self._pin = pin
        self._active_high = active_high
        now_ns = part.clock.now_ns()
        self._seen = part.line_state(pin, now_ns, now_ns).count

    def wait(self, timeout_s: float) -> Edge | None:
        """The newest edge not yet seen, else the next one; None after `timeout_s` without."""
        clock = self._part.clock
        now_ns = clock.now_ns()
        deadline_ns = now_ns + round(timeout_s * 1e9)
        while True:
            # With the wrong polarity the listener takes the start of the invalid phase for its end.
            lead_ns = 0 if self._part.is_high_when_valid == self._active_high else INVALID_NS
            state = self._part.line_state(self._pin, now_ns, deadline_ns + lead_ns)
            count, newest_ns, wake_ns = state.count, state.newest_ns, state.known_until_ns
            if state.next is not None:
                early_ns = state.next.t_ns - lead_ns
                if early_ns <= now_ns:
                    count, newest_ns = count + 1, state.next.stamp_ns
                wake_ns = min(wake_ns, early_ns if early_ns > now_ns else state.next.t_ns)
            if count > self._seen:
                missed, self._seen = count - self._seen - 1, count
                return Edge(newest_ns - lead_ns, TimeKind.EDGE, missed)
            if now_ns >= deadline_ns:
                return None
            clock.sleep((min(deadline_ns, wake_ns) - now_ns) / 1e9)
            now_ns = clock.now_ns()

    def close(self) -> None:
        """Nothing to release."""
