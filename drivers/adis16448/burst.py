"""One burst read: every output register of the ADIS16448 in a single SPI frame."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from enum import IntEnum

from drivers.adis16448.crc import burst_crc
from drivers.adis16448.registers import (
    ACCEL_LSB,
    BARO_LSB,
    DIAG_SPI,
    GYRO_LSB_DPS,
    MAGN_LSB,
    TEMP_AT_ZERO_C,
    TEMP_LSB,
)
from estimation.records import ImuSample, TimeKind, Vector

_COMMAND = b"\x3e\x00"
_PLAIN = struct.Struct(">2x12H")
_WITH_CRC = struct.Struct(">2x13H")

REQUEST = _COMMAND + bytes(_PLAIN.size - 2)
REQUEST_WITH_CRC = _COMMAND + bytes(_WITH_CRC.size - 2)

_NO_WORDS = (0,) * 12


class Fault(IntEnum):
    """What is wrong with a burst."""

    NONE = 0
    CRC = 1  # checksum mismatch: a torn burst or a bad wire
    REPEATED = 2  # the sample was read before, or the registers froze
    ALL_ZERO = 3  # data wire stuck low or no supply
    ALL_ONE = 4  # data wire open
    SPI = 5  # the port failed, or the part saw a malformed frame and no checksum vouches for the words


@dataclass(slots=True, frozen=True)
class Burst:
    """The raw words of one sample, exactly as read: DIAG_STAT, then XGYRO_OUT..TEMP_OUT, unsigned."""

    t_ns: int
    time_kind: TimeKind
    words: tuple[int, ...]  # 12
    crc: int | None  # None: the part sends no checksum
    fault: Fault = Fault.NONE


def parse(frame: bytes, t_ns: int, time_kind: TimeKind) -> Burst:
    """Read the answer to REQUEST or REQUEST_WITH_CRC. Raises ValueError for any other length."""
    if len(frame) == _WITH_CRC.size:
        *words, crc = _WITH_CRC.unpack(frame)
        return Burst(t_ns, time_kind, tuple(words), crc, classify(tuple(words), crc))
    if len(frame) == _PLAIN.size:
        plain = _PLAIN.unpack(frame)
        return Burst(t_ns, time_kind, plain, None, classify(plain, None))
    raise ValueError(f"a burst has {_PLAIN.size} or {_WITH_CRC.size} bytes, not {len(frame)}")


def failed(t_ns: int, time_kind: TimeKind) -> Burst:
    """The burst that could not be read because the port failed."""
    return Burst(t_ns, time_kind, _NO_WORDS, None, Fault.SPI)


def classify(words: tuple[int, ...], crc: int | None) -> Fault:
    """What one burst by itself shows to be wrong."""
    if crc is not None and burst_crc(words[1:]) == crc:
        return Fault.NONE
    # A dead bus fails the checksum too; telling it apart names the wire.
    if not any(words):
        return Fault.ALL_ZERO
    if all(word == 0xFFFF for word in words):
        return Fault.ALL_ONE
    if crc is not None:
        return Fault.CRC
    return Fault.SPI if words[0] & DIAG_SPI else Fault.NONE


class RepetitionWatch:
    """Tells a sample read twice, or frozen registers, from honest samples that happen to be equal.

    Filtered samples of a resting part often are equal: equality alone condemns a burst only when nothing
    says that the part has sampled again (a paced read, or an edge too soon after the last one). With an
    edge each, it takes a run that no noise survives; the longer the filter, the longer the run.
    """

    def __init__(self, period_s: float, taps_exponent: int) -> None:
        self._too_soon_ns = round(0.5e9 * period_s)
        self._longest_run = 16 << taps_exponent
        self._last = Burst(0, TimeKind.READ, _NO_WORDS, None)
        self._run = 0

    def is_repeated(self, burst: Burst) -> bool:
        """Whether `burst` brings nothing new."""
        last, self._last = self._last, burst
        # DIAG_STAT is cleared by reading it, so it may differ between two reads of one sample.
        if burst.words[1:] != last.words[1:]:
            self._run = 0
            return False
        self._run += 1
        return (
            burst.time_kind is TimeKind.READ
            or burst.t_ns - last.t_ns < self._too_soon_ns
            or self._run > self._longest_run
        )


def _signed(word: int) -> int:
    return (word ^ 0x8000) - 0x8000


class BurstDecoder:
    """Turns raw words into SI units."""

    def __init__(self, gyro_range_dps: int) -> None:
        self._gyro_lsb = math.radians(GYRO_LSB_DPS[gyro_range_dps])

    def sample(self, burst: Burst) -> ImuSample:
        """Rates [rad/s], specific force [m/s^2] and temperature [degC] of a burst."""
        _, gx, gy, gz, ax, ay, az, _, _, _, _, temperature = burst.words
        lsb = self._gyro_lsb
        return ImuSample(
            burst.t_ns,
            (_signed(gx) * lsb, _signed(gy) * lsb, _signed(gz) * lsb),
            (_signed(ax) * ACCEL_LSB, _signed(ay) * ACCEL_LSB, _signed(az) * ACCEL_LSB),
            # 12 bits, two's complement; bits 15..12 are not used.
            TEMP_AT_ZERO_C + (((temperature & 0xFFF) ^ 0x800) - 0x800) * TEMP_LSB,
            burst.time_kind,
        )

    def magnetometer_tesla(self, burst: Burst) -> Vector:
        """Magnetic flux density [T]."""
        _, _, _, _, _, _, _, mx, my, mz, _, _ = burst.words
        return (_signed(mx) * MAGN_LSB, _signed(my) * MAGN_LSB, _signed(mz) * MAGN_LSB)

    def pressure_pa(self, burst: Burst) -> float:
        """Air pressure [Pa]; the word is unsigned, unlike its neighbours."""
        return burst.words[10] * BARO_LSB
