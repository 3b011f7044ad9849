"""Times of a recording as people read them: of day where the recording knows it, else its own seconds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta, timezone


@dataclass(slots=True, frozen=True)
class Clock:
    """wall_minus_own_ns: what turns the recording's time into time of day; None where that is unknown."""

    wall_minus_own_ns: int | None
    zone: timezone | None = None

    @classmethod
    def of(cls, metadata: Mapping[str, str], t_ns: int) -> Clock:
        """As the head of the file says, in the time zone of this computer at `t_ns`."""
        try:
            offset_ns = int(metadata["wall_minus_monotonic_ns"])
            there = datetime.fromtimestamp((offset_ns + t_ns) * 1e-9, UTC).astimezone()
        except (KeyError, ValueError, OverflowError, OSError):
            return cls(None)
        return cls(offset_ns, timezone(there.utcoffset() or timedelta()))

    @property
    def name(self) -> str:
        """What times are called."""
        if self.wall_minus_own_ns is None:
            return "seconds of the recording"
        return f"time of day, {datetime.now(self.zone).tzname()}"

    def day(self, t_ns: int) -> str:
        """Date and time, or seconds."""
        there = self._there(t_ns)
        return self._seconds(t_ns) if there is None else there.strftime("%Y-%m-%d %H:%M:%S")

    def time(self, t_ns: int, digits: int = 1) -> str:
        """Time of day, or seconds."""
        there = self._there(t_ns)
        if there is None:
            return self._seconds(t_ns, digits + 1)
        return f"{there:%H:%M:%S}" + (f".{there.microsecond:06d}"[: digits + 1] if digits else "")

    def minute(self, t_ns: int) -> str:
        """Hour and minute, or seconds."""
        there = self._there(t_ns)
        return self._seconds(t_ns) if there is None else there.strftime("%H:%M")

    def axis_ms(self, t_ns: int) -> float:
        """Where plots put it: milliseconds, as if the zone's time were UTC; or seconds times 1000."""
        offset_ns = self.wall_minus_own_ns or 0
        shift = timedelta() if self.zone is None else self.zone.utcoffset(None)
        return (t_ns + offset_ns) / 1e6 + shift.total_seconds() * 1e3

    def _there(self, t_ns: int) -> datetime | None:
        if self.wall_minus_own_ns is None:
            return None
        microseconds = (self.wall_minus_own_ns + t_ns) // 1000
        return datetime(1970, 1, 1, tzinfo=UTC).astimezone(self.zone) + timedelta(microseconds=microseconds)

    @staticmethod
    def _seconds(t_ns: int, digits: int = 1) -> str:
        return f"{t_ns * 1e-9:.{digits}f} s"
