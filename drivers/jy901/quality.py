"""How well a JY901 is read: what was lost on the line over the last seconds, and whether the part keeps its rate."""

from __future__ import annotations

from collections import deque

from drivers.jy901.counters import Jy901Counters

_STEP_NS = 500_000_000
_STEPS = 10
_ILL_SHARE, _WELL_SHARE = 0.01, 0.005
_LEAST_LOST = 3
_SLOW_SHARE, _LOST_SETTINGS_SHARE = 0.95, 0.5  # of the wanted rate
_RATE_S = 2.0  # of samples tell a rate

_FROZEN = ("the samples stand still", "switch the sensor's supply off and on; if that goes on, replace the sensor")
_NOISY = ("samples are lost on the serial line", "check the wires for length and contact; a lower baud rate bears more")


class QualityWatch:
    """Judges the counters of the last five seconds; ill above 1 % of losses, well again below 0.5 %."""

    def __init__(self, counters: Jy901Counters, wanted_hz: float) -> None:
        self.has_lost_settings = False  # the part sends whole packets, and far too few
        self._counters = counters
        self._wanted_hz = wanted_hz
        self._due_ns = 0
        self._marks: deque[tuple[int, int, int, int]] = deque(maxlen=_STEPS + 1)  # time, samples, lost, damage
        self._is_noisy = False
        self._is_slow = False

    def begin(self) -> None:
        """The samples begin, or go on after a silence, which was told while it lasted."""
        self._marks.clear()
        self._counters.rate_hz = 0.0
        self._is_noisy = self._is_slow = self.has_lost_settings = False

    def is_due(self, now_ns: int) -> bool:
        """Twice a second."""
        if now_ns < self._due_ns:
            return False
        self._due_ns = now_ns + _STEP_NS
        return True

    def complaints(self, now_ns: int, *, is_frozen: bool) -> list[tuple[str, str]]:
        """What is wrong and what to do about it, the worst first; call when it is due."""
        self._judge(now_ns)
        said = [_FROZEN] if is_frozen else []
        if self._is_noisy:
            said.append(_NOISY)
        if self._is_slow:
            said.append(
                (
                    f"the part sends {self._counters.rate_hz:.0f} samples a second, not {self._wanted_hz:g}",
                    "set a higher baud or bandwidth_hz in [jy901], or a lower rate_hz",
                )
            )
        return said

    def _judge(self, now_ns: int) -> None:
        counters = self._counters
        mark = (now_ns, counters.samples, counters.lost, counters.halves + counters.skipped_bytes)
        self._marks.append(mark)
        elapsed_ns, samples, lost, damage = (new - old for new, old in zip(mark, self._marks[0], strict=True))
        seconds = elapsed_ns * 1e-9
        if seconds >= _RATE_S:
            counters.rate_hz = round(samples / seconds, 1)
        # A line that brings whole packets and too few of them: it is the part that sends no more.
        share = counters.rate_hz / self._wanted_hz
        self._is_slow = not damage and 0 < share < _SLOW_SHARE
        self.has_lost_settings = self._is_slow and share < _LOST_SETTINGS_SHARE
        limit = _WELL_SHARE if self._is_noisy else _ILL_SHARE
        self._is_noisy = not self._is_slow and lost >= _LEAST_LOST and lost > limit * (samples + lost)
