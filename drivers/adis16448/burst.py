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
    DIAG_OVERRANGE,
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

_NO_WORDS: tuple[int, ...] = (0,) * 12


# Counts that no honest sample reaches: 1.2 times the range of the accelerometers (18 g), 1.3 times that of the
# gyroscopes, which is the same count in every range.
_ACCEL_RANGE, _GYRO_RANGE = 18 * 1200 - 1, 25_000 - 1
_ACCEL_LIMIT = round(1.2 * 18 * 1200)
_GYRO_LIMIT = round(1.3 * 25_000)


class Fault(IntEnum):
    """What is wrong with a burst."""

    NONE = 0
    CRC = 1  # checksum mismatch that the time of the read does not explain: a bad wire
    REPEATED = 2  # the sample was read before, or the registers froze
    ALL_ZERO = 3  # data wire stuck low or no supply
    ALL_ONE = 4  # data wire open
    SPI = 5  # the port failed, or the part saw a malformed frame and no checksum vouches for the words
    TORN = 6  # read so late that some or all of it is the next sample
    OUT_OF_RANGE = 7  # counts that the part cannot measure


@dataclass(slots=True, frozen=True)
class Burst:
    """The raw words of one sample, exactly as read: DIAG_STAT, then XGYRO_OUT..TEMP_OUT, unsigned."""

    t_ns: int
    time_kind: TimeKind
    words: tuple[int, ...]  # 12
    crc: int | None  # None: the part sends no checksum
    fault: Fault = Fault.NONE

    def with_fault(self, fault: Fault) -> Burst:
        """The same words, found to be wrong."""
        return Burst(self.t_ns, self.time_kind, self.words, self.crc, fault)


def parse(frame: bytes, t_ns: int, time_kind: TimeKind) -> Burst:
    """Read the answer to REQUEST or REQUEST_WITH_CRC. Raises ValueError for any other length."""
    if len(frame) == _WITH_CRC.size:
        received = _WITH_CRC.unpack(frame)
        words, crc = received[:12], received[12]
        return Burst(t_ns, time_kind, words, crc, classify(words, crc))
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
        return Fault.NONE if _is_measurable(words) else Fault.OUT_OF_RANGE
    # A dead bus fails the checksum too; telling it apart names the wire.
    if not any(words):
        return Fault.ALL_ZERO
    if all(word == 0xFFFF for word in words):
        return Fault.ALL_ONE
    if crc is not None:
        return Fault.CRC
    if words[0] & DIAG_SPI:
        return Fault.SPI
    return Fault.NONE if _is_measurable(words) else Fault.OUT_OF_RANGE


def _is_measurable(words: tuple[int, ...]) -> bool:
    flags, gx, gy, gz, ax, ay, az, _, _, _, _, _ = words
    # When the part itself says that something is beyond its range, what reads full scale is what it means.
    gyro, accel = (_GYRO_RANGE, _ACCEL_RANGE) if flags & DIAG_OVERRANGE else (_GYRO_LIMIT, _ACCEL_LIMIT)
    # Two's complement: what lies between the positive and the negative limit is beyond both.
    g, a = 0x10000 - gyro, 0x10000 - accel
    return not (gyro < gx < g or gyro < gy < g or gyro < gz < g or accel < ax < a or accel < ay < a or accel < az < a)


# By taps exponent: a dozen, and four times the longest run of equal samples that a part with the noise of the data
# sheet gives in 40 s of perfect rest (0, 0, 1, 2, 7, 18, 62, 237).
_LONGEST_RUNS = (12, 12, 12, 12, 32, 80, 250, 1000)


class RepetitionWatch:
    """Tells a sample read twice, or frozen registers, from honest samples that happen to be equal.

    Filtered samples of a resting part often are equal: equality alone condemns a burst only if its time is
    doubtful. Else it takes a run that no noise survives; the longer the filter, the longer the run.
    """

    def __init__(self, taps_exponent: int) -> None:
        self._longest_run = _LONGEST_RUNS[taps_exponent]
        self._last = _NO_WORDS
        self._run = 0

    @property
    def is_frozen(self) -> bool:
        """Whether the registers have stood still longer than noise ever lets them."""
        return self._run > self._longest_run

    def is_repeated(self, burst: Burst, *, is_doubtful: bool) -> bool:
        """Whether `burst` brings nothing new; `is_doubtful`: nothing says that the part sampled again."""
        words, last = burst.words, self._last
        self._last = words
        # DIAG_STAT is cleared by reading it, so it may differ between two reads of one sample.
        if words[1] != last[1] or words[1:] != last[1:]:
            self._run = 0
            return False
        self._run += 1
        return is_doubtful or self._run > self._longest_run


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
