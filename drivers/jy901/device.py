"""Finding a JY901 on a serial line and setting it up: baud rate, unlock, content, rate, read back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from drivers.jy901.packets import (
    ALGORITHM,
    BAUD,
    BAUD_CODES,
    CONTENT,
    RATE,
    RATE_CODES,
    UNLOCK,
    Kind,
    Packet,
    Parser,
    content_bits,
    highest_rate_hz,
    read_registers,
    write_register,
)

SCANNED = (115200, 9600, 57600, 38400, 230400, 460800, 921600, 19200, 4800)  # the usual ones first
LISTEN_S = 0.35  # three groups at the default of 10 Hz
ANSWER_S = 0.5
SIX_AXES = 1  # no magnetometer: beside steel it misleads
WANTED = content_bits(Kind.ACCEL, Kind.GYRO)


class SerialPort(Protocol):
    """What pyserial's port is, as far as it is used; reads return what has come within its timeout."""

    baudrate: int

    def read(self, size: int) -> bytes:
        """Up to `size` bytes."""

    def write(self, data: bytes) -> object:
        """All of it."""


class Jy901Error(Exception):
    """The part cannot be used; the text is one sentence that says what to do."""


@dataclass(frozen=True)
class Found:
    """A part that has been set up."""

    baud: int
    rate_hz: float


def set_up(port: SerialPort, rate_hz: float, clock_s: Callable[[], float], baud: int | None = None) -> Found:
    """Find the part and make it send acceleration and rate, `rate_hz` times a second, at `baud` (as found if None).

    Nothing is saved in the part: it is as before when it is switched off. Raises Jy901Error if there is none, if it
    does not obey, or if the line is too slow for the rate.
    """
    if rate_hz not in RATE_CODES:
        raise Jy901Error(f"rate {rate_hz:g} Hz: the JY901 knows {', '.join(f'{one:g}' for one in RATE_CODES)} Hz")
    at = find(port, clock_s)
    wanted = baud or at
    if wanted not in BAUD_CODES:
        raise Jy901Error(f"baud rate {wanted}: the JY901 knows {', '.join(map(str, BAUD_CODES))}")
    if rate_hz > highest_rate_hz(wanted, 2):
        raise Jy901Error(
            f"at {wanted} baud the line carries {highest_rate_hz(wanted, 2)} samples a second, not {rate_hz:g}: "
            "choose a higher baud rate or a lower output rate"
        )
    port.write(UNLOCK)
    for register, value in ((CONTENT, WANTED), (ALGORITHM, SIX_AXES), (RATE, RATE_CODES[rate_hz])):
        port.write(write_register(register, value))
    if wanted != at:
        port.write(write_register(BAUD, BAUD_CODES[wanted]))
        port.baudrate = wanted  # from the next byte on
    port.write(read_registers(CONTENT))
    answer = _wait_for(port, Kind.REGISTERS, clock_s)
    told = None if answer is None else tuple(word & 0xFFFF for word in answer.words[:2])
    if told != (WANTED, RATE_CODES[rate_hz]):
        said = "no answer" if told is None else f"content 0x{told[0]:04X}, rate code {told[1]}"
        raise Jy901Error(
            f"the JY901 did not take its settings ({said} instead of 0x{WANTED:04X}, {RATE_CODES[rate_hz]}): check its "
            "RX wire; a part with old firmware counts its rates otherwise"
        )
    return Found(wanted, rate_hz)


def find(port: SerialPort, clock_s: Callable[[], float]) -> int:
    """The baud rate at which packets come. Raises Jy901Error if there are none at any."""
    noise = False
    for baud in (port.baudrate, *(one for one in SCANNED if one != port.baudrate)):
        port.baudrate = baud
        parser, until_s = Parser(), clock_s() + LISTEN_S
        while clock_s() < until_s:
            if parser.feed(port.read(256)):
                return baud
        noise |= parser.fed > 0
    what = "bytes come, but no packet at any baud rate" if noise else "nothing comes on the line"
    raise Jy901Error(f"no JY901 answers: {what}; check its supply, and that its TX goes to the computer's RX")


def _wait_for(port: SerialPort, kind: Kind, clock_s: Callable[[], float]) -> Packet | None:
    parser, until_s = Parser(), clock_s() + ANSWER_S
    while clock_s() < until_s:
        for packet in parser.feed(port.read(256)):
            if packet.kind is kind:
                return packet
    return None
