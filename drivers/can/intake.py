"""What becomes of each frame that was read: handed on, counted as unwanted or in excess; and what that shows."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import can

from drivers.can.error_tally import TOLD_S, ErrorTally
from drivers.can.frame import Frame, FrameId
from drivers.can.interface import to_frame
from drivers.can.rate import RecentCount, TokenBudget

# What sources send is far below; what is above fills disk and queues and tells nothing more.
FRAMES_PER_S = 2000
ERROR_FRAMES_PER_S = 100
STRANGERS = 8  # unwanted identifiers that are remembered, to be shown


@dataclass(slots=True)
class CanCounters:
    """What happened on the link since the start.

    Every frame that came is in one of the first six; what waits in the receive buffer of a bus that fails is
    lost with it.
    """

    received: int = 0  # data frames handed on
    ignored: int = 0  # data frames with identifiers that nobody asked for
    overload: int = 0  # wanted data frames beyond FRAMES_PER_S, not handed on
    kernel_drops: int = 0  # frames of any kind that found the receive buffer full
    error_frames: int = 0  # error frames handed on
    error_overload: int = 0  # error frames beyond ERROR_FRAMES_PER_S: taken into account, not handed on
    sent: int = 0
    send_failures: int = 0  # refused ones included
    failures: int = 0  # failed openings and readings
    reconnects: int = 0  # openings that worked, except the first
    clock_steps: int = 0  # settings of the wall clock, by which the kernel stamps frames


class Intake:
    """Sorts the frames of one link.

    Args:
        ids: identifiers that are wanted, None for all.
        silent_after_s: a link without a frame for as long counts as silent.
    """

    def __init__(self, ids: Collection[FrameId] | None, silent_after_s: float) -> None:
        self._ids = None if ids is None else frozenset(ids)
        self._silent_after_ns = round(silent_after_s * 1e9)
        self._budget = TokenBudget(FRAMES_PER_S, FRAMES_PER_S)
        self._error_budget = TokenBudget(ERROR_FRAMES_PER_S, ERROR_FRAMES_PER_S)
        self._recent_overload = RecentCount(TOLD_S)
        self._recent_drops = RecentCount(TOLD_S)
        self._strangers: dict[FrameId, None] = {}  # in order of appearance
        self._frame_ns = 0  # the last data frame
        self._wanted_ns = 0  # the last wanted one
        self.counters = CanCounters()
        self.errors = ErrorTally()

    def restart(self, now_ns: int) -> None:
        """The bus was opened: nothing that was seen before speaks of it."""
        self._frame_ns = self._wanted_ns = now_ns
        self._strangers.clear()
        self.errors.forget_state()

    def take(self, message: can.Message, t_ns: int) -> Frame | None:
        """Count a message that came at `t_ns`; gives the frame to hand on, if any."""
        if message.is_error_frame:
            return self._take_error(to_frame(message, t_ns))
        self.errors.note_data(t_ns)
        self._frame_ns = t_ns
        frame_id = FrameId(message.arbitration_id, message.is_extended_id)
        if self._ids is not None and frame_id not in self._ids:
            self.counters.ignored += 1
            if len(self._strangers) < STRANGERS:
                self._strangers[frame_id] = None
            return None
        self._wanted_ns = t_ns
        if not self._budget.take(t_ns):
            self.counters.overload += 1
            self._recent_overload.add(t_ns)
            return None
        self.counters.received += 1
        return to_frame(message, t_ns)

    def note_drops(self, count: int, now_ns: int) -> None:
        """The kernel has dropped `count` frames more."""
        self.counters.kernel_drops += count
        self._recent_drops.add(now_ns, count)
        if count:
            self.errors.note_losses()

    def note_filtered(self, now_ns: int) -> None:
        """Frames reach the interface, though none passes the kernel's filter."""
        self._frame_ns = now_ns

    def wanted(self) -> str:
        """The wanted identifiers, as text."""
        return ", ".join(map(str, sorted(self._ids or ())))

    def strangers(self) -> str:
        """Some identifiers that came, but are not wanted, as text."""
        return ", ".join(map(str, self._strangers))

    def silent_s(self, now_ns: int) -> float | None:
        """For how long no data frame has come [s]; None if that is no reason to worry."""
        return self._too_long_s(self._frame_ns, now_ns)

    def unwanted_only_s(self, now_ns: int) -> float | None:
        """For how long frames have come, but no wanted one [s]; None if that is not so."""
        if self._too_long_s(self._frame_ns, now_ns) is not None:
            return None
        return self._too_long_s(self._wanted_ns, now_ns)

    def nobody_acknowledges(self, now_ns: int) -> bool:
        """Whether our last frames were not acknowledged; who sends frames to us would acknowledge ours as well."""
        t_ns = self.errors.no_acknowledgement_ns
        return t_ns is not None and t_ns >= self._frame_ns and now_ns - t_ns < TOLD_S * 1e9

    def recent_overload(self, now_ns: int) -> int:
        """Wanted frames in excess within the last TOLD_S."""
        return self._recent_overload.count(now_ns)

    def recent_drops(self, now_ns: int) -> int:
        """Frames dropped by the kernel within the last TOLD_S."""
        return self._recent_drops.count(now_ns)

    def _take_error(self, frame: Frame) -> Frame | None:
        self.errors.add(frame)
        if not self._error_budget.take(frame.t_ns):
            self.counters.error_overload += 1
            return None
        self.counters.error_frames += 1
        return frame

    def _too_long_s(self, since_ns: int, now_ns: int) -> float | None:
        if self._ids is not None and not self._ids:
            return None  # nobody waits for anything
        passed_ns = now_ns - since_ns
        return passed_ns * 1e-9 if passed_ns >= self._silent_after_ns else None
