"""The ADIS16448 behind an SPI port: start it, check it, read it."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import StrEnum

from drivers.adis16448 import burst as bursts
from drivers.adis16448.burst import Burst
from drivers.adis16448.configuration import ImuSettings, RegisterBits, register_bits
from drivers.adis16448.crc import burst_crc
from drivers.adis16448.registers import (
    CMD_RESET,
    DIAG_BAROMETER,
    DIAG_INERTIAL_PARTS,
    DIAG_MAGNETOMETER,
    DIAG_MEMORY,
    DIAG_SELF_TEST,
    MSC_BURST_CRC,
    MSC_SELF_TEST,
    PRODUCT_ID,
    REGISTERS,
    diagnoses,
)
from drivers.clock import Clock
from drivers.data_ready import Edge
from drivers.spi import SpiError, SpiTransport

# Half of the part's limits for register access and exactly its limit for bursts.
_SPEED_HZ = 1_000_000
_STALL_NS = 9_000  # chip select high between frames
_WORD_STALL_NS = 24_000  # after a register word of 16 us: the 40 us the part wants from start to start

_RESET_S = 0.090
_SELF_TEST_S = 0.045
_SELF_TEST_LIMIT_S = 1.0
_POLL_S = 0.005

_IDENTIFY_ATTEMPTS = 10
_IDENTIFY_PAUSE_S = 0.020  # together 0.2 s: the time from power-on to data
_READ_ATTEMPTS = 8
_WRITE_ATTEMPTS = 3

_CRC_MATCHES = 8  # by chance once in 2^128
# Without the data-ready line a third of the bursts meets an update of the registers; the pause lets their
# phase wander, so that most do not.
_CRC_BURSTS = 64
_CRC_PAUSE_S = 0.0017

_FAILING_PARTS = DIAG_INERTIAL_PARTS | DIAG_MEMORY | DIAG_BAROMETER | DIAG_MAGNETOMETER
_FATAL_PARTS = DIAG_INERTIAL_PARTS | DIAG_MEMORY | DIAG_SELF_TEST


class ImuError(RuntimeError):
    """The inertial sensor does not do what it must; the text is one sentence for a person."""


class State(StrEnum):
    """Where the part is on its way to data; any fault that lasts starts over at RESET."""

    RESET = "reset"
    IDENTIFY = "identify"
    SELF_TEST = "self-test"
    CONFIGURE = "configure"
    READ = "read"


@dataclass(slots=True, frozen=True)
class Identity:
    """Who the part says it is."""

    product_id: int
    lot_id: int  # LOT_ID1 in the upper half
    serial: int


class Adis16448:
    """One ADIS16448: `start` it, then `read_burst` at each data-ready edge.

    Every method may raise SpiError when the port fails and ImuError when the part does; only `read_burst`
    raises nothing: a burst that failed says so itself.
    """

    def __init__(self, transport: SpiTransport, clock: Clock, settings: ImuSettings) -> None:
        self.settings = settings
        self.state = State.RESET
        self.crc_active = False
        self.notes: list[str] = []  # what a person should know although the part works
        self.last_spi_error = ""
        self._transport = transport
        self._clock = clock
        self._bus_free_ns = clock.now_ns()
        self._request = bursts.REQUEST

    def start(self) -> Identity:
        """Bring the part from any state to data: reset, identify, self-test, configure."""
        self.notes.clear()
        self.state = State.RESET
        self.reset()
        self.state = State.IDENTIFY
        identity = self.identify()
        self.state = State.SELF_TEST
        self.notes.extend(self.self_test())
        self.state = State.CONFIGURE
        self.configure()
        self.state = State.READ
        return identity

    def reset(self) -> None:
        """Software reset, and the time it takes."""
        self._write_byte(REGISTERS["GLOB_CMD"].address, CMD_RESET)
        self._clock.sleep(_RESET_S)

    def identify(self) -> Identity:
        """Read who the part is, patiently: after a cold start its first answers may be wrong."""
        self.read_register("PROD_ID")  # the answer of a waking part does not count
        for _ in range(_IDENTIFY_ATTEMPTS):
            product = [self.read_register("PROD_ID") for _ in range(2)]
            if product == [PRODUCT_ID] * 2:
                break
            self._clock.sleep(_IDENTIFY_PAUSE_S)
        else:
            raise ImuError(
                f"register {_label('PROD_ID')} reads 0x{product[1]:04X} instead of 0x{PRODUCT_ID:04X}: "
                f"{_likely_cause(product[1])}"
            )
        return Identity(
            product_id=PRODUCT_ID,
            lot_id=self._read_settled("LOT_ID1") << 16 | self._read_settled("LOT_ID2"),
            serial=self._read_settled("SERIAL_NUM") & 0x0FFF,
        )

    def self_test(self) -> list[str]:
        """Let the part test itself; the sentences name what it is nevertheless usable without.

        A magnet or steel nearby fails the magnetometer, which nothing here needs. Raises ImuError if a
        gyroscope, an accelerometer or the program memory failed.
        """
        self.read_register("DIAG_STAT")  # clears what happened before
        control = REGISTERS["MSC_CTRL"].address
        # The high byte alone: data-ready and checksum bits live in the low one.
        self._write_byte(control + 1, MSC_SELF_TEST >> 8)
        self._clock.sleep(_SELF_TEST_S)
        limit_ns = self._clock.now_ns() + round(_SELF_TEST_LIMIT_S * 1e9)
        while self.read_register("MSC_CTRL") & MSC_SELF_TEST:
            if self._clock.now_ns() > limit_ns:
                raise ImuError(f"the self-test did not end within {_SELF_TEST_LIMIT_S:g} s: replace the sensor")
            self._clock.sleep(_POLL_S)
        # Once only: this read clears the answer.
        status = self.read_register("DIAG_STAT")
        failed = status & _FAILING_PARTS or status & DIAG_SELF_TEST
        failures = diagnoses(failed)
        if failed & _FATAL_PARTS:
            raise ImuError(
                f"{' and '.join(failures)} (DIAG_STAT 0x{status:04X}): keep the sensor still and try again, "
                "else replace it"
            )
        return failures

    def configure(self) -> None:
        """Write the register table, read it back, and find out whether bursts carry a checksum.

        Writes only bytes that differ and never updates the flash memory, which wears.
        """
        self._use_crc(False)
        for bits in register_bits(self.settings, crc=False):
            self._apply(bits)
        if self.settings.burst_crc == "off":
            return
        if self._probe_crc():
            self._use_crc(True)
        elif self.settings.burst_crc == "on":
            raise ImuError('the part sends no valid burst checksum (old silicon or a bad wire): set burst_crc = "auto"')
        else:
            self._write_byte(REGISTERS["MSC_CTRL"].address, self._read_settled("MSC_CTRL") & 0xFF & ~MSC_BURST_CRC)
            self.notes.append("the part sends no burst checksum (old silicon): torn bursts cannot be seen")

    def read_burst(self, edge: Edge) -> Burst:
        """Read the sample announced by `edge`; a bad wire or port shows in `fault`, not as an exception."""
        try:
            frame = self._frame(self._request)
        except SpiError as error:
            self.last_spi_error = str(error)
            return bursts.failed(edge.t_ns, edge.kind)
        return bursts.parse(frame, edge.t_ns, edge.kind)

    def read_register(self, name: str) -> int:
        """Read one 16-bit register: one frame asks, the next one carries the answer."""
        self._word(REGISTERS[name].address << 8)
        return self._word(0x0000)

    def write_register(self, name: str, value: int) -> None:
        """Write both bytes of a register, low byte first."""
        address = REGISTERS[name].address
        self._write_byte(address, value & 0xFF)
        self._write_byte(address + 1, value >> 8)

    def _read_settled(self, name: str) -> int:
        readings = [self.read_register(name), self.read_register(name)]
        while readings[-1] != readings[-2]:
            if len(readings) == _READ_ATTEMPTS:
                raise ImuError(
                    f"register {_label(name)} reads 0x{readings[-2]:04X}, then 0x{readings[-1]:04X}: "
                    f"{_likely_cause(readings[-1])}"
                )
            readings.append(self.read_register(name))
        return readings[-1]

    def _apply(self, bits: RegisterBits) -> None:
        address = REGISTERS[bits.register].address
        wanted = read = self._read_settled(bits.register)
        for _ in range(_WRITE_ATTEMPTS):
            if bits.holds_in(read):
                return
            wanted = bits.applied_to(read)
            for shift in (0, 8):
                if (wanted ^ read) >> shift & 0xFF:
                    self._write_byte(address + shift // 8, wanted >> shift & 0xFF)
            read = self._read_settled(bits.register)
        if not bits.holds_in(read):
            raise ImuError(
                f"register {_label(bits.register)} was written 0x{wanted:04X} and reads back 0x{read:04X}: "
                f"{_likely_cause(read)}"
            )

    def _probe_crc(self) -> bool:
        control = REGISTERS["MSC_CTRL"].address
        self._write_byte(control, self._read_settled("MSC_CTRL") & 0xFF | MSC_BURST_CRC)
        if not self._read_settled("MSC_CTRL") & MSC_BURST_CRC:
            return False
        matches = 0
        for _ in range(_CRC_BURSTS):
            self._clock.sleep(_CRC_PAUSE_S)
            frame = self._frame(bursts.REQUEST_WITH_CRC)
            *words, crc = struct.unpack(">4x12H", frame)
            matches += burst_crc(words[:11]) == crc
            if matches == _CRC_MATCHES:
                return True
        return False

    def _use_crc(self, active: bool) -> None:
        self.crc_active = active
        self._request = bursts.REQUEST_WITH_CRC if active else bursts.REQUEST

    def _write_byte(self, address: int, value: int) -> None:
        self._word(0x8000 | address << 8 | value)

    def _word(self, word: int) -> int:
        return int.from_bytes(self._frame(word.to_bytes(2, "big"), _WORD_STALL_NS), "big")

    def _frame(self, data: bytes, stall_ns: int = _STALL_NS) -> bytes:
        """Exchange one frame, not before the part is ready for it, and note when it is ready again."""
        early_ns = self._bus_free_ns - self._clock.now_ns()
        if early_ns > 0:
            self._clock.sleep(early_ns / 1e9)
        answer = self._transport.transfer(data, _SPEED_HZ)
        self._bus_free_ns = self._clock.now_ns() + stall_ns
        return answer


def _label(name: str) -> str:
    return f"{name} (0x{REGISTERS[name].address:02X})"


def _likely_cause(value: int) -> str:
    if value == 0x0000:
        return "the data wire (DOUT, MISO) stays low; check the sensor's supply and that wire"
    if value == 0xFFFF:
        return "the data wire (DOUT, MISO) floats; check that the sensor is plugged in and its chip select"
    return "check the wires SCLK, DIN (MOSI) and CS, and that nothing else uses this SPI port"
