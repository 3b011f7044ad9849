"""When a frame came: the kernel's stamp, which is wall-clock time, on the monotonic clock."""

from __future__ import annotations

import time

from drivers.clock import Clock

_LONGEST_WAIT_NS = 60_000_000_000  # no frame waits longer to be read: an older stamp is none
_STEADY_NS = 1_000_000  # a wall clock that moved further against the monotonic one was set ...
_SLEW = 5e-4  # ... unless it had time to: the kernel slews it by up to 500 ppm (adjtimex)
_CLOSE_TOGETHER_NS = 100_000  # both clocks are read within so long, or once more
_TRIES = 4


class ArrivalTimes:
    """Turns the kernel's stamps into monotonic times that never go back.

    A frame may have waited long, in a flood or while the program stood still, so a stamp's age says nothing about
    its worth. What does: whether the wall clock went along with the monotonic one meanwhile.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._last_ns = 0
        self.restart()

    def restart(self) -> None:
        """The bus was opened: whatever waits in it came after the last setting of the wall clock."""
        self._offset_ns, self._checked_ns = self._read_clocks()
        self._is_steady = True

    def check(self) -> bool:
        """Whether the wall clock was set since the last call; call it about once a second.

        After a setting, frames with stamps of before may still wait: until the next call no stamp is believed.
        """
        offset_ns, now_ns = self._read_clocks()
        self._is_steady = self._is_near(offset_ns, now_ns)
        self._offset_ns, self._checked_ns = offset_ns, now_ns
        return not self._is_steady

    def of(self, stamp_s: float) -> int:
        """Monotonic time [ns] of a frame stamped `stamp_s` (wall clock); now, if the stamp cannot be believed."""
        offset_ns, now_ns = self._read_clocks()
        t_ns = round(stamp_s * 1e9) - offset_ns
        is_believed = self._is_steady and self._is_near(offset_ns, now_ns)
        if not is_believed or not now_ns - _LONGEST_WAIT_NS <= t_ns <= now_ns:
            t_ns = now_ns
        self._last_ns = max(self._last_ns, t_ns)
        return self._last_ns

    def _is_near(self, offset_ns: int, now_ns: int) -> bool:
        return abs(offset_ns - self._offset_ns) <= _STEADY_NS + _SLEW * (now_ns - self._checked_ns)

    def _read_clocks(self) -> tuple[int, int]:
        """How far the wall clock is ahead of the monotonic one, and the monotonic time [ns]."""
        for _ in range(_TRIES):
            before_ns, wall_ns, now_ns = self._clock.now_ns(), time.time_ns(), self._clock.now_ns()
            if now_ns - before_ns <= _CLOSE_TOGETHER_NS:
                break
        return wall_ns - (before_ns + now_ns) // 2, now_ns
