"""The inertial sensor's side of the daemon: acquisition in a thread or in a process of its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from daemon.imu.ports import inertial_sensor
from daemon.imu.process import ImuProcess
from daemon.imu.roles import Role
from daemon.settings import Settings
from drivers.acquisition import Acquisition, AnyIdentity, Block
from drivers.clock import Clock
from drivers.condition import Condition

if TYPE_CHECKING:
    from drivers.virtual.support import VirtualSupport


class ImuLink:
    """Brings samples to `on_block` for as long as it takes; nothing it meets ends it.

    Args:
        settings: of the program.
        clock: of the run.
        on_block: called in a foreign thread, an Identity first whenever the part was started.
        support: carries the virtual part, for the transport "virtual".
        role: the sensor that is estimated from, or the one that is recorded beside it.
    """

    def __init__(
        self,
        settings: Settings,
        clock: Clock,
        on_block: Callable[[Block], None],
        support: VirtualSupport | None = None,
        role: Role = "main",
    ) -> None:
        self._side: _ThreadSide | ImuProcess
        # The one beside sends a quarter of the samples and waits most of the time: a thread will do.
        if settings.imu.acquisition == "process" and role == "main":
            start_ns = clock.now_ns() if support is None else support.start_ns
            self._side = ImuProcess(settings, start_ns, on_block)
        else:
            self._side = _ThreadSide(settings, clock, on_block, support, role)

    def start(self) -> None:
        """Begin; returns at once."""
        self._side.start()

    def stop(self) -> None:
        """End it and wait for that, some seconds at most; blocks come until it returns."""
        self._side.stop()

    @property
    def condition(self) -> Condition:
        """How the sensor is, in words."""
        return self._side.condition

    @property
    def identity(self) -> AnyIdentity | None:
        """The part that delivers, or did last."""
        return self._side.identity

    @property
    def progress(self) -> int:
        """Moves as long as the acquisition lives, even if the sensor is ill."""
        return self._side.progress

    @property
    def is_behind(self) -> bool:
        """Whether samples that were read some time ago may still be on their way here."""
        return self._side.is_behind

    def counters(self) -> dict[str, Any]:
        """What happened so far, JSON-able; kinds that never happened are left out of tables of kinds."""
        counted = {
            name: {kind: count for kind, count in value.items() if count} if isinstance(value, dict) else value
            for name, value in asdict(self._side.counters).items()
        }
        facts = {} if self.identity is None else self.identity.facts
        return facts | counted | self._side.own_counters() | {"notes": list(self._side.notes)}


class _ThreadSide:
    """Acquisition in a thread of this process."""

    def __init__(
        self,
        settings: Settings,
        clock: Clock,
        on_block: Callable[[Block], None],
        support: VirtualSupport | None,
        role: Role,
    ) -> None:
        self._sensor = inertial_sensor(settings, clock, support, role)
        priority = settings.imu.realtime_priority if role == "main" else None
        self._acquisition = Acquisition(self._sensor, on_block, priority)

    def start(self) -> None:
        self._acquisition.start()

    def stop(self) -> None:
        self._acquisition.stop()

    @property
    def condition(self) -> Condition:
        return self._sensor.condition

    @property
    def identity(self) -> AnyIdentity | None:
        return self._sensor.identity

    @property
    def progress(self) -> int:
        return self._sensor.progress

    @property
    def counters(self) -> Any:
        return self._sensor.counters

    @property
    def notes(self) -> list[str]:
        return self._sensor.notes

    @property
    def is_behind(self) -> bool:
        return False  # it stands still together with the rest

    def own_counters(self) -> dict[str, int]:
        return {"lost_blocks": self._acquisition.lost_blocks}
