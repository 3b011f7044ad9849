"""The inertial sensor's side of the daemon: a thread that starts the part, acquires, and starts again."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from daemon.settings import Settings
from drivers.acquisition import Acquisition
from drivers.adis16448.burst import Burst, Fault
from drivers.adis16448.configuration import ImuSettings
from drivers.adis16448.device import Adis16448, Identity, ImuError
from drivers.clock import Clock
from drivers.data_ready import DataReady, DataReadyError, GpiodDataReady, PacedDataReady
from drivers.spi import SpidevTransport, SpiTransport

if TYPE_CHECKING:
    from drivers.virtual.support import VirtualSupport

FIRST_RETRY_S, LONGEST_RETRY_S = 0.5, 5.0
DEAD_S = 2.0  # without one good sample: start the part anew

_log = logging.getLogger(__name__)


def open_ports(settings: ImuSettings, clock: Clock, support: VirtualSupport | None) -> tuple[SpiTransport, DataReady]:
    """The SPI port and the data-ready line that the settings name.

    Raises:
        SpiError, DataReadyError: a port cannot be opened.
    """
    pin, active_high = settings.data_ready_pin, settings.data_ready_active_high
    if settings.transport == "virtual":
        from daemon.virtual import virtual_part

        assert support is not None
        part = virtual_part(support, clock)
        return part, part.data_ready(pin=pin, active_high=active_high)
    if settings.transport == "socket":
        from drivers.virtual.spi_socket import SocketDataReady, SocketTransport

        path = settings.socket_path
        return _both(SocketTransport(path), lambda: SocketDataReady(path, pin=pin, active_high=active_high))
    spi, chip, line = SpidevTransport(settings.spi_device), settings.data_ready_chip, settings.data_ready_line
    if line is None:
        return spi, PacedDataReady(clock, settings.nominal_period_s)
    return _both(spi, lambda: GpiodDataReady(chip, line, active_high=active_high))


def _both(transport: SpiTransport, open_line: Callable[[], DataReady]) -> tuple[SpiTransport, DataReady]:
    """Port and line, or neither."""
    try:
        return transport, open_line()
    except DataReadyError:
        transport.close()
        raise


class ImuLink:
    """Brings bursts to `on_block` (called in the acquisition thread) for as long as it takes."""

    def __init__(
        self,
        settings: Settings,
        clock: Clock,
        on_block: Callable[[list[Burst]], None],
        support: VirtualSupport | None = None,
    ) -> None:
        self._settings = settings.imu
        self._clock = clock
        self._on_block = on_block
        self._support = support
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="imu", daemon=True)
        self._acquisition: Acquisition | None = None
        self.state = "waiting: not started yet"
        self.identity: Identity | None = None
        self.starts = 0
        self.attempts = 0  # to start the part

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def stop(self) -> None:
        """End acquisition and the thread."""
        self._stopping.set()
        self._thread.join(10.0)

    def health(self) -> dict[str, Any]:
        """Counters and state, for people and recordings."""
        report: dict[str, Any] = {"state": self.state, "starts": self.starts}
        if self.identity is not None:
            report["serial"] = self.identity.serial
        acquisition = self._acquisition
        if acquisition is not None:
            counters = asdict(acquisition.counters)
            counters["faults"] = {Fault(kind).name.lower(): n for kind, n in counters["faults"].items() if n}
            report |= counters | {"paced": acquisition.is_paced}
        return report

    def _run(self) -> None:
        retry_s = FIRST_RETRY_S / 2
        while not self._stopping.is_set():
            starts = self.starts
            self.attempts += 1
            try:
                self._acquire()
            except Exception as error:
                if self.state != f"waiting: {error}":
                    expected = isinstance(error, OSError | ImuError)
                    _log.warning("no inertial samples: %s", error, exc_info=None if expected else error)
                self.state = f"waiting: {error}"
                retry_s = FIRST_RETRY_S if self.starts > starts else min(2 * retry_s, LONGEST_RETRY_S)
                self._stopping.wait(retry_s)

    def _wait_while_good(self, acquisition: Acquisition) -> None:
        """Return on stop; raise ImuError when good samples have ceased."""
        counters, good = acquisition.counters, -1
        while not self._stopping.wait(DEAD_S):
            now_good = counters.samples - sum(counters.faults.values())
            if now_good == good:
                raise ImuError(
                    f"no good sample for {DEAD_S:g} s ({counters.last_error or 'see the counted faults'}): "
                    "the part is started anew; check its cable and supply"
                )
            good = now_good

    def _acquire(self) -> None:
        transport, data_ready = open_ports(self._settings, self._clock, self._support)
        try:
            device = Adis16448(transport, self._clock, self._settings)
            self.identity = device.start()
            for note in device.notes:
                _log.warning("inertial sensor: %s", note)
            acquisition = Acquisition(device, data_ready, self._clock, self._settings.block_samples, self._on_block)
            self._acquisition = acquisition
            self.starts += 1
            self.state = "running"
            _log.info("inertial sensor running, serial %d", self.identity.serial)
            acquisition.start()
            try:
                self._wait_while_good(acquisition)
            finally:
                acquisition.stop()
        finally:
            data_ready.close()
            transport.close()
