"""What the frames of one message tell by their numbers and times alone."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.can.protection import CounterSignal
from drivers.can.remembered import Count, RateHz, RawNumber, TimeNs

_WINDOW_NS = 1_000_000_000  # the rate is that of so long ...
_WINDOW_FRAMES = 5  # ... and so many frames at least
_LEARNING_WINDOWS = 5  # before the usual rate is known
_MEMORY_WINDOWS = 16
_CROWDED = 5.0  # times the usual rate


@dataclass(slots=True)
class CounterWatch:
    """Follows a message counter."""

    number: RawNumber | None = None  # the last one
    t_ns: TimeNs = 0
    lost_frames: Count = 0  # numbers that were left out, modulo the counter's range
    lost_ns: TimeNs | None = None  # when that was last noticed

    def stands_still(self, number: int, t_ns: int, counter: CounterSignal, timeout_ns: int) -> bool:
        """Take in the next number; says whether it is the last one again.

        The first number of all, and the first after a silence, prove nothing: the sender may have started anew.
        """
        last, is_known = self.number, 0 <= t_ns - self.t_ns <= timeout_ns
        self.number, self.t_ns = number, t_ns
        if last is None or not is_known:
            return False
        if number == last:
            return True
        lost = (number - last - 1) % counter.numbers
        if lost:
            self.lost_frames, self.lost_ns = self.lost_frames + lost, t_ns
        return False


@dataclass(slots=True)
class FrameRate:
    """Learns how often frames come, and notices when they crowd: come far too often, and not from one sound sender.

    A sender may change its rate, so a second sign within the same window is asked for. Crowded frames are not
    learned from: a second sender must not become the usual state of things.
    """

    begin_ns: TimeNs = 0  # of the present window
    last_ns: TimeNs | None = None
    frames: Count = 0  # in the present window
    signs: Count = 0  # in the present window, of a second or a wild sender: wrong checksum or message counter
    windows: Count = 0  # learned from
    usual_hz: RateHz | None = None
    recent_hz: RateHz | None = None  # of the last window
    is_crowded: bool = False
    crowded_frames: Count = 0

    def see(self, t_ns: int, timeout_ns: int) -> None:
        """Take in the time of a frame; a silence longer than `timeout_ns` begins a new window."""
        if self.last_ns is None or not 0 <= t_ns - self.last_ns <= timeout_ns:
            self.begin_ns, self.frames, self.signs, self.recent_hz, self.is_crowded = t_ns, 0, 0, None, False
        else:
            self.frames += 1
            if self.frames >= _WINDOW_FRAMES and t_ns - self.begin_ns >= _WINDOW_NS:
                self._judge(self.frames / ((t_ns - self.begin_ns) * 1e-9))
                self.begin_ns, self.frames, self.signs = t_ns, 0, 0
        self.last_ns = t_ns

    def _judge(self, rate_hz: float) -> None:
        usual_hz = rate_hz if self.usual_hz is None else self.usual_hz
        self.recent_hz = rate_hz
        is_known = self.windows >= _LEARNING_WINDOWS
        self.is_crowded = is_known and self.signs > 0 and rate_hz > _CROWDED * usual_hz
        if self.is_crowded:
            self.crowded_frames += self.frames
            return
        self.windows = min(self.windows + 1, _MEMORY_WINDOWS)
        self.usual_hz = usual_hz + (rate_hz - usual_hz) / self.windows
