"""A virtual ADIS16448: answers SPI frames and drives a data-ready line like the part (data sheet Rev. E).

Where the sheet is silent it does what would hurt a careless driver: undefined words are junk, a word that
comes too early gets the previous answer once more, a burst across an update of the registers is torn.
"""

from __future__ import annotations

import struct
import threading
from typing import Literal

from drivers.adis16448.registers import (
    ACCEL_LSB,
    AVG_RANGE_CODE,
    AVG_RANGE_MASK,
    AVG_RANGE_SHIFT,
    AVG_TAPS_MASK,
    CMD_FACTORY_RESTORE,
    CMD_FLASH_UPDATE,
    CMD_GYRO_BIAS,
    CMD_RESET,
    DIAG_MEMORY,
    DIAG_NEW_DATA,
    DIAG_OVERRANGE,
    DIAG_SELF_TEST,
    DIAG_SPI,
    GYRO_LSB_DPS,
    GYRO_OFFSET_LSB,
    MIN_TAPS_EXPONENT,
    MSC_ACTIVE_HIGH,
    MSC_BURST_CRC,
    MSC_DATA_READY,
    MSC_MEMORY_TEST,
    MSC_ON_DIO2,
    MSC_SELF_TEST,
    REGISTERS,
    SMPL_DECIMATION_MASK,
    SMPL_DECIMATION_SHIFT,
    SMPL_INTERNAL_CLOCK,
)
from drivers.clock import Clock
from drivers.data_ready import Edge
from drivers.virtual.adis16448_updates import SignalSettings, Updates
from drivers.virtual.inertial_input import InertialInput
from drivers.virtual.sensor_errors import SensorErrors
from estimation.records import TimeKind

INVALID_NS = 210_000  # the registers change during this time before each data-ready edge
RESET_NS = 90_000_000
FLASH_NS = 75_000_000
SELF_TEST_NS = 45_000_000
MEMORY_TEST_NS = 20_000_000

_STALL_NS = 9_000
_WORD_PERIOD_NS = 40_000
_REGISTER_SPEED_HZ = 2_000_000
_BURST_SPEED_HZ = 1_000_000

_UNDEFINED = 0x5AA5
_BURST_READ = REGISTERS["GLOB_CMD"].address
_FIRST_OUTPUT = REGISTERS["XGYRO_OUT"].address
_LAST_OUTPUT = REGISTERS["TEMP_OUT"].address
_FIELD_AND_PRESSURE = range(REGISTERS["XMAGN_OUT"].address, REGISTERS["BARO_OUT"].address + 2)
_GYRO_OFFSETS = REGISTERS["XGYRO_OFF"].address
_ACCEL_OFFSETS = REGISTERS["XACCL_OFF"].address
_MSC = REGISTERS["MSC_CTRL"].address
_PRD = REGISTERS["SMPL_PRD"].address
_AVG = REGISTERS["SENS_AVG"].address
_SIGNAL_SETTINGS = {*range(_GYRO_OFFSETS, _ACCEL_OFFSETS + 6), *range(_PRD, _AVG + 2)}
_WRITABLE = {r.address + i for r in REGISTERS.values() if r.access == "RW" for i in (0, 1)}
_FLASH_BACKED = sorted(r.address + i for r in REGISTERS.values() if r.flash for i in (0, 1))
_MEMORY_SIZE = REGISTERS["SERIAL_NUM"].address + 2
_RANGES = {code: dps for dps, code in AVG_RANGE_CODE.items()}
_FULL_SEQUENCE = 16  # internal samples per magnetometer and barometer sample


class VirtualAdis16448:
    """The part at its SPI pins: an SpiTransport; `data_ready` gives the line that belongs to it.

    Before the first sample of its input the registers hold that sample and the line rests; after the last
    one the line rests for ever. Safe to use from several threads.
    """

    def __init__(
        self,
        inertial_input: InertialInput,
        clock: Clock,
        *,
        errors: SensorErrors | None = None,
        silicon: Literal["BMLZ", "AMLZ"] = "BMLZ",
        lot_id: int = 0x1824_0042,
        serial: int = 1234,
        failing_parts: int = 0,
    ) -> None:
        """Power the part up. AMLZ, the old silicon, has no burst checksum.

        `failing_parts` are the DIAG_STAT bits that its self-test and memory test will set.
        """
        self.stuck_byte: int | None = None  # 0x00 or 0xFF: the data wire is shorted or open
        self.is_line_cut = False  # the data-ready wire is broken
        self.clock = clock
        self.lock = threading.RLock()
        self._has_crc = silicon == "BMLZ"
        self._failing_parts = failing_parts

        self._memory = bytearray(_MEMORY_SIZE)
        for register in REGISTERS.values():
            self._set(register.address, register.reset or 0)
        self._set(REGISTERS["LOT_ID1"].address, lot_id >> 16)
        self._set(REGISTERS["LOT_ID2"].address, lot_id)
        self._set(REGISTERS["SERIAL_NUM"].address, serial)
        self._flash = bytes(self._memory)

        self._answer = _UNDEFINED  # of the word to come
        self._last_answer = _UNDEFINED
        self._frame_start_ns = self._frame_end_ns = clock.now_ns() - _WORD_PERIOD_NS
        self._deaf_until_ns = 0  # SPI answers zeros
        self._paused_until_ns = 0  # no updates of the registers
        self._tests: dict[int, int] = {}  # running test bits of MSC_CTRL: end [ns]

        self._flags = 0  # DIAG_STAT without NEW DATA
        self._field_read = -1  # number of the last magnetometer sample read
        self._edges = [0, 0]  # of DIO1, DIO2
        self._updates = Updates(inertial_input, errors, self._signal_settings())

    # -- pins ----------------------------------------------------------------------------------------

    def transfer(self, data: bytes, speed_hz: int) -> bytes:
        """One chip-select-low frame; takes the time the bits take."""
        with self.lock:
            start_ns = self.clock.now_ns()
            if self.stuck_byte is not None:
                answer = bytes([self.stuck_byte]) * len(data)
            else:
                answer = self._exchange(data, speed_hz, start_ns)
            self._frame_start_ns = start_ns
            duration_s = 8 * len(data) / speed_hz
            self._frame_end_ns = start_ns + round(duration_s * 1e9)
        self.clock.sleep(duration_s)
        return answer

    def close(self) -> None:
        """Nothing to release."""

    def data_ready(self, *, pin: Literal[1, 2] = 1, active_high: bool = True) -> TwinDataReady:
        """A listener on DIO1 or DIO2 for the edge to the level that should mean valid data."""
        return TwinDataReady(self, pin, active_high)

    @property
    def exhausted(self) -> bool:
        """Whether the input has ended and its last sample is in the registers."""
        with self.lock:
            return self._updates.exhausted

    def edge_state(self, pin: int, now_ns: int, until_ns: int) -> tuple[int, int, int | None]:
        """Valid edges of `pin` so far, time of the newest, and of the next one if it comes by `until_ns`."""
        with self.lock:
            self._advance(now_ns)
            self._updates.load_until(until_ns)
            next_ns = self._updates.next_ns if self._active_pin() == pin else None
            return self._edges[pin - 1], self._updates.newest_ns, next_ns

    def is_high_when_valid(self) -> bool:
        """Polarity of the line as set in MSC_CTRL."""
        return bool(self._memory[_MSC] & MSC_ACTIVE_HIGH)

    def _active_pin(self) -> int | None:
        control = self._memory[_MSC]
        if self.is_line_cut or not control & MSC_DATA_READY:
            return None
        return 2 if control & MSC_ON_DIO2 else 1

    # -- SPI -----------------------------------------------------------------------------------------

    def _exchange(self, data: bytes, speed_hz: int, start_ns: int) -> bytes:
        if start_ns < self._deaf_until_ns:
            return bytes(len(data))
        self._advance(start_ns)
        if len(data) % 2:
            self._flags |= DIAG_SPI
            return self._answer.to_bytes(2, "big").ljust(len(data), b"\0")[: len(data)]
        words = struct.unpack(f">{len(data) // 2}H", data)
        too_early = start_ns - self._frame_end_ns < _STALL_NS
        if len(words) > 1 and words[0] >> 8 == _BURST_READ:
            return self._burst(len(words), start_ns, speed_hz, too_early or speed_hz > _BURST_SPEED_HZ)
        too_early |= start_ns - self._frame_start_ns < _WORD_PERIOD_NS or speed_hz > _REGISTER_SPEED_HZ
        answers = []
        for word in words:
            if not too_early:
                self._last_answer = self._answer
            answers.append(self._last_answer)
            self._answer = self._execute(word, start_ns)
        return struct.pack(f">{len(words)}H", *answers)

    def _burst(self, words: int, start_ns: int, speed_hz: int, disturbed: bool) -> bytes:
        word_ns = 16e9 / speed_hz
        updates = self._updates
        frame, checksum = updates.frame, updates.checksum
        end_ns = start_ns + round(words * word_ns) + INVALID_NS
        updates.load_until(end_ns)
        if updates.next_ns is not None and updates.next_ns < end_ns:
            frame, checksum = self._torn(start_ns, word_ns)
        if not self._memory[_MSC] & MSC_BURST_CRC:
            checksum = b""
        answer = struct.pack(">HH", self._answer, self._diagnosis()) + frame + checksum
        self._read_field()
        self._answer = _UNDEFINED
        if disturbed:
            # The next word is not ready in time and the last one goes out again.
            answer = answer[:4] + answer[2:]
        undefined = _UNDEFINED.to_bytes(2, "big") * words
        return (answer + undefined)[: 2 * words]

    def _torn(self, start_ns: int, word_ns: float) -> tuple[bytes, bytes]:
        """A burst across updates: each word as its register is when its turn comes."""
        frame = b""
        for word in range(11):
            # The registers change one after the other through the invalid phase; DIAG_STAT goes first.
            turn_ns = round(start_ns + (word + 2) * word_ns)
            shown = self._updates.shown_at(turn_ns + INVALID_NS - (word + 2) * INVALID_NS // 12)
            frame += shown[0][2 * word : 2 * word + 2]
        return frame, self._updates.shown_at(round(start_ns + 13 * word_ns))[1]

    def _execute(self, word: int, now_ns: int) -> int:
        """Carry out one command word; return the answer that the next word will shift out."""
        address, value = word >> 8 & 0x7F, word & 0xFF
        if word & 0x8000:
            self._write(address, value, now_ns)
            return _UNDEFINED
        return self._read(address & 0x7E)

    def _read(self, address: int) -> int:
        if _FIRST_OUTPUT <= address <= _LAST_OUTPUT:
            offset = address - _FIRST_OUTPUT
            if address in _FIELD_AND_PRESSURE:
                self._read_field()
            return int.from_bytes(self._updates.frame[offset : offset + 2], "big")
        if address == REGISTERS["SEQ_CNT"].address:
            decimation = 1 << self._decimation_exponent()
            sequence = max(1, _FULL_SEQUENCE // decimation)
            return sequence - self._updates.number // decimation % sequence
        if address == REGISTERS["DIAG_STAT"].address:
            return self._diagnosis()
        return self._get(address) if address < _MEMORY_SIZE else 0

    def _diagnosis(self) -> int:
        """DIAG_STAT; reading it clears the flags, not NEW DATA."""
        flags, self._flags = self._flags, 0
        return flags | (DIAG_NEW_DATA if self._field_number() != self._field_read else 0)

    def _field_number(self) -> int:
        return self._updates.number // max(_FULL_SEQUENCE, 1 << self._decimation_exponent())

    def _read_field(self) -> None:
        self._field_read = self._field_number()

    # -- registers -----------------------------------------------------------------------------------

    def _get(self, address: int) -> int:
        return self._memory[address] | self._memory[address + 1] << 8

    def _set(self, address: int, value: int) -> None:
        self._memory[address : address + 2] = (value & 0xFFFF).to_bytes(2, "little")

    def _decimation_exponent(self) -> int:
        return min(16, (self._get(_PRD) & SMPL_DECIMATION_MASK) >> SMPL_DECIMATION_SHIFT)

    def _gyro_range(self) -> int:
        return _RANGES.get((self._get(_AVG) & AVG_RANGE_MASK) >> AVG_RANGE_SHIFT, 1000)

    def _write(self, address: int, value: int, now_ns: int) -> None:
        if address == _BURST_READ:
            self._command(value, now_ns)
        if address not in _WRITABLE:
            return
        if address == _MSC and not self._has_crc:
            value &= ~MSC_BURST_CRC
        self._memory[address] = value
        if address == _MSC + 1:
            self._start_tests(now_ns)
        if address in (_AVG, _AVG + 1):
            # A lower range raises the least number of taps.
            least = MIN_TAPS_EXPONENT[self._gyro_range()]
            self._memory[_AVG] = self._memory[_AVG] & ~AVG_TAPS_MASK | max(
                least, self._memory[_AVG] & AVG_TAPS_MASK
            )
        if address in _SIGNAL_SETTINGS:
            self._update_signal(now_ns)

    def _start_tests(self, now_ns: int) -> None:
        self._set(_MSC, self._get(_MSC) & (MSC_SELF_TEST | MSC_MEMORY_TEST | 0xFF))
        if self._get(_MSC) & MSC_SELF_TEST:
            self._tests[MSC_SELF_TEST] = now_ns + (SELF_TEST_NS << self._decimation_exponent())
        if self._get(_MSC) & MSC_MEMORY_TEST:
            self._tests[MSC_MEMORY_TEST] = now_ns + MEMORY_TEST_NS
        if self._tests:
            self._pause(now_ns, max(self._tests.values()))

    def _end_tests(self, now_ns: int) -> None:
        for bit, end_ns in list(self._tests.items()):
            if now_ns < end_ns:
                continue
            del self._tests[bit]
            self._set(_MSC, self._get(_MSC) & ~bit)
            if bit == MSC_MEMORY_TEST:
                self._flags |= self._failing_parts & DIAG_MEMORY
            elif failing := self._failing_parts & ~DIAG_MEMORY:
                self._flags |= failing | DIAG_SELF_TEST

    def _command(self, command: int, now_ns: int) -> None:
        busy_ns = 0
        if command & CMD_GYRO_BIAS:
            to_offset = GYRO_LSB_DPS[self._gyro_range()] / 0.01
            for axis, count in enumerate(struct.unpack_from(">3h", self._updates.frame)):
                self._set(_GYRO_OFFSETS + 2 * axis, round(-count * to_offset))
        if command & CMD_FACTORY_RESTORE:
            self._memory[_GYRO_OFFSETS : _ACCEL_OFFSETS + 6] = bytes(12)
        if command & (CMD_FLASH_UPDATE | CMD_GYRO_BIAS | CMD_FACTORY_RESTORE):
            self._set(0, self._get(0) + 1)  # FLASH_CNT
            self._flash = bytes(self._memory)
            busy_ns += FLASH_NS
        if command & (CMD_RESET | CMD_FACTORY_RESTORE):
            for register in REGISTERS.values():
                if not register.flash:
                    self._set(register.address, register.reset or 0)
            for address in _FLASH_BACKED:
                self._memory[address] = self._flash[address]
            self._tests.clear()
            self._flags = 0
            busy_ns += RESET_NS
        if busy_ns:
            self._deaf_until_ns = now_ns + busy_ns
            self._pause(now_ns, self._deaf_until_ns)

    # -- samples -------------------------------------------------------------------------------------

    def _advance(self, now_ns: int) -> None:
        if self._tests:
            self._end_tests(now_ns)
        passed, overrange = self._updates.advance(now_ns)
        pin = self._active_pin()
        if pin is not None:
            self._edges[pin - 1] += passed
        if overrange:
            self._flags |= DIAG_OVERRANGE

    def _pause(self, now_ns: int, until_ns: int) -> None:
        self._paused_until_ns = until_ns
        self._update_signal(now_ns)

    def _update_signal(self, now_ns: int) -> None:
        self._updates.change(self._signal_settings(), now_ns, self._paused_until_ns)

    def _signal_settings(self) -> SignalSettings:
        counts = struct.unpack_from("<6h", self._memory, _GYRO_OFFSETS)
        return SignalSettings(
            taps_exponent=self._get(_AVG) & AVG_TAPS_MASK,
            decimation_exponent=self._decimation_exponent(),
            gyro_range_dps=self._gyro_range(),
            offsets=(
                *(count * GYRO_OFFSET_LSB for count in counts[:3]),
                *(count * ACCEL_LSB for count in counts[3:]),
            ),
            has_clock=bool(self._get(_PRD) & SMPL_INTERNAL_CLOCK),
        )


class TwinDataReady:
    """The data-ready line as a listener sees it: a DataReady on the clock of the twin."""

    def __init__(self, twin: VirtualAdis16448, pin: Literal[1, 2], active_high: bool) -> None:
        self._twin = twin
        self._clock = twin.clock
        self._pin = pin
        self._active_high = active_high
        now_ns = self._clock.now_ns()
        self._seen = twin.edge_state(pin, now_ns, now_ns)[0]

    def wait(self, timeout_s: float) -> Edge | None:
        """The newest edge not yet seen, else the next one; None after `timeout_s` without."""
        now_ns = self._clock.now_ns()
        deadline_ns = now_ns + round(timeout_s * 1e9)
        while True:
            # With the wrong polarity the listener takes the start of the invalid phase for its end.
            lead_ns = 0 if self._twin.is_high_when_valid() == self._active_high else INVALID_NS
            count, newest_ns, next_ns = self._twin.edge_state(self._pin, now_ns, deadline_ns + lead_ns)
            if next_ns is not None and next_ns - lead_ns <= now_ns:
                count, newest_ns = count + 1, next_ns
            if count > self._seen:
                missed, self._seen = count - self._seen - 1, count
                return Edge(newest_ns - lead_ns, TimeKind.EDGE, missed)
            if now_ns >= deadline_ns:
                return None
            wake_ns = deadline_ns if next_ns is None else min(deadline_ns, next_ns - lead_ns)
            self._clock.sleep((wake_ns - now_ns) / 1e9)
            now_ns = self._clock.now_ns()

    def close(self) -> None:
        """Nothing to release."""
