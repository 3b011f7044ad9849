"""The virtual support as a program of its own, in real time."""

from __future__ import annotations

import asyncio
import logging
import signal
from contextlib import suppress
from pathlib import Path

from daemon.settings import Settings
from daemon.virtual import ControllerTransmitter, virtual_controller, virtual_part, virtual_support
from drivers.clock import SystemClock
from drivers.virtual.spi_socket import SpiSocketServer

_log = logging.getLogger(__name__)


async def simulate(settings: Settings) -> None:
    """Serve sensor and controller until SIGTERM or SIGINT. Raises OSError if the socket cannot be served."""
    clock = SystemClock()
    support = virtual_support(settings, start_ns=clock.now_ns())
    Path(settings.imu.socket_path).parent.mkdir(parents=True, exist_ok=True)
    server = SpiSocketServer(settings.imu.socket_path, virtual_part(support, clock))
    server.start()
    stopping = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stopping.set)
    sending = None
    if settings.can.enabled:
        controller = virtual_controller(settings, support)
        sending = asyncio.ensure_future(ControllerTransmitter(settings, controller, clock).run())
    _log.info("virtual support %d on %s", settings.simulation.seed, settings.imu.socket_path)
    try:
        await stopping.wait()
    finally:
        server.close()
        if sending is not None:
            sending.cancel()
            with suppress(asyncio.CancelledError):
                await sending
