"""The serial line between the virtual JY901 and a computer, with what a fault script does to both."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from random import Random

from drivers.jy901.packets import HEAD, KINDS
from drivers.virtual.faults import (
    AdapterGone,
    FaultScript,
    Jy901BrownOut,
    Jy901DeadBand,
    Jy901Frozen,
    SerialCut,
    SerialDrops,
    SerialFlips,
    SerialGarbage,
    SerialHeaps,
    placed,
)
from drivers.virtual.jy901 import VirtualJy901

_LONGEST_GARBAGE = 30  # bytes
_STEP_NS = 1_000_000


@dataclass(slots=True)
class LineAccount:
    """What went over the line so far."""

    bytes: int = 0  # that arrived at the computer
    lost_by_script: int = 0
    added_by_script: int = 0
    flipped_by_script: int = 0  # bytes


class ScriptedPart:
    """The part's own faults."""

    def __init__(self, script: FaultScript, start_ns: int) -> None:
        self._off = placed(script, start_ns, Jy901BrownOut)
        self._frozen = placed(script, start_ns, Jy901Frozen)
        self._dead = placed(script, start_ns, Jy901DeadBand)

    def is_off(self, t_ns: int) -> bool:
        """Without supply."""
        return any(place.holds(t_ns) for place in self._off)

    def is_frozen(self, t_ns: int) -> bool:
        """It repeats what it sent last."""
        return any(place.holds(t_ns) for place in self._frozen)

    def has_dead_band(self, t_ns: int) -> bool:
        """Slow rates read zero."""
        return any(place.holds(t_ns) for place in self._dead)


class VirtualLine:
    """Bytes both ways; at another baud rate than the part's they are others."""

    def __init__(self, part: VirtualJy901, script: FaultScript | None = None, start_ns: int = 0) -> None:
        script = script or FaultScript()
        self.part = part
        part.faults = ScriptedPart(script, start_ns)
        self.account = LineAccount()
        self._gone = placed(script, start_ns, AdapterGone)
        self._cut = placed(script, start_ns, SerialCut)
        self._drops = [(place, place.generator()) for place in placed(script, start_ns, SerialDrops)]
        self._flips = [(place, place.generator()) for place in placed(script, start_ns, SerialFlips)]
        self._garbage = [(place, place.generator()) for place in placed(script, start_ns, SerialGarbage)]
        self._heaps = placed(script, start_ns, SerialHeaps)
        self._coming: deque[tuple[int, int | None, bytes]] = deque()  # when, at which baud rate (None: any), what
        self._garbage_ns = start_ns

    def is_gone(self, t_ns: int) -> bool:
        """Whether the computer has no such port."""
        return any(place.holds(t_ns) for place in self._gone)

    def write(self, data: bytes, t_ns: int, baud: int) -> None:
        """Bytes from a computer whose port is set to that rate."""
        if baud == self.part.baud and not any(place.holds(t_ns) for place in self._cut):
            self.part.write(data, t_ns)

    def arrived(self, t_ns: int, baud: int) -> bytes:
        """What has arrived since the last call at a port that is set to that rate."""
        at_part = self.part.baud
        for sent_ns, packet in self.part.read(t_ns):
            self._send(sent_ns, packet, at_part)
        self._babble(t_ns)
        data = bytearray()
        while self._coming and self._coming[0][0] <= t_ns:
            _, sent_at, packet = self._coming.popleft()
            data += packet if sent_at in (baud, None) else _misread(packet)
        self.account.bytes += len(data)
        return bytes(data)

    def _send(self, sent_ns: int, packet: bytes, baud: int) -> None:
        is_cut = any(place.holds(sent_ns) for place in self._cut)
        if is_cut or self.is_gone(sent_ns):
            self.account.lost_by_script += len(packet)
            return
        for place, generator in self._drops:
            if place.holds(sent_ns):
                kept = bytes(b for b in packet if generator.random() >= place.fault.share)
                self.account.lost_by_script += len(packet) - len(kept)
                packet = kept
        for flips, generator in self._flips:
            if flips.holds(sent_ns):
                packet = self._flipped(packet, flips.fault.probability, generator)
        self._coming.append((self._handed_over(sent_ns), baud, packet))

    def _flipped(self, packet: bytes, probability: float, generator: Random) -> bytes:
        masks = [sum((generator.random() < probability) << bit for bit in range(8)) for _ in packet]
        self.account.flipped_by_script += sum(mask > 0 for mask in masks)
        return bytes(b ^ mask for b, mask in zip(packet, masks, strict=True))

    def _babble(self, t_ns: int) -> None:
        """Random bytes between the packets, true heads among them."""
        while self._garbage_ns <= t_ns:
            for place, generator in self._garbage:
                if place.holds(self._garbage_ns) and generator.random() < place.fault.rate_hz * _STEP_NS * 1e-9:
                    noise = generator.randbytes(generator.randrange(1, _LONGEST_GARBAGE))
                    head = bytes((HEAD, generator.choice(sorted(KINDS))))
                    self.account.added_by_script += len(head + noise)
                    self._coming.append((self._garbage_ns, None, head + noise))
            self._garbage_ns += _STEP_NS
        if self._garbage:
            self._coming = deque(sorted(self._coming, key=lambda one: one[0]))

    def _handed_over(self, sent_ns: int) -> int:
        for place in self._heaps:
            if place.holds(sent_ns):
                every_ns = round(place.fault.every_ms * 1e6)
                return place.start_ns + -(-(sent_ns - place.start_ns) // every_ns) * every_ns
        return sent_ns


def _misread(packet: bytes) -> bytes:
    """At another pace the bits fall into other bytes."""
    return bytes(b ^ 0x5A for b in packet[::2])
