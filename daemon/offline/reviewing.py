"""What a recording holds and what it shows, as plain data."""

from __future__ import annotations

import json
from bisect import bisect_left
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from daemon.offline.replay import ReplayResult, replay
from daemon.recording import topics
from daemon.recording.reader import Recording
from daemon.recording.topics import TOPICS, Health, Recorded, RecordedDisplacement
from drivers.adis16448.burst import Burst, Fault
from estimation.records import CanState, Displacement, Estimate, Event, Segment, Tier

GAP_S = 0.05
SIGMAS_95 = 1.96


@dataclass(slots=True)
class Gap:
    """A hole in the inertial samples."""

    at_s: float
    length_s: float


@dataclass(slots=True)
class ReferenceErrors:
    """Settled estimate minus reference, at the reference's readings."""

    readings: int
    mean_mm: float
    rms_mm: float
    worst_mm: float
    inside_95: float  # share within the stated 95 %


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
    reference: ReferenceErrors | None = None


GAPS_SHOWN = 20


def review(path: Path, progress: Callable[[int], None] | None = None) -> Review:
    """Read and replay one recording. Raises RecordingError or CanConfigError."""
    settled: list[Estimate] = []
    references: list[Displacement] = []
    events: list[Event] = []

    def receive(_topic: str, record: Recorded) -> None:
        if isinstance(record, Estimate):
            if record.tier is Tier.SETTLED:
                settled.append(record)
        elif isinstance(record, Event):
            events.append(record)
        elif isinstance(record, RecordedDisplacement) and record.reading.is_reference:
            references.append(record.reading)

    result = replay(path, sink=receive, progress=progress)
    recording = Recording(path)
    reviewed = Review(recording.metadata, recording.complete, result, events=events)
    last_ns: int | None = None
    for topic, record in recording.messages():
        if isinstance(record, Burst) and record.fault is not Fault.NONE:
            reviewed.faults[record.fault.name.lower()] += 1
        elif isinstance(record, Health):
            reviewed.last_health = _parsed(record.json)
        if topic in (topics.IMU_RAW, topics.IMU_SAMPLE):
            t_ns = TOPICS[topic].time_ns(record)
            if last_ns is not None and t_ns - last_ns > GAP_S * 1e9:
                _note_gap(reviewed, last_ns, t_ns)
            last_ns = t_ns
    reviewed.messages, reviewed.lost = recording.counts, recording.lost
    reviewed.segments.update(estimate.segment for estimate in settled)
    reviewed.can_states.update(estimate.can_state for estimate in settled)
    reviewed.reference = _against_reference(settled, references)
    return reviewed


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


def _against_reference(settled: list[Estimate], references: list[Displacement]) -> ReferenceErrors | None:
    """Errors at the reference's times, the estimate drawn straight between its steps."""
    times = [estimate.t_ns for estimate in settled]
    errors_mm, inside = [], 0
    for reading in references:
        i = bisect_left(times, reading.t_ns)
        if not reading.valid or i == 0 or i == len(times):
            continue
        before, after = settled[i - 1], settled[i]
        share = (reading.t_ns - before.t_ns) / (after.t_ns - before.t_ns)
        estimate_m = before.displacement_m + share * (after.displacement_m - before.displacement_m)
        error_m = estimate_m - reading.value_m
        errors_mm.append(error_m * 1e3)
        inside += abs(error_m) <= SIGMAS_95 * max(before.sigma_m, after.sigma_m)
    if not errors_mm:
        return None
    n = len(errors_mm)
    return ReferenceErrors(
        readings=n,
        mean_mm=sum(errors_mm) / n,
        rms_mm=(sum(e * e for e in errors_mm) / n) ** 0.5,
        worst_mm=max(errors_mm, key=abs),
        inside_95=inside / n,
    )
