"""A virtual ADIS16448: answers SPI frames and drives a data-ready line like the part (data sheet Rev. E).

Where the sheet is silent it does what would hurt a careless driver: undefined words are junk, a word that
comes too early gets the previous answer once more, a burst across an update of the registers is torn.
"""

from __future__ import annotations

import struct
import threading
from collections import deque
from dataclasses import dataclass
from typing import Literal

from drivers.adis16448.registers import (
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
    INVALID_NS,
    MSC_MEMORY_TEST,
    MSC_SELF_TEST,
    REGISTERS,
)
from drivers.clock import Clock
from drivers.virtual.adis16448_line import EdgeWire, LineState, PinHistory, VirtualDataReady
from drivers.virtual.adis16448_memory import SIGNAL_BYTES, Memory
from drivers.virtual.adis16448_updates import Updates
from drivers.virtual.faulty_part import PartCondition, PartSchedule
from drivers.virtual.inertial_input import InertialInput
from drivers.virtual.sensor_errors import SensorErrors

_POWER_ON_NS = 205_000_000
_RESET_NS = 90_000_000
_FLASH_NS = 75_000_000
_SELF_TEST_NS = 45_000_000
_MEMORY_TEST_NS = 20_000_000

_STALL_NS = 9_000
_WORD_PERIOD_NS = 40_000
_REGISTER_SPEED_HZ = 2_000_000
_BURST_SPEED_HZ = 1_000_000

_NEVER_NS = 1 << 62
# A request may have been under way between two processes that long; an older one was held up.
_UNDER_WAY_NS = 5_000_000

_UNDEFINED = 0x5AA5
_GLOB_CMD = REGISTERS["GLOB_CMD"].address
_SEQ_CNT = REGISTERS["SEQ_CNT"].address
_DIAG_STAT = REGISTERS["DIAG_STAT"].address
_MSC_CTRL = REGISTERS["MSC_CTRL"].address
_PROD_ID = REGISTERS["PROD_ID"].address
_GYRO_OFFSETS = REGISTERS["XGYRO_OFF"].address
_OUTPUTS = range(REGISTERS["XGYRO_OUT"].address, REGISTERS["TEMP_OUT"].address + 2)
_FIELD_AND_PRESSURE = range(REGISTERS["XMAGN_OUT"].address, REGISTERS["BARO_OUT"].address + 2)
_FIELD_PERIOD = 16  # internal samples per magnetometer and barometer sample


@dataclass(slots=True, frozen=True)
class PartAccount:
    """What a part has done since it was made."""

    updates: int  # of its output registers: one data-ready edge each, if the line is enabled
    edges: int  # that arrived at the listeners' end of the wire
    edges_lost_by_script: int
    edges_added_by_script: int


class VirtualAdis16448:
    """The part at its pins: an SpiTransport; `data_ready` gives the line that belongs to it.

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
        schedule: PartSchedule | None = None,
        edge_wire: EdgeWire | None = None,
    ) -> None:
        """Power the part up. AMLZ, the old silicon, has no burst checksum.

        `failing_parts` are the DIAG_STAT bits that its self-test and memory test will set, `schedule` is
        what a fault script does to the part, `edge_wire` what becomes of its data-ready edges.
        """
        self.clock = clock
        self.stuck_byte: int | None = None  # 0x00 or 0xFF: the data wire is shorted or open
        self.is_line_cut = False  # the data-ready wire is broken
        self._failing_parts = failing_parts
        self._lock = threading.Lock()
        self._has_crc = silicon == "BMLZ"
        self._memory = Memory(lot_id, serial, has_crc=self._has_crc)
        self._schedule = schedule
        self._changes = deque(schedule.changes_ns if schedule else ())
        self._condition = PartCondition()
        saturations = schedule.saturations if schedule else ()
        self._updates = Updates(inertial_input, errors, self._memory.signal_settings(), saturations)
        self._shown = self._updates.at(clock.now_ns())  # the output registers as the present frame sees them

        self._answer = _UNDEFINED  # to the word to come
        self._last_answer = _UNDEFINED
        self._frame_start_ns = self._frame_end_ns = clock.now_ns() - _WORD_PERIOD_NS
        self._now_ns = clock.now_ns()  # how far everything has happened
        self._deaf_until_ns = 0  # SPI answers zeros
        self._paused_until_ns = 0  # no updates of the output registers
        self._tests: dict[int, int] = {}  # running test bits of MSC_CTRL: end [ns]
        self._flags = 0  # DIAG_STAT without NEW DATA
        self._field_read = -1  # number of the last magnetometer sample read
        self._pins = (PinHistory(edge_wire), PinHistory(edge_wire))  # DIO1, DIO2

    def transfer(self, data: bytes, speed_hz: int, asked_ns: int | None = None) -> bytes:
        """One chip-select-low frame; takes the time its bits take.

        A client in another process says when it asked: what the way took does not count.
        """
        with self._lock:
            start_ns = now_ns = self.clock.now_ns()
            if asked_ns is not None and max(now_ns - _UNDER_WAY_NS, self._frame_end_ns) <= asked_ns < now_ns:
                start_ns = asked_ns
            if self.stuck_byte is None:
                answer = self._exchange(data, speed_hz, start_ns)
            else:
                answer = bytes([self.stuck_byte]) * len(data)
            self._frame_start_ns = start_ns
            self._frame_end_ns = start_ns + round(8e9 * len(data) / speed_hz)
        self.clock.sleep(max(0, self._frame_end_ns - now_ns) / 1e9)
        return answer

    def close(self) -> None:
        """Nothing to release."""

    def data_ready(self, *, pin: Literal[1, 2] = 1, active_high: bool = True) -> VirtualDataReady:
        """A listener on DIO1 or DIO2 for the edge to the level that should mean valid data."""
        return VirtualDataReady(self, pin, active_high=active_high)

    @property
    def exhausted(self) -> bool:
        """Whether the input has ended and its last sample is in the registers."""
        with self._lock:
            self._advance(self.clock.now_ns())
            return self._updates.exhausted

    def account(self) -> PartAccount:
        """What it has done so far."""
        with self._lock:
            now_ns = self.clock.now_ns()
            self._advance(now_ns)
            pins = self._pins
            for pin in pins:
                pin.pass_time(now_ns)
            return PartAccount(
                updates=self._updates.count,
                edges=sum(pin.arrived for pin in pins),
                edges_lost_by_script=sum(pin.lost for pin in pins),
                edges_added_by_script=sum(pin.added for pin in pins),
            )

    @property
    def is_high_when_valid(self) -> bool:
        """Polarity of the data-ready line as set in MSC_CTRL."""
        return self._memory.is_high_when_valid

    def line_state(self, pin: int, now_ns: int, until_ns: int) -> LineState:
        """The data-ready line of `pin` at `now_ns`, with its next edge if that comes by `until_ns`."""
        with self._lock:
            self._advance(now_ns)
            known_until_ns = min([until_ns, *list(self._changes)[:1]])
            self._updates.load_until(known_until_ns)
            next_ns = self._updates.next_ns if self._active_pin() == pin else None
            if next_ns is not None and self._changes and next_ns >= self._changes[0]:
                next_ns = None
            return self._pins[pin - 1].state(now_ns, next_ns, known_until_ns)

    def _active_pin(self) -> int | None:
        return None if self.is_line_cut else self._memory.data_ready_pin

    def _advance(self, now_ns: int) -> None:
        """Let everything happen that is due."""
        while self._changes and self._changes[0] <= now_ns:
            change_ns = self._changes.popleft()
            self._pass_time(change_ns - 1)
            self._change_condition(change_ns)
        self._pass_time(now_ns)

    def _pass_time(self, now_ns: int) -> None:
        if self._tests:
            self._end_tests(now_ns)
        passed, overrange = self._updates.advance(now_ns)
        self._now_ns = max(self._now_ns, now_ns)
        pin = self._active_pin()
        if passed and pin is not None:
            self._pins[pin - 1].make(passed)
        if overrange:
            self._flags |= DIAG_OVERRANGE

    # -- faults --------------------------------------------------------------------------------------

    def _change_condition(self, now_ns: int) -> None:
        assert self._schedule is not None
        old, self._condition = self._condition, self._schedule.at(now_ns)
        new = self._condition
        self._updates.is_frozen = new.is_frozen
        if new.part != old.part:
            part = self._schedule.new_part(new.part)
            self._memory = Memory(part.lot_id, part.serial, has_crc=self._has_crc)
            self._updates.exchange_sensor(part.errors, now_ns)
        if new.is_powered != old.is_powered:
            self._memory.restart()
            self._tests.clear()
            self._flags = 0
            self._answer = self._last_answer = _UNDEFINED
            self._deaf_until_ns = self._paused_until_ns = now_ns + _POWER_ON_NS if new.is_powered else _NEVER_NS
            self._update_signal(now_ns)

    # -- SPI -----------------------------------------------------------------------------------------

    def _exchange(self, data: bytes, speed_hz: int, start_ns: int) -> bytes:
        self._advance(start_ns)
        self._shown = self._updates.at(start_ns)
        if start_ns < self._deaf_until_ns:
            return bytes(len(data))
        if len(data) % 2:
            self._flags |= DIAG_SPI
            return self._answer.to_bytes(2, "big").ljust(len(data), b"\0")[: len(data)]
        words = struct.unpack(f">{len(data) // 2}H", data)
        too_early = start_ns - self._frame_end_ns < _STALL_NS
        if len(words) > 1 and words[0] >> 8 == _GLOB_CMD:
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
        updates = self._updates
        frame, checksum = self._shown.frame, self._shown.checksum
        word_ns = 16e9 / speed_hz
        end_ns = start_ns + round(words * word_ns) + INVALID_NS
        updates.load_until(end_ns)
        update_ns = updates.next_after(start_ns)
        if update_ns is not None and update_ns < end_ns:
            frame, checksum = self._torn(start_ns, word_ns)
        if not self._memory.sends_crc:
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
            # The registers change one after the other through the invalid phase, the last one first: the
            # order that no burst across it survives.
            turn_ns = round(start_ns + (word + 2) * word_ns)
            shown = self._updates.at(turn_ns + INVALID_NS - (11 - word) * INVALID_NS // 12)
            frame += shown.frame[2 * word : 2 * word + 2]
        return frame, self._updates.at(round(start_ns + 13 * word_ns)).checksum

    def _execute(self, word: int, now_ns: int) -> int:
        """Carry out one command word; return the answer that the next word will shift out."""
        address, value = word >> 8 & 0x7F, word & 0xFF
        if not word & 0x8000:
            return self._read(address & 0x7E)
        if address == _GLOB_CMD:
            self._command(value, now_ns)
        elif self._memory.write(address, value):
            if address == _MSC_CTRL + 1:
                self._start_tests(now_ns)
            if address in SIGNAL_BYTES:
                self._update_signal(now_ns)
        return _UNDEFINED

    def _read(self, address: int) -> int:
        if address in _OUTPUTS:
            offset = address - _OUTPUTS.start
            if address in _FIELD_AND_PRESSURE:
                self._read_field()
            return int.from_bytes(self._shown.frame[offset : offset + 2], "big")
        if address == _DIAG_STAT:
            return self._diagnosis()
        if address == _SEQ_CNT:
            decimation = 1 << self._memory.decimation_exponent
            sequence = max(1, _FIELD_PERIOD // decimation)
            return sequence - self._shown.number // decimation % sequence
        if address == _PROD_ID and self._condition.product_id is not None:
            return self._condition.product_id
        return self._memory.get(address)

    def _diagnosis(self) -> int:
        """DIAG_STAT; reading it clears the flags, not NEW DATA."""
        flags, self._flags = self._flags, 0
        return flags | (DIAG_NEW_DATA if self._field_number() != self._field_read else 0)

    def _field_number(self) -> int:
        return self._shown.number // max(_FIELD_PERIOD, 1 << self._memory.decimation_exponent)

    def _read_field(self) -> None:
        self._field_read = self._field_number()

    # -- commands ------------------------------------------------------------------------------------

    def _command(self, command: int, now_ns: int) -> None:
        memory = self._memory
        busy_ns = 0
        if command & CMD_GYRO_BIAS:
            to_offset = GYRO_LSB_DPS[memory.gyro_range_dps] / 0.01
            for axis, count in enumerate(struct.unpack_from(">3h", self._shown.frame)):
                memory.set(_GYRO_OFFSETS + 2 * axis, round(-count * to_offset))
        if command & CMD_FACTORY_RESTORE:
            memory.clear_offsets()
        if command & (CMD_FLASH_UPDATE | CMD_GYRO_BIAS | CMD_FACTORY_RESTORE):
            memory.save()
            busy_ns += _FLASH_NS
        if command & (CMD_RESET | CMD_FACTORY_RESTORE):
            memory.restart()
            self._tests.clear()
            self._flags = 0
            busy_ns += _RESET_NS
        if busy_ns:
            self._deaf_until_ns = self._paused_until_ns = now_ns + busy_ns
            self._update_signal(now_ns)

    def _start_tests(self, now_ns: int) -> None:
        control = self._memory.get(_MSC_CTRL) & (MSC_SELF_TEST | MSC_MEMORY_TEST | 0xFF)
        self._memory.set(_MSC_CTRL, control)
        if control & MSC_SELF_TEST:
            self._tests[MSC_SELF_TEST] = now_ns + (_SELF_TEST_NS << self._memory.decimation_exponent)
        if control & MSC_MEMORY_TEST:
            self._tests[MSC_MEMORY_TEST] = now_ns + _MEMORY_TEST_NS
        if self._tests:
            self._paused_until_ns = max(self._tests.values())
            self._update_signal(now_ns)

    def _end_tests(self, now_ns: int) -> None:
        for bit, end_ns in list(self._tests.items()):
            if now_ns < end_ns:
                continue
            del self._tests[bit]
            self._memory.set(_MSC_CTRL, self._memory.get(_MSC_CTRL) & ~bit)
            failing_parts = self._failing_parts | self._condition.failing_parts
            if bit == MSC_MEMORY_TEST:
                self._flags |= failing_parts & DIAG_MEMORY
            elif failing := failing_parts & ~DIAG_MEMORY:
                self._flags |= failing | DIAG_SELF_TEST

    def _update_signal(self, now_ns: int) -> None:
        """From now on; what a listener has heard of stays."""
        self._updates.change(self._memory.signal_settings(), max(now_ns, self._now_ns), self._paused_until_ns)
