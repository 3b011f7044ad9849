"""A recording through another method than ours: the papers', and what they are compared with."""

from __future__ import annotations

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
from estimation.methods.batch import Collector
from estimation.methods.outputs import outputs_of
from estimation.methods.registry import METHODS
from estimation.records import Estimate, Move

_OURS = (topics.PROVISIONAL, topics.SETTLED, topics.MOVES, topics.EVENTS)


def replay_method(
    path: Path,
    method: str,
    settings: Settings | None = None,
    sink: Sink | None = None,
    progress: Progress | None = None,
) -> ReplayResult:
    """Replay with a batch method; arguments and errors as for `replay`.

    Our own estimator runs along: it tells where the stroke begins, and the moves to the methods that find none.

    Raises:
        RecordingError: also where the recording does not suffice for the method.
    """
    course_of = METHODS[method].course
    if course_of is None:
        raise ValueError(f"{method} is no batch method")
    in_use = settings or settings_of(Recording(path))
    collector = Collector(in_use.mount, in_use.support, in_use.two_state)
    last: list[Estimate] = []

    def receive(topic: str, record: Recorded) -> None:
        if topic in _OURS:
            if isinstance(record, Estimate):
                last[:] = [record]
        elif sink is not None:
            sink(topic, record)

    result = replay_ours(path, settings, receive, progress, tap=collector.add)
    if result.moves:
        collector.start_m = result.moves[0].start_m
    elif last:
        collector.start_m = last[0].displacement_m
    try:
        batch = collector.batch(result.moves)
        course = course_of(batch)
    except ValueError as error:
        raise RecordingError(f"{path}: {method} cannot be used on it: {error}") from error
    moves = []
    for output in outputs_of(batch, course):
        if isinstance(output, Move):
            moves.append(output)
        if sink is not None:
            sink(topics.MOVES if isinstance(output, Move) else topics.SETTLED, output)
    return replace(result, moves=moves, identical=None, learned=None, end=None)
