"""The virtual support, as configured, joined to the rest of the program."""

from __future__ import annotations

import asyncio
import logging

import can
import numpy as np

from daemon.settings import Settings
from drivers.acquisition import Acquisition
from drivers.adis16448.burst import Burst
from drivers.adis16448.device import Adis16448
from drivers.can.bus import CanBus
from drivers.can.frame import Frame
from drivers.can.interface import open_bus, to_message
from drivers.clock import Clock
from drivers.virtual.adis16448 import VirtualAdis16448
from drivers.virtual.controller import VirtualController
from drivers.virtual.motion import SCENARIOS
from drivers.virtual.support import VirtualSupport
from estimation.mount import Mount
from estimation.settings import MountSettings

RETRY_S = 1.0

_log = logging.getLogger(__name__)


def virtual_support(settings: Settings, *, start_ns: int = 0, cycles: int | None = None) -> VirtualSupport:
    """The support that the configuration describes, its sensor mounted as [mount] says."""
    chosen = settings.simulation
    return VirtualSupport(
        chosen.seed,
        SCENARIOS[chosen.scenario],
        start_ns=start_ns,
        cycles=cycles,
        sensor_axes=_sensor_axes(settings.mount),
    )


def virtual_part(support: VirtualSupport, clock: Clock) -> VirtualAdis16448:
    """The virtual ADIS16448 on that support."""
    return VirtualAdis16448(support.inertial_input(), clock, errors=support.sensor_errors)


def virtual_controller(settings: Settings, support: VirtualSupport) -> VirtualController:
    """The controller that reports that support's displacement. Raises CanConfigError."""
    reference = support.reference() if settings.simulation.reference else ()
    return VirtualController(support.observations(), settings.can.displacement, reference)


def _sensor_axes(mount: MountSettings) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Turns support axes into sensor axes: the inverse of the mount."""
    to_support = Mount(mount).to_support
    unit = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    return np.array([to_support(v) for v in unit])


class ControllerTransmitter:
    """Sends the virtual controller's frames on the configured interface, when they are due."""

    def __init__(self, settings: Settings, controller: VirtualController, clock: Clock) -> None:
        self._settings = settings.can
        self._controller = controller
        self._clock = clock
        self._bus: can.BusABC | None = None
        self.sent = 0
        self.failed = 0

    async def run(self) -> None:
        """Send until cancelled; frames that find no bus are counted and gone, as on a real one."""
        try:
            while (due_ns := self._controller.next_t_ns) is not None:
                await asyncio.sleep(max((due_ns - self._clock.now_ns()) * 1e-9, 0.0))
                self.send_due()
                if self._bus is None:
                    await asyncio.sleep(RETRY_S)
        finally:
            self.close()

    def send_due(self) -> None:
        """Send the frames due by now."""
        for frame in self._controller.due(self._clock.now_ns()):
            try:
                if self._bus is None:
                    self._bus = open_bus(self._settings, None)
                self._bus.send(to_message(frame))
            except (can.CanError, OSError, ValueError) as error:
                if self.failed == 0:
                    _log.warning("the virtual controller cannot send on %s: %s", self._settings.channel, error)
                self.failed += 1
                self.close()
            else:
                self.sent += 1

    def close(self) -> None:
        """Release the bus."""
        bus, self._bus = self._bus, None
        if bus is not None:
            bus.shutdown()


class SimulatedRun:
    """The program's own driver and bus against the twins, in simulated time: no threads, no waiting."""

    def __init__(self, settings: Settings, support: VirtualSupport, clock: Clock) -> None:
        self._part = virtual_part(support, clock)
        self._clock = clock
        device = Adis16448(self._part, clock, settings.imu)
        self.identity = device.start()
        data_ready = self._part.data_ready(
            pin=settings.imu.data_ready_pin, active_high=settings.imu.data_ready_active_high
        )
        self.acquisition = Acquisition(device, data_ready, clock, settings.imu.block_samples, on_block=lambda _: None)
        self._transmitter = self._bus = None
        if settings.can.enabled:
            self._transmitter = ControllerTransmitter(settings, virtual_controller(settings, support), clock)
            self._bus = CanBus(settings.can, lambda _: None, clock)
            self._bus.drain()  # open it before the first frame is sent

    def next(self) -> tuple[list[Burst], list[Frame]] | None:
        """The next block and the frames that came meanwhile; None at the end of the motion."""
        if self._part.exhausted:
            return None
        block = self.acquisition.read_block()
        frames: list[Frame] = []
        if self._transmitter is not None and self._bus is not None:
            self._transmitter.send_due()
            frames = list(self._bus.drain())
        return block, frames

    def close(self) -> None:
        """Release the buses."""
        if self._transmitter is not None:
            self._transmitter.close()
        if self._bus is not None:
            self._bus.close()
