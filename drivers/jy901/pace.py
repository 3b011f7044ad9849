"""Times of evenly spaced samples out of times of arrival, which a serial adapter makes late as it likes."""

from __future__ import annotations

GAP_NS = 50_000_000  # between two arrivals: no adapter collects bytes that long, so samples are missing
LATE_NS = 30_000_000  # behind for longer than any adapter makes it: samples are missing, or the period is another
_SHORTEST = 0.75  # of a period, from one sample to the next: an error is taken back in steps, never by times that touch
_FOLLOW_FIRST, _FOLLOW = 30, 100  # samples in which lateness that stays is believed; at first the period is unknown
_FIRST_WINDOW, _WINDOW = 128, 1024  # samples from which the period is learned; doubled each time


class SampleClock:
    """A sample cannot arrive before it was taken: the earliest arrivals of late are right, the others are late."""

    def __init__(self, rate_hz: float) -> None:
        self.period_ns = self._nominal_ns = 1e9 / rate_hz
        self.missed = 0  # samples for which there was room
        self._last_ns: int | None = None  # time handed out
        self._arrived_ns = 0
        self._window: tuple[int, int] = (-1, 0)  # periods so far, time at their start
        self._window_size = _FIRST_WINDOW

    def time(self, arrived_ns: int, *, was_disturbed: bool = False) -> int:
        """When the sample that arrived then was taken [ns]; always three quarters of a period after the last at least.

        A reader that was held up stamps too late what has been waiting for it; what comes then is not squeezed.

        was_disturbed: bytes that make no packet came before it, so samples may be missing.
        """
        since_ns, self._arrived_ns = arrived_ns - self._arrived_ns, arrived_ns
        if self._last_ns is None:
            t_ns, periods = arrived_ns, 1
        else:
            behind_ns = arrived_ns - self._last_ns
            is_behind = was_disturbed or behind_ns - self.period_ns > LATE_NS
            periods = max(1, round(behind_ns / self.period_ns)) if is_behind else 1
            self.missed += periods - 1
            if since_ns > self.period_ns + GAP_NS:
                t_ns, self._window = arrived_ns, (-1, 0)
            else:
                late_ns = behind_ns - periods * self.period_ns
                follow = _FOLLOW_FIRST if self._window_size == _FIRST_WINDOW else _FOLLOW
                t_ns = self._last_ns + round(periods * self.period_ns + min(late_ns, late_ns / follow))
            t_ns = max(t_ns, self._last_ns + round(_SHORTEST * self.period_ns))
        self._last_ns = t_ns
        self._learn(t_ns, periods)
        return t_ns

    def _learn(self, t_ns: int, periods: int) -> None:
        count, first_ns = self._window
        if count < 0:
            self._window = (0, t_ns)
            return
        count += periods
        if count >= self._window_size:
            self.period_ns = min(max((t_ns - first_ns) / count, 0.5 * self._nominal_ns), 2 * self._nominal_ns)
            self._window_size = min(2 * self._window_size, _WINDOW)
            self._window = (0, t_ns)
        else:
            self._window = (count, first_ns)
