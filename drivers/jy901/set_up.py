"""Finding a JY901 on a serial line and setting it up: baud rate, unlock, content, filter, rate, read back, save.

Written as generators that yield whenever they have waited for a moment, so that a caller may do other things between.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass

from drivers.clock import Clock
from drivers.jy901.packets import (
    BANDWIDTH,
    BANDWIDTH_CODES,
    BAUD,
    BAUD_CODES,
    CONTENT,
    OLD_200_HZ,
    RATE,
    RATE_CODES,
    SAVE,
    UNLOCK,
    VERSION,
    Kind,
    Packet,
    Parser,
    content_bits,
    highest_rate_hz,
    read_registers,
    write_register,
)
from drivers.jy901.port import SerialPort
from drivers.jy901.settings import GROUP, Jy901Settings

SCANNED = (115200, 9600, 57600, 38400, 230400, 460800, 921600, 19200, 4800)  # the usual ones first
LISTEN_S = 0.15  # longer than the time between groups at the default of 10 Hz; a part that sends none is asked
GO_ON_S = 0.35
ANSWER_S = 0.5
COMMAND_S = 0.03  # between two commands; a vendor's own program waits 0.02 to 0.1 s
SEVERAL = 5  # groups
WANTED = content_bits(Kind.ACCEL, Kind.GYRO)

Waiting = Generator[None, None, None]


class Jy901Error(Exception):
    """The part cannot be used: what is wrong, and what to do about it."""

    def __init__(self, what: str, advice: str) -> None:
        super().__init__(f"{what}: {advice}")
        self.what = what
        self.advice = advice


@dataclass(frozen=True)
class Found:
    """A part that has been set up."""

    baud: int
    firmware: int  # 0: it does not tell
    was_changed: bool  # it stood otherwise before


def set_up(port: SerialPort, settings: Jy901Settings, clock: Clock) -> Generator[None, None, Found]:
    """Find the part and make it send acceleration and rate as the settings want.

    Raises Jy901Error if there is none, if it does not obey, or if the line is too slow; PortError.
    """
    at = yield from find(port, settings.baud, clock)
    before = yield from _registers(port, CONTENT, clock)
    if before is None:
        raise Jy901Error("the JY901 sends, but does not answer", "check the wire from the computer's TX to its RX")
    filter_before = yield from _registers(port, BANDWIDTH, clock)
    code = RATE_CODES[settings.rate_hz]
    yield from _write(port, settings, code, clock)
    baud = at
    if at != settings.baud:
        baud = yield from _change_baud(port, settings.baud, clock)
    if settings.rate_hz > highest_rate_hz(baud, GROUP):
        raise Jy901Error(
            f"the JY901 stays at {baud} baud, which carries {highest_rate_hz(baud, GROUP)} samples a second",
            f"set baud = {baud} and a lower rate_hz in [jy901]",
        )
    after = yield from _registers(port, CONTENT, clock)
    _insist(after, code)
    if settings.rate_hz == 200 and not (yield from _goes_on(port, clock)):
        # Firmware of before counts otherwise: what means 200 Hz today means "one group and no more" there.
        code = OLD_200_HZ
        yield from _write(port, settings, code, clock)
    version = yield from _registers(port, VERSION, clock)
    stood = (at, *before[:2], None if filter_before is None else filter_before[0])
    was_changed = stood != (settings.baud, WANTED, code, BANDWIDTH_CODES[bandwidth_hz(settings)])
    if settings.save and was_changed:
        port.write(UNLOCK)
        yield from _pause(port, COMMAND_S, clock)
        port.write(SAVE)
        yield from _pause(port, COMMAND_S, clock)
    return Found(baud, 0 if version is None else version[0], was_changed)


def find(port: SerialPort, likely: int, clock: Clock) -> Generator[None, None, int]:
    """The baud rate at which packets come. Raises Jy901Error if there are none at any; PortError."""
    noise = False
    for baud in dict.fromkeys((likely, *SCANNED)):
        fed = yield from _listen(port, baud, clock)
        if fed is None:
            return baud
        if fed and not noise and baud != likely and (yield from _listen(port, likely, clock)) is None:
            return likely  # a cable was plugged in again meanwhile
        noise |= fed > 0
    what = "bytes come, but no packet at any baud rate" if noise else "nothing comes on the serial line"
    raise Jy901Error(
        f"no JY901 answers: {what}", "check its supply, its ground, and that its TX goes to the computer's RX"
    )


def _listen(port: SerialPort, baud: int, clock: Clock) -> Generator[None, None, int | None]:
    """None if packets come at that baud rate, else how many bytes do."""
    port.baudrate = baud
    port.write(read_registers(CONTENT))
    parser, until_ns = Parser(), _after(clock, LISTEN_S)
    while clock.now_ns() < until_ns:
        if parser.feed(port.read()):
            return None
        yield
    return parser.fed


def bandwidth_hz(settings: Jy901Settings) -> int:
    """The filter to set: as wanted, else the highest that lets no vibration fold into what the samples show."""
    return settings.bandwidth_hz or max(one for one in BANDWIDTH_CODES if 2 * one <= settings.rate_hz)


def _write(port: SerialPort, settings: Jy901Settings, rate_code: int, clock: Clock) -> Waiting:
    wanted = ((CONTENT, WANTED), (BANDWIDTH, BANDWIDTH_CODES[bandwidth_hz(settings)]), (RATE, rate_code))
    for command in (UNLOCK, *(write_register(register, value) for register, value in wanted)):
        port.write(command)
        yield from _pause(port, COMMAND_S, clock)


def _change_baud(port: SerialPort, wanted: int, clock: Clock) -> Generator[None, None, int]:
    """Change it at both ends; returns the one at which the part sends afterwards."""
    port.write(write_register(BAUD, BAUD_CODES[wanted]))
    yield from _pause(port, COMMAND_S, clock)  # the command must have left before this end changes
    return (yield from find(port, wanted, clock))


def _insist(registers: tuple[int, ...] | None, rate_code: int) -> None:
    if registers is not None and registers[:2] == (WANTED, rate_code):
        return
    said = "no answer" if registers is None else f"content 0x{registers[0]:04X}, rate code {registers[1]}"
    raise Jy901Error(
        f"the JY901 did not take its settings ({said} instead of 0x{WANTED:04X}, {rate_code})",
        "check the wire from the computer's TX to its RX for contact",
    )


def _registers(port: SerialPort, first: int, clock: Clock) -> Generator[None, None, tuple[int, ...] | None]:
    """Four registers; None if no answer comes."""
    for _ in range(2):  # a disturbed answer is no answer
        port.write(read_registers(first))
        answer = yield from _hear(port, Kind.REGISTERS, ANSWER_S, clock)
        if answer is not None:
            return tuple(word & 0xFFFF for word in answer.words)
    return None


def _hear(port: SerialPort, kind: Kind, seconds: float, clock: Clock) -> Generator[None, None, Packet | None]:
    parser, until_ns = Parser(), _after(clock, seconds)
    while clock.now_ns() < until_ns:
        for packet in parser.feed(port.read()):
            if packet.kind is kind:
                return packet
        yield
    return None


def _goes_on(port: SerialPort, clock: Clock) -> Generator[None, None, bool]:
    """Whether it sends again and again."""
    parser, until_ns, groups = Parser(), _after(clock, GO_ON_S), 0
    while groups < SEVERAL and clock.now_ns() < until_ns:
        groups += sum(packet.kind is Kind.GYRO for packet in parser.feed(port.read()))
        yield
    return groups >= SEVERAL


def _pause(port: SerialPort, seconds: float, clock: Clock) -> Waiting:
    until_ns = _after(clock, seconds)
    while clock.now_ns() < until_ns:
        port.read()
        yield


def _after(clock: Clock, seconds: float) -> int:
    return clock.now_ns() + round(seconds * 1e9)
