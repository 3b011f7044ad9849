"""Looking for a fault at the part's wires: who answers, and which line the part's own pin moves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from drivers.adis16448.burst import Fault
from drivers.adis16448.device import Adis16448, likely_cause
from drivers.adis16448.registers import PRODUCT_ID
from drivers.clock import Clock
from drivers.data_ready import DataReady

_FAMILY = range(16_000, 17_000)  # product numbers
_QUEUE = 64  # edges that may wait
_SETTLE_S = 0.005  # from writing the bit to the pin's rest; longer than the line's longest pulse
_SLICE_S = 0.02
_SILENT_SHARE = 0.02  # of the nominal rate: a stray edge is no life
_DRIVEN_SHARE = 0.5  # of it, at least, must come and go with the pin
_TOLERANCE = 0.1
_BURSTS, _LONGEST_WAIT_S = 60, 0.2
_INVERTED_SHARE = 0.15  # of bursts that are torn; a line that is right tears none, or as many when turned


class IdKind(StrEnum):
    """How the register that names the part reads."""

    RIGHT = "right"
    LOW = "all zeros"
    HIGH = "all ones"
    WANDERING = "wandering"
    OTHER_PART = "another part"
    WRONG = "wrong"


@dataclass(slots=True, frozen=True)
class IdMeaning:
    """What the readings of PROD_ID say, and which wire to look at."""

    kind: IdKind
    what: str
    advice: str = ""


def product_ids(device: Adis16448, times: int) -> list[int]:
    """Read PROD_ID so many times. Raises SpiError."""
    device.read_register("PROD_ID")  # the answer of a waking part does not count
    return [device.read_register("PROD_ID") for _ in range(times)]


def meaning_of_ids(readings: Sequence[int]) -> IdMeaning:
    """One value for all means the part or a dead wire, many mean a bad wire."""
    total, wrong = len(readings), [value for value in readings if value != PRODUCT_ID]
    if not wrong:
        return IdMeaning(IdKind.RIGHT, f"PROD_ID reads 0x{PRODUCT_ID:04X} {total} times of {total}")
    value = wrong[0]
    if len(set(readings)) > 1:
        flips = 0
        for one in wrong:
            flips |= one ^ PRODUCT_ID
        return IdMeaning(
            IdKind.WANDERING,
            f"PROD_ID wanders: {len(wrong)} of {total} readings are wrong (bits 0x{flips:04X} change), the first "
            f"0x{value:04X}",
            "check the wires SCLK, DOUT (MISO), CS and ground for length and contact, and that nothing else uses this "
            "SPI port",
        )
    said = f"PROD_ID reads 0x{value:04X} instead of 0x{PRODUCT_ID:04X} {total} times of {total}"
    if value == 0x0000:
        return IdMeaning(IdKind.LOW, said, likely_cause(value))
    if value == 0xFFFF:
        return IdMeaning(IdKind.HIGH, said, likely_cause(value))
    if value in (PRODUCT_ID << 1 & 0xFFFF, PRODUCT_ID >> 1):
        return IdMeaning(
            IdKind.WRONG,
            f"{said}: the right answer, shifted by one bit",
            "shorten the wire SCLK or put its ground beside it: the computer counts one edge too many or too few",
        )
    if value in _FAMILY:
        return IdMeaning(
            IdKind.OTHER_PART,
            f"{said}: an ADIS{value}",
            "fit an ADIS16448, or correct spi_device in [imu] if the wanted part hangs on another port",
        )
    return IdMeaning(IdKind.WRONG, said, likely_cause(value))


class LineKind(StrEnum):
    """How a line behaves while the part's data-ready pin is switched on and off."""

    FOLLOWS = "follows"  # it is the part's
    SILENT = "silent"
    STRANGER = "ticks for another reason"
    TOO_FEW = "too few edges"
    TOO_MANY = "too many edges"


@dataclass(slots=True, frozen=True)
class LineReaction:
    """Edges a second while the part drives its pin, and while it does not."""

    on_hz: float
    off_hz: float

    def kind(self, nominal_hz: float) -> LineKind:
        """What that means for a part with so many samples a second.

        A pin that is not driven floats, so that a few edges of hum speak against nothing.
        """
        least = _SILENT_SHARE * nominal_hz
        if self.on_hz < least and self.off_hz < least:
            return LineKind.SILENT
        if self.off_hz >= least and self.on_hz - self.off_hz < _DRIVEN_SHARE * nominal_hz:
            return LineKind.STRANGER
        if self.on_hz < (1 - _TOLERANCE) * nominal_hz:
            return LineKind.TOO_FEW
        return LineKind.FOLLOWS if self.on_hz <= (1 + _TOLERANCE) * nominal_hz else LineKind.TOO_MANY


def line_reaction(device: Adis16448, line: DataReady, clock: Clock, pin: int, seconds: float) -> LineReaction:
    """Let `pin` rest, then drive it, and count edges. Raises SpiError, ImuError, DataReadyError.

    A line that ticks for another reason does so all the time: only driving the pin tells. Afterwards the part is
    as it was configured.
    """
    try:
        device.drive_data_ready(None)
        off_hz = edges_per_second(line, clock, seconds)
        device.drive_data_ready(pin)
        return LineReaction(edges_per_second(line, clock, seconds), off_hz)
    finally:
        device.drive_data_ready(device.settings.data_ready_pin)


def is_inverted(device: Adis16448, line: DataReady, clock: Clock) -> bool:
    """Whether the line shows the wrong edge of each pulse, as behind an inverter. Raises as `line_reaction`.

    At the wrong edge the registers are about to change, and bursts are torn; turn the pin round and they are whole.
    Only checksums tell: False without.
    """
    if not device.crc_active or (as_it_is := _torn_share(device, line, clock)) < _INVERTED_SHARE:
        return False
    try:
        device.turn_data_ready(inverted=True)
        return _torn_share(device, line, clock) < as_it_is / 4
    finally:
        device.turn_data_ready(inverted=False)


def _torn_share(device: Adis16448, line: DataReady, clock: Clock) -> float:
    """Share of bursts, read at an edge each, whose checksum is wrong."""
    edges_per_second(line, clock, 0.0)  # those of before are stale
    torn = 0
    for _ in range(_BURSTS):
        edge = line.wait(_LONGEST_WAIT_S)
        if edge is None:
            return 0.0
        torn += device.read_burst(edge.t_ns, edge.kind).fault is Fault.CRC
    return torn / _BURSTS


def edges_per_second(line: DataReady, clock: Clock, seconds: float) -> float:
    """Edges of a line, those of before left out. Raises DataReadyError."""
    clock.sleep(_SETTLE_S)
    for _ in range(_QUEUE):
        if line.wait(0.0) is None:
            break
    begin_ns = clock.now_ns()
    end_ns = begin_ns + round(seconds * 1e9)
    edges = 0
    while (now_ns := clock.now_ns()) < end_ns:
        edge = line.wait(min(_SLICE_S, (end_ns - now_ns) / 1e9))
        edges += 0 if edge is None else edge.missed + 1
    return edges / max((clock.now_ns() - begin_ns) / 1e9, 1e-9)
