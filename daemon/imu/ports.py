"""The inertial sensor that the settings describe, with the ports that they name."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from drivers.adis16448.configuration import ImuSettings
from drivers.adis16448.machine import InertialSensor
from drivers.clock import Clock
from drivers.data_ready import DataReady, GpiodDataReady
from drivers.spi import SpidevTransport, SpiTransport

if TYPE_CHECKING:
    from drivers.virtual.support import VirtualSupport

OpenPort = Callable[[], SpiTransport]
OpenLine = Callable[[], DataReady]


def inertial_sensor(settings: ImuSettings, clock: Clock, support: VirtualSupport | None = None) -> InertialSensor:
    """The sensor, not started yet; `support` carries it if the transport is "virtual"."""
    open_port, open_line = port_openers(settings, clock, support)
    return InertialSensor(settings, clock, open_port, open_line)


def port_openers(
    settings: ImuSettings, clock: Clock, support: VirtualSupport | None
) -> tuple[OpenPort, OpenLine | None]:
    """What opens the SPI port (SpiError) and the data-ready line (DataReadyError); None: there is no line."""
    pin, active_high = settings.data_ready_pin, settings.data_ready_active_high
    if settings.transport == "virtual":
        from daemon.simulation.virtual import virtual_part

        assert support is not None
        part = virtual_part(support, clock)
        return lambda: part, lambda: part.data_ready(pin=pin, active_high=active_high)
    if settings.transport == "socket":
        from drivers.virtual.spi_socket import SocketDataReady, SocketTransport

        path = settings.socket_path
        return lambda: SocketTransport(path), lambda: SocketDataReady(path, pin=pin, active_high=active_high)
    device, chip, line = settings.spi_device, settings.data_ready_chip, settings.data_ready_line
    if line is None:
        return lambda: SpidevTransport(device), None
    return lambda: SpidevTransport(device), lambda: GpiodDataReady(chip, line, active_high=active_high)
