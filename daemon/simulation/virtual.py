"""The virtual support, as configured, joined to the rest of the program."""

from __future__ import annotations

import asyncio
import logging
from collections import Counter

import can
import numpy as np

from daemon.settings import Settings
from drivers.can.dbc import find_signal
from drivers.can.frame import Frame
from drivers.can.interface import open_bus, to_message
from drivers.can.settings import CanConfigError
from drivers.clock import Clock
from drivers.virtual.adis16448 import VirtualAdis16448
from drivers.virtual.can_network import network
from drivers.virtual.controller import LABORATORY_SENSOR, VirtualController
from drivers.virtual.faults import FaultScript, InterfaceDeleted, InterfaceDown
from drivers.virtual.faulty_controller import FaultyController, FrameSource
from drivers.virtual.faulty_line import FaultyEdges, FaultyWires
from drivers.virtual.faulty_part import PartSchedule
from drivers.virtual.faulty_values import faulty_observations
from drivers.virtual.jy901 import VirtualJy901
from drivers.virtual.jy901_line import VirtualLine
from drivers.virtual.motion import full_cycle
from drivers.virtual.part import VirtualPart
from drivers.virtual.scenarios import SCENARIOS
from drivers.virtual.support import VirtualSupport
from estimation.mount.axes import Mount
from estimation.settings import AxesSettings

_log = logging.getLogger(__name__)


def virtual_support(
    settings: Settings, *, start_ns: int = 0, cycles: int | None = None, rest_s: float = 10.0
) -> VirtualSupport:
    """The support that the configuration describes, its sensor mounted as [mount] says; `rest_s` before each cycle."""
    chosen = settings.simulation
    return VirtualSupport(
        chosen.seed,
        SCENARIOS[chosen.scenario],
        start_ns=start_ns,
        cycles=cycles,
        script=full_cycle(rest_s=rest_s),
        sensor_axes=_sensor_axes(settings.mount),
    )


def virtual_part(support: VirtualSupport, clock: Clock, faults: FaultScript | None = None) -> VirtualPart:
    """The virtual ADIS16448 on that support, with what the script does to it and to its wires."""
    if faults is None:
        return VirtualAdis16448(support.inertial_input(), clock, errors=support.sensor_errors)
    start_ns = support.start_ns
    part = VirtualAdis16448(
        support.inertial_input(),
        clock,
        errors=support.sensor_errors,
        schedule=PartSchedule(faults, start_ns),
        edge_wire=FaultyEdges(faults, start_ns),
    )
    return FaultyWires(part, faults, start_ns)


def virtual_line(settings: Settings, support: VirtualSupport, faults: FaultScript | None = None) -> VirtualLine:
    """The virtual JY901 on that support and its serial line, with what the script does to both."""
    axes = settings.mount if settings.jy901.use == "instead" else settings.jy901_mount
    part = VirtualJy901(support.jy901_input(_sensor_axes(axes)), support.start_ns, support.jy901_errors)
    return VirtualLine(part, faults, support.start_ns)


def virtual_controller(
    settings: Settings, support: VirtualSupport, faults: FaultScript | None = None
) -> VirtualController | FaultyController:
    """The controller that reports that support's displacement, with what the script does to it and to the bus.

    Raises CanConfigError: the settings do not fit a DBC file, or the script needs another interface.
    """
    reference = support.reference() if settings.simulation.reference else ()
    displacement = settings.can.displacement
    if faults is None:
        return VirtualController(support.observations(), displacement, reference)
    is_ours = settings.can.interface == "virtual"
    taken_away = [fault.kind for fault in faults.fault if isinstance(fault, InterfaceDown | InterfaceDeleted)]
    if taken_away and not is_ours:
        raise CanConfigError(
            f'the fault script has {taken_away[0]}, which only can.interface = "virtual" can play, not '
            f'"{settings.can.interface}": delete it from the script and set the interface down by hand'
        )
    observations = faulty_observations(support.observations(), faults, support.start_ns)
    return FaultyController(
        VirtualController(observations, displacement, reference),
        faults,
        support.start_ns,
        reading_id=find_signal(displacement).frame_id,
        bystander_id=find_signal(LABORATORY_SENSOR).frame_id,
        network=network(settings.can.channel) if is_ours else None,
    )


def _sensor_axes(mount: AxesSettings) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Turns support axes into sensor axes: the inverse of the mount."""
    to_support = Mount(mount).to_support
    unit = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    return np.array([to_support(v) for v in unit])


class ControllerTransmitter:
    """Sends the virtual controller's frames on the configured interface, when they are due."""

    def __init__(self, settings: Settings, controller: FrameSource, clock: Clock) -> None:
        self._settings = settings.can
        self._controller = controller
        self._clock = clock
        self._bus: can.BusABC | None = None
        self.sent = 0
        self.failed = 0
        self.sent_by_kind: Counter[str] = Counter()  # identifier, or "error frame"

    async def run(self) -> None:
        """Send until cancelled; frames that find no bus are counted and gone, as on a real one."""
        try:
            while (due_ns := self._controller.next_t_ns) is not None:
                await asyncio.sleep(max((due_ns - self._clock.now_ns()) * 1e-9, 0.0))
                self.send_due()
        finally:
            self.close()

    def send_due(self) -> None:
        """Send the frames due by now, instant by instant: the interface may change between two of them."""
        now_ns = self._clock.now_ns()
        while (due_ns := self._controller.next_t_ns) is not None and due_ns <= now_ns:
            for frame in self._controller.due(due_ns):
                self._send(frame)

    def close(self) -> None:
        """Release the bus, and the interface if a fault script holds it."""
        self._drop_bus()
        if isinstance(self._controller, FaultyController):
            self._controller.close()

    def _send(self, frame: Frame) -> None:
        try:
            if self._bus is None:
                self._bus = open_bus(self._settings, None)
            self._bus.send(to_message(frame))
        except (can.CanError, OSError, ValueError) as error:
            if self.failed == 0:
                _log.warning("the virtual controller cannot send on %s: %s", self._settings.channel, error)
            self.failed += 1
            self._drop_bus()
        else:
            self.sent += 1
            self.sent_by_kind["error frame" if frame.is_error else str(frame.frame_id)] += 1

    def _drop_bus(self) -> None:
        bus, self._bus = self._bus, None
        if bus is not None:
            bus.shutdown()
