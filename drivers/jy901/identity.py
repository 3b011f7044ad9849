"""Who answers on the serial line."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True, frozen=True)
class Jy901Identity:
    """A JY901 that was set up and delivers from `t_ns` on; it has no serial number."""

    t_ns: int
    firmware: int  # register VERSION, 0 if it does not tell
    baud: int
    rate_hz: float

    @property
    def name(self) -> str:
        """The part in words."""
        return f"JY901 firmware {self.firmware}" if self.firmware else "JY901"

    @property
    def facts(self) -> dict[str, float]:
        """What health tells of the part."""
        return {"firmware": self.firmware, "baud": self.baud}

    def is_same_part(self, other: object) -> bool:
        """Whether both may be one and the same part: more than the firmware there is not to compare."""
        return isinstance(other, Jy901Identity) and self.firmware == other.firmware
