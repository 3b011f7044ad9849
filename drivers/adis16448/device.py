"""The ADIS16448 behind an SPI port: its registers, its tests, its bursts, each as one short step."""

from __future__ import annotations

import struct

from drivers.adis16448 import burst as bursts
from drivers.adis16448.burst import Burst
from drivers.adis16448.configuration import ImuSettings, RegisterBits, merged, register_bits
from drivers.adis16448.crc import burst_crc
from drivers.adis16448.identity import Identity
from drivers.adis16448.registers import (
    CMD_RESET,
    DIAG_BAROMETER,
    DIAG_INERTIAL_PARTS,
    DIAG_MAGNETOMETER,
    DIAG_MEMORY,
    DIAG_SELF_TEST,
    MSC_ACTIVE_HIGH,
    MSC_BURST_CRC,
    MSC_DATA_READY,
    MSC_ON_DIO2,
    MSC_SELF_TEST,
    PRODUCT_ID,
    REGISTERS,
    diagnoses,
)
from drivers.clock import Clock
from drivers.spi import SpiError, SpiTransport
from estimation.records import TimeKind

# Half of the part's limits for register access and exactly its limit for bursts.
_SPEED_HZ = 1_000_000
_STALL_NS = 9_000  # chip select high between frames
_WORD_STALL_NS = 24_000  # after a register word of 16 us: the 40 us the part wants from start to start

_READ_ATTEMPTS = 8
_WRITE_ATTEMPTS = 3

# Eight matches end the probe. After all bursts of it two suffice (by chance once in two million probes): a bad
# wire must not talk us out of the checksum that tells of it.
_CRC_MATCHES, _LEAST_CRC_MATCHES = 8, 2
# Without the data-ready line a third of the bursts meets an update of the registers; the pause lets their
# phase wander, so that most do not.
_CRC_BURSTS = 64
_CRC_PAUSE_S = 0.0017

_FAILING_PARTS = DIAG_INERTIAL_PARTS | DIAG_MEMORY | DIAG_BAROMETER | DIAG_MAGNETOMETER
_FATAL_PARTS = DIAG_INERTIAL_PARTS | DIAG_MEMORY | DIAG_SELF_TEST


class ImuError(RuntimeError):
    """The inertial sensor does not do what it must: what is wrong, and what to do about it."""

    def __init__(self, what: str, advice: str = "") -> None:
        super().__init__(f"{what}: {advice}" if advice else what)
        self.what = what
        self.advice = advice


class ChecksumMissing(ImuError):
    """Bursts should carry a checksum and none is right: a bad wire, or silicon that sends none."""


class Adis16448:
    """One ADIS16448 at an SPI port.

    Every method may raise SpiError when the port fails, those on the way to data ImuError when the part does. The
    times between the steps are the caller's.
    """

    def __init__(self, transport: SpiTransport, clock: Clock, settings: ImuSettings) -> None:
        self.settings = settings
        self.crc_active = False
        self._transport = transport
        self._clock = clock
        self._bus_free_ns = clock.now_ns()
        self._request = bursts.REQUEST
        self._table = merged(register_bits(settings, crc=False))
        self._turn = 0

    # --- on the way to data -----------------------------------------------------------------------------------

    def reset(self) -> None:
        """Software reset; the part needs 90 ms for it."""
        self._write_byte(REGISTERS["GLOB_CMD"].address, CMD_RESET)

    def identify(self) -> Identity:
        """Read who the part is. Raises ImuError if it is no ADIS16448, or no part at all."""
        self.read_register("PROD_ID")  # the answer of a waking part does not count
        product = [self.read_register("PROD_ID") for _ in range(2)]
        for value in product:
            if value != PRODUCT_ID:
                raise ImuError(
                    f"register {_label('PROD_ID')} reads 0x{value:04X} instead of 0x{PRODUCT_ID:04X}",
                    likely_cause(value),
                )
        return Identity(
            t_ns=self._clock.now_ns(),
            product_id=PRODUCT_ID,
            lot_id=self._read_settled("LOT_ID1") << 16 | self._read_settled("LOT_ID2"),
            serial=self._read_settled("SERIAL_NUM") & 0x0FFF,
        )

    def begin_self_test(self) -> None:
        """Let the part test itself, which takes 45 ms, times 2^D of the decimation."""
        self.read_register("DIAG_STAT")  # clears what happened before
        # The high byte alone: data-ready and checksum bits live in the low one.
        self._write_byte(REGISTERS["MSC_CTRL"].address + 1, MSC_SELF_TEST >> 8)

    def self_test_verdict(self) -> list[str] | None:
        """None while the test runs, then sentences that name what the part is usable without.

        A magnet or steel nearby fails the magnetometer, which nothing here needs. Raises ImuError if a
        gyroscope, an accelerometer or the program memory failed.
        """
        if self.read_register("MSC_CTRL") & MSC_SELF_TEST:
            return None
        # Once only: this read clears the answer.
        status = self.read_register("DIAG_STAT")
        failed = status & _FAILING_PARTS or status & DIAG_SELF_TEST
        failures = diagnoses(failed)
        if failed & _FATAL_PARTS:
            raise ImuError(
                f"{' and '.join(failures)} (DIAG_STAT 0x{status:04X})",
                "keep the sensor still and wait for the next try; if it fails again, replace the sensor",
            )
        return failures

    def configure(self, *, may_lack_crc: bool = False) -> list[str]:
        """Write the register table, read it back, and find out whether bursts carry a checksum.

        Old silicon ignores the bit that asks for one. A part that takes the bit and sends none is believed only
        if `may_lack_crc`: a bad wire looks the same; else ChecksumMissing. Returns sentences that a person should
        know although the part works. Writes only bytes that differ and never updates the flash memory, which wears.
        """
        self._use_crc(False)
        for bits in register_bits(self.settings, crc=False):
            self._apply(bits)
        if self.settings.burst_crc == "off":
            return []
        takes_bit = self._ask_for_crc()
        if takes_bit and self._probe_crc():
            self._use_crc(True)
            return []
        if self.settings.burst_crc == "on":
            raise ImuError(
                "the part sends no valid burst checksum (old silicon or a bad wire)", 'set burst_crc = "auto" in [imu]'
            )
        if takes_bit and not may_lack_crc:
            raise ChecksumMissing(
                "the part takes the setting for burst checksums, but those that arrive are wrong",
                "check the wires SCLK, DOUT (MISO) and ground for length and contact",
            )
        self._write_byte(REGISTERS["MSC_CTRL"].address, self._read_settled("MSC_CTRL") & 0xFF & ~MSC_BURST_CRC)
        return ["the part sends no burst checksum (old silicon): only its time tells that a burst was torn"]

    def drive_data_ready(self, pin: int | None) -> None:
        """Let the part drive DIO1, DIO2 or neither of them, for whoever looks for the line that follows."""
        control = self._read_settled("MSC_CTRL") & 0xFF & ~(MSC_DATA_READY | MSC_ON_DIO2)
        driven = 0 if pin is None else MSC_DATA_READY | (MSC_ON_DIO2 if pin == 2 else 0)
        self._write_byte(REGISTERS["MSC_CTRL"].address, control | driven)

    def turn_data_ready(self, *, inverted: bool) -> None:
        """Give the data-ready pin the opposite polarity, or its own again."""
        control = self._read_settled("MSC_CTRL") & 0xFF & ~MSC_ACTIVE_HIGH
        self._write_byte(REGISTERS["MSC_CTRL"].address, control | (0 if inverted else MSC_ACTIVE_HIGH))

    # --- while data come --------------------------------------------------------------------------------------

    def read_burst(self, t_ns: int, time_kind: TimeKind) -> Burst:
        """Read the sample of that time; what is wrong with it shows in its `fault`."""
        return bursts.parse(self._frame(self._request), t_ns, time_kind)

    def wrong_register(self) -> str | None:
        """Check the next register of the table; a sentence if it lost its setting.

        A mismatch may be the wire's: it counts only if a second read says the same.
        """
        self._turn = (self._turn + 1) % len(self._table)
        bits = self._table[self._turn]
        value = self.read_register(bits.register)
        if bits.holds_in(value) or self.read_register(bits.register) != value:
            return None
        wanted = bits.applied_to(value)
        return f"register {_label(bits.register)} was set to 0x{wanted:04X} and reads 0x{value:04X}"

    # --- registers --------------------------------------------------------------------------------------------

    def read_register(self, name: str) -> int:
        """Read one 16-bit register."""
        return self.read_registers(name)[0]

    def read_registers(self, *names: str) -> list[int]:
        """Read 16-bit registers: each frame asks for one and carries the answer to the frame before."""
        requests = [REGISTERS[name].address << 8 for name in names]
        return [self._word(word) for word in (*requests, 0x0000)][1:]

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
                    f"register {_label(name)} reads 0x{readings[-2]:04X}, then 0x{readings[-1]:04X}",
                    likely_cause(readings[-1]),
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
                f"register {_label(bits.register)} was written 0x{wanted:04X} and reads back 0x{read:04X}",
                likely_cause(read),
            )

    def _ask_for_crc(self) -> bool:
        """Whether the part takes the bit."""
        control = REGISTERS["MSC_CTRL"].address
        self._write_byte(control, self._read_settled("MSC_CTRL") & 0xFF | MSC_BURST_CRC)
        return bool(self._read_settled("MSC_CTRL") & MSC_BURST_CRC)

    def _probe_crc(self) -> bool:
        matches = 0
        for _ in range(_CRC_BURSTS):
            self._clock.sleep(_CRC_PAUSE_S)
            frame = self._frame(bursts.REQUEST_WITH_CRC)
            *words, crc = struct.unpack(">4x12H", frame)
            matches += burst_crc(words[:11]) == crc
            if matches == _CRC_MATCHES:
                break
        return matches >= _LEAST_CRC_MATCHES

    def _use_crc(self, active: bool) -> None:
        self.crc_active = active
        self._request = bursts.REQUEST_WITH_CRC if active else bursts.REQUEST
        self._table = merged(register_bits(self.settings, crc=active))

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
        if len(answer) != len(data):
            raise SpiError(f"the SPI port returned {len(answer)} bytes of {len(data)}: replace its driver")
        self._bus_free_ns = self._clock.now_ns() + stall_ns
        return answer


def _label(name: str) -> str:
    return f"{name} (0x{REGISTERS[name].address:02X})"


def likely_cause(value: int) -> str:
    """Which wire to look at when a register reads `value` instead of what it must."""
    if value == 0x0000:
        return "the data wire (DOUT, MISO) stays low; check the sensor's supply and that wire"
    if value == 0xFFFF:
        return "the data wire (DOUT, MISO) floats; check that the sensor is plugged in and its chip select (CS)"
    return "check the wires SCLK, DIN (MOSI) and CS, and that nothing else uses this SPI port"
