"""Decoders and frames for the tests of the displacement source."""

from __future__ import annotations

import struct
from typing import Any

import pytest
from crccheck.crc import Crc8SaeJ1850  # type: ignore[import-untyped]  # has no annotations

from drivers.can.displacement import DisplacementDecoder
from drivers.can.frame import Frame
from drivers.can.settings import DisplacementSettings
from estimation.records import Displacement

MS = 1_000_000

about: Any = pytest.approx  # so that it may stand for a float


def decoder(is_reference: bool = False, **options: Any) -> DisplacementDecoder:
    """A decoder of the support controller's frame, or of what `options` say."""
    return DisplacementDecoder(DisplacementSettings.model_validate(options), is_reference)


def read(reader: DisplacementDecoder, data: bytes, t_ns: int = 7, **flags: bool) -> Displacement | None:
    """Decode `data` as if it came under the reader's own identifier."""
    arbitration_id, is_extended = reader.arbitration_ids[0]
    return reader.decode(Frame(t_ns, arbitration_id, data, is_extended=is_extended, **flags))


def taken(reader: DisplacementDecoder, data: bytes, t_ns: int = 7, **flags: bool) -> Displacement:
    """As `read`, of a frame that carries a reading."""
    reading = read(reader, data, t_ns, **flags)
    assert reading is not None
    return reading


def status(value_mm: int, counter: int = 0, *, valid: int = 1) -> bytes:
    """The support controller's frame, put together without the DBC file and with a foreign CRC."""
    body = struct.pack("<hBB", value_mm, valid, counter)
    return body + bytes([Crc8SaeJ1850.calc(body)])


def position(tenths_mm: int) -> bytes:
    """The first PDO of a CANopen sensor."""
    return struct.pack("<ih", tenths_mm, 0)


def emergency(code: int, register: int = 0, *, node: int = 127, t_ns: int = 1) -> Frame:
    """A CANopen emergency."""
    return Frame(t_ns, 0x080 + node, struct.pack("<HB5x", code, register))


def heartbeat(state: int, *, node: int = 127, t_ns: int = 1) -> Frame:
    """A CANopen heartbeat."""
    return Frame(t_ns, 0x700 + node, bytes([state]))
