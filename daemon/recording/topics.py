"""The one table of what a recording holds: topic, schema, Python type, and how to encode and decode it."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from daemon.recording import schemas
from daemon.recording.cdr import ENCAPSULATION, DecodeError, Layout
from drivers.adis16448.burst import Burst, Fault
from drivers.adis16448.identity import Identity
from drivers.can.frame import Frame
from drivers.jy901.identity import Jy901Identity
from drivers.jy901.reading import Reading
from estimation.records import (
    CanState,
    Displacement,
    Estimate,
    Event,
    ImuSample,
    Move,
    MoveKind,
    ReadingFault,
    Segment,
    Tick,
    Tier,
    TimeKind,
)

IMU_RAW = "/imu/adis16448"
IMU_IDENTITY = "/imu/identity"
IMU_SAMPLE = "/imu/sample"
JY901 = "/imu/jy901"
JY901_IDENTITY = "/imu/jy901/identity"
CAN_RX = "/can/rx"
CAN_TX = "/can/tx"
OBSERVED = "/displacement/observed"
REFERENCE = "/displacement/reference"
TICK = "/tick"
PROVISIONAL = "/estimate/provisional"
SETTLED = "/estimate/settled"
MOVES = "/moves"
EVENTS = "/events"
LOG = "/log"
HEALTH = "/health"


@dataclass(slots=True, frozen=True)
class RecordedDisplacement:
    """A displacement reading and whether it repeats a CAN frame of the same file.

    A replay feeds the frame and must then leave out the `decoded` reading, or it would count it twice.
    """

    reading: Displacement
    decoded: bool


@dataclass(slots=True, frozen=True)
class LogLine:
    """One line of the program's log; `level` counts as in `logging` (INFO = 20)."""

    t_ns: int
    level: int
    logger: str
    text: str


@dataclass(slots=True, frozen=True)
class Health:
    """Health of the program as one JSON object."""

    t_ns: int
    json: str


Inertial = Burst | Identity | Reading | Jy901Identity | ImuSample
Recorded = Inertial | Frame | RecordedDisplacement | Tick | Estimate | Move | Event | LogLine | Health


# What `Topic.decode` raises for bytes that are not such a record (an unknown enum code is a LookupError).
UNDECODABLE = (ValueError, LookupError, struct.error)


@dataclass(slots=True, frozen=True)
class Topic:
    """One row of the table.

    `encode` raises `ValueError` or `struct.error` when a value does not fit; `decode` one of `UNDECODABLE`.
    `starts_file`: a new file may begin with this record. Outputs may not (they belong to an input of the
    old file), nor may a displacement (its CAN frame would stay behind in the old file).
    """

    name: str
    layout: Layout
    time_ns: Callable[[Any], int]
    encode: Callable[[Any], bytes]
    decode: Callable[[bytes], Recorded]
    starts_file: bool = False


_TIME_KINDS = tuple(TimeKind)
_FAULTS = {fault.value: fault for fault in Fault}
_READING_FAULTS = {fault.value: fault for fault in ReadingFault}
_SEGMENTS, _TIERS, _CAN_STATES, _MOVE_KINDS = tuple(Segment), tuple(Tier), tuple(CanState), tuple(MoveKind)
_SEGMENT_CODES = {member: code for code, member in enumerate(_SEGMENTS)}
_TIER_CODES = {member: code for code, member in enumerate(_TIERS)}
_CAN_STATE_CODES = {member: code for code, member in enumerate(_CAN_STATES)}
_MOVE_KIND_CODES = {member: code for code, member in enumerate(_MOVE_KINDS)}

# The same bytes as the schema's, but the register words travel unsigned in the program.
_BURST = struct.Struct(schemas.BURST.format.replace("h", "H"))
_LARGEST_FRAME = 64  # bytes, CAN FD


def _encode_burst(burst: Burst) -> bytes:
    crc, has_crc = (0, False) if burst.crc is None else (burst.crc, True)
    return _BURST.pack(ENCAPSULATION, burst.t_ns, *burst.words, crc, has_crc, burst.time_kind, burst.fault)


def _decode_burst(data: bytes) -> Burst:
    values = _BURST.unpack(data)
    if values[0] != ENCAPSULATION:
        raise DecodeError("burst: not little-endian CDR")
    crc = values[14] if values[15] else None
    return Burst(values[1], _TIME_KINDS[values[16]], values[2:14], crc, _FAULTS[values[17]])


def _encode_identity(identity: Identity) -> bytes:
    return schemas.IDENTITY.pack(identity.t_ns, identity.product_id, identity.lot_id, identity.serial)


def _decode_identity(data: bytes) -> Identity:
    return Identity(*schemas.IDENTITY.unpack(data))


def _encode_reading(reading: Reading) -> bytes:
    return schemas.JY901.pack(reading.t_ns, *reading.accel, *reading.gyro, reading.is_frozen)


def _decode_reading(data: bytes) -> Reading:
    t_ns, *words, is_frozen = schemas.JY901.unpack(data)
    ax, ay, az, accel_temperature, gx, gy, gz, gyro_temperature = words
    return Reading(t_ns, (ax, ay, az, accel_temperature), (gx, gy, gz, gyro_temperature), is_frozen)


def _encode_jy901_identity(identity: Jy901Identity) -> bytes:
    return schemas.JY901_IDENTITY.pack(identity.t_ns, identity.firmware, identity.baud, identity.rate_hz)


def _decode_jy901_identity(data: bytes) -> Jy901Identity:
    return Jy901Identity(*schemas.JY901_IDENTITY.unpack(data))


def _encode_sample(sample: ImuSample) -> bytes:
    return schemas.IMU_SAMPLE.pack(sample.t_ns, *sample.gyro, *sample.accel, sample.temperature_c, sample.time_kind)


def _decode_sample(data: bytes) -> ImuSample:
    t_ns, gx, gy, gz, ax, ay, az, temperature_c, time_kind = schemas.IMU_SAMPLE.unpack(data)
    return ImuSample(t_ns, (gx, gy, gz), (ax, ay, az), temperature_c, _TIME_KINDS[time_kind])


def _encode_frame(frame: Frame) -> bytes:
    flags = frame.is_extended, frame.is_fd, frame.is_error, frame.is_remote
    return schemas.CAN_FRAME.pack(frame.t_ns, frame.arbitration_id, *flags, frame.data)


def _decode_frame(data: bytes) -> Frame:
    t_ns, arbitration_id, extended, fd, error, remote, payload = schemas.CAN_FRAME.unpack(data)
    if len(payload) > _LARGEST_FRAME:
        raise DecodeError(f"CAN frame of {len(payload)} bytes")
    return Frame(t_ns, arbitration_id, payload, extended, fd, error, remote)


def _displacement_topic(name: str, is_reference: bool) -> Topic:
    def encode(record: RecordedDisplacement) -> bytes:
        reading = record.reading
        if reading.is_reference != is_reference:
            raise ValueError(f"{name} does not carry a displacement with is_reference={reading.is_reference}")
        return schemas.DISPLACEMENT.pack(reading.t_ns, reading.value_m, reading.fault, record.decoded)

    def decode(data: bytes) -> RecordedDisplacement:
        t_ns, value_m, fault, decoded = schemas.DISPLACEMENT.unpack(data)
        return RecordedDisplacement(Displacement(t_ns, value_m, _READING_FAULTS[fault], is_reference), decoded)

    return Topic(name, schemas.DISPLACEMENT, lambda record: int(record.reading.t_ns), encode, decode)


def _encode_tick(tick: Tick) -> bytes:
    return schemas.TICK.pack(tick.t_ns)


def _decode_tick(data: bytes) -> Tick:
    return Tick(*schemas.TICK.unpack(data))


def _encode_estimate(estimate: Estimate) -> bytes:
    return schemas.ESTIMATE.pack(
        estimate.t_ns,
        estimate.displacement_m,
        estimate.sigma_m,
        estimate.velocity_m_s,
        estimate.velocity_sigma_m_s,
        estimate.acceleration_m_s2,
        estimate.chart_lower_m_s2,
        estimate.chart_upper_m_s2,
        estimate.step_m_s,
        estimate.innovation_m,
        estimate.gate_m,
        estimate.move,
        _SEGMENT_CODES[estimate.segment],
        _TIER_CODES[estimate.tier],
        _CAN_STATE_CODES[estimate.can_state],
    )


def _decode_estimate(data: bytes) -> Estimate:
    t_ns, *motion, innovation, gate, move, segment, tier, can_state = schemas.ESTIMATE.unpack(data)
    displacement, sigma, velocity, velocity_sigma, acceleration, lower, upper, step = motion
    return Estimate(
        t_ns,
        displacement,
        sigma,
        velocity,
        velocity_sigma,
        _SEGMENTS[segment],
        _TIERS[tier],
        _CAN_STATES[can_state],
        move,
        acceleration,
        lower,
        upper,
        step,
        innovation,
        gate,
    )


def _encode_move(move: Move) -> bytes:
    return schemas.MOVE.pack(
        move.onset_ns,
        move.stop_ns,
        move.start_m,
        move.end_m,
        move.sigma_m,
        move.end_before_stop_m,
        move.sigma_before_stop_m,
        move.velocity_m_s,
        move.number,
        _MOVE_KIND_CODES[move.kind],
        _CAN_STATE_CODES[move.can_state],
        _TIER_CODES[move.tier],
    )


def _decode_move(data: bytes) -> Move:
    onset_ns, stop_ns, *lengths, velocity, number, kind, can_state, tier = schemas.MOVE.unpack(data)
    start, end, sigma, end_before_stop, sigma_before_stop = lengths
    return Move(
        number,
        _MOVE_KINDS[kind],
        onset_ns,
        stop_ns,
        start,
        end,
        sigma,
        end_before_stop,
        sigma_before_stop,
        velocity,
        _CAN_STATES[can_state],
        _TIERS[tier],
    )


def _encode_event(event: Event) -> bytes:
    return schemas.EVENT.pack(event.t_ns, event.what)


def _decode_event(data: bytes) -> Event:
    return Event(*schemas.EVENT.unpack(data))


def _encode_log(line: LogLine) -> bytes:
    seconds, nanoseconds = divmod(line.t_ns, 1_000_000_000)
    return schemas.LOG.pack(seconds, nanoseconds, line.level, line.logger, line.text, "", "", 0)


def _decode_log(data: bytes) -> LogLine:
    seconds, nanoseconds, level, logger, text, *_ = schemas.LOG.unpack(data)
    return LogLine(seconds * 1_000_000_000 + nanoseconds, level, logger, text)


def _encode_health(health: Health) -> bytes:
    return schemas.HEALTH.pack(health.t_ns, health.json)


def _decode_health(data: bytes) -> Health:
    return Health(*schemas.HEALTH.unpack(data))


def _own_time(record: Any) -> int:
    return int(record.t_ns)


def _stop_time(move: Move) -> int:
    return move.stop_ns


_ROWS = (
    Topic(IMU_RAW, schemas.BURST, _own_time, _encode_burst, _decode_burst, starts_file=True),
    Topic(IMU_IDENTITY, schemas.IDENTITY, _own_time, _encode_identity, _decode_identity, starts_file=True),
    Topic(IMU_SAMPLE, schemas.IMU_SAMPLE, _own_time, _encode_sample, _decode_sample, starts_file=True),
    Topic(CAN_RX, schemas.CAN_FRAME, _own_time, _encode_frame, _decode_frame, starts_file=True),
    Topic(CAN_TX, schemas.CAN_FRAME, _own_time, _encode_frame, _decode_frame),
    _displacement_topic(OBSERVED, is_reference=False),
    _displacement_topic(REFERENCE, is_reference=True),
    Topic(TICK, schemas.TICK, _own_time, _encode_tick, _decode_tick, starts_file=True),
    Topic(PROVISIONAL, schemas.ESTIMATE, _own_time, _encode_estimate, _decode_estimate),
    Topic(SETTLED, schemas.ESTIMATE, _own_time, _encode_estimate, _decode_estimate),
    Topic(MOVES, schemas.MOVE, _stop_time, _encode_move, _decode_move),
    Topic(EVENTS, schemas.EVENT, _own_time, _encode_event, _decode_event),
    Topic(LOG, schemas.LOG, _own_time, _encode_log, _decode_log),
    Topic(HEALTH, schemas.HEALTH, _own_time, _encode_health, _decode_health),
    Topic(JY901, schemas.JY901, _own_time, _encode_reading, _decode_reading, starts_file=True),
    Topic(
        JY901_IDENTITY,
        schemas.JY901_IDENTITY,
        _own_time,
        _encode_jy901_identity,
        _decode_jy901_identity,
        starts_file=True,
    ),
)
TOPICS: dict[str, Topic] = {row.name: row for row in _ROWS}

_INERTIAL_TOPICS = {
    Burst: IMU_RAW,
    Identity: IMU_IDENTITY,
    Reading: JY901,
    Jy901Identity: JY901_IDENTITY,
    ImuSample: IMU_SAMPLE,
}


def inertial_topic(record: Inertial) -> str:
    """The topic of what an inertial sensor brings."""
    return _INERTIAL_TOPICS[type(record)]
