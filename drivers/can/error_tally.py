"""What the error frames of a link have said so far: counts by kind, the controller's state, the last word."""

from __future__ import annotations

from drivers.can.error_frames import BUS_OFF, ERROR_ACTIVE, NO_ACKNOWLEDGEMENT, decode
from drivers.can.frame import Frame
from drivers.can.rate import RecentCount

TOLD_S = 10.0  # for how long a loss is told, and a bus-off that the kernel has ended

# Controllers tell of the way up and often not of the way back; a bus on which frames pass for so long is well.
_CALM_NS = 10_000_000_000


class ErrorTally:
    """Sums up error frames."""

    def __init__(self) -> None:
        self.kinds: dict[str, int] = {}  # how often each kind of word was said; a bounded set of kinds
        self.state = ERROR_ACTIVE  # error-active, error-warning, error-passive or bus-off
        self.transmit_errors: int | None = None  # the controller's error counters as last told
        self.receive_errors: int | None = None
        self.last = ""  # the last error frame in words
        self.last_ns: int | None = None  # and its time, monotonic
        self.no_acknowledgement_ns: int | None = None  # when nobody acknowledged last
        self._recent = RecentCount(1.0)
        self._recent_bus_offs = RecentCount(TOLD_S)

    def add(self, frame: Frame) -> None:
        """Take error frame `frame` into account."""
        report = decode(frame)
        for word in report.words:
            self.kinds[word.kind] = self.kinds.get(word.kind, 0) + 1
            if word.kind == NO_ACKNOWLEDGEMENT:
                self.no_acknowledgement_ns = frame.t_ns
        if report.state == BUS_OFF:
            self._recent_bus_offs.add(frame.t_ns)
        if report.state is not None:
            self.state = report.state
        if report.transmit_errors is not None:
            self.transmit_errors, self.receive_errors = report.transmit_errors, report.receive_errors
        self.last, self.last_ns = str(report), frame.t_ns
        self._recent.add(frame.t_ns)

    def note_data(self, t_ns: int) -> None:
        """A data frame came at `t_ns`: no bus-off; and no trouble, if no error frame has come lately."""
        if self.state == BUS_OFF or (self.last_ns is not None and t_ns - self.last_ns >= _CALM_NS):
            self.state = ERROR_ACTIVE

    def note_losses(self) -> None:
        """Frames were lost, perhaps the one that ended the state; bus-off ends with the next data frame anyway."""
        if self.state != BUS_OFF:
            self.state = ERROR_ACTIVE

    def forget_state(self) -> None:
        """The interface was opened anew: what was said about the controller no longer holds."""
        self.state = ERROR_ACTIVE
        self.transmit_errors = self.receive_errors = self.no_acknowledgement_ns = None

    def in_last_second(self, now_ns: int) -> int:
        """Error frames of the last second."""
        return self._recent.count(now_ns)

    def recent_bus_offs(self, now_ns: int) -> int:
        """How often the controller went bus-off within the last TOLD_S: a restart may follow within milliseconds."""
        return self._recent_bus_offs.count(now_ns)
