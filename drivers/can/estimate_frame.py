"""Our estimate as one classic CAN frame: 8 bytes, laid out as in config/dbc/ramstroke_estimate.dbc."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

from drivers.can.checksums import crc8_j1850
from drivers.can.frame import Frame
from drivers.can.settings import PublishSettings
from estimation.records import CanState, Estimate, Segment, Tier

# Displacement, velocity, sigma with segment and tier, sensor state with counter; the CRC follows.
_LAYOUT = struct.Struct("<hhHB")
_LENGTH = _LAYOUT.size + 1
_TENTHS_PER_SI = 10_000  # 0.1 mm per metre, 0.1 mm/s per m/s
_SIGNED_LIMIT = 0x7FFF
_SIGNED_UNDETERMINED = -0x8000
_SIGMA_LIMIT = 0xFFE
_SIGMA_UNDETERMINED = 0xFFF

# The order is part of the frame: append, never reorder.
_SEGMENTS = (Segment.ZUPT, Segment.VVS, Segment.CVS)
_TIERS = (Tier.PROVISIONAL, Tier.SETTLED)
_SENSOR_STATES = (
    CanState.OK,
    CanState.LATE,
    CanState.SILENT,
    CanState.STUCK,
    CanState.OUT_OF_RANGE,
    CanState.INVALID,
    CanState.BIASED,
    CanState.ABSENT,
)


@dataclass(slots=True, frozen=True)
class PublishedEstimate:
    """What a receiver learns from one estimate frame; NaN = undetermined."""

    t_ns: int
    displacement_m: float
    velocity_m_s: float
    sigma_m: float
    segment: Segment
    tier: Tier
    can_state: CanState
    counter: int


class EstimateEncoder:
    """Turns estimates into frames and counts them, 0 to 15 and over."""

    def __init__(self, settings: PublishSettings) -> None:
        self._arbitration_id = settings.arbitration_id
        self._is_extended = settings.extended
        self._counter = 0

    def encode(self, estimate: Estimate) -> Frame:
        """The next frame; values beyond a field saturate, NaN becomes the field's undetermined code."""
        sigma_segment_tier = (
            _sigma(estimate.sigma_m) | _SEGMENTS.index(estimate.segment) << 12 | _TIERS.index(estimate.tier) << 14
        )
        body = _LAYOUT.pack(
            _signed(estimate.displacement_m),
            _signed(estimate.velocity_m_s),
            sigma_segment_tier,
            _SENSOR_STATES.index(estimate.can_state) | self._counter << 4,
        )
        self._counter = (self._counter + 1) % 16
        return Frame(
            estimate.t_ns,
            self._arbitration_id,
            body + bytes([crc8_j1850(body)]),
            is_extended=self._is_extended,
        )


def decode_estimate(frame: Frame) -> PublishedEstimate:
    """Read an estimate frame back, as a receiver would.

    Raises:
        ValueError: wrong length, wrong CRC, or a segment or sensor state that is not defined.
    """
    if len(frame.data) != _LENGTH:
        raise ValueError(f"The estimate frame has {len(frame.data)} bytes instead of {_LENGTH}.")
    body, crc = frame.data[:-1], frame.data[-1]
    if crc8_j1850(body) != crc:
        raise ValueError(f"The estimate frame's CRC is 0x{crc:02X} instead of 0x{crc8_j1850(body):02X}.")
    displacement, velocity, packed, state_and_counter = _LAYOUT.unpack(body)
    segment, state = packed >> 12 & 0b11, state_and_counter & 0xF
    if segment >= len(_SEGMENTS) or state >= len(_SENSOR_STATES):
        raise ValueError(f"The estimate frame has segment {segment}, sensor state {state}: not defined.")
    sigma = packed & 0xFFF
    return PublishedEstimate(
        t_ns=frame.t_ns,
        displacement_m=math.nan if displacement == _SIGNED_UNDETERMINED else displacement / _TENTHS_PER_SI,
        velocity_m_s=math.nan if velocity == _SIGNED_UNDETERMINED else velocity / _TENTHS_PER_SI,
        sigma_m=math.nan if sigma == _SIGMA_UNDETERMINED else sigma / _TENTHS_PER_SI,
        segment=_SEGMENTS[segment],
        tier=_TIERS[packed >> 14 & 1],
        can_state=_SENSOR_STATES[state],
        counter=state_and_counter >> 4,
    )


def _signed(value_si: float) -> int:
    if math.isnan(value_si):
        return _SIGNED_UNDETERMINED
    return round(max(-_SIGNED_LIMIT, min(_SIGNED_LIMIT, value_si * _TENTHS_PER_SI)))


def _sigma(sigma_m: float) -> int:
    if math.isnan(sigma_m):
        return _SIGMA_UNDETERMINED
    # Rounded up: a receiver must never think us more certain than we are (round() takes off binary dust).
    return math.ceil(round(max(0.0, min(_SIGMA_LIMIT, sigma_m * _TENTHS_PER_SI)), 6))
