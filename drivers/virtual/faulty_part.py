"""What a fault script does to the part itself: its supply, its registers, which part it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.adis16448.registers import DIAG_BAROMETER, DIAG_MAGNETOMETER, DIAG_MEMORY
from drivers.virtual.adis16448_updates import Saturation
from drivers.virtual.faults import (
    Axis,
    BrownOut,
    FaultScript,
    Overrange,
    Placed,
    RepeatedSamples,
    Replaced,
    SelfTestFailure,
    SelfTestPart,
    Unplugged,
    WrongProductId,
    placed,
)
from drivers.virtual.sensor_errors import SensorErrors

_VERDICT_BITS: dict[SelfTestPart, int] = {
    "x_gyro": 1 << 10,
    "y_gyro": 1 << 11,
    "z_gyro": 1 << 12,
    "x_accl": 1 << 13,
    "y_accl": 1 << 14,
    "z_accl": 1 << 15,
    "memory": DIAG_MEMORY,
    "barometer": DIAG_BAROMETER,
    "magnetometer": DIAG_MAGNETOMETER,
}
_CHANNELS: tuple[Axis, ...] = ("x_gyro", "y_gyro", "z_gyro", "x_accl", "y_accl", "z_accl")


@dataclass(slots=True, frozen=True)
class PartCondition:
    """How the part is between two changes."""

    is_powered: bool = True
    is_frozen: bool = False  # its output registers hold what they held
    failing_parts: int = 0  # DIAG_STAT bits that a test ending now sets
    product_id: int | None = None  # what PROD_ID holds instead of the right one
    part: int = 0  # which one, counted up at each replacement


@dataclass(slots=True, frozen=True)
class NewPart:
    """The part that takes the place of another one."""

    lot_id: int
    serial: int
    errors: SensorErrors


class PartSchedule:
    """The part's conditions through a run that starts at `start_ns`."""

    def __init__(self, script: FaultScript, start_ns: int) -> None:
        self._unpowered: list[Placed[BrownOut | Unplugged | Replaced]] = placed(
            script, start_ns, BrownOut, Unplugged, Replaced
        )
        self._replaced = sorted(placed(script, start_ns, Replaced), key=lambda place: place.end_ns)
        self._frozen = placed(script, start_ns, RepeatedSamples)
        self._failing = placed(script, start_ns, SelfTestFailure)
        self._renamed = placed(script, start_ns, WrongProductId)
        windows: list[tuple[int, int]] = []
        for places in (self._unpowered, self._frozen, self._failing, self._renamed):
            windows += [(place.start_ns, place.end_ns) for place in places]
        self.changes_ns = sorted({t_ns for window in windows for t_ns in window})
        self.saturations = tuple(
            Saturation(place.start_ns, place.end_ns, _CHANNELS.index(place.fault.axis))
            for place in placed(script, start_ns, Overrange)
        )

    def at(self, t_ns: int) -> PartCondition:
        """The condition at `t_ns`, which lasts until the next of `changes_ns`."""
        failing = 0
        for place in self._failing:
            if place.holds(t_ns):
                failing |= sum(_VERDICT_BITS[part] for part in set(place.fault.parts))
        renamed = [place.fault.product_id for place in self._renamed if place.holds(t_ns)]
        return PartCondition(
            is_powered=not any(place.holds(t_ns) for place in self._unpowered),
            is_frozen=any(place.holds(t_ns) for place in self._frozen),
            failing_parts=failing,
            product_id=renamed[-1] if renamed else None,
            part=sum(place.end_ns <= t_ns for place in self._replaced),
        )

    def new_part(self, number: int) -> NewPart:
        """Part `number`, from 1; its errors are its own."""
        place = self._replaced[number - 1]
        errors = SensorErrors(np.random.default_rng(list(place.key)))
        return NewPart(place.fault.lot_id, place.fault.serial, errors)
