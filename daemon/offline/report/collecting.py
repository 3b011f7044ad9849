"""What report and pictures show of a recording, in compact arrays: some 20 MB an hour."""

from __future__ import annotations

import json
from array import array
from collections import Counter, deque
from dataclasses import dataclass, field
from typing import NamedTuple

from daemon.inertial import SampleDecoder
from daemon.offline.reviewing.onlooker import Onlooker
from daemon.recording import topics
from daemon.recording.topics import Health, LogLine, Recorded, RecordedDisplacement
from daemon.settings import Settings
from drivers.adis16448.burst import Burst, Fault
from drivers.can.frame import Frame
from drivers.jy901.reading import Reading
from estimation.mount.axes import Mount
from estimation.records import CanState, Displacement, Estimate, Event, ImuSample, Move, ReadingFault, Segment
from estimation.smoothing.settled_smoother import SmoothedStep

SEGMENTS, STATES = tuple(Segment), tuple(CanState)
_SEGMENT_CODES = {segment: code for code, segment in enumerate(SEGMENTS)}
_STATE_CODES = {state: code for code, state in enumerate(STATES)}
# What may be wrong with a reading: by itself, or in the eyes of the estimator. 0 is good.
_FAULTS = tuple(fault for fault in ReadingFault if fault is not ReadingFault.NONE)
_DOUBTS = tuple(state for state in CanState if state is not CanState.OK)
READING_WORDS = ("good", *(fault.name.lower().replace("_", " ") for fault in _FAULTS), *map(str, _DOUBTS))
_READING_CODES: dict[ReadingFault | CanState, int] = {
    ReadingFault.NONE: 0,
    CanState.OK: 0,
    **{kind: code for code, kind in enumerate((*_FAULTS, *_DOUBTS), start=1)},
}
PARTS = ("imu", "jy901", "can", "displacement", "estimator", "recorder", "loop")
MOST_LINES = 3000  # of events, warnings, gaps, changes of a part: beyond, they are counted
_WARNING = 30
_TILT_EVERY = 8  # samples
_SECOND_NS = 1_000_000_000


def floats() -> array[float]:
    """An array of 32-bit floats: seven digits, more than any sensor here has."""
    return array("f")


@dataclass(slots=True)
class Steps:
    """Settled steps, a column each: mm, mm/s, m/s²."""

    t_ns: array[int] = field(default_factory=lambda: array("q"))
    stroke: array[float] = field(default_factory=floats)
    sigma: array[float] = field(default_factory=floats)
    velocity: array[float] = field(default_factory=floats)
    velocity_sigma: array[float] = field(default_factory=floats)
    acceleration: array[float] = field(default_factory=floats)
    chart_lower: array[float] = field(default_factory=floats)
    chart_upper: array[float] = field(default_factory=floats)
    innovation: array[float] = field(default_factory=floats)
    gate: array[float] = field(default_factory=floats)
    smoothed: array[float] = field(default_factory=floats)
    segment: array[int] = field(default_factory=lambda: array("B"))  # places in SEGMENTS
    state: array[int] = field(default_factory=lambda: array("B"))  # places in STATES

    def add(self, step: SmoothedStep) -> None:
        """Take the next one."""
        settled = step.settled
        self.t_ns.append(settled.t_ns)
        self.stroke.append(settled.displacement_m * 1e3)
        self.sigma.append(settled.sigma_m * 1e3)
        self.velocity.append(settled.velocity_m_s * 1e3)
        self.velocity_sigma.append(settled.velocity_sigma_m_s * 1e3)
        self.acceleration.append(settled.acceleration_m_s2)
        self.chart_lower.append(settled.chart_lower_m_s2)
        self.chart_upper.append(settled.chart_upper_m_s2)
        self.innovation.append(settled.innovation_m * 1e3)
        self.gate.append(settled.gate_m * 1e3)
        self.smoothed.append(step.displacement_m * 1e3)
        self.segment.append(_SEGMENT_CODES[settled.segment])
        self.state.append(_STATE_CODES[settled.can_state])


@dataclass(slots=True)
class Readings:
    """Readings of one displacement sensor: time, mm, place in READING_WORDS."""

    t_ns: array[int] = field(default_factory=lambda: array("q"))
    value: array[float] = field(default_factory=floats)
    word: array[int] = field(default_factory=lambda: array("B"))

    def add(self, reading: Displacement, word: ReadingFault | CanState) -> None:
        """Take the next one."""
        self.t_ns.append(reading.t_ns)
        self.value.append(reading.value_m * 1e3)
        self.word.append(_READING_CODES[word])


@dataclass(slots=True)
class Course:
    """The stroke by another method, and its moves."""

    t_ns: array[int] = field(default_factory=lambda: array("q"))
    stroke: array[float] = field(default_factory=floats)
    moves: list[Move] = field(default_factory=list)


class State(NamedTuple):
    """How a part is from a time on."""

    t_ns: int
    word: str
    what: str


class Line(NamedTuple):
    """Something that was said."""

    t_ns: int
    kind: str  # event, warning, error
    text: str


@dataclass(slots=True)
class Tilt:
    """Specific force in support axes, summed up second by second."""

    sums: dict[int, list[float]] = field(default_factory=dict)

    def add(self, second: int, force: tuple[float, float, float]) -> None:
        """Take a sample."""
        sums = self.sums.setdefault(second, [0.0, 0.0, 0.0])
        for axis in range(3):
            sums[axis] += force[axis]


class Collector(Onlooker):
    """Gathers it while the recording is reviewed."""

    def __init__(self, settings: Settings) -> None:
        self.steps = Steps()
        self.observed, self.reference = Readings(), Readings()
        self.others: dict[str, Course] = {}
        self.tilt = Tilt()
        self.samples: Counter[int] = Counter()  # good ones, by second
        self.bad_samples: Counter[int] = Counter()
        self.frames: Counter[int] = Counter()  # received
        self.sent: Counter[int] = Counter()
        self.error_frames: Counter[int] = Counter()
        self.gaps: list[tuple[int, int]] = []
        self.parts: dict[str, list[State]] = {part: [] for part in PARTS}
        self.lines: list[Line] = []
        self.lines_not_shown = 0
        self.last_health_ns: int | None = None
        self.first_ns: int | None = None
        self.last_ns: int | None = None
        self._decoder = SampleDecoder(settings)
        self._mount = Mount(settings.mount, with_tilt=False)
        self._count = 0
        self._waiting: deque[Displacement] = deque()

    def replayed(self, topic: str, record: Recorded) -> None:
        """Inputs, settled steps, events."""
        if isinstance(record, Burst | Reading | ImuSample):
            if self._decoder.is_mine(record):
                self._see(record.t_ns)
                self._take_sample(record)
        elif isinstance(record, Frame):
            self._see(record.t_ns)
            (self.error_frames if record.is_error else self.frames)[record.t_ns // _SECOND_NS] += 1
        elif isinstance(record, RecordedDisplacement):
            self._see(record.reading.t_ns)
            if record.reading.is_reference:
                self.reference.add(record.reading, record.reading.fault)
            else:
                self._waiting.append(record.reading)
        elif isinstance(record, Estimate):
            if topic == topics.SETTLED:
                self._judge_readings(record)
        elif isinstance(record, Event):
            self._say(Line(record.t_ns, "event", record.what))

    def step(self, step: SmoothedStep) -> None:
        """A settled step."""
        self.steps.add(step)

    def recorded(self, topic: str, record: Recorded) -> None:
        """Log, health, frames sent."""
        if isinstance(record, LogLine):
            if record.level >= _WARNING:
                self._say(Line(record.t_ns, "error" if record.level > _WARNING else "warning", record.text))
        elif isinstance(record, Health):
            self._take_health(record)
        elif isinstance(record, Frame) and topic == topics.CAN_TX:
            self.sent[record.t_ns // _SECOND_NS] += 1

    def gap(self, last_ns: int, next_ns: int) -> None:
        """A hole in the inertial samples."""
        if len(self.gaps) < MOST_LINES:
            self.gaps.append((last_ns, next_ns))

    def other(self, method: str, output: Estimate | Move) -> None:
        """What another method says."""
        course = self.others.setdefault(method, Course())
        if isinstance(output, Move):
            course.moves.append(output)
        else:
            course.t_ns.append(output.t_ns)
            course.stroke.append(output.displacement_m * 1e3)

    def finish(self) -> None:
        """The last readings, behind the last step, keep what they say of themselves; lines in order of time."""
        while self._waiting:
            reading = self._waiting.popleft()
            self.observed.add(reading, reading.fault)
        self.lines.sort(key=lambda line: line.t_ns)

    def _see(self, t_ns: int) -> None:
        self.first_ns = t_ns if self.first_ns is None else min(self.first_ns, t_ns)
        self.last_ns = t_ns if self.last_ns is None else max(self.last_ns, t_ns)

    def _take_sample(self, record: Burst | Reading | ImuSample) -> None:
        second = record.t_ns // _SECOND_NS
        if (isinstance(record, Burst) and record.fault is not Fault.NONE) or (
            isinstance(record, Reading) and record.is_frozen
        ):
            self.bad_samples[second] += 1
            return
        self.samples[second] += 1
        self._count += 1
        if self._count % _TILT_EVERY == 0 and (sample := self._decoder.sample(record)) is not None:
            self.tilt.add(second, self._mount.to_support(sample.accel))

    def _judge_readings(self, settled: Estimate) -> None:
        """A reading is what the first settled step behind it takes the sensor for."""
        while self._waiting and self._waiting[0].t_ns <= settled.t_ns:
            reading = self._waiting.popleft()
            self.observed.add(reading, settled.can_state if reading.valid else reading.fault)

    def _take_health(self, record: Health) -> None:
        try:
            health = json.loads(record.json)
        except ValueError:
            return
        if not isinstance(health, dict):
            return
        self.last_health_ns = record.t_ns
        for part, states in self.parts.items():
            told = health.get(part)
            if not isinstance(told, dict) or "state" not in told:
                continue
            word, what = str(told["state"]), str(told.get("what") or "")
            if (not states or states[-1].word != word) and len(states) < MOST_LINES:
                states.append(State(record.t_ns, word, what))

    def _say(self, line: Line) -> None:
        if len(self.lines) < MOST_LINES:
            self.lines.append(line)
        else:
            self.lines_not_shown += 1
