"""What happened to the JY901 since the program started."""

from __future__ import annotations

from dataclasses import dataclass, fields


@dataclass(slots=True)
class Jy901Counters:
    """Plain numbers."""

    samples: int = 0  # frozen ones among them
    frozen: int = 0
    halves: int = 0  # samples of which one packet was lost
    missed: int = 0  # samples that should have come between two that did
    bad_checksums: int = 0
    skipped_bytes: int = 0  # that belong to no packet
    starts: int = 0  # times the part began to deliver
    other_parts: int = 0  # times it was another part than before
    silences: int = 0  # times nothing came any more
    failed_starts: int = 0
    port_failures: int = 0  # times the port could not be opened or failed
    errors: int = 0  # faults of the program that were survived
    rate_hz: float = 0.0  # measured
    last_error: str = ""

    @property
    def lost(self) -> int:
        """Samples that did not come through."""
        return self.halves + self.missed

    def plus(self, later: Jy901Counters) -> Jy901Counters:
        """Both together: `later` began at zero when this one ended."""
        total = Jy901Counters()
        for name in (one.name for one in fields(Jy901Counters)):
            mine, other = getattr(self, name), getattr(later, name)
            setattr(total, name, (other or mine) if name in ("rate_hz", "last_error") else mine + other)
        return total
