"""The program's own drivers and bus against the twins, in simulated time."""

from __future__ import annotations

from dataclasses import dataclass

from daemon.settings import Settings
from daemon.simulation.virtual import ControllerTransmitter, virtual_controller, virtual_line, virtual_part
from drivers.acquisition import AnyIdentity, Block, Sensor
from drivers.adis16448.machine import InertialSensor
from drivers.can.bus import CanBus
from drivers.can.frame import Frame
from drivers.clock import Clock
from drivers.jy901.machine import Jy901
from drivers.virtual.faults import FaultScript
from drivers.virtual.faulty_controller import FrameSource
from drivers.virtual.jy901_line import VirtualLine
from drivers.virtual.jy901_port import VirtualSerialPort
from drivers.virtual.part import PartAtPins
from drivers.virtual.support import VirtualSupport


@dataclass(frozen=True)
class Devices:
    """The twins of a run: one inertial sensor at least."""

    controller: FrameSource
    part: PartAtPins | None = None  # the ADIS16448
    line: VirtualLine | None = None  # with the JY901 at its end

    @classmethod
    def of(
        cls, settings: Settings, support: VirtualSupport, clock: Clock, faults: FaultScript | None = None
    ) -> Devices:
        """Those of a virtual support, with what a script does to them. Raises CanConfigError."""
        return cls(
            virtual_controller(settings, support, faults),
            None if settings.jy901.use == "instead" else virtual_part(support, clock, faults),
            None if settings.jy901.use == "no" else virtual_line(settings, support, faults),
        )

    @property
    def exhausted(self) -> bool:
        """Whether the motion has ended for the sensor that is estimated from."""
        if self.part is not None:
            return self.part.exhausted
        return self.line is None or self.line.part.exhausted


class _Onlooker:
    """The clock of one who must not let time pass: others wait for him."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock

    def now_ns(self) -> int:
        """Monotonic time [ns]."""
        return self._clock.now_ns()

    def sleep(self, seconds: float) -> None:
        """Not now."""


class SimulatedRun:
    """No threads, no waiting; whatever is broken is in the conditions and counters of `sensor`, `beside` and `bus`."""

    def __init__(self, settings: Settings, devices: Devices, clock: Clock) -> None:
        self._devices = devices
        self.sensor, self.beside = _sensors(settings, devices, clock)
        self.bus: CanBus | None = None
        self._transmitter: ControllerTransmitter | None = None
        if settings.can.enabled:
            self._transmitter = ControllerTransmitter(settings, devices.controller, clock)
            self.bus = CanBus(settings.can, lambda _: None, clock)
            self.bus.drain()  # open it before the first frame is sent

    @classmethod
    def of(
        cls, settings: Settings, support: VirtualSupport, clock: Clock, faults: FaultScript | None = None
    ) -> SimulatedRun:
        """On the twins of a virtual support, with what a script does to them. Raises CanConfigError."""
        return cls(settings, Devices.of(settings, support, clock, faults), clock)

    @property
    def identity(self) -> AnyIdentity | None:
        """The part that was met first or last; None until then."""
        return self.sensor.identity

    def next(self) -> tuple[Block, list[Frame]] | None:
        """The next block and the frames that came meanwhile; None at the end of the motion."""
        if self._devices.exhausted:
            return None
        block = list(self.sensor.read_block())
        if self.beside is not None:
            block += self.beside.read_block()
        frames: list[Frame] = []
        if self._transmitter is not None and self.bus is not None:
            self._transmitter.send_due()
            frames = list(self.bus.drain())
        return block, frames

    def close(self) -> None:
        """Release the buses."""
        for sensor in (self.sensor, self.beside):
            if sensor is not None:
                sensor.close()
        if self._transmitter is not None:
            self._transmitter.close()
        if self.bus is not None:
            self.bus.close()


def _sensors(settings: Settings, devices: Devices, clock: Clock) -> tuple[Sensor, Jy901 | None]:
    """The one to estimate from, and the one beside it."""
    imu, part, line = settings.imu, devices.part, devices.line
    pace = clock if part is None else _Onlooker(clock)
    jy901 = None if line is None else Jy901(settings.jy901, pace, lambda: VirtualSerialPort(line, pace))
    if part is None:
        assert jy901 is not None
        return jy901, None
    adis16448 = InertialSensor(
        imu,
        clock,
        lambda: part,
        lambda: part.data_ready(pin=imu.data_ready_pin),
    )
    return adis16448, jy901
