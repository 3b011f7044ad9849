"""The kernel's CAN error frames in words (linux/can/error.h).

python-can's `SocketcanBus.state` always says active, so error frames are the only news without netlink.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

from drivers.can.frame import Frame

ERROR_ACTIVE = "error-active"
ERROR_WARNING = "error-warning"
ERROR_PASSIVE = "error-passive"
BUS_OFF = "bus-off"
NO_ACKNOWLEDGEMENT = "no acknowledgement"

# Error classes: the identifier of an error frame
_TRANSMIT_TIMEOUT = 0x001
_ARBITRATION_LOST = 0x002
_CONTROLLER = 0x004
_PROTOCOL = 0x008
_TRANSCEIVER = 0x010
_NO_ACKNOWLEDGEMENT = 0x020
_BUS_OFF = 0x040
_BUS_ERROR = 0x080
_RESTARTED = 0x100
_COUNTERS = 0x200
_ALL_CLASSES = 0x3FF

_PLAIN_CLASSES = {
    _TRANSMIT_TIMEOUT: "transmit timeout",
    _NO_ACKNOWLEDGEMENT: NO_ACKNOWLEDGEMENT,
    _BUS_OFF: BUS_OFF,
    _BUS_ERROR: "bus error",
    _RESTARTED: "restarted",
}

_CONTROLLER_STATUS = {  # data[1]
    0x01: "receive buffer overflow",
    0x02: "transmit buffer overflow",
    0x04: "error-warning (receive)",
    0x08: "error-warning (transmit)",
    0x10: "error-passive (receive)",
    0x20: "error-passive (transmit)",
    0x40: "error-active again",
}
_STATUS_WARNING = 0x04 | 0x08
_STATUS_PASSIVE = 0x10 | 0x20
_STATUS_ACTIVE = 0x40

_VIOLATIONS = {  # data[2]
    0x01: "bit error",
    0x02: "form error",
    0x04: "stuff error",
    0x08: "bit error (cannot send dominant)",
    0x10: "bit error (cannot send recessive)",
    0x20: "bus overload",
    0x40: "active error flag",
}
_VIOLATION_WHILE_SENDING = 0x80

_AT_CRC, _AT_ACKNOWLEDGE_SLOT = 0x08, 0x19
_LOCATIONS = {  # data[3]
    0x03: "start of frame",
    0x02: "identifier bits 28-21",
    0x06: "identifier bits 20-18",
    0x04: "substitute RTR bit",
    0x05: "identifier extension bit",
    0x07: "identifier bits 17-13",
    0x0F: "identifier bits 12-5",
    0x0E: "identifier bits 4-0",
    0x0C: "RTR bit",
    0x0D: "reserved bit 1",
    0x09: "reserved bit 0",
    0x0B: "data length code",
    0x0A: "data field",
    _AT_CRC: "CRC sequence",
    0x18: "CRC delimiter",
    _AT_ACKNOWLEDGE_SLOT: "acknowledge slot",
    0x1B: "acknowledge delimiter",
    0x1A: "end of frame",
    0x12: "intermission",
}
# Controllers with a "last error code" (c_can, m_can) report these two as nothing but a location.
_VIOLATION_BY_LOCATION = {_AT_CRC: "CRC error", _AT_ACKNOWLEDGE_SLOT: NO_ACKNOWLEDGEMENT}

_CANH = {  # data[4], lower half
    0x04: "CANH not connected",
    0x05: "CANH shorted to the battery",
    0x06: "CANH shorted to the supply",
    0x07: "CANH shorted to ground",
}
_CANL = {  # data[4], upper half
    0x40: "CANL not connected",
    0x50: "CANL shorted to the battery",
    0x60: "CANL shorted to the supply",
    0x70: "CANL shorted to ground",
    0x80: "CANL shorted to CANH",
}


class ErrorWord(NamedTuple):
    """One thing that an error frame says: a kind out of a small set, to count by, and its circumstances."""

    kind: str
    detail: str = ""

    def __str__(self) -> str:
        return f"{self.kind} {self.detail}".rstrip()


@dataclass(slots=True, frozen=True)
class ErrorReport:
    """What one error frame says."""

    words: tuple[ErrorWord, ...]  # at least one, no kind twice
    state: str | None  # of the controller, None if the frame is silent about it
    transmit_errors: int | None = None  # the controller's error counters, if the frame carries them
    receive_errors: int | None = None

    def __str__(self) -> str:
        return ", ".join(map(str, self.words))


def decode(frame: Frame) -> ErrorReport:
    """All that error frame `frame` says; missing detail bytes count as unspecified."""
    error_class = frame.arbitration_id
    data = frame.data[:8].ljust(8, b"\0")
    words = {word.kind: word for word in _words(error_class, data)}
    transmit, receive = (data[6], data[7]) if error_class & _COUNTERS else (None, None)
    if not words and transmit is not None:
        words[""] = ErrorWord("error counters", f"(transmit {transmit}, receive {receive})")
    if not words:
        words[""] = ErrorWord("unspecified error")
    return ErrorReport(tuple(words.values()), _state(error_class, data[1]), transmit, receive)


def _words(error_class: int, data: bytes) -> Iterator[ErrorWord]:
    for bit, kind in _PLAIN_CLASSES.items():
        if error_class & bit:
            yield ErrorWord(kind)
    if error_class & _ARBITRATION_LOST:
        yield ErrorWord("arbitration lost", f"in bit {data[0]}" if data[0] else "")
    if error_class & _CONTROLLER:
        yield from _bits(data[1], _CONTROLLER_STATUS, "controller problem")
    if error_class & _PROTOCOL:
        yield from _protocol_words(data[2], data[3])
    if error_class & _TRANSCEIVER:
        yield from _transceiver_words(data[4])
    if error_class & ~_ALL_CLASSES:
        yield ErrorWord("unknown error class", f"0x{error_class & ~_ALL_CLASSES:X}")


def _bits(value: int, names: dict[int, str], otherwise: str) -> Iterator[ErrorWord]:
    for bit, kind in names.items():
        if value & bit:
            yield ErrorWord(kind)
    unknown = value & ~sum(names)
    if unknown or not value:
        yield ErrorWord(otherwise, f"0x{unknown:02X}" if unknown else "")


def _protocol_words(violation: int, location: int) -> Iterator[ErrorWord]:
    kinds = violation & ~_VIOLATION_WHILE_SENDING
    place = f"at {_LOCATIONS.get(location, f'place 0x{location:02X}')}" if location else ""
    if kinds == 0 and location in _VIOLATION_BY_LOCATION:
        words = iter([ErrorWord(_VIOLATION_BY_LOCATION[location])])
        place = ""
    else:
        words = _bits(kinds, _VIOLATIONS, "protocol violation")
    sending = "while sending" if violation & _VIOLATION_WHILE_SENDING else ""
    for word in words:
        yield ErrorWord(word.kind, " ".join(filter(None, (word.detail, place, sending))))


def _transceiver_words(status: int) -> Iterator[ErrorWord]:
    for half, names in ((status & 0x0F, _CANH), (status & 0xF0, _CANL)):
        if half in names:
            yield ErrorWord(names[half])
        elif half:
            yield ErrorWord("transceiver problem", f"0x{half:02X}")
    if not status:
        yield ErrorWord("transceiver problem")


def _state(error_class: int, status: int) -> str | None:
    if error_class & _BUS_OFF:
        return BUS_OFF
    if error_class & _RESTARTED:
        return ERROR_ACTIVE
    if error_class & _CONTROLLER:
        if status & _STATUS_PASSIVE:
            return ERROR_PASSIVE
        if status & _STATUS_WARNING:
            return ERROR_WARNING
        if status & _STATUS_ACTIVE:
            return ERROR_ACTIVE
    return None
