"""What a recording holds and what it shows, as plain data."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from math import nan
from pathlib import Path
from typing import Any

from daemon.inertial import SampleDecoder
from daemon.offline.replaying.methods import replay_method
from daemon.offline.replaying.replay import ReplayResult, replay
from daemon.offline.replaying.step_table import COLUMNS, SMOOTHED_COLUMNS, cells, smoothed_cells, step_table
from daemon.offline.reviewing.reference_errors import ReferenceComparison
from daemon.offline.reviewing.smoothed_moves import SmoothedMoves
from daemon.recording.errors import refuse_same_file
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

    @property
    def sensor(self) -> str:
        """The inertial sensor, as the head of the file names it, or as it named itself later."""
        return self.metadata.get("sensor") or self.identity


GAPS_SHOWN = 20


def review(
    path: Path, progress: Callable[[int], None] | None = None, table: Path | None = None, method: str = OURS
) -> Review:
    """Read, replay and smooth one recording. Raises RecordingError or CanConfigError.

    Args:
        path: the recording.
        progress: called now and then with the number of messages read.
        table: gets a row for each step, settled and smoothed.
        method: another one than ours is not smoothed.
    """
    segments: Counter[Segment] = Counter()
    can_states: Counter[CanState] = Counter()
    events: list[Event] = []
    reference, smoothed_moves = ReferenceComparison(), SmoothedMoves()

    def receive(_topic: str, record: Recorded) -> None:
        if isinstance(record, Event):
            events.append(record)
        elif isinstance(record, RecordedDisplacement) and record.reading.is_reference:
            reference.add_reading(record.reading)

    with ExitStack() as stack:
        add_row = None
        if table is not None:
            refuse_same_file(path, table)
            columns, cells_of = (SMOOTHED_COLUMNS, smoothed_cells) if method == OURS else (COLUMNS, _settled_cells)
            add_row = stack.enter_context(step_table(table, columns))

        def take(step: SmoothedStep) -> None:
            segments[step.settled.segment] += 1
            can_states[step.settled.can_state] += 1
            reference.add_step(step)
            if method == OURS:
                smoothed_moves.add(step)
            if add_row is not None:
                add_row(cells_of(step))

        if method == OURS:
            result = replay(path, sink=receive, progress=progress, smoothed=take)
        else:
            result = replay_method(path, method, sink=_steps_too(receive, take), progress=progress)
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
    decoder = SampleDecoder(result.settings)
    last_ns: int | None = None
    for topic, record in recording.messages():
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
            last_ns = t_ns
    reviewed.messages, reviewed.lost = recording.counts, recording.lost
    return reviewed


def _settled_cells(step: SmoothedStep) -> Sequence[str]:
    return cells(step.settled)


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
