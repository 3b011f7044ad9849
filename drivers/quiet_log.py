"""A log that a flapping cable cannot flood."""

from __future__ import annotations

import logging
from dataclasses import dataclass

from drivers.clock import Clock

_PAUSE_S = 10.0
_MOST_SENTENCES = 64  # remembered; sentences may hold numbers that never come again


@dataclass(slots=True)
class _Said:
    level: int
    due_ns: int  # may be said again
    last_ns: int
    held_back: int = 0


class QuietLog:
    """Says the same sentence at most every 10 s, then with the number of its repetitions.

    Call `flush` now and then: what is held back comes out in the order of its last occurrence, so that the last
    line in the log is always the present state.
    """

    def __init__(self, log: logging.Logger, clock: Clock) -> None:
        self._log = log
        self._clock = clock
        self._said: dict[str, _Said] = {}
        self._held_back = 0

    def say(self, level: int, sentence: str) -> None:
        """Log `sentence`, or hold it back."""
        now_ns = self._clock.now_ns()
        said = self._said.get(sentence)
        if self._held_back or (said is not None and now_ns < said.due_ns):
            # While anything is held back everything is: else a line would overtake an older one.
            said = said or self._remember(sentence, level, now_ns)
            said.held_back += 1
            said.last_ns = now_ns
            self._held_back += 1
            return
        self._remember(sentence, level, now_ns).due_ns = now_ns + round(_PAUSE_S * 1e9)
        self._log.log(level, "%s", sentence)

    def flush(self, *, at_end: bool = False) -> None:
        """Say what was held back long enough; `at_end`: all of it."""
        if not self._held_back:
            return
        now_ns = self._clock.now_ns()
        waiting = [(sentence, said) for sentence, said in self._said.items() if said.held_back]
        if not at_end and now_ns < min(said.due_ns for _, said in waiting):
            return
        for sentence, said in sorted(waiting, key=lambda item: item[1].last_ns):
            times = f" ({said.held_back} times)" if said.held_back > 1 else ""
            self._log.log(said.level, "%s", sentence + times)
            said.held_back = 0
            said.due_ns = now_ns + round(_PAUSE_S * 1e9)
        self._held_back = 0

    def _remember(self, sentence: str, level: int, now_ns: int) -> _Said:
        if len(self._said) >= _MOST_SENTENCES and sentence not in self._said:
            silent = [old for old, said in self._said.items() if not said.held_back]
            for old in silent[: _MOST_SENTENCES // 2]:
                del self._said[old]
        return self._said.setdefault(sentence, _Said(level, now_ns + round(_PAUSE_S * 1e9), now_ns))
