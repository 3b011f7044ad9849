"""A virtual part with a fault script, read at its edges in simulated time by raw frames, without our driver."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

import numpy as np

from drivers.adis16448.crc import burst_crc
from drivers.clock import VirtualClock
from drivers.data_ready import Edge
from drivers.spi import SpiError
from drivers.virtual.adis16448 import VirtualAdis16448
from drivers.virtual.faults import FaultScript
from drivers.virtual.faulty_line import FaultyEdges, FaultyWires
from drivers.virtual.faulty_part import PartSchedule
from drivers.virtual.inertial_input import SteadyInput
from drivers.virtual.sensor_errors import SensorErrors

RATE_HZ = 800.0
PERIOD_NS = round(1e9 / RATE_HZ)
BURST = b"\x3e\x00" + bytes(26)
START_NS = 5_000_000_000


def script(*faults: dict[str, Any], seed: int = 1) -> FaultScript:
    """A script of `fault(...)`s."""
    return FaultScript.model_validate({"seed": seed, "fault": faults})


def fault(kind: str, at_s: float, for_s: float, **parameters: Any) -> dict[str, Any]:
    return {"kind": kind, "at_s": at_s, "for_s": for_s, **parameters}


@dataclass(frozen=True)
class Reading:
    """One edge and the burst read at once."""

    t_s: float  # of the edge, from the start of the simulation
    missed: int
    answer: bytes | None  # None: SpiError
    begun_ns: int

    @property
    def outputs(self) -> bytes:
        """XGYRO_OUT..TEMP_OUT."""
        assert self.answer is not None
        return self.answer[4:26]

    @property
    def words(self) -> tuple[int, ...]:
        assert self.answer is not None
        return struct.unpack(">14H", self.answer)

    @property
    def is_good(self) -> bool:
        return self.answer is not None and burst_crc(self.words[2:13]) == self.words[13]


class Bench:
    """The part on a steady base, with noise, from START_NS on."""

    def __init__(self, faults: FaultScript | None = None, duration_s: float = 3.0) -> None:
        self.clock = VirtualClock(START_NS)
        source = SteadyInput(RATE_HZ, start_ns=START_NS, duration_s=duration_s)
        errors = SensorErrors(np.random.default_rng(4))
        self.part: VirtualAdis16448 | FaultyWires
        if faults is None:
            self.part = VirtualAdis16448(source, self.clock, errors=errors)
        else:
            twin = VirtualAdis16448(
                source,
                self.clock,
                errors=errors,
                schedule=PartSchedule(faults, START_NS),
                edge_wire=FaultyEdges(faults, START_NS),
            )
            self.part = FaultyWires(twin, faults, START_NS)
        self.line = self.part.data_ready()
        self.word(0xB416)  # data-ready and checksum

    def word(self, word: int) -> int:
        answer = self.part.transfer(word.to_bytes(2, "big"), 1_000_000)
        self.clock.sleep(24e-6)
        return int.from_bytes(answer, "big")

    def register(self, address: int) -> int:
        self.word(address << 8)
        return self.word(0)

    def to(self, t_s: float) -> None:
        self.clock.advance_to(START_NS + round(t_s * 1e9))

    def read(self) -> list[Reading]:
        """Everything until the motion ends."""
        readings: list[Reading] = []
        while not self.part.exhausted:
            edge = self.line.wait(0.05)
            if edge is not None:
                readings.append(self._read(edge))
        return readings

    def _read(self, edge: Edge) -> Reading:
        begun_ns = self.clock.now_ns()
        try:
            answer = self.part.transfer(BURST, 1_000_000)
        except SpiError:
            answer = None
        self.clock.sleep(9e-6)
        return Reading((edge.t_ns - START_NS) / 1e9, edge.missed, answer, begun_ns)


def healthy() -> list[Reading]:
    """What is read without any fault."""
    return Bench().read()


def within(readings: list[Reading], start_s: float, end_s: float) -> list[Reading]:
    return [reading for reading in readings if start_s <= reading.t_s < end_s]


def outside(readings: list[Reading], start_s: float, end_s: float) -> list[Reading]:
    return [reading for reading in readings if not start_s <= reading.t_s < end_s]
