"""Displacement readings out of CAN frames, as described by a DBC file, each with what speaks against it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from cantools.database import DecodeError
from pydantic import TypeAdapter

from drivers.can import cia406
from drivers.can.cia301 import emergency_words
from drivers.can.cia406 import NodeWatch
from drivers.can.dbc import DisplacementSignal, find_signal
from drivers.can.displacement_report import DisplacementReport, Lapse, source_condition
from drivers.can.frame import Frame, FrameId
from drivers.can.frame_watch import CounterWatch, FrameRate
from drivers.can.settings import CanConfigError, CanSettings, DisplacementSettings
from estimation.records import Displacement, ReadingFault

_NOT_AVAILABLE = 0xFF00  # SAE J1939-71, 16 bits; below it, the codes mean "error"


@dataclass(slots=True)
class _Memory:
    """What one frame leaves behind for the next ones; a recording that goes on in a new file needs it."""

    counter: CounterWatch = field(default_factory=CounterWatch)
    rate: FrameRate = field(default_factory=FrameRate)
    node: NodeWatch = field(default_factory=NodeWatch)


_MEMORY = TypeAdapter(_Memory)


class DisplacementDecoder:
    """Reads one displacement signal and says what its frame shows to be wrong.

    Checked in this order: length and number (MALFORMED: no value), checksum (CHECKSUM), message counter (REPEATED),
    the source's own word (INVALID), limits (OUT_OF_RANGE). `faults` counts each kind.

    Raises:
        CanConfigError: the settings do not fit the DBC file.
    """

    def __init__(self, settings: DisplacementSettings, is_reference: bool = False) -> None:
        self._source = find_signal(settings)
        self._settings = settings
        self._minimum_m = settings.minimum_mm / 1000
        self._maximum_m = settings.maximum_mm / 1000
        self._timeout_ns = round(settings.timeout_ms * 1e6)
        self._is_reference = is_reference
        self._memory = _Memory()
        self._lapse: Lapse | None = None
        self.frames = 0  # of the message, bad ones included
        self.faults: dict[ReadingFault, int] = {fault: 0 for fault in ReadingFault if fault}

    @property
    def source(self) -> DisplacementSignal:
        """The signal that is read."""
        return self._source

    @property
    def arbitration_ids(self) -> tuple[FrameId, ...]:
        """All identifiers that `decode` wants to see, for filters."""
        node = self._source.node_id
        if node is None:
            return (self._source.frame_id,)
        return (self._source.frame_id, cia406.emergency_id(node), cia406.heartbeat_id(node))

    def decode(self, frame: Frame) -> Displacement | None:
        """The reading in `frame`, or None if the frame carries none. Never raises, whatever the bytes."""
        if frame.is_error or frame.is_remote:
            return None
        if frame.frame_id == self._source.frame_id:
            self.frames += 1
            self._memory.rate.see(frame.t_ns, self._timeout_ns)
            return self._decode_message(frame)
        if self._source.node_id is not None:
            self._memory.node.observe(frame, self._source.node_id)
        return None

    def report(self, now_ns: int) -> DisplacementReport:
        """How the source is at `now_ns`."""
        memory, faults = self._memory, self.faults
        last_ns, rate_hz = memory.rate.last_ns, memory.rate.recent_hz
        return DisplacementReport(
            condition=source_condition(
                self._source, memory.node, memory.rate, memory.counter, self._lapse, now_ns, self._timeout_ns
            ),
            frames=self.frames,
            malformed=faults[ReadingFault.MALFORMED],
            checksum=faults[ReadingFault.CHECKSUM],
            repeated=faults[ReadingFault.REPEATED],
            invalid=faults[ReadingFault.INVALID],
            out_of_range=faults[ReadingFault.OUT_OF_RANGE],
            lost_frames=memory.counter.lost_frames,
            crowded_frames=memory.rate.crowded_frames,
            emergencies=memory.node.emergencies,
            malformed_emergencies=memory.node.malformed_emergencies,
            rate_hz=None if rate_hz is None else round(rate_hz, 2),
            age_s=None if last_ns is None else round((now_ns - last_ns) * 1e-9, 3),
        )

    def remembered(self) -> dict[str, Any]:
        """All that earlier frames mean for later ones, as plain values for JSON."""
        return asdict(self._memory)

    def recall(self, memory: object) -> None:
        """Go on from what `remembered` gave.

        Raises:
            ValueError: `memory` is damaged.
        """
        recalled = _MEMORY.validate_python(memory)
        if asdict(recalled) != memory:
            raise ValueError("the memory of a displacement decoder is not complete")
        self._memory = recalled

    def _decode_message(self, frame: Frame) -> Displacement | None:
        source = self._source
        if not source.accepts_length(frame):
            wanted = source.message.length
            what = f"frames {source.frame_id} have {len(frame.data)} bytes instead of {wanted}: wrong DBC or identifier"
            return self._reading(frame, math.nan, ReadingFault.MALFORMED, what)
        try:
            raw: Mapping[str, Any] = source.message.decode_simple(frame.data, decode_choices=False, scaling=False)
        except DecodeError as error:
            if source.message.is_multiplexed():
                return None  # a page that the DBC file leaves out
            what = f"frames {source.frame_id} cannot be decoded: {error}"
            return self._reading(frame, math.nan, ReadingFault.MALFORMED, what)
        fault, what = self._check_protection(frame, raw)
        memory = self._memory
        memory.rate.signs += fault is not ReadingFault.NONE or memory.counter.lost_ns == frame.t_ns
        if source.signal.name not in raw:  # another page of a multiplexed message
            self._note(frame, fault, what)
            return None
        number = raw[source.signal.name]
        if math.isnan(number):
            what = f'signal "{source.signal.name}" of frames {source.frame_id} holds no number'
            return self._reading(frame, math.nan, ReadingFault.MALFORMED, what)
        value = source.signal.conversion.raw_to_scaled(number, decode_choices=False)
        assert isinstance(value, int | float)
        value_m = value / source.units_per_metre
        if fault is ReadingFault.NONE:
            fault, what = self._check_value(raw, number, value_m)
        return self._reading(frame, value_m, fault, what)

    def _check_protection(self, frame: Frame, raw: Mapping[str, Any]) -> tuple[ReadingFault, str]:
        """What checksum and message counter say; every page of a multiplexed message moves the counter."""
        source, memory = self._source, self._memory
        if source.checksum is not None and source.checksum.name in raw and not source.checksum.fits(frame.data):
            return ReadingFault.CHECKSUM, f"the checksum of frames {source.frame_id} does not fit"
        if source.counter is not None and source.counter.name in raw:
            number = raw[source.counter.name]
            if memory.counter.stands_still(number, frame.t_ns, source.counter, self._timeout_ns):
                return ReadingFault.REPEATED, "the message counter stands still: the controller repeats an old frame"
        return ReadingFault.NONE, ""

    def _check_value(self, raw: Mapping[str, Any], number: float, value_m: float) -> tuple[ReadingFault, str]:
        objection = self._objection_of_source(raw, number)
        if objection:
            return ReadingFault.INVALID, f"the source says: {objection}"
        if not self._minimum_m <= value_m <= self._maximum_m:
            settings = self._settings
            limits = f"{settings.minimum_mm:g} to {settings.maximum_mm:g} mm"
            return ReadingFault.OUT_OF_RANGE, f"the source shows {value_m * 1000:.0f} mm, outside {limits}"
        return ReadingFault.NONE, ""

    def _objection_of_source(self, raw: Mapping[str, Any], number: float) -> str:
        """Why the source itself does not want its value believed; empty if it does."""
        source, node = self._source, self._memory.node
        if node.error_code is not None:
            return emergency_words(node.error_code, node.error_register)
        if source.lowest_code is not None and number >= source.lowest_code:
            meaning = "not available" if number >= _NOT_AVAILABLE else "error"
            return f"{meaning} ({source.signal.name} = 0x{number:04X})"
        flag = source.valid_signal
        if flag is None or raw[flag.name] == source.valid_value:
            return ""
        state = raw[flag.name]
        word = (flag.choices or {}).get(state)
        meaning = "not valid" if word is None else str(word).replace("_", " ")
        return f"{meaning} ({flag.name} = {state})"

    def _reading(self, frame: Frame, value_m: float, fault: ReadingFault, what: str) -> Displacement:
        self._note(frame, fault, what)
        return Displacement(frame.t_ns, value_m, fault, self._is_reference)

    def _note(self, frame: Frame, fault: ReadingFault, what: str) -> None:
        if fault is not ReadingFault.NONE:
            self.faults[fault] += 1
            self._lapse = Lapse(frame.t_ns, fault, what)


def build_decoders(settings: CanSettings) -> tuple[DisplacementDecoder, DisplacementDecoder | None]:
    """The decoders of the observed and the reference displacement.

    Raises:
        CanConfigError: a DBC file does not fit, both read the same signal, or the estimate frame would use
            the identifier of a frame that we read.
    """
    observed = DisplacementDecoder(settings.displacement)
    reference = None if settings.reference is None else DisplacementDecoder(settings.reference, True)
    if reference is not None and (
        reference.source.frame_id == observed.source.frame_id
        and reference.source.signal.name == observed.source.signal.name
    ):
        raise CanConfigError(
            f'`displacement` and `reference` both read signal "{observed.source.signal.name}" of frame '
            f"{observed.source.frame_id}: name the laboratory sensor's message and signal in `reference`."
        )
    published = FrameId(settings.publish.arbitration_id, settings.publish.extended)
    taken = {*observed.arbitration_ids, *(reference.arbitration_ids if reference else ())}
    if settings.publish.enabled and published in taken:
        raise CanConfigError(
            f"`publish.arbitration_id` {published} is the identifier of a frame that is read: choose a free one."
        )
    return observed, reference
