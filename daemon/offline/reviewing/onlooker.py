"""Who looks on while a recording is reviewed: exports, the report."""

from __future__ import annotations

from daemon.recording.topics import Recorded
from estimation.records import Estimate, Move
from estimation.smoothing.settled_smoother import SmoothedStep


class Onlooker:
    """Sees all of a recording; what a subclass does not care for passes by."""

    def replayed(self, topic: str, /, record: Recorded) -> None:
        """Every input and output of the replay, in order."""

    def step(self, step: SmoothedStep) -> None:
        """Every settled step, minutes behind; smoothed values are NaN for another method than ours."""

    def recorded(self, topic: str, /, record: Recorded) -> None:
        """Every message as it stands in the file, after the replay."""

    def gap(self, last_ns: int, next_ns: int) -> None:
        """A hole in the inertial samples, between these two."""

    def other(self, method: str, output: Estimate | Move) -> None:
        """What another method than ours says, after the replay."""
