"""The program's own driver and bus against the twins, in simulated time."""

from __future__ import annotations

from daemon.settings import Settings
from daemon.simulation.virtual import ControllerTransmitter, virtual_controller, virtual_part
from drivers.acquisition import Block
from drivers.adis16448.identity import Identity
from drivers.adis16448.machine import InertialSensor
from drivers.can.bus import CanBus
from drivers.can.frame import Frame
from drivers.clock import Clock
from drivers.virtual.faults import FaultScript
from drivers.virtual.faulty_controller import FrameSource
from drivers.virtual.part import PartAtPins
from drivers.virtual.support import VirtualSupport


class SimulatedRun:
    """No threads, no waiting; whatever is broken is in the conditions and counters of `sensor` and `bus`."""

    def __init__(self, settings: Settings, part: PartAtPins, controller: FrameSource, clock: Clock) -> None:
        imu, self._part = settings.imu, part
        self.sensor = InertialSensor(
            imu,
            clock,
            lambda: part,
            lambda: part.data_ready(pin=imu.data_ready_pin, active_high=imu.data_ready_active_high),
        )
        self.bus: CanBus | None = None
        self._transmitter: ControllerTransmitter | None = None
        if settings.can.enabled:
            self._transmitter = ControllerTransmitter(settings, controller, clock)
            self.bus = CanBus(settings.can, lambda _: None, clock)
            self.bus.drain()  # open it before the first frame is sent

    @classmethod
    def of(
        cls, settings: Settings, support: VirtualSupport, clock: Clock, faults: FaultScript | None = None
    ) -> SimulatedRun:
        """On the twins of a virtual support, with what a script does to them. Raises CanConfigError."""
        part, controller = virtual_part(support, clock, faults), virtual_controller(settings, support, faults)
        return cls(settings, part, controller, clock)

    @property
    def identity(self) -> Identity | None:
        """The part that was met first or last; None until then."""
        return self.sensor.identity

    def next(self) -> tuple[Block, list[Frame]] | None:
        """The next block and the frames that came meanwhile; None at the end of the motion."""
        if self._part.exhausted:
            return None
        block = self.sensor.read_block()
        frames: list[Frame] = []
        if self._transmitter is not None and self.bus is not None:
            self._transmitter.send_due()
            frames = list(self.bus.drain())
        return block, frames

    def close(self) -> None:
        """Release the buses."""
        self.sensor.close()
        if self._transmitter is not None:
            self._transmitter.close()
        if self.bus is not None:
            self.bus.close()
