"""A CAN frame as the rest of the program sees it: time-stamped bytes, free of any library's types."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple


class FrameId(NamedTuple):
    """What a receiver selects by: 0x123 with 11 bits and 0x123 with 29 bits are two different identifiers."""

    arbitration_id: int
    is_extended: bool = False

    def __str__(self) -> str:
        return f"0x{self.arbitration_id:08X}" if self.is_extended else f"0x{self.arbitration_id:03X}"


@dataclass(slots=True, frozen=True)
class Frame:
    """One classic or FD frame; of an error frame `arbitration_id` holds the kernel's error class bits."""

    t_ns: int  # monotonic
    arbitration_id: int
    data: bytes
    is_extended: bool = False
    is_fd: bool = False
    is_error: bool = False
    is_remote: bool = False

    @property
    def frame_id(self) -> FrameId:
        """Identifier together with its width."""
        return FrameId(self.arbitration_id, self.is_extended)
