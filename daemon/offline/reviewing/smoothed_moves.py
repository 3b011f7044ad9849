"""What the smoothed steps say of each move."""

from __future__ import annotations

from dataclasses import dataclass, field

from estimation.records import Move, Segment
from estimation.smoothing.settled_smoother import SmoothedStep


@dataclass(slots=True)
class SmoothedMove:
    """One move from its first step to the first at rest behind it."""

    first: SmoothedStep
    last: SmoothedStep
    largest_difference_m: float = 0.0  # smoothed minus settled

    def include(self, step: SmoothedStep) -> None:
        """Take the next step of it."""
        self.last = step
        difference_m = step.displacement_m - step.settled.displacement_m
        self.largest_difference_m = max(self.largest_difference_m, difference_m, key=abs)


@dataclass(slots=True)
class SmoothedMoves:
    """Takes the steps in order and finds the moves that begin in them."""

    _moves: list[SmoothedMove] = field(default_factory=list)
    _number: int | None = None  # of the last move, whoever saw it begin
    _moving: bool = False

    def add(self, step: SmoothedStep) -> None:
        """Take the next step."""
        if self._number is None:
            self._number = step.settled.move
        if step.settled.move != self._number:
            self._number, self._moving = step.settled.move, True
            self._moves.append(SmoothedMove(step, step))
        if self._moving:
            self._moves[-1].include(step)
            self._moving = step.settled.segment is not Segment.ZUPT

    def of(self, move: Move) -> SmoothedMove | None:
        """The smoothed counterpart of a move; None if its steps do not show where it began."""
        for smoothed in self._moves:
            if smoothed.first.settled.t_ns <= move.stop_ns <= smoothed.last.settled.t_ns:
                return smoothed
        return None
