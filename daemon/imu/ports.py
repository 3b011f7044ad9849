"""The inertial sensors that the settings describe, with the ports that they name."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from daemon.imu.roles import Role, is_jy901
from daemon.settings import Settings
from drivers.acquisition import Sensor
from drivers.adis16448.configuration import ImuSettings
from drivers.adis16448.counters import Counters
from drivers.adis16448.machine import InertialSensor
from drivers.clock import Clock
from drivers.data_ready import DataReady, GpiodDataReady
from drivers.jy901.counters import Jy901Counters
from drivers.jy901.machine import Jy901
from drivers.jy901.port import PySerialPort, SerialPort
from drivers.spi import SpidevTransport, SpiTransport

if TYPE_CHECKING:
    from drivers.virtual.support import VirtualSupport

OpenPort = Callable[[], SpiTransport]
OpenLine = Callable[[], DataReady]


def inertial_sensor(
    settings: Settings, clock: Clock, support: VirtualSupport | None = None, role: Role = "main"
) -> Sensor:
    """The sensor of that role, not started yet; `support` carries a virtual one."""
    if is_jy901(settings, role):
        return Jy901(settings.jy901, clock, serial_opener(settings, clock, support))
    open_port, open_line = port_openers(settings.imu, clock, support)
    return InertialSensor(settings.imu, clock, open_port, open_line)


def no_counters(settings: Settings, role: Role) -> Counters | Jy901Counters:
    """The counters of that sensor before anything happened."""
    return Jy901Counters() if is_jy901(settings, role) else Counters()


def serial_opener(settings: Settings, clock: Clock, support: VirtualSupport | None) -> Callable[[], SerialPort]:
    """What opens the serial port (PortError)."""
    if settings.jy901.transport == "virtual":
        from daemon.simulation.virtual import virtual_line
        from drivers.virtual.jy901_port import VirtualSerialPort

        assert support is not None
        line = virtual_line(settings, support)
        return lambda: VirtualSerialPort(line, clock)
    return lambda: PySerialPort(settings.jy901.port)


def port_openers(
    settings: ImuSettings, clock: Clock, support: VirtualSupport | None
) -> tuple[OpenPort, OpenLine | None]:
    """What opens the SPI port (SpiError) and the data-ready line (DataReadyError); None: there is no line."""
    pin, active_high = settings.data_ready_pin, settings.data_ready_active_high
    if settings.transport == "virtual":
        from daemon.simulation.virtual import virtual_part

        assert support is not None
        part = virtual_part(support, clock)
        # The virtual wire inverts where the settings say so: the listener sees the pin's own edges.
        return lambda: part, lambda: part.data_ready(pin=pin)
    if settings.transport == "socket":
        from drivers.virtual.spi_socket import SocketDataReady, SocketTransport

        path = settings.socket_path
        return lambda: SocketTransport(path), lambda: SocketDataReady(path, pin=pin)
    device, chip, line = settings.spi_device, settings.data_ready_chip, settings.data_ready_line
    if line is None:
        return lambda: SpidevTransport(device), None
    return lambda: SpidevTransport(device), lambda: GpiodDataReady(chip, line, active_high=active_high)
