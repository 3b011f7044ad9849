"""A sensor and a bus that do again what a recording holds: register words at their times, frames at theirs.

Not the estimator's replay: here the driver itself reads the recorded words, and makes of them what it can.
"""

from __future__ import annotations

import struct
from bisect import bisect_right
from collections.abc import Iterable
from pathlib import Path

from daemon.recording import topics
from daemon.recording.reader import Recording
from drivers.adis16448.burst import Burst, Fault
from drivers.adis16448.identity import Identity
from drivers.adis16448.registers import REGISTERS
from drivers.can.frame import Frame
from drivers.clock import Clock
from drivers.data_ready import Edge
from drivers.spi import SpiError
from drivers.virtual.adis16448_memory import Memory
from estimation.records import TimeKind

_BURST_COMMAND = REGISTERS["GLOB_CMD"].address
_DEAD = {Fault.ALL_ZERO: b"\x00", Fault.ALL_ONE: b"\xff"}
_NOBODY = Identity(0, 0x4040, 0x1824_0000, 1)


class RecordedPart:
    """An SpiTransport whose bursts are recorded ones; `data_ready` is the line with their edges.

    Registers answer as a part's memory does, unless the recording says that at this time the wire was dead.
    """

    def __init__(self, bursts: list[Burst], identities: Iterable[Identity], clock: Clock) -> None:
        self.clock = clock
        self._bursts = bursts
        self._times = [burst.t_ns for burst in bursts]
        self._edges = [burst.t_ns for burst in bursts if burst.time_kind is TimeKind.EDGE]
        self._identities = sorted(identities, key=lambda identity: identity.t_ns) or [_NOBODY]
        self._has_crc = any(burst.crc is not None for burst in bursts)
        self._memory = self._memory_of(self._identities[0])
        self._identity = self._identities[0]
        self._answer = 0

    @property
    def exhausted(self) -> bool:
        """Whether the last burst is past."""
        return self.clock.now_ns() > self._times[-1]

    def transfer(self, data: bytes, speed_hz: int, asked_ns: int | None = None) -> bytes:
        """Exchange one frame; takes the time its bits take."""
        self.clock.sleep(8 * len(data) / speed_hz)
        now_ns = self.clock.now_ns()
        index = bisect_right(self._times, now_ns) - 1
        burst = self._bursts[max(index, 0)]
        if burst.fault is Fault.SPI and not any(burst.words):
            raise SpiError("the port failed when this was recorded")
        if burst.fault in _DEAD:
            return _DEAD[burst.fault] * len(data)
        if data[0] == _BURST_COMMAND and len(data) > 2:
            words = struct.pack(">H12H", 0, *burst.words)
            return (words + struct.pack(">H", burst.crc or 0))[: len(data)]
        self._become(now_ns)
        answers = []
        for (word,) in struct.iter_unpack(">H", data):
            answers.append(self._answer)
            self._answer = self._execute(word)
        return struct.pack(f">{len(answers)}H", *answers)

    def data_ready(self, *, pin: int = 1, active_high: bool = True) -> RecordedLine:
        """The line, however it was wired."""
        return RecordedLine(self._edges, self.clock)

    def close(self) -> None:
        """Nothing to release."""

    def _execute(self, word: int) -> int:
        address, value = word >> 8 & 0x7F, word & 0xFF
        if not word & 0x8000:
            return self._memory.get(address & 0x7E)
        if address == _BURST_COMMAND:
            self._memory.restart()
        else:
            # Tests end at once: nothing is known of how long they took, or that any failed.
            self._memory.write(address, 0 if address == REGISTERS["MSC_CTRL"].address + 1 else value)
        return 0

    def _become(self, now_ns: int) -> None:
        """The part of that time."""
        present = [i for i in self._identities if i.t_ns <= now_ns] or self._identities[:1]
        if not present[-1].is_same_part(self._identity):
            self._memory = self._memory_of(present[-1])
        self._identity = present[-1]

    def _memory_of(self, identity: Identity) -> Memory:
        return Memory(identity.lot_id, identity.serial, has_crc=self._has_crc)


class RecordedLine:
    """Edges at recorded times."""

    def __init__(self, edges: list[int], clock: Clock) -> None:
        self._edges = edges
        self._clock = clock
        self._next = bisect_right(edges, clock.now_ns())

    def wait(self, timeout_s: float) -> Edge | None:
        """The newest edge not yet seen, else the next one; None after `timeout_s` without."""
        deadline_ns = self._clock.now_ns() + round(timeout_s * 1e9)
        passed = bisect_right(self._edges, self._clock.now_ns())
        if passed == self._next:
            due_ns = self._edges[self._next] if self._next < len(self._edges) else deadline_ns + 1
            self._clock.sleep((min(due_ns, deadline_ns) - self._clock.now_ns()) * 1e-9)
            if due_ns > deadline_ns:
                return None
            passed = self._next + 1
        missed, self._next = passed - self._next - 1, passed
        return Edge(self._edges[passed - 1], TimeKind.EDGE, missed)

    def close(self) -> None:
        """Nothing to release."""


class RecordedController:
    """Frames at recorded times, as a VirtualController gives them."""

    def __init__(self, frames: list[Frame]) -> None:
        self._frames = frames
        self._next = 0

    @property
    def next_t_ns(self) -> int | None:
        """When the next frame is due, None after the last."""
        return self._frames[self._next].t_ns if self._next < len(self._frames) else None

    def due(self, t_ns: int) -> list[Frame]:
        """The frames up to and including `t_ns` that were not returned before."""
        first = self._next
        while (due_ns := self.next_t_ns) is not None and due_ns <= t_ns:
            self._next += 1
        return self._frames[first : self._next]


def devices_of(path: Path, clock: Clock) -> tuple[RecordedPart, RecordedController]:
    """Sensor and bus of a recording."""
    bursts: list[Burst] = []
    identities: list[Identity] = []
    frames: list[Frame] = []
    for _, record in Recording(path).messages((topics.IMU_RAW, topics.IMU_IDENTITY, topics.CAN_RX)):
        if isinstance(record, Burst):
            bursts.append(record)
        elif isinstance(record, Identity):
            identities.append(record)
        elif isinstance(record, Frame):
            frames.append(record)
    return RecordedPart(bursts, identities, clock), RecordedController(frames)


def first_ns(path: Path) -> int:
    """Time of a recording's first burst."""
    return next(r.t_ns for _, r in Recording(path).messages((topics.IMU_RAW,)) if isinstance(r, Burst))
