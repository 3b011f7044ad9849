"""The JY901's packets of eleven bytes, and the commands of five that it takes.

0x55, kind, four little-endian words, low byte of the sum of the ten before it. There is no length and no escape: 0x55
may stand anywhere in a packet and is a kind of its own. So a parser that lost its place tries every byte: a wrong
checksum costs one byte, not eleven, else it would skip good packets behind a false head.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from enum import IntEnum
from math import radians

from estimation.records import Vector

HEAD, SIZE = 0x55, 11
G_M_S2 = 9.80665
ACCEL_LSB = 16 * G_M_S2 / 32768  # m/s^2
GYRO_LSB = radians(2000) / 32768  # rad/s
ANGLE_LSB = radians(180) / 32768  # rad
TEMPERATURE_LSB = 0.01  # deg C
UNLOCK = b"\xff\xaa\x69\x88\xb5"  # for ten seconds
SAVE = b"\xff\xaa\x00\x00\x00"
CONTENT, RATE, BAUD, BANDWIDTH, VERSION = 0x02, 0x03, 0x04, 0x1F, 0x2E  # registers
_WORDS = struct.Struct("<4h")


class Kind(IntEnum):
    """What a packet carries."""

    TIME = 0x50
    ACCEL = 0x51
    GYRO = 0x52
    ANGLE = 0x53
    MAGNETIC = 0x54
    PORTS = 0x55
    PRESSURE = 0x56
    POSITION = 0x57
    GROUND_SPEED = 0x58
    QUATERNION = 0x59
    ACCURACY = 0x5A
    REGISTERS = 0x5F


KINDS = frozenset(int(kind) for kind in Kind)


@dataclass(slots=True, frozen=True)
class Packet:
    """One packet whose checksum is right."""

    kind: Kind
    words: tuple[int, int, int, int]  # signed
    at: int  # position of its first byte, counted from the first byte ever fed

    @property
    def accel(self) -> Vector:
        """Specific force [m/s^2]; of an ACCEL packet."""
        x, y, z, _ = self.words
        return (x * ACCEL_LSB, y * ACCEL_LSB, z * ACCEL_LSB)

    @property
    def gyro(self) -> Vector:
        """Rate [rad/s]; of a GYRO packet."""
        x, y, z, _ = self.words
        return (x * GYRO_LSB, y * GYRO_LSB, z * GYRO_LSB)

    @property
    def angles(self) -> Vector:
        """Roll, pitch, yaw [rad] by the part's own filter; of an ANGLE packet."""
        x, y, z, _ = self.words
        return (x * ANGLE_LSB, y * ANGLE_LSB, z * ANGLE_LSB)

    @property
    def temperature_c(self) -> float:
        """Of an ACCEL, GYRO or MAGNETIC packet."""
        return self.words[3] * TEMPERATURE_LSB


def encode(kind: Kind, words: tuple[int, int, int, int]) -> bytes:
    """The bytes of a packet; words beyond 16 bits saturate, as in the part."""
    kept = (max(-32768, min(32767, word)) for word in words)
    body = bytes((HEAD, kind)) + _WORDS.pack(*kept)
    return body + bytes((sum(body) & 0xFF,))


@dataclass(slots=True)
class Parser:
    """Packets out of a stream of bytes, whatever comes between them."""

    fed: int = 0  # bytes so far
    skipped: int = 0  # of them, those that belong to no packet
    bad_checksums: int = 0  # heads with a kind behind them whose sum was wrong
    _rest: bytearray = field(default_factory=bytearray)
    _taken: int = 0  # bytes that are done with

    def feed(self, data: bytes) -> list[Packet]:
        """The packets that these bytes complete. Memory stays below one packet between calls."""
        self._rest += data
        self.fed += len(data)
        found: list[Packet] = []
        rest, place = self._rest, 0
        while len(rest) - place >= SIZE:
            if rest[place] == HEAD and rest[place + 1] in KINDS:
                if sum(rest[place : place + SIZE - 1]) & 0xFF == rest[place + SIZE - 1]:
                    words = _WORDS.unpack_from(rest, place + 2)
                    found.append(Packet(Kind(rest[place + 1]), words, self._taken + place))
                    place += SIZE
                    continue
                self.bad_checksums += 1
            self.skipped += 1
            place += 1
        del rest[:place]
        self._taken += place
        return found


def write_register(register: int, value: int) -> bytes:
    """The command that sets a register, which must be unlocked. Raises ValueError beyond a byte or 16 bits."""
    if not (0 <= register <= 0xFF and 0 <= value <= 0xFFFF):
        raise ValueError(f"register 0x{register:02X} = 0x{value:04X} does not fit a byte and 16 bits")
    return bytes((0xFF, 0xAA, register, value & 0xFF, value >> 8))


def read_registers(first: int) -> bytes:
    """The command that asks for four registers; the REGISTERS packet that answers does not say which."""
    return bytes((0xFF, 0xAA, 0x27, first, 0))


# Output rates [Hz] by code; 0x0C is one group and no more. Firmware of before has 0x0A = 200 Hz, 0x0B = one group.
RATE_CODES = {0.2: 1, 0.5: 2, 1: 3, 2: 4, 5: 5, 10: 6, 20: 7, 50: 8, 100: 9, 200: 0x0B}
OLD_200_HZ = 0x0A
BANDWIDTH_CODES = {256: 0, 184: 1, 94: 2, 44: 3, 21: 4, 10: 5, 5: 6}  # of the low-pass filter [Hz]
BAUD_CODES = {
    2400: 0, 4800: 1, 9600: 2, 19200: 3, 38400: 4, 57600: 5, 115200: 6, 230400: 7, 460800: 8, 921600: 9
}  # fmt: skip


def content_bits(*kinds: Kind) -> int:
    """Register CONTENT for a group of packets."""
    order = (
        *(Kind.TIME, Kind.ACCEL, Kind.GYRO, Kind.ANGLE, Kind.MAGNETIC, Kind.PORTS, Kind.PRESSURE, Kind.POSITION),
        *(Kind.GROUND_SPEED, Kind.QUATERNION, Kind.ACCURACY),
    )
    return sum(1 << order.index(kind) for kind in set(kinds))


def highest_rate_hz(baud: int, packets: int) -> int:
    """Groups a second that the line carries, ten bits a byte; the part lowers its rate by itself to that."""
    return baud // (10 * SIZE * packets)
