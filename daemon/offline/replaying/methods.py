"""A recording through another method than ours: the papers', and what they are compared with."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from daemon.offline.replaying.replay import Progress, ReplayResult, settings_of
from daemon.offline.replaying.replay import replay as replay_ours
from daemon.recording import topics
from daemon.recording.errors import RecordingError
from daemon.recording.reader import Recording
from daemon.recording.topics import Recorded
from daemon.settings import Settings
from daemon.stream import Sink
from estimation.methods.batch import Batch, Collector
from estimation.methods.outputs import outputs_of
from estimation.methods.registry import METHODS
from estimation.records import Estimate, Move, Record

_OURS = (topics.PROVISIONAL, topics.SETTLED, topics.MOVES, topics.EVENTS)


class BatchReplay:
    """Gathers what a replay feeds, for batch methods to work on at its end.

    Our own estimator runs along: it tells where the stroke begins, and the moves to the methods that find none.
    """

    def __init__(self, settings: Settings) -> None:
        self._collector = Collector(settings.mount, settings.support, settings.two_state)
        self._last: Estimate | None = None
        self._batch: Batch | None = None

    def take(self, record: Record) -> None:
        """What the estimator got: `tap` of the replay."""
        self._collector.add(record)

    def see(self, record: Recorded) -> None:
        """What our estimator gave."""
        if isinstance(record, Estimate):
            self._last = record

    def outputs(self, method: str, moves: Sequence[Move]) -> Iterator[Estimate | Move]:
        """What the method makes of it, given our moves. Raises ValueError where the recording does not suffice."""
        course_of = METHODS[method].course
        if course_of is None:
            raise ValueError(f"{method} is no batch method")
        if self._batch is None:
            if moves:
                self._collector.start_m = moves[0].start_m
            elif self._last is not None:
                self._collector.start_m = self._last.displacement_m
            self._batch = self._collector.batch(moves)
        for output in outputs_of(self._batch, course_of(self._batch)):
            if isinstance(output, Estimate | Move):
                yield output


def replay_method(
    path: Path,
    method: str,
    settings: Settings | None = None,
    sink: Sink | None = None,
    progress: Progress | None = None,
) -> ReplayResult:
    """Replay with a batch method; arguments and errors as for `replay`.

    Raises:
        RecordingError: also where the recording does not suffice for the method.
    """
    gathered = BatchReplay(settings or settings_of(Recording(path)))

    def receive(topic: str, record: Recorded) -> None:
        if topic in _OURS:
            gathered.see(record)
        elif sink is not None:
            sink(topic, record)

    result = replay_ours(path, settings, receive, progress, tap=gathered.take)
    moves = []
    try:
        for output in gathered.outputs(method, result.moves):
            if isinstance(output, Move):
                moves.append(output)
            if sink is not None:
                sink(topics.MOVES if isinstance(output, Move) else topics.SETTLED, output)
    except ValueError as error:
        raise RecordingError(f"{path}: {method} cannot be used on it: {error}") from error
    return replace(result, moves=moves, identical=None, learned=None, end=None)
