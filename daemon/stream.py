"""The one way from received records to outputs, the same live, simulated and replayed: decode, estimate, pass on."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict

from daemon.inertial import SampleDecoder
from daemon.machine import machine_of
from daemon.recording import topics
from daemon.recording.metadata import LEARNED, SNAPSHOT
from daemon.recording.topics import Recorded, RecordedDisplacement
from daemon.settings import Settings
from drivers.acquisition import AnyIdentity
from drivers.adis16448.burst import Burst
from drivers.adis16448.identity import Identity
from drivers.can.displacement import build_decoders
from drivers.can.frame import Frame
from drivers.jy901.identity import Jy901Identity
from drivers.jy901.reading import Reading
from estimation.learned import Learned
from estimation.pipeline import Pipeline, Start
from estimation.records import Displacement, Estimate, ImuSample, Move, Output, Record, SensorChange, Tick, Tier

Sink = Callable[[str, Recorded], None]

# What a replay feeds again; everything else in a recording follows from these.
INPUTS = (
    topics.IMU_IDENTITY,
    topics.IMU_RAW,
    topics.IMU_SAMPLE,
    topics.JY901_IDENTITY,
    topics.JY901,
    topics.CAN_RX,
    topics.OBSERVED,
    topics.REFERENCE,
    topics.TICK,
)


class Stream:
    """Takes every received record once, in order, and gives it and what follows from it to the sink.

    Args:
        settings: of the program.
        sink: called with topic and record, inputs first, then what they brought about.
        start: what is known beforehand.
        tap: called with every record that the estimator gets, before it.

    Raises:
        CanConfigError: the CAN settings do not fit their DBC files.
        ValueError: what was learned belongs to another machine.
    """

    def __init__(
        self,
        settings: Settings,
        sink: Sink,
        start: Start | None = None,
        tap: Callable[[Record], object] | None = None,
    ) -> None:
        self.settings = settings
        self._sink = sink
        self._tap = tap
        self._machine = machine_of(settings)
        if start is not None and start.learned is not None:
            self._machine = self._machine.named_as(start.learned.machine)
        self._imu = SampleDecoder(settings)
        observed, reference = build_decoders(settings.can) if settings.can.enabled else (None, None)
        self.decoders = [decoder for decoder in (observed, reference) if decoder is not None]
        self.pipeline = Pipeline(
            settings.mount,
            settings.support,
            settings.estimator,
            latency_s=settings.can.displacement.latency_ms / 1e3,
            timeout_s=settings.can.displacement.timeout_ms / 1e3,
            start=start,
        )
        self.samples = 0  # good inertial samples
        self.bad_bursts = 0  # and impossible or frozen samples
        self.foreign_samples = 0  # of a sensor that the settings do not estimate from
        self.identity: AnyIdentity | None = None  # of the inertial sensor
        self.last_sample_ns: int | None = None
        self.last: Estimate | None = None  # provisional

    def take(self, topic: str, record: Recorded) -> None:
        """Take one input record."""
        self._sink(topic, record)
        if isinstance(record, Burst | Reading | ImuSample):
            if self._imu.is_mine(record):
                self._take_sample(self._imu.sample(record))
            else:
                self.foreign_samples += 1
        elif isinstance(record, Identity | Jy901Identity):
            if self._imu.is_mine(record):
                self._meet(record)
        elif isinstance(record, Frame):
            self._take_frame(record)
        elif isinstance(record, RecordedDisplacement):
            if not record.decoded:
                self._feed(record.reading)
        elif isinstance(record, Tick):
            self._feed(record)

    def finish(self) -> None:
        """End of the data: let the estimator settle what is open."""
        self._emit(self.pipeline.finish())

    def learned(self) -> Learned | None:
        """What another run may begin with; None if nothing was learned yet."""
        part = "" if self.identity is None else self.identity.name
        return self.pipeline.learned(self._machine.model_copy(update={"inertial_part": part}).named_as(self._machine))

    def attachments(self) -> dict[str, bytes]:
        """The present state, as it stands at the head of a recording that begins now."""
        learned = self.learned()
        return {SNAPSHOT: self.snapshot(), LEARNED: b"{}" if learned is None else learned.model_dump_json().encode()}

    def snapshot(self) -> bytes:
        """State of everything that remembers, as JSON."""
        decoders = [decoder.remembered() for decoder in self.decoders]
        identity = None if self.identity is None else asdict(self.identity)
        head = json.dumps({"decoders": decoders, "identity": identity})
        return head.encode() + b"\n" + self.pipeline.snapshot()

    def restore(self, snapshot: bytes) -> None:
        """Continue from a snapshot. Raises ValueError on damaged or foreign bytes."""
        head, _, state = snapshot.partition(b"\n")
        try:
            remembered = json.loads(head)
            memories, identity = remembered["decoders"], remembered["identity"]
            kind = Jy901Identity if self._imu.is_jy901 else Identity
            self.identity = None if identity is None else kind(**identity)
            for decoder, memory in zip(self.decoders, memories, strict=True):
                decoder.recall(memory)
        except (LookupError, TypeError, RecursionError) as error:
            raise ValueError("not a snapshot of this program") from error
        self.pipeline.restore(state)

    def _meet(self, identity: AnyIdentity) -> None:
        """The sensor may be the one that spoke before, started anew, or another one."""
        known, self.identity = self.identity, identity
        if known is not None and not identity.is_same_part(known):
            self._feed(SensorChange(identity.t_ns))

    def _take_frame(self, frame: Frame) -> None:
        for decoder in self.decoders:
            reading = decoder.decode(frame)
            if reading is not None:
                topic = topics.REFERENCE if reading.is_reference else topics.OBSERVED
                self._sink(topic, RecordedDisplacement(reading, decoded=True))
                self._feed(reading)

    def _take_sample(self, sample: ImuSample | None) -> None:
        if sample is None:
            self.bad_bursts += 1
            return
        self.samples += 1
        self.last_sample_ns = sample.t_ns
        self._feed(sample)

    def _feed(self, record: Record) -> None:
        if isinstance(record, Displacement) and record.is_reference:
            return
        if self._tap is not None:
            self._tap(record)
        outputs = self.pipeline.feed(record)
        if outputs:
            self._emit(outputs)

    def _emit(self, outputs: list[Output]) -> None:
        for output in outputs:
            if isinstance(output, Estimate):
                if output.tier is Tier.PROVISIONAL:
                    self.last = output
                    self._sink(topics.PROVISIONAL, output)
                else:
                    self._sink(topics.SETTLED, output)
            elif isinstance(output, Move):
                self._sink(topics.MOVES, output)
            else:
                self._sink(topics.EVENTS, output)
