"""The checksum of a burst: a CRC-16 of the ADIS16448's own kind.

The register starts at 0xFFFF, shifts right and is fed back with 0x1021 *not* bit-reversed; words go in low
byte first; the result is complemented and its bytes are swapped. No library CRC has this combination.
"""

from __future__ import annotations

from collections.abc import Iterable

_FEEDBACK = 0x1021


def _byte_step(register: int) -> int:
    for _ in range(8):
        register = (register >> 1) ^ (_FEEDBACK if register & 1 else 0)
    return register


CRC_TABLE: tuple[int, ...] = tuple(_byte_step(byte) for byte in range(256))
# The checksum is linear: a word's two steps are the exclusive or of what its bytes do alone, the low one twice.
_LOW_BYTE = tuple((once >> 8) ^ CRC_TABLE[once & 0xFF] for once in CRC_TABLE)


def burst_crc(words: Iterable[int]) -> int:
    """Checksum of the 11 unsigned 16-bit words XGYRO_OUT..TEMP_OUT (DIAG_STAT is not covered)."""
    low, high = _LOW_BYTE, CRC_TABLE
    register = 0xFFFF
    for word in words:
        register ^= word
        register = low[register & 0xFF] ^ high[register >> 8]
    register ^= 0xFFFF
    return (register >> 8) | (register & 0xFF) << 8
