"""What a fault script does to the wires between part and computer, and to the computer's own port."""

from __future__ import annotations

from collections.abc import Sequence
from random import Random
from typing import Literal

from drivers.spi import SpiError
from drivers.virtual.adis16448 import PartAccount, VirtualAdis16448
from drivers.virtual.adis16448_line import Arrival, VirtualDataReady
from drivers.virtual.faults import (
    BitFlips,
    DataReadyDoubled,
    DataReadyLost,
    FaultScript,
    LateEdges,
    MisoHigh,
    MisoLow,
    Placed,
    Replaced,
    SlowSpi,
    SpiErrors,
    Unplugged,
    placed,
)


class FaultyEdges:
    """An EdgeWire that loses, doubles and delays edges."""

    def __init__(self, script: FaultScript, start_ns: int) -> None:
        self._lost = placed(script, start_ns, DataReadyLost)
        self._doubled = placed(script, start_ns, DataReadyDoubled)
        self._late = placed(script, start_ns, LateEdges)

    def arrivals(self, edge_ns: int) -> Sequence[Arrival]:
        """When and how often the listener hears of the edge."""
        if any(_meets(place, place.fault.share, edge_ns) for place in self._lost):
            return ()
        stamps = [edge_ns]
        stamps += [
            edge_ns + round(place.fault.after_us * 1e3)
            for place in self._doubled
            if _meets(place, place.fault.share, edge_ns)
        ]
        return [Arrival(max(self._delivered_ns(stamp), edge_ns), stamp) for stamp in stamps]

    def _delivered_ns(self, stamp_ns: int) -> int:
        delivered_ns = stamp_ns
        for place in self._late:
            if place.holds(stamp_ns):
                every_ns = round(place.fault.every_ms * 1e6)
                whole_ns = place.start_ns + -(-(stamp_ns - place.start_ns) // every_ns) * every_ns
                delivered_ns = max(delivered_ns, min(whole_ns, place.end_ns))
        return delivered_ns


class FaultyWires:
    """A VirtualPart: the twin behind wires and a port that go wrong."""

    def __init__(self, part: VirtualAdis16448, script: FaultScript, start_ns: int) -> None:
        self._part = part
        self._low = placed(script, start_ns, MisoLow)
        self._high: list[Placed[MisoHigh | Unplugged | Replaced]] = placed(
            script, start_ns, MisoHigh, Unplugged, Replaced
        )
        self._flips = [(place, place.generator()) for place in placed(script, start_ns, BitFlips)]
        self._errors = [(place, place.generator()) for place in placed(script, start_ns, SpiErrors)]
        self._slow = placed(script, start_ns, SlowSpi)

    def transfer(self, data: bytes, speed_hz: int, asked_ns: int | None = None) -> bytes:
        """One frame through the wires as they are when it begins. Raises SpiError."""
        clock = self._part.clock
        now_ns = clock.now_ns()
        for failing, generator in self._errors:
            if failing.holds(now_ns) and generator.random() < failing.fault.share:
                raise SpiError("the SPI port of the virtual sensor failed, as its fault script says")
        for slow in self._slow:
            if slow.holds(now_ns):
                clock.sleep(slow.fault.extra_us * 1e-6)
                asked_ns = None  # late for a reason
        answer = self._part.transfer(data, speed_hz, asked_ns)
        for noisy, generator in self._flips:
            if noisy.holds(now_ns):
                answer = _flipped(answer, noisy.fault.probability, generator)
        if any(place.holds(now_ns) for place in self._high):
            answer = b"\xff" * len(answer)
        if any(place.holds(now_ns) for place in self._low):
            answer = bytes(len(answer))
        return answer

    def close(self) -> None:
        """Nothing to release."""

    def data_ready(self, *, pin: Literal[1, 2] = 1, active_high: bool = True) -> VirtualDataReady:
        """A listener on DIO1 or DIO2; what the script does to edges is done on the way to it."""
        return self._part.data_ready(pin=pin, active_high=active_high)

    @property
    def exhausted(self) -> bool:
        """Whether the motion has ended."""
        return self._part.exhausted

    def account(self) -> PartAccount:
        """What the part has done so far."""
        return self._part.account()


def _meets(place: Placed[DataReadyLost] | Placed[DataReadyDoubled], share: float, edge_ns: int) -> bool:
    return place.holds(edge_ns) and place.draw(edge_ns) < share


def _flipped(answer: bytes, probability: float, generator: Random) -> bytes:
    """The answer with each bit wrong by that probability."""
    mask = 0
    for bit in range(8 * len(answer)):
        mask |= (generator.random() < probability) << bit
    return (int.from_bytes(answer, "big") ^ mask).to_bytes(len(answer), "big")
