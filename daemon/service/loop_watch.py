"""How late the event loop is, and what held it up."""

from __future__ import annotations

import gc
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

LONG_S = 0.002  # work shorter than this holds up nobody
REMEMBERED = 256  # pieces of long work between two looks, more than 0.1 s can hold


@dataclass(slots=True, frozen=True)
class Lateness:
    """The worst of the time since it was last taken."""

    late_s: float = 0.0
    culprit: str = ""  # what took most of that time
    culprit_s: float = 0.0


class LoopWatch:
    """Name work on the loop with `doing`; tell a timer's lateness to `woke`; `take` the worst now and then."""

    def __init__(
        self,
        now_s: Callable[[], float] = time.monotonic,
        process_s: Callable[[], float] = time.process_time,
        thread_s: Callable[[], float] = time.thread_time,
    ) -> None:
        self._now_s, self._process_s, self._thread_s = now_s, process_s, thread_s
        self._work: deque[tuple[str, float, float]] = deque(maxlen=REMEMBERED)  # name, begin, end
        self._used_s = process_s(), thread_s()
        self._worst = Lateness()
        self._collecting_since_s = 0.0

    @contextmanager
    def doing(self, name: str) -> Iterator[None]:
        """Work of that name runs on the loop meanwhile."""
        began_s = self._now_s()
        try:
            yield
        finally:
            self._note(name, began_s)

    def watch_collector(self) -> None:
        """See the garbage collector's passes too, in whichever thread they run: all others wait."""
        gc.callbacks.append(self._collector)

    def forget_collector(self) -> None:
        """Undo `watch_collector`."""
        if self._collector in gc.callbacks:
            gc.callbacks.remove(self._collector)

    def woke(self, due_s: float) -> None:
        """A timer of the loop that was due at `due_s` runs now."""
        now_s = self._now_s()
        late_s = now_s - due_s
        process_s, thread_s = self._process_s(), self._thread_s()
        if late_s > self._worst.late_s:
            culprit, share_s = self._longest_within(due_s, now_s)
            if share_s < late_s / 2:
                culprit, share_s = self._from_outside(late_s, process_s, thread_s)
            self._worst = Lateness(late_s, culprit, share_s)
        self._work.clear()
        self._used_s = process_s, thread_s

    def take(self) -> Lateness:
        """The worst since the last call."""
        worst, self._worst = self._worst, Lateness()
        return worst

    def _longest_within(self, begin_s: float, end_s: float) -> tuple[str, float]:
        shares: dict[str, float] = {}
        for name, began_s, ended_s in list(self._work):
            overlap_s = min(ended_s, end_s) - max(began_s, begin_s)
            if overlap_s > 0:
                shares[name] = shares.get(name, 0.0) + overlap_s
        return max(shares.items(), key=lambda item: item[1], default=("", 0.0))

    def _from_outside(self, late_s: float, process_s: float, thread_s: float) -> tuple[str, float]:
        """Nothing that was named: tell by the processor time who was busy since the last look."""
        own_s = thread_s - self._used_s[1]
        others_s = process_s - self._used_s[0] - own_s
        if own_s >= late_s / 2:
            return "work without a name", own_s
        if others_s >= late_s / 2:
            return "another thread of this program", others_s
        return "the computer, busy with something else", late_s

    def _note(self, name: str, began_s: float) -> None:
        ended_s = self._now_s()
        if ended_s - began_s >= LONG_S:
            self._work.append((name, began_s, ended_s))

    def _collector(self, phase: str, _: dict[str, int]) -> None:
        if phase == "start":
            self._collecting_since_s = self._now_s()
        else:
            self._note("garbage collection", self._collecting_since_s)
