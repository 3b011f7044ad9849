"""A JY901 at the level of its bytes: groups of packets at a rate, registers behind a lock, a line that is too slow.

Motion is an `InertialInput`; the last sample before a group is what the group says, as in the part, which has no
data-ready line. Bytes carry the time at which the line has sent them.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from drivers.jy901.packets import (
    ACCEL_LSB,
    BAUD,
    BAUD_CODES,
    CONTENT,
    GYRO_LSB,
    RATE,
    RATE_CODES,
    TEMPERATURE_LSB,
    UNLOCK,
    Kind,
    encode,
)
from drivers.virtual.inertial_input import InertialBlock, InertialInput

UNLOCKED_NS = 10_000_000_000
BITS_PER_BYTE = 10
DEFAULTS = {CONTENT: 0x001E, RATE: RATE_CODES[10], BAUD: BAUD_CODES[9600]}
SENDS = (Kind.TIME, Kind.ACCEL, Kind.GYRO, Kind.ANGLE, Kind.MAGNETIC)
_RATES = {code: rate for rate, code in RATE_CODES.items()}
_BAUDS = {code: baud for baud, code in BAUD_CODES.items()}


@dataclass(slots=True)
class VirtualJy901:
    """Feed it commands, ask it for what it has sent by now."""

    motion: InertialInput
    start_ns: int = 0
    registers: dict[int, int] = field(default_factory=lambda: dict(DEFAULTS))
    saved: dict[int, int] = field(default_factory=lambda: dict(DEFAULTS))
    _unlocked_until_ns: int = -1
    _next_ns: int = -1
    _line_free_ns: int = 0
    _answers: list[bytes] = field(default_factory=list)
    _pending: bytearray = field(default_factory=bytearray)
    _block: InertialBlock | None = None
    _row: int = 0

    @property
    def baud(self) -> int:
        """Of the line, now."""
        return _BAUDS[self.registers[BAUD]]

    def write(self, data: bytes, t_ns: int) -> None:
        """Bytes from the computer; what is no command is overheard."""
        self._pending += data
        while len(self._pending) >= len(UNLOCK):
            if self._pending[0] != 0xFF or self._pending[1] != 0xAA:
                del self._pending[0]
                continue
            self._obey(bytes(self._pending[:5]), t_ns)
            del self._pending[:5]

    def read(self, t_ns: int) -> list[tuple[int, bytes]]:
        """Groups that were due by `t_ns`: (time at which the line has sent the last byte, packet) each, in order."""
        if self._next_ns < 0:
            self._next_ns = self.start_ns
        sent: list[tuple[int, bytes]] = []
        rate_hz = _RATES.get(self.registers[RATE])
        while self._next_ns <= t_ns:
            at_ns = self._next_ns
            answers, self._answers = self._answers, []
            group = [] if rate_hz is None else self._group(at_ns)
            if group is None:
                break  # the end of the motion
            for packet in (*answers, *group):
                self._line_free_ns = max(self._line_free_ns, at_ns) + round(
                    len(packet) * BITS_PER_BYTE * 1e9 / self.baud
                )
                sent.append((self._line_free_ns, packet))
            # A line too slow for the rate lowers it: the next group waits until the last one has gone.
            period_ns = round(1e9 / (rate_hz or 10.0))
            self._next_ns = max(at_ns + period_ns, self._line_free_ns if group else 0)
        return sent

    def power_cycle(self, t_ns: int) -> None:
        """Off and on: what was not saved is gone."""
        self.registers = dict(self.saved)
        self._unlocked_until_ns, self._next_ns, self._line_free_ns = -1, t_ns, t_ns
        self._pending.clear()

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
        elif register != BAUD or value in _BAUDS:
            self.registers[register] = value

    def _group(self, t_ns: int) -> list[bytes] | None:
        """The packets of one instant; None behind the end of the motion."""
        while self._block is None or int(self._block.t_ns[-1]) < t_ns:
            following = self.motion.block()
            if following is None:
                return None
            self._block, self._row = following, 0
        block = self._block
        while self._row + 1 < len(block.t_ns) and int(block.t_ns[self._row + 1]) <= t_ns:
            self._row += 1
        temperature = round(float(block.temperature_c[self._row]) / TEMPERATURE_LSB)
        accel = [round(float(v) / ACCEL_LSB) for v in block.accel[self._row]]
        gyro = [round(float(v) / GYRO_LSB) for v in block.gyro[self._row]]
        content = self.registers[CONTENT]
        packets = []
        for bit, kind in enumerate(SENDS):
            if content >> bit & 1:
                x, y, z = {Kind.ACCEL: accel, Kind.GYRO: gyro}.get(kind, (0, 0, 0))
                packets.append(encode(kind, (x, y, z, temperature)))
        return packets
