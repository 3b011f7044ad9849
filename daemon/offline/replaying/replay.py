"""Running a recording through the pipeline again, as fast as the machine allows."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

from daemon.machine import machine_of
from daemon.recording import topics
from daemon.recording.errors import RecordingError
from daemon.recording.metadata import LEARNED, SNAPSHOT
from daemon.recording.reader import Recording
from daemon.recording.topics import TOPICS, Recorded, RecordedDisplacement
from daemon.service import state_file
from daemon.service.state_file import SavedState, StateFileError
from daemon.settings import Settings
from daemon.stream import INPUTS, Sink, Stream
from estimation.learned import Learned, prior_of
from estimation.pipeline import Start
from estimation.records import Estimate, Move, Record
from estimation.smoothing.settled_smoother import SettledSmoother, SmoothedStep

# Hears a share, 0 to 1. (Any: who counts whole things will do.)
Progress = Callable[[Any], None]

_COMPARED = (topics.PROVISIONAL, topics.SETTLED)


@dataclass(slots=True)
class ReplayResult:
    """What a replay found."""

    samples: int
    bad_bursts: int
    duration_s: float
    elapsed_s: float
    identical: bool | None  # recorded estimates reproduced bit for bit; None = there are none to compare with
    moves: list[Move]
    learned: Learned | None
    settings: Settings  # in use
    end: SavedState | None  # what a restart would find; None without an estimate
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
    progress: Progress | None = None,
    smoothed: Callable[[SmoothedStep], None] | None = None,
    state: Path | None = None,
    tap: Callable[[Record], object] | None = None,
) -> ReplayResult:
    """Feed what was received through a fresh pipeline.

    Args:
        path: the recording.
        settings: instead of the file's own; then nothing else that the file says of its start is used either.
        sink: gets every input and output.
        progress: called now and then with the share of the file that has been read.
        smoothed: gets every settled step with what all that follows says of it, minutes behind `sink`.
        state: start from this state file, as the daemon would; then the recorded estimates are not compared.
        tap: gets every record that the estimator gets.

    Raises:
        RecordingError: the recording cannot be used.
        CanConfigError: its CAN settings do not fit their DBC files.
        StateFileError: the state file cannot be used.
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

    stream = stream_at_start(recording, settings, receive, state, tap)
    smoother = None if smoothed is None else SettledSmoother(stream.pipeline, smoothed)
    first_ns = last_ns = None
    count = 0
    stream.pipeline.prepare(stream.settings.nominal_rate_hz)
    began = time.perf_counter()
    for topic, record in recording.messages((*INPUTS, *_COMPARED) if state is None else INPUTS):
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
            progress(recording.share_read)
    if stream.foreign_samples and not stream.samples + stream.bad_bursts:
        wanted = "a JY901" if stream.settings.jy901.use == "instead" else "an ADIS16448"
        raise RecordingError(
            f"{path}: the settings estimate from {wanted}, and it holds another sensor's samples: see use in [jy901]"
        )
    stream.finish()
    if smoother is not None:
        smoother.finish()
    elapsed_s = time.perf_counter() - began
    has_estimates = any(c.compared or c.recorded for c in comparisons.values())
    duration_s = 0.0 if first_ns is None or last_ns is None else (last_ns - first_ns) * 1e-9
    return ReplayResult(
        samples=stream.samples,
        bad_bursts=stream.bad_bursts,
        duration_s=duration_s,
        elapsed_s=elapsed_s,
        identical=all(c.identical for c in comparisons.values()) if has_estimates else None,
        moves=moves,
        learned=stream.learned(),
        settings=stream.settings,
        end=_end(stream, (_began_s(recording) or time.time()) + duration_s),
        damage=recording.damage,
    )


def stream_at_start(
    recording: Recording,
    settings: Settings | None,
    sink: Sink,
    state: Path | None = None,
    tap: Callable[[Record], object] | None = None,
) -> Stream:
    """The stream in the state that the replay starts from; arguments and errors as for `replay`."""
    own = settings is None
    settings = settings_of(recording) if settings is None else settings
    snapshot = recording.attachments.get(SNAPSHOT) if own and state is None else None
    start = Start()
    if state is not None:
        start = _saved_start(recording, settings, state)
    elif own and snapshot is None:
        start = Start(learned=_recorded_learned(recording, settings))
    if recording.metadata.get("kind") == "import":
        start = Start((settings.support.initial_mm or 0.0) / 1e3, learned=start.learned)
    stream = Stream(settings, sink, start, tap)
    if snapshot is not None:
        try:
            stream.restore(snapshot)
        except ValueError as error:
            raise RecordingError(
                f"{recording.path}: its snapshot is damaged or of another version: name --config FILE to start afresh"
            ) from error
    return stream


def _saved_start(recording: Recording, settings: Settings, path: Path) -> Start:
    """What the state file is worth when the recording begins; one that was saved later counts as of that moment."""
    try:
        saved = state_file.read(path, settings)
    except FileNotFoundError as error:
        raise StateFileError(f"{path} does not exist: name a state file, or write one with --save-state") from error
    return saved.start(settings, max(saved.wall_time_s, _began_s(recording)))


def _recorded_learned(recording: Recording, settings: Settings) -> Learned | None:
    """What the estimator had learned when the recording began."""
    text = recording.attachments.get(LEARNED, b"{}")
    if text.strip() == b"{}":
        return None
    try:
        learned = Learned.model_validate_json(text)
        learned.check(machine_of(settings), prior_of(settings.support, settings.estimator))
    except ValueError as error:
        raise RecordingError(
            f"{recording.path}: its learned state is damaged or of another version: name --config FILE to start afresh"
        ) from error
    return learned


def _began_s(recording: Recording) -> float:
    """Wall clock at the start of the recording; 0 if it does not say."""
    try:
        return max(datetime.fromisoformat(recording.metadata["created"]).timestamp(), 0.0)
    except (KeyError, ValueError, OverflowError):
        return 0.0


def _end(stream: Stream, wall_time_s: float) -> SavedState | None:
    stroke_mm = stream.settings.support.stroke_mm
    return None if stream.last is None else SavedState.of(stream.last, stream.learned(), stroke_mm, wall_time_s)
