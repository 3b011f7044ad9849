"""What a recording holds and what it shows, as plain data."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import nan
from pathlib import Path
from typing import Any

from daemon.inertial import SampleDecoder
from daemon.offline.progress import shares
from daemon.offline.replaying.methods import BatchReplay, replay_method
from daemon.offline.replaying.replay import ReplayResult, replay, settings_of
from daemon.offline.reviewing.onlooker import Onlooker
from daemon.offline.reviewing.reference_errors import ReferenceComparison
from daemon.offline.reviewing.smoothed_moves import SmoothedMoves
from daemon.recording.reader import Recording
from daemon.recording.topics import TOPICS, Health, Recorded, RecordedDisplacement
from daemon.stream import Sink
from drivers.adis16448.burst import Burst, Fault
from drivers.adis16448.identity import Identity
from drivers.jy901.identity import Jy901Identity
from drivers.jy901.reading import Reading
from estimation.methods.registry import OURS
from estimation.records import CanState, Estimate, Event, ImuSample, Segment
from estimation.smoothing.settled_smoother import SmoothedStep

GAP_S = 0.05


@dataclass(slots=True)
class Gap:
    """A hole in the inertial samples."""

    at_s: float
    length_s: float


@dataclass(slots=True)
class Review:
    """Everything `ramstroke review` tells."""

    metadata: dict[str, str]
    complete: bool
    replayed: ReplayResult
    messages: Counter[str] = field(default_factory=Counter)
    lost: int = 0
    faults: Counter[str] = field(default_factory=Counter)
    gaps: list[Gap] = field(default_factory=list)
    gaps_not_shown: int = 0
    segments: Counter[Segment] = field(default_factory=Counter)  # settled steps
    can_states: Counter[CanState] = field(default_factory=Counter)
    events: list[Event] = field(default_factory=list)
    last_health: dict[str, Any] | None = None
    identity: str = ""  # of the first part that spoke
    reference: ReferenceComparison = field(default_factory=ReferenceComparison)
    smoothed_moves: SmoothedMoves = field(default_factory=SmoothedMoves)
    refused: dict[str, str] = field(default_factory=dict)  # methods that cannot be used on it, and why

    @property
    def sensor(self) -> str:
        """The inertial sensor, as the head of the file names it, or as it named itself later."""
        return self.metadata.get("sensor") or self.identity


GAPS_SHOWN = 20
_REPLAYING = 0.85  # of the work; the rest is reading


def review(
    path: Path,
    progress: Callable[[float], None] | None = None,
    onlookers: Sequence[Onlooker] = (),
    method: str = OURS,
    others: Sequence[str] = (),
) -> Review:
    """Read, replay and smooth one recording. Raises RecordingError or CanConfigError.

    Args:
        path: the recording.
        progress: called now and then with the share of the work that is done.
        onlookers: see all of it.
        method: another one than ours is not smoothed.
        others: methods beside ours; one that the recording does not suffice for is named in `refused`.
    """
    segments: Counter[Segment] = Counter()
    can_states: Counter[CanState] = Counter()
    events: list[Event] = []
    reference, smoothed_moves = ReferenceComparison(), SmoothedMoves()
    gathered = BatchReplay(settings_of(Recording(path))) if others else None

    def receive(topic: str, record: Recorded) -> None:
        if isinstance(record, Event):
            events.append(record)
        elif isinstance(record, RecordedDisplacement) and record.reading.is_reference:
            reference.add_reading(record.reading)
        if gathered is not None:
            gathered.see(record)
        for onlooker in onlookers:
            onlooker.replayed(topic, record)

    def take(step: SmoothedStep) -> None:
        segments[step.settled.segment] += 1
        can_states[step.settled.can_state] += 1
        reference.add_step(step)
        if method == OURS:
            smoothed_moves.add(step)
        for onlooker in onlookers:
            onlooker.step(step)

    replaying, reading = shares(progress, _REPLAYING, 1.0 - _REPLAYING)
    if method == OURS:
        tap = None if gathered is None else gathered.take
        result = replay(path, sink=receive, progress=replaying, smoothed=take, tap=tap)
    else:
        result = replay_method(path, method, sink=_steps_too(receive, take), progress=replaying)
    recording = Recording(path)
    reviewed = Review(
        recording.metadata,
        recording.complete,
        result,
        segments=segments,
        can_states=can_states,
        events=events,
        reference=reference,
        smoothed_moves=smoothed_moves,
    )
    if gathered is not None:
        _ask_others(reviewed, gathered, others, onlookers)
        gathered = None  # all samples
    decoder = SampleDecoder(result.settings)
    last_ns: int | None = None
    for count, (topic, record) in enumerate(recording.messages()):
        if reading is not None and count % 5000 == 0:
            reading(recording.share_read)
        for onlooker in onlookers:
            onlooker.recorded(topic, record)
        if isinstance(record, Burst) and record.fault is not Fault.NONE:
            reviewed.faults[record.fault.name.lower()] += 1
        elif isinstance(record, Reading) and record.is_frozen:
            reviewed.faults["frozen"] += 1
        elif isinstance(record, Identity | Jy901Identity) and decoder.is_mine(record):
            reviewed.identity = reviewed.identity or record.name
        elif isinstance(record, Health):
            reviewed.last_health = _parsed(record.json)
        if isinstance(record, Burst | Reading | ImuSample) and decoder.is_mine(record):
            t_ns = TOPICS[topic].time_ns(record)
            if last_ns is not None and t_ns - last_ns > GAP_S * 1e9:
                _note_gap(reviewed, last_ns, t_ns)
                for onlooker in onlookers:
                    onlooker.gap(last_ns, t_ns)
            last_ns = t_ns
    reviewed.messages, reviewed.lost = recording.counts, recording.lost
    return reviewed


def _ask_others(reviewed: Review, gathered: BatchReplay, names: Sequence[str], onlookers: Sequence[Onlooker]) -> None:
    for name in names:
        try:
            for output in gathered.outputs(name, reviewed.replayed.moves):
                for onlooker in onlookers:
                    onlooker.other(name, output)
        except ValueError as error:
            reviewed.refused[name] = str(error)


def _steps_too(receive: Sink, take: Callable[[SmoothedStep], None]) -> Sink:
    """For a method that is not smoothed."""

    def receive_all(topic: str, record: Recorded) -> None:
        receive(topic, record)
        if isinstance(record, Estimate):
            take(SmoothedStep(record, *(nan,) * 6))

    return receive_all


def _note_gap(reviewed: Review, last_ns: int, t_ns: int) -> None:
    if len(reviewed.gaps) < GAPS_SHOWN:
        reviewed.gaps.append(Gap(last_ns * 1e-9, (t_ns - last_ns) * 1e-9))
    else:
        reviewed.gaps_not_shown += 1


def _parsed(text: str) -> dict[str, Any] | None:
    try:
        health = json.loads(text)
    except ValueError:
        return None
    return health if isinstance(health, dict) else None
