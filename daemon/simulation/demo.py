"""One cycle of the virtual support in simulated time, measured by the same code as a real one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from daemon.recording import topics
from daemon.recording.metadata import describe
from daemon.recording.topics import Recorded
from daemon.recording.writer import RecordingWriter
from daemon.settings import Settings
from daemon.simulation.run import SimulatedRun
from daemon.simulation.stream import SimulatedStream
from daemon.simulation.virtual import virtual_support
from drivers.clock import VirtualClock
from drivers.virtual.faults import FaultScript
from drivers.virtual.motion import TrueMove
from estimation.records import Displacement, Estimate, Event, Move, MoveKind


@dataclass(slots=True)
class DemoResult:
    """What was estimated, and the truth."""

    moves: list[Move] = field(default_factory=list)
    truth: tuple[TrueMove, ...] = ()
    duration_s: float = 0.0
    settled: list[Estimate] = field(default_factory=list)
    observed: list[Displacement] = field(default_factory=list)
    reference: list[Displacement] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)

    def move_of(self, true: TrueMove) -> Move | None:
        """The found move that is this true one: same direction, at the same time."""
        kind = MoveKind.PUSH if true.end_m > true.start_m else MoveKind.RETRACT
        met = [
            move
            for move in self.moves
            if move.kind is kind and move.onset_ns < true.stop_s * 1e9 and move.stop_ns > true.onset_s * 1e9
        ]
        return met[-1] if met else None


ImuChoice = Literal["adis16448", "jy901", "both"]
_USE: dict[ImuChoice, str] = {"adis16448": "no", "jy901": "instead", "both": "beside"}


def demo_settings(seed: int, imu: ImuChoice = "adis16448") -> Settings:
    """The default configuration on twins instead of devices."""
    return Settings.model_validate(
        {
            "imu": {"transport": "virtual"},
            "jy901": {"use": _USE[imu], "transport": "virtual"},
            "can": {
                "interface": "virtual",
                "channel": "ramstroke-demo",
                "reference": {"message": "LaboratorySensor", "signal": "reference_stroke"},
            },
            "simulation": {"seed": seed},
        }
    )


def run_demo(
    settings: Settings,
    recording: Path,
    progress: Callable[[float], None],
    faults: FaultScript | None = None,
    rest_s: float = 10.0,
) -> DemoResult:
    """Play one cycle into `recording`, `rest_s` of rest before it; `progress` hears the share done.

    Raises:
        RecordingError: the recording cannot be written.
    """
    clock = VirtualClock()
    support = virtual_support(settings, cycles=1, rest_s=rest_s)
    duration_ns = support.truth().t_s[-1] * 1e9
    result = DemoResult(truth=support.true_moves(), duration_s=duration_ns * 1e-9)
    sensor = "JY901" if settings.jy901.use == "instead" else "ADIS16448"
    metadata = describe("recording", settings.model_dump_json(), sensor=f"virtual {sensor}")
    # The stream must exist before the file (its snapshot stands at the head) and writes into it.
    written: list[RecordingWriter] = []

    def receive(topic: str, record: Recorded) -> None:
        written[0].write(topic, record)
        _collect(result, topic, record)

    run = SimulatedRun.of(settings, support, clock, faults)
    with (
        SimulatedStream(settings, run, clock, receive) as simulated,
        RecordingWriter(recording, metadata, simulated.stream.attachments()) as writer,
    ):
        written.append(writer)
        simulated.play(lambda now_ns: progress(min(now_ns / duration_ns, 1.0)))
    return result


def _collect(result: DemoResult, topic: str, record: Recorded) -> None:
    if isinstance(record, Move):
        if result.moves and result.moves[-1].number == record.number:
            result.moves.pop()
        result.moves.append(record)
    elif isinstance(record, Event):
        result.events.append(record)
    elif topic == topics.SETTLED and isinstance(record, Estimate):
        result.settled.append(record)
    elif isinstance(record, topics.RecordedDisplacement):
        readings = result.reference if record.reading.is_reference else result.observed
        readings.append(record.reading)
