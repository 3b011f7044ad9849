"""Running a recording through the pipeline again, as fast as the machine allows."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from daemon.recording import topics
from daemon.recording.errors import RecordingError
from daemon.recording.metadata import SNAPSHOT
from daemon.recording.reader import Recording
from daemon.recording.topics import TOPICS, Recorded, RecordedDisplacement
from daemon.settings import Settings
from daemon.stream import INPUTS, Sink, Stream
from estimation.pipeline import Start
from estimation.records import Estimate, Move
from estimation.settled_smoother import SettledSmoother, SmoothedStep

_COMPARED = (topics.PROVISIONAL, topics.SETTLED)


@dataclass(slots=True)
class ReplayResult:
    """What a replay found."""

    samples: int
    bad_bursts: int
    duration_s: float
    elapsed_s: float
    identical: bool | None  # recorded estimates reproduced bit for bit; None = the file holds none
    moves: list[Move]
    damage: list[str]

    @property
    def realtime_factor(self) -> float:
        """Seconds of recording per second of computing, start-up excluded."""
        return self.duration_s / self.elapsed_s if self.elapsed_s else 0.0


@dataclass(slots=True)
class _Comparison:
    """Recorded against computed estimates of one topic, as bytes: NaN equals NaN, nothing is rounded.

    The file's last estimates come from the end of the run, which the replay reaches only after the last message.
    """

    computed: deque[bytes] = field(default_factory=deque)
    recorded: deque[bytes] = field(default_factory=deque)
    compared: int = 0
    equal: bool = True

    def add(self, queue: deque[bytes], topic: str, estimate: Estimate) -> None:
        """Take one estimate into `queue`, one of the two."""
        queue.append(TOPICS[topic].encode(estimate))
        while self.computed and self.recorded:
            self.compared += 1
            self.equal &= self.computed.popleft() == self.recorded.popleft()

    @property
    def identical(self) -> bool:
        """Whether every recorded estimate was computed again."""
        return self.equal and not self.recorded


def settings_of(recording: Recording) -> Settings:
    """The settings that a recording was made with. Raises RecordingError if they cannot be read."""
    text = recording.metadata.get("settings")
    if text is None:
        raise RecordingError(f"{recording.path} does not say with which settings it was made: name --config FILE")
    try:
        return Settings.model_validate_json(text)
    except ValueError as error:
        raise RecordingError(
            f"{recording.path} was made with settings of another version: name --config FILE"
        ) from error


def replay(
    path: Path,
    settings: Settings | None = None,
    sink: Sink | None = None,
    progress: Callable[[int], None] | None = None,
    smoothed: Callable[[SmoothedStep], None] | None = None,
) -> ReplayResult:
    """Feed what was received through a fresh pipeline.

    Args:
        path: the recording.
        settings: instead of the file's own; then the file's snapshot is not used either.
        sink: gets every input and output.
        progress: called now and then with the number of messages read.
        smoothed: gets every settled step with what all that follows says of it, minutes behind `sink`.

    Raises:
        RecordingError: the recording cannot be used.
        CanConfigError: its CAN settings do not fit their DBC files.
    """
    recording = Recording(path)
    moves: list[Move] = []
    comparisons = {topic: _Comparison() for topic in _COMPARED}

    def receive(topic: str, record: Recorded) -> None:
        if isinstance(record, Estimate):
            comparison = comparisons[topic]
            comparison.add(comparison.computed, topic, record)
        elif isinstance(record, Move):
            if moves and moves[-1].number == record.number:
                moves.pop()  # re-opened after a false stop
            moves.append(record)
        if sink is not None:
            sink(topic, record)

    stream = _stream_for(recording, settings, receive)
    smoother = None if smoothed is None else SettledSmoother(stream.pipeline, smoothed)
    first_ns = last_ns = None
    count = 0
    stream.pipeline.prepare()
    began = time.perf_counter()
    for topic, record in recording.messages((*INPUTS, *_COMPARED)):
        count += 1
        if isinstance(record, Estimate):
            comparison = comparisons[topic]
            comparison.add(comparison.recorded, topic, record)
            continue
        if isinstance(record, RecordedDisplacement) and record.decoded:
            continue  # follows again from its CAN frame
        stream.take(topic, record)
        last_ns = TOPICS[topic].time_ns(record)
        first_ns = last_ns if first_ns is None else first_ns
        if progress is not None and count % 5000 == 0:
            progress(count)
    stream.finish()
    if smoother is not None:
        smoother.finish()
    elapsed_s = time.perf_counter() - began
    has_estimates = any(c.compared or c.recorded for c in comparisons.values())
    return ReplayResult(
        samples=stream.samples,
        bad_bursts=stream.bad_bursts,
        duration_s=0.0 if first_ns is None or last_ns is None else (last_ns - first_ns) * 1e-9,
        elapsed_s=elapsed_s,
        identical=all(c.identical for c in comparisons.values()) if has_estimates else None,
        moves=moves,
        damage=recording.damage,
    )


def _stream_for(recording: Recording, settings: Settings | None, sink: Sink) -> Stream:
    """The stream in the state that the recording started with."""
    own = settings is None
    settings = settings_of(recording) if settings is None else settings
    if recording.metadata.get("kind") == "import":
        return Stream(settings, sink, Start((settings.support.initial_mm or 0.0) / 1e3))
    stream = Stream(settings, sink)
    snapshot = recording.attachments.get(SNAPSHOT)
    if own and snapshot is not None:
        try:
            stream.restore(snapshot)
        except ValueError as error:
            raise RecordingError(
                f"{recording.path}: its snapshot is damaged or of another version: name --config FILE to start afresh"
            ) from error
    return stream
