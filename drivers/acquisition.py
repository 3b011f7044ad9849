"""The acquisition thread: reads the inertial sensor for ever and hands over blocks."""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Callable, Sequence
from typing import Any, Protocol

from drivers.adis16448.burst import Burst
from drivers.adis16448.identity import Identity
from drivers.condition import Condition
from drivers.jy901.identity import Jy901Identity
from drivers.jy901.reading import Reading

AnyIdentity = Identity | Jy901Identity
Block = list[Burst | Identity | Reading | Jy901Identity]

_JOIN_S = 5.0

_log = logging.getLogger(__name__)


class Source(Protocol):
    """What acquisition needs of a sensor."""

    def read_block(self) -> Sequence[Burst | Identity | Reading | Jy901Identity]:
        """The next samples, soon; none if none come. Raises nothing."""

    def close(self) -> None:
        """Give the ports back."""


class Sensor(Source, Protocol):
    """An inertial sensor of any kind."""

    @property
    def condition(self) -> Condition:
        """How it is, in words."""

    @property
    def identity(self) -> AnyIdentity | None:
        """The part that delivers, or did last."""

    @property
    def progress(self) -> int:
        """Moves as long as caller and port come back, even if the part is ill."""

    @property
    def counters(self) -> Any:
        """A dataclass of plain numbers with `samples` and `plus`."""

    @property
    def notes(self) -> list[str]:
        """What a person should know although all is well."""


class Acquisition:
    """Calls `read_block` in a thread of its own and gives what comes to `on_block`, in that thread.

    Args:
        sensor: read by nobody else; closed at the end.
        on_block: must return soon; what it raises is counted and survived.
        realtime_priority: SCHED_FIFO priority of the thread, 1 to 99; None: as all others.
    """

    def __init__(self, sensor: Source, on_block: Callable[[Block], None], realtime_priority: int | None = None) -> None:
        self.lost_blocks = 0  # `on_block` raised
        self._sensor = sensor
        self._on_block = on_block
        self._realtime_priority = realtime_priority
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="acquisition", daemon=True)

    @property
    def is_running(self) -> bool:
        """Whether the thread lives."""
        return self._thread.is_alive()

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread and wait for it."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join(_JOIN_S)

    def _run(self) -> None:
        if self._realtime_priority is not None:
            prefer_this_thread(self._realtime_priority)
        try:
            while not self._stopping.is_set():
                block = self._sensor.read_block()
                if block:
                    self._hand_over(list(block))
        finally:
            self._sensor.close()

    def _hand_over(self, block: Block) -> None:
        try:
            self._on_block(block)
        except Exception:
            self.lost_blocks += 1
            if self.lost_blocks == 1:
                _log.exception("a block of inertial samples is lost: nobody could take it")


def prefer_this_thread(priority: int) -> None:
    """Give the calling thread a real-time priority; if the system refuses, say so and go on."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError as error:
        _log.warning(
            "realtime_priority = %d is refused (%s): allow it with LimitRTPRIO=%d, for the service by `ramstroke "
            "install-service --realtime`, or with the capability CAP_SYS_NICE; the sensor is read without it",
            priority,
            error.strerror or error,
            priority,
        )
