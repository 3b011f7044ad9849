"""A JY901 at the level of its bytes: groups of packets at a rate, registers behind a lock, a line that is too slow.

Motion is an `InertialInput`, seen through the part's low-pass filter: the mean over half a period of its bandwidth.
Bytes carry the time at which the line has sent them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from drivers.jy901.packets import (
    ACCEL_LSB,
    BANDWIDTH,
    BANDWIDTH_CODES,
    BAUD,
    BAUD_CODES,
    CONTENT,
    GYRO_LSB,
    OLD_200_HZ,
    RATE,
    RATE_CODES,
    TEMPERATURE_LSB,
    UNLOCK,
    VERSION,
    Kind,
    encode,
)
from drivers.virtual.inertial_input import Floats, InertialInput, Times
from drivers.virtual.sensor_errors import SensorErrors

UNLOCKED_NS = 10_000_000_000
BITS_PER_BYTE = 10
FIRMWARE = 4711
DEFAULTS = {
    CONTENT: 0x001E,
    RATE: RATE_CODES[10],
    BAUD: BAUD_CODES[9600],
    BANDWIDTH: BANDWIDTH_CODES[256],
    VERSION: FIRMWARE,
}
SENDS = (Kind.TIME, Kind.ACCEL, Kind.GYRO, Kind.ANGLE, Kind.MAGNETIC)
SINGLE_NS = 1 << 62  # until the next group of a part that sends one and no more
DEAD_BAND_RAD_S = 0.02  # slower rates read zero where it is on
_RATES = {code: rate for rate, code in RATE_CODES.items()}
_OLD_RATES = {code: rate for code, rate in _RATES.items() if rate < 200} | {OLD_200_HZ: 200}
_BAUDS = {code: baud for baud, code in BAUD_CODES.items()}
_BANDWIDTHS = {code: width for width, code in BANDWIDTH_CODES.items()}


class PartFaults(Protocol):
    """What goes wrong within the part at some moment."""

    def is_off(self, t_ns: int) -> bool:
        """Without supply."""

    def is_frozen(self, t_ns: int) -> bool:
        """It repeats what it sent last."""

    def has_dead_band(self, t_ns: int) -> bool:
        """Slow rates read zero."""


@dataclass(slots=True)
class VirtualJy901:
    """Feed it commands, ask it for what it has sent by now.

    motion: what it feels. errors: of the part, None for a perfect one. start_ns: when it is switched on.
    has_old_firmware: it counts its rates otherwise. faults: by script.
    """

    motion: InertialInput
    start_ns: int = 0
    errors: SensorErrors | None = None
    has_old_firmware: bool = False
    faults: PartFaults | None = None
    registers: dict[int, int] = field(default_factory=lambda: dict(DEFAULTS))
    saved: dict[int, int] = field(default_factory=lambda: dict(DEFAULTS))
    groups: int = 0  # sent
    saves: int = 0
    exhausted: bool = False  # the motion has ended
    _unlocked_until_ns: int = -1
    _next_ns: int | None = None
    _line_free_ns: int = 0
    _was_off: bool = False
    _answers: list[bytes] = field(default_factory=list)
    _pending: bytearray = field(default_factory=bytearray)
    _felt: _Felt | None = None
    _last_words: tuple[list[int], list[int]] = ([0, 0, 0], [0, 0, 0])

    @property
    def baud(self) -> int:
        """Of the line, now."""
        return _BAUDS[self.registers[BAUD]]

    @property
    def rate_hz(self) -> float | None:
        """Groups a second; None: one and no more."""
        return (_OLD_RATES if self.has_old_firmware else _RATES).get(self._rate_code)

    def write(self, data: bytes, t_ns: int) -> None:
        """Bytes from the computer; what is no command is overheard."""
        if self._was_off:
            return
        self._pending += data
        while len(self._pending) >= len(UNLOCK):
            if self._pending[0] != 0xFF or self._pending[1] != 0xAA:
                del self._pending[0]
                continue
            self._obey(bytes(self._pending[:5]), t_ns)
            del self._pending[:5]

    def read(self, t_ns: int) -> list[tuple[int, bytes]]:
        """Packets due by `t_ns`: (time at which the line has sent the last byte, packet) each, in order."""
        if self._next_ns is None:
            self._next_ns = self._line_free_ns = self.start_ns
        sent: list[tuple[int, bytes]] = []
        while self._next_ns <= t_ns and not self.exhausted:
            at_ns = self._next_ns
            if self._is_off(at_ns):
                self._next_ns = at_ns + 1_000_000
                continue
            group = self._group(at_ns)
            answers, self._answers = self._answers, []
            for packet in (*answers, *group):
                duration_ns = round(len(packet) * BITS_PER_BYTE * 1e9 / self.baud)
                self._line_free_ns = max(self._line_free_ns, at_ns) + duration_ns
                sent.append((self._line_free_ns, packet))
            # A line too slow for the rate lowers it: the next group waits until the last one has gone.
            rate_hz = self.rate_hz
            self._next_ns = SINGLE_NS if rate_hz is None else max(at_ns + round(1e9 / rate_hz), self._line_free_ns)
        for packet in self._answers if self._next_ns == SINGLE_NS else ():
            sent.append((t_ns, packet))
            self._answers = []
        return sent

    def power_cycle(self, t_ns: int) -> None:
        """Off and on: what was not saved is gone."""
        self.registers = dict(self.saved)
        self._unlocked_until_ns, self._next_ns, self._line_free_ns = -1, t_ns, t_ns
        self._pending.clear()
        self._answers.clear()

    @property
    def _rate_code(self) -> int:
        return self.registers[RATE]

    def _is_off(self, t_ns: int) -> bool:
        is_off = self.faults is not None and self.faults.is_off(t_ns)
        if is_off and not self._was_off:
            self.power_cycle(t_ns)
        self._was_off = is_off
        return is_off

    def _obey(self, command: bytes, t_ns: int) -> None:
        register, value = command[2], command[3] | command[4] << 8
        if command == UNLOCK:
            self._unlocked_until_ns = t_ns + UNLOCKED_NS
        elif register == 0x27:
            first = value & 0xFF
            words = tuple(self.registers.get(first + i, 0) for i in range(4))
            self._answers.append(encode(Kind.REGISTERS, (words[0], words[1], words[2], words[3])))
        elif t_ns > self._unlocked_until_ns:
            return  # locked: ignored without a word
        elif register == 0x00:
            if value == 0:
                self.saved = dict(self.registers)
                self.saves += 1
        elif register not in (BAUD, VERSION) or value in _BAUDS:
            self.registers[register] = value
            if register == RATE:
                self._next_ns = t_ns

    def _group(self, t_ns: int) -> list[bytes]:
        """The packets of one instant; none behind the end of the motion."""
        if self._felt is None:
            self._felt = _Felt(self.motion, self.errors)
        width_hz = _BANDWIDTHS.get(self.registers[BANDWIDTH], 256)
        felt = self._felt.mean(t_ns, round(0.5e9 / width_hz))
        if felt is None:
            self.exhausted = True
            return []
        gyro, accel, temperature_c = felt
        words = [round(v / ACCEL_LSB) for v in accel], [round(v / GYRO_LSB) for v in gyro]
        if self.faults is not None:
            if self.faults.has_dead_band(t_ns):
                words[1][:] = [word if abs(word * GYRO_LSB) > DEAD_BAND_RAD_S else 0 for word in words[1]]
            if self.faults.is_frozen(t_ns):
                words = self._last_words
        self._last_words = words
        content, packets = self.registers[CONTENT], []
        for bit, kind in enumerate(SENDS):
            if content >> bit & 1:
                x, y, z = {Kind.ACCEL: words[0], Kind.GYRO: words[1]}.get(kind, (0, 0, 0))
                packets.append(encode(kind, (x, y, z, round(temperature_c / TEMPERATURE_LSB))))
        self.groups += 1
        return packets


class _Felt:
    """What the part senses, a mean over some time before an instant."""

    def __init__(self, motion: InertialInput, errors: SensorErrors | None) -> None:
        self._motion = motion
        self._errors = errors
        self._t_ns: Times = np.empty(0, dtype=np.int64)
        self._values: Floats = np.empty((0, 7))  # rates, forces, temperature

    def mean(self, t_ns: int, over_ns: int) -> tuple[list[float], list[float], float] | None:
        """Rates, forces, temperature up to `t_ns`; None behind the end of the motion."""
        while not len(self._t_ns) or self._t_ns[-1] < t_ns:
            if not self._fetch(t_ns - over_ns):
                return None
        last = max(int(np.searchsorted(self._t_ns, t_ns, "right")), 1)
        first = min(int(np.searchsorted(self._t_ns, t_ns - over_ns, "right")), last - 1)
        mean = [float(value) for value in self._values[first:last].mean(axis=0)]
        return mean[:3], mean[3:6], mean[6]

    def _fetch(self, keep_from_ns: int) -> bool:
        """The next samples, errors added; what is older than `keep_from_ns` goes."""
        block = self._motion.block()
        if block is None:
            return False
        gyro, accel = block.gyro, block.accel
        before_ns = self._t_ns[-1] if len(self._t_ns) else block.t_ns[0] - 1_000_000
        if self._errors is not None:
            dt_s = float(block.t_ns[-1] - before_ns) * 1e-9 / len(block.t_ns)
            gyro, accel = self._errors.apply(dt_s, gyro, accel, block.temperature_c)
        kept = self._t_ns >= keep_from_ns
        self._t_ns = np.concatenate([self._t_ns[kept], block.t_ns])
        fresh = np.column_stack([gyro, accel, block.temperature_c])
        self._values = np.concatenate([self._values[kept], fresh])
        return True
