"""A bus that is open, together with the interface that it was opened on: is it still the same, and what was lost?"""

from __future__ import annotations

from contextlib import suppress

import can

from drivers.can.interface import InterfaceFault, InterfaceStatus, interface_status, kernel_drops, never_sent
from drivers.can.settings import CanSettings

CHECKS_WITHOUT_CARRIER = 2  # the kernel tells of a carrier with up to a second's delay


class OpenedBus:
    """One opening of a bus.

    Args:
        settings: of the interface.
        bus: what was opened.
        status: of the interface just before.
    """

    def __init__(self, settings: CanSettings, bus: can.BusABC, status: InterfaceStatus) -> None:
        self.bus = bus
        self._settings = settings
        self._index = status.index
        self._foreign: int | None = None  # frames from others when last asked; None: nothing to compare with
        self._checks_without_carrier = 0
        self._drops = 0
        self._never_sent = never_sent(settings)

    @property
    def has_carrier(self) -> bool:
        """Whether the kernel has not switched the interface's carrier off, as CAN drivers do when bus-off."""
        return self._checks_without_carrier < CHECKS_WITHOUT_CARRIER

    def note_frames(self) -> None:
        """Frames come, so there is nothing to ask."""
        self._checks_without_carrier = 0
        self._foreign = None  # the old count would take those that were read for frames held back

    def check(self, sent: int) -> bool:
        """Ask how the interface is on which nothing comes; whether it gets frames that a kernel filter holds back.

        Args:
            sent: how many frames this program has sent, which a virtual interface counts among those received.

        Raises:
            InterfaceFault: it is missing, down, or another one of the same name.
        """
        try:
            status = interface_status(self._settings)
        except InterfaceFault:
            raise
        except OSError:  # no descriptor left to ask with: no reason to give up a bus
            return False
        if status.index != self._index:
            raise InterfaceFault(
                0, "the network interface was deleted and made anew", "nothing: the bus is opened again by itself"
            )
        self._checks_without_carrier = 0 if status.is_running else self._checks_without_carrier + 1
        before = self._foreign
        self._foreign = None
        if status.received is not None:
            self._foreign = status.received - (sent if status.receives_own else 0)
        return before is not None and self._foreign is not None and self._foreign > before

    def new_drops(self) -> int:
        """Frames that the receive buffer had no room for since the last call."""
        before = self._drops
        with suppress(OSError):
            self._drops = kernel_drops(self.bus)
        return self._drops - before

    def new_never_sent(self) -> int:
        """Frames that the interface took and dropped since the last call; `send` does not tell."""
        before, self._never_sent = self._never_sent, never_sent(self._settings)
        return self._never_sent - before
