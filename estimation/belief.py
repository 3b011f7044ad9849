"""What is believed to have happened when: moves and unexplained times, in order, as far back as the buffer reaches."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import StrEnum

from estimation.recognition.motion import Decision, Motion
from estimation.records import Segment

BURST_LEAD_S = 0.1  # the refined onset may be this late
START_BURST_S, SLOW_START_BURST_S = 0.9, 1.6
STOP_BURST_S = 0.8


class Phase(StrEnum):
    """Part of a move, or none of one."""

    REST = "rest"
    START = "start"
    CRUISE = "cruise"
    STOP = "stop"
    FREE = "free"
    UNFELT = "unfelt"


SEGMENT_OF = {
    Phase.REST: Segment.ZUPT,
    Phase.START: Segment.VVS,
    Phase.CRUISE: Segment.CVS,
    Phase.STOP: Segment.VVS,
    Phase.FREE: Segment.VVS,
    Phase.UNFELT: Segment.VVS,
}


@dataclass(slots=True, frozen=True)
class Free:
    """A time in which no model is known to hold; without `until_ns` it still goes on.

    `unfelt`: the inertial sensor does not take part in this move, the displacement sensor alone leads.
    """

    from_ns: int
    until_ns: int | None = None
    unfelt: bool = False


@dataclass(slots=True)
class Belief:
    """The present hypothesis about the buffered past; changing it means estimating again."""

    items: list[Motion | Free] = field(default_factory=list)  # in order of time

    @property
    def last_motion(self) -> Motion | None:
        """The last item, if it is a move."""
        last = self.items[-1] if self.items else None
        return last if isinstance(last, Motion) else None

    @property
    def last_settled_motion(self) -> Motion | None:
        """The last move that has ended, though a start be proposed already; None if other things came after it."""
        items = self._proven
        last = items[-1] if items else None
        return last if isinstance(last, Motion) and last.stop_confirmed else None

    @property
    def _proven(self) -> list[Motion | Free]:
        last = self.items[-1] if self.items else None
        return self.items[:-1] if isinstance(last, Motion) and not last.confirmed else self.items

    @property
    def open_free(self) -> Free | None:
        """The unexplained time that still goes on."""
        last = self.items[-1] if self.items else None
        return last if isinstance(last, Free) and last.until_ns is None else None

    def phase_at(self, t_ns: int) -> tuple[Phase, Motion | None]:
        """Phase at a time, and the move it belongs to."""
        for item in reversed(self.items):
            if isinstance(item, Free):
                if item.from_ns <= t_ns and (item.until_ns is None or t_ns < item.until_ns):
                    return Phase.UNFELT if item.unfelt else Phase.FREE, None
                continue
            phase = _phase_in(item, t_ns)
            if phase is not None:
                return phase, item
        return Phase.REST, None

    def follow(self, decision: Decision, motion: Motion | None) -> None:
        """Adopt what the recogniser decided."""
        if decision is Decision.START_DISCARDED:
            self.items.pop()
            return
        assert motion is not None
        if decision is Decision.STOP_UNSTARTED and self.last_motion is not None and not self.last_motion.confirmed:
            self.items.pop()  # a start that was proposed meanwhile
        if decision in (Decision.START_PROPOSED, Decision.STOP_UNSTARTED):
            self.items.append(motion)
        else:
            self.items[-1] = motion

    def replace_last(self, motion: Motion) -> None:
        """Believe something else of the last move."""
        self.items[-1] = motion

    def begin_free(self, from_ns: int, *, unfelt: bool = False) -> None:
        """From then on nothing is explained; a move that still went on is cut there, an unproven one forgotten."""
        motion = self.last_motion
        if motion is not None and not motion.stop_confirmed:
            if motion.confirmed:
                self.items[-1] = replace(motion, stop_ns=None, cut_ns=from_ns)
            else:
                self.items.pop()
        self.items.append(Free(from_ns, unfelt=unfelt))

    def end_free(self, t_ns: int) -> None:
        """At rest again."""
        free = self.open_free
        assert free is not None
        self.items[-1] = replace(free, until_ns=t_ns)

    def rests_since_ns(self) -> int | None:
        """End of the last item but for a start that is only proposed; None if there is none or it goes on."""
        items = self._proven
        return _end_ns(items[-1]) if items else None

    def forget_before(self, t_ns: int) -> None:
        """Drop what ended before the buffer begins, but for the last two items: a stop may yet turn out to be none."""
        while len(self.items) > 2 and (end_ns := _end_ns(self.items[0])) is not None and end_ns < t_ns:
            self.items.pop(0)


def _phase_in(motion: Motion, t_ns: int) -> Phase | None:
    """Phase of one move at a time, None outside it."""
    since_onset_s = (t_ns - motion.onset_ns) * 1e-9
    if since_onset_s < -BURST_LEAD_S:
        return None
    if motion.cut_ns is not None and t_ns >= motion.cut_ns:
        return None
    if motion.stop_ns is not None:
        since_stop_s = (t_ns - motion.stop_ns) * 1e-9
        if since_stop_s >= STOP_BURST_S:
            return None
        if since_stop_s >= -BURST_LEAD_S:
            return Phase.STOP
    burst_s = SLOW_START_BURST_S if motion.slow else START_BURST_S
    return Phase.START if since_onset_s < burst_s else Phase.CRUISE


def _end_ns(item: Motion | Free) -> int | None:
    if isinstance(item, Free):
        return item.until_ns
    if item.cut_ns is not None:
        return item.cut_ns
    return None if item.stop_ns is None else item.stop_ns + round(STOP_BURST_S * 1e9)
