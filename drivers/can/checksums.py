"""The checksums that controllers put into their frames, as functions of the bytes that they cover."""

from __future__ import annotations

from collections.abc import Callable

from drivers.can.settings import ChecksumName


def _crc8_table(polynomial: int) -> bytes:
    table = bytearray()
    for crc in range(256):
        for _ in range(8):
            crc = (crc << 1 ^ polynomial) & 0xFF if crc & 0x80 else crc << 1
        table.append(crc)
    return bytes(table)


_J1850 = _crc8_table(0x1D)
_AUTOSAR = _crc8_table(0x2F)


def crc8_j1850(data: bytes) -> int:
    """CRC-8 SAE J1850: polynomial 0x1D, start 0xFF, final XOR 0xFF, not reflected."""
    return _crc8(data, _J1850)


def crc8_autosar(data: bytes) -> int:
    """CRC-8 of AUTOSAR (CRC8H2F): polynomial 0x2F, start 0xFF, final XOR 0xFF, not reflected."""
    return _crc8(data, _AUTOSAR)


def sum8(data: bytes) -> int:
    """Sum of all bytes modulo 256."""
    return sum(data) & 0xFF


def xor8(data: bytes) -> int:
    """Exclusive or of all bytes."""
    result = 0
    for byte in data:
        result ^= byte
    return result


CHECKSUMS: dict[ChecksumName, Callable[[bytes], int]] = {
    "crc8_j1850": crc8_j1850,
    "crc8_autosar": crc8_autosar,
    "sum8": sum8,
    "xor8": xor8,
}


def _crc8(data: bytes, table: bytes) -> int:
    crc = 0xFF
    for byte in data:
        crc = table[crc ^ byte]
    return crc ^ 0xFF
