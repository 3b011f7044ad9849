"""Displacement readings out of CAN frames, as described by a DBC file."""

from __future__ import annotations

import math
from collections.abc import Mapping

from cantools.database import DecodeError

from drivers.can.cia406 import EmergencyMonitor
from drivers.can.dbc import DisplacementSignal, find_signal
from drivers.can.frame import Frame, FrameId
from drivers.can.settings import CanConfigError, CanSettings, DisplacementSettings
from estimation.records import Displacement


class DisplacementDecoder:
    """Reads one displacement signal and says whether its source calls it valid.

    Counters: `malformed` (wrong length or undecodable: no value), `out_of_range` (value kept, not valid) and
    `invalid` (value kept, the source itself says that it is bad).

    Raises:
        CanConfigError: the settings do not fit the DBC file.
    """

    def __init__(self, settings: DisplacementSettings, is_reference: bool = False) -> None:
        self._source = find_signal(settings)
        self._minimum_m = settings.minimum_mm / 1000
        self._maximum_m = settings.maximum_mm / 1000
        self._is_reference = is_reference
        node = self._source.node_id
        self.emergency = None if node is None else EmergencyMonitor(node)
        self.malformed = 0
        self.out_of_range = 0
        self.invalid = 0

    @property
    def source(self) -> DisplacementSignal:
        """The signal that is read."""
        return self._source

    @property
    def arbitration_ids(self) -> tuple[FrameId, ...]:
        """All identifiers that `decode` wants to see, for filters."""
        return (self._source.frame_id, *(self.emergency.ids if self.emergency else ()))

    def decode(self, frame: Frame) -> Displacement | None:
        """The reading in `frame`, or None if the frame carries none. Never raises, whatever the bytes."""
        if frame.is_error or frame.is_remote:
            return None
        if frame.frame_id == self._source.frame_id:
            return self._decode_reading(frame)
        if self.emergency is not None:
            self.emergency.observe(frame)
        return None

    def _decode_reading(self, frame: Frame) -> Displacement | None:
        source = self._source
        if not source.accepts_length(len(frame.data)):
            return self._malformed(frame)
        try:
            values = source.message.decode_simple(frame.data, decode_choices=False)
        except DecodeError:
            # Of a multiplexed message this is a page that the DBC file leaves out, not a fault.
            return None if source.message.is_multiplexed() else self._malformed(frame)
        if source.signal.name not in values:
            return None  # another page of a multiplexed message
        physical = values[source.signal.name]
        assert isinstance(physical, int | float)
        if math.isnan(physical):
            return self._malformed(frame)
        value_m = physical / source.units_per_metre
        in_range = self._minimum_m <= value_m <= self._maximum_m
        trusted = self._is_trusted_by_its_source(values)
        self.out_of_range += not in_range
        self.invalid += not trusted
        return Displacement(frame.t_ns, value_m, in_range and trusted, self._is_reference)

    def _is_trusted_by_its_source(self, values: Mapping[str, object]) -> bool:
        if self.emergency is not None and self.emergency.pending_code is not None:
            return False
        flag = self._source.valid_signal
        return flag is None or values.get(flag.name) == self._source.valid_value

    def _malformed(self, frame: Frame) -> Displacement:
        self.malformed += 1
        return Displacement(frame.t_ns, math.nan, False, self._is_reference)


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
