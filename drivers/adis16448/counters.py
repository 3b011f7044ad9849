"""What happened to the inertial sensor since the program started."""

from __future__ import annotations

from dataclasses import dataclass, field, fields

from drivers.adis16448.burst import Fault
from drivers.adis16448.registers import DIAG_SENTENCES

LATENESS_BINS_US = (50, 100, 200, 400, 800, 1600)  # upper ends; one more bin holds the rest

FAULT_NAMES: dict[Fault, str] = {fault: fault.name.lower() for fault in Fault if fault is not Fault.NONE}


@dataclass(slots=True)
class Counters:
    """Plain numbers. Edges of the data-ready line = `edge_reads` + `missed` + `missed_starting` + `unheeded`."""

    samples: int = 0  # bursts read, good or bad
    edge_reads: int = 0  # of these: announced by an edge
    paced_reads: int = 0  # of these: read without an edge
    missed: int = 0  # edges whose sample nobody read
    missed_paced: int = 0  # periods without a read while reads were paced
    missed_silent: int = 0  # periods that passed before a silent line was given up
    missed_unseen: int = 0  # edges that should have come and did not: the wire lost them
    unheeded: int = 0  # edges that came while reads were paced, before the line was trusted again
    missed_starting: int = 0  # edges that passed while the part was being started
    starts: int = 0  # times the part began to deliver
    other_parts: int = 0  # times it was another part than before
    wrong_id: int = 0  # times the part was asked who it is and did not say ADIS16448
    wrong_registers: int = 0  # times a setting was lost
    failed_self_tests: int = 0
    failed_starts: int = 0  # other things that kept the part from delivering
    failed_checks: int = 0  # register checks that the port refused
    port_failures: int = 0  # times the SPI port could not be opened or was given up
    line_failures: int = 0  # times the data-ready line could not be opened or read
    silences: int = 0  # times the data-ready line was given up
    errors: int = 0  # faults of the program that were survived
    latest_read_s: float = 0.0  # longest time from an edge to the start of its read
    last_error: str = ""
    # Never change their size, so that another thread may read them.
    lateness: list[int] = field(default_factory=lambda: [0] * (len(LATENESS_BINS_US) + 1))  # edge to start of read
    faults: dict[str, int] = field(default_factory=lambda: dict.fromkeys(FAULT_NAMES.values(), 0))
    diagnoses: dict[str, int] = field(default_factory=lambda: dict.fromkeys(DIAG_SENTENCES.values(), 0))

    @property
    def bad(self) -> int:
        """Bursts that cannot be used."""
        return sum(self.faults.values())

    def plus(self, later: Counters) -> Counters:
        """Both together: `later` began at zero when this one ended."""
        total = Counters()
        for name in (f.name for f in fields(Counters)):
            mine, other = getattr(self, name), getattr(later, name)
            if name == "latest_read_s":
                joined = max(mine, other)
            elif name == "last_error":
                joined = other or mine
            elif isinstance(mine, list):
                joined = [a + b for a, b in zip(mine, other, strict=True)]
            elif isinstance(mine, dict):
                joined = {key: mine[key] + other[key] for key in mine}
            else:
                joined = mine + other
            setattr(total, name, joined)
        return total
