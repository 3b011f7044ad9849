"""The virtual sensor as its users see it, with or without faults on its wires."""

from __future__ import annotations

from typing import Literal, Protocol

from drivers.data_ready import DataReady
from drivers.virtual.adis16448 import PartAccount


class PartAtPins(Protocol):
    """An SpiTransport with the data-ready line that belongs to it."""

    def transfer(self, data: bytes, speed_hz: int, asked_ns: int | None = None) -> bytes:
        """One chip-select-low frame, asked for at `asked_ns`. Raises SpiError."""

    def close(self) -> None:
        """Release it."""

    def data_ready(self, *, pin: Literal[1, 2] = 1, active_high: bool = True) -> DataReady:
        """A listener on DIO1 or DIO2."""

    @property
    def exhausted(self) -> bool:
        """Whether the motion has ended."""


class VirtualPart(PartAtPins, Protocol):
    """A part that counts what it does."""

    def account(self) -> PartAccount:
        """What the part has done so far."""
