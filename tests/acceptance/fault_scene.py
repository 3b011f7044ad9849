"""A short push of the virtual support in simulated time, with faults, and all that came of it."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daemon.recording import topics
from daemon.recording.metadata import describe
from daemon.recording.topics import Recorded
from daemon.recording.writer import RecordingWriter
from daemon.service.health import HealthBook, displacement_condition, kind_of
from daemon.settings import Settings
from daemon.simulation.run import SimulatedRun
from daemon.simulation.stream import SimulatedStream
from drivers.adis16448.burst import Burst, Fault
from drivers.adis16448.identity import Identity
from drivers.can.frame import Frame
from drivers.clock import VirtualClock
from drivers.condition import Condition, Wellness
from drivers.jy901.identity import Jy901Identity
from drivers.jy901.reading import Reading
from drivers.virtual.faults import FaultScript
from drivers.virtual.motion import PlannedMove, TrueMove
from drivers.virtual.support import VirtualSupport
from estimation.pipeline import Start
from estimation.records import Displacement, Estimate, Event, Move, TimeKind

SCRIPT = (PlannedMove(4.5, 0.12, 0.01453),)
SEED = 3
HEALTH_NS = 250_000_000


@dataclass
class Outcome:
    """Everything that one run received, estimated and said."""

    bursts: list[Burst] = field(default_factory=list)
    serial: list[Reading] = field(default_factory=list)  # of a JY901
    identities: list[Identity | Jy901Identity] = field(default_factory=list)
    frames: list[Frame] = field(default_factory=list)
    readings: list[Displacement] = field(default_factory=list)
    estimates: list[Estimate] = field(default_factory=list)  # provisional
    events: list[Event] = field(default_factory=list)
    moves: dict[int, Move] = field(default_factory=dict)
    said: list[tuple[float, str, Condition]] = field(default_factory=list)  # changes: time [s], part, condition
    imu: dict[str, Any] = field(default_factory=dict)  # counters at the end
    can: dict[str, Any] = field(default_factory=dict)
    displacement: dict[str, Any] = field(default_factory=dict)
    truth: tuple[TrueMove, ...] = ()
    path: tuple[NDArray[np.float64], NDArray[np.float64]] = field(default_factory=lambda: (np.empty(0), np.empty(0)))
    steps: int = 0  # turns of the acquisition
    recording: Path | None = None

    @property
    def good(self) -> list[Burst]:
        """Samples of the ADIS16448 that were believed."""
        return [burst for burst in self.bursts if burst.fault is Fault.NONE]

    @property
    def good_ns(self) -> list[int]:
        """Times of believed samples of either sensor."""
        return [one.t_ns for one in self.good] + [one.t_ns for one in self.serial if not one.is_frozen]

    @property
    def valid(self) -> list[Displacement]:
        """Displacement readings that nothing speaks against by themselves."""
        return [reading for reading in self.readings if reading.valid]

    def words(self, part: str) -> str:
        """All that was said of a part, in order."""
        return "\n".join(condition.what for _, name, condition in self.said if name == part and condition.what)

    def worst_sigmas(self, from_ns: int, to_ns: int) -> float:
        """Largest error of the provisional estimate meanwhile, in its own sigmas."""
        t_s, true_m = self.path
        meant = [e for e in self.estimates if from_ns <= e.t_ns < to_ns]
        errors = [e.displacement_m - float(np.interp(e.t_ns * 1e-9, t_s, true_m)) for e in meant]
        return max(abs(error) / e.sigma_m for error, e in zip(errors, meant, strict=True))

    def receive(self, topic: str, record: Recorded) -> None:
        """Sink of the stream."""
        if isinstance(record, Burst):
            self.bursts.append(record)
        elif isinstance(record, Reading):
            self.serial.append(record)
        elif isinstance(record, Identity | Jy901Identity):
            self.identities.append(record)
        elif isinstance(record, Frame):
            self.frames.append(record)
        elif isinstance(record, topics.RecordedDisplacement):
            if not record.reading.is_reference:
                self.readings.append(record.reading)
        elif isinstance(record, Estimate):
            if topic == topics.PROVISIONAL:
                self.estimates.append(record)
        elif isinstance(record, Event):
            self.events.append(record)
        elif isinstance(record, Move):
            self.moves[record.number] = record


def settings(channel: str, *, jy901: bool = False, **imu: Any) -> Settings:
    """A support with a short stroke, on twins."""
    return Settings.model_validate(
        {
            "imu": {"transport": "virtual"} | imu,
            "jy901": {"use": "instead" if jy901 else "no", "transport": "virtual"},
            "can": {
                "interface": "virtual",
                "channel": channel,
                "reference": {"message": "LaboratorySensor", "signal": "reference_stroke"},
            },
            "support": {"stroke_mm": 120},
        }
    )


def play(
    faults: FaultScript | None,
    *,
    script: tuple[PlannedMove, ...] = SCRIPT,
    seed: int = SEED,
    recording: Path | None = None,
    channel: str = "fault-scene",
    jy901: bool = False,
    **imu: Any,
) -> Outcome:
    """Run the support to the end of its motion."""
    chosen = settings(channel, jy901=jy901, **imu)
    clock = VirtualClock()
    support = VirtualSupport(seed, cycles=1, script=script)
    truth = support.truth()
    outcome = Outcome(truth=support.true_moves(), path=(truth.t_s, truth.displacement_m), recording=recording)
    book = HealthBook()
    writers: list[RecordingWriter] = []

    def receive(topic: str, record: Recorded) -> None:
        outcome.receive(topic, record)
        for writer in writers:
            writer.write(topic, record)

    run = SimulatedRun.of(chosen, support, clock, faults)
    with ExitStack() as stack:
        scene = stack.enter_context(SimulatedStream(chosen, run, clock, receive, Start(0.0)))
        sensor, bus, (decoder, *_) = scene.run.sensor, scene.run.bus, scene.stream.decoders
        assert bus is not None
        if recording is not None:
            description = describe("recording", chosen.model_dump_json())
            writer = RecordingWriter(recording, description, scene.stream.attachments())
            writers.append(stack.enter_context(writer))
        next_ns = 0
        while scene.step():
            outcome.steps += 1
            now_ns = clock.now_ns()
            if now_ns < next_ns:
                continue
            next_ns = now_ns + HEALTH_NS
            last = scene.stream.last
            parts = {
                "imu": sensor.condition,
                "can": bus.condition,
                "displacement": displacement_condition(
                    last.can_state if last else None, decoder.report(now_ns).condition
                ),
            }
            for part, condition in parts.items():
                before = book.entries.get(part)
                if before is None or kind_of(before.condition) != kind_of(condition):
                    outcome.said.append((now_ns * 1e-9, part, condition))
                book.note(part, condition, now_ns * 1e-9)
        scene.stream.finish()
        outcome.imu = asdict(sensor.counters)
        outcome.can = bus.report()
        outcome.displacement = decoder.report(clock.now_ns()).counters()
    return outcome


@cache
def without_faults(decimation: int = 0, *, jy901: bool = False) -> Outcome:
    """The same run when nothing goes wrong."""
    return play(FaultScript(), decimation_exponent=decimation, jy901=jy901)


def is_ill(condition: Condition) -> bool:
    """Whether people should look."""
    return condition.word in (Wellness.ILL, Wellness.WAITING)


def edge_samples(outcome: Outcome) -> list[int]:
    """Times of good samples that came with an edge."""
    return [burst.t_ns for burst in outcome.good if burst.time_kind is TimeKind.EDGE]
