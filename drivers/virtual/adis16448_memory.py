"""The virtual ADIS16448's control registers: what can be written, what flash keeps, what it means."""

from __future__ import annotations

import struct

from drivers.adis16448.registers import (
    ACCEL_LSB,
    AVG_RANGE_CODE,
    AVG_RANGE_MASK,
    AVG_RANGE_SHIFT,
    AVG_TAPS_MASK,
    GYRO_OFFSET_LSB,
    MIN_TAPS_EXPONENT,
    MSC_ACTIVE_HIGH,
    MSC_BURST_CRC,
    MSC_DATA_READY,
    MSC_ON_DIO2,
    REGISTERS,
    SMPL_DECIMATION_MASK,
    SMPL_DECIMATION_SHIFT,
    SMPL_INTERNAL_CLOCK,
)
from drivers.virtual.adis16448_updates import SignalSettings

_SIZE = REGISTERS["SERIAL_NUM"].address + 2
_WRITABLE = {r.address + i for r in REGISTERS.values() if r.access == "RW" for i in (0, 1)}
_RANGES = {code: dps for dps, code in AVG_RANGE_CODE.items()}
_MSC = REGISTERS["MSC_CTRL"].address
_PRD = REGISTERS["SMPL_PRD"].address
_AVG = REGISTERS["SENS_AVG"].address
_OFFSETS = REGISTERS["XGYRO_OFF"].address
_OFFSET_BYTES = 12  # gyro xyz, accel xyz

SIGNAL_BYTES = {*range(_OFFSETS, _OFFSETS + _OFFSET_BYTES), *range(_PRD, _AVG + 2)}


class Memory:
    """Two bytes per register, low byte first, and the copy in flash."""

    def __init__(self, lot_id: int, serial: int, *, has_crc: bool) -> None:
        self._has_crc = has_crc
        self._bytes = bytearray(_SIZE)
        for register in REGISTERS.values():
            self.set(register.address, register.reset or 0)
        self.set(REGISTERS["LOT_ID1"].address, lot_id >> 16)
        self.set(REGISTERS["LOT_ID2"].address, lot_id)
        self.set(REGISTERS["SERIAL_NUM"].address, serial)
        self._flash = bytes(self._bytes)

    def get(self, address: int) -> int:
        """The register at an even address; reserved ones read zero."""
        return self._bytes[address] | self._bytes[address + 1] << 8 if address < _SIZE else 0

    def set(self, address: int, value: int) -> None:
        """Set a register from inside the part."""
        self._bytes[address : address + 2] = (value & 0xFFFF).to_bytes(2, "little")

    def write(self, address: int, value: int) -> bool:
        """Write a byte from outside; return whether that address can be written."""
        if address not in _WRITABLE:
            return False
        if address == _MSC and not self._has_crc:
            value &= ~MSC_BURST_CRC
        self._bytes[address] = value
        # A lower range raises the least number of taps.
        taps = max(self.taps_exponent, MIN_TAPS_EXPONENT[self.gyro_range_dps])
        self._bytes[_AVG] = self._bytes[_AVG] & ~AVG_TAPS_MASK | taps
        return True

    def save(self) -> None:
        """Flash update."""
        self.set(REGISTERS["FLASH_CNT"].address, self.get(REGISTERS["FLASH_CNT"].address) + 1)
        self._flash = bytes(self._bytes)

    def restart(self) -> None:
        """Take every register from flash, or its reset value."""
        for register in REGISTERS.values():
            address = register.address
            if register.flash:
                self._bytes[address : address + 2] = self._flash[address : address + 2]
            else:
                self.set(address, register.reset or 0)

    def clear_offsets(self) -> None:
        """Zero the gyro and accelerometer offsets."""
        self._bytes[_OFFSETS : _OFFSETS + _OFFSET_BYTES] = bytes(_OFFSET_BYTES)

    @property
    def sends_crc(self) -> bool:
        """Whether bursts end with a checksum."""
        return bool(self._bytes[_MSC] & MSC_BURST_CRC)

    @property
    def data_ready_pin(self) -> int | None:
        """The DIO pin that carries data-ready."""
        if not self._bytes[_MSC] & MSC_DATA_READY:
            return None
        return 2 if self._bytes[_MSC] & MSC_ON_DIO2 else 1

    @property
    def is_high_when_valid(self) -> bool:
        """Polarity of data-ready."""
        return bool(self._bytes[_MSC] & MSC_ACTIVE_HIGH)

    @property
    def decimation_exponent(self) -> int:
        """D of SMPL_PRD."""
        return min(16, (self.get(_PRD) & SMPL_DECIMATION_MASK) >> SMPL_DECIMATION_SHIFT)

    @property
    def taps_exponent(self) -> int:
        """B of SENS_AVG."""
        return self._bytes[_AVG] & AVG_TAPS_MASK

    @property
    def gyro_range_dps(self) -> int:
        """Range of SENS_AVG; codes that mean nothing leave the largest."""
        return _RANGES.get((self.get(_AVG) & AVG_RANGE_MASK) >> AVG_RANGE_SHIFT, 1000)

    def signal_settings(self) -> SignalSettings:
        """All that shapes the output."""
        counts = struct.unpack_from("<6h", self._bytes, _OFFSETS)
        return SignalSettings(
            taps_exponent=self.taps_exponent,
            decimation_exponent=self.decimation_exponent,
            gyro_range_dps=self.gyro_range_dps,
            offsets=(
                *(count * GYRO_OFFSET_LSB for count in counts[:3]),
                *(count * ACCEL_LSB for count in counts[3:]),
            ),
            has_clock=bool(self._bytes[_PRD] & SMPL_INTERNAL_CLOCK),
        )
