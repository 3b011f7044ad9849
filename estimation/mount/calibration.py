"""Which way the sensor sits, from a recording of rests and a few moves: gravity tells up, the bursts tell the push.

The configured mount is not used: all work is done in sensor axes, so that a wrong one does no harm.
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass, replace
from enum import StrEnum
from math import acos, asin, degrees, hypot
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from estimation.blocks import BlockCutter
from estimation.mount.axes import Mount
from estimation.mount.burst_line import LEAST_STEPS, BurstLine, burst_line
from estimation.mount.sign import odds_from_displacement, odds_from_speeds
from estimation.mount.stillness import WINDOW_S, Stillness, stillness
from estimation.mount.stretch import Stretch
from estimation.mount.velocity_steps import velocity_steps
from estimation.records import Displacement, ImuSample, Record, SensorChange, Vector
from estimation.settings import MountSettings, SupportSettings

Array = NDArray[np.float64]

GRAVITY_M_S2 = (8.8, 10.8)  # beyond: no specific force in m/s^2, or no rest
ACCEL_BIAS_M_S2 = 0.2  # data sheet: 20 mg on each axis, one sigma; looks like tilt
PUSH_FLOOR_DEG = 0.3  # scale and misalignment of the sensor's axes, tilt while the ram moves
TURNED_DEG = 5.0
STEEPEST_DEG = 30.0  # of a push; a face dips, but not more
BETWEEN_AXES_DEG = 45.0
SURE_SIGMAS = 3.0  # to the middle between two axes, so that no axis is named with a sigma of 15 degrees or more
DECISIVE_NATS = 7.0  # one in a thousand

_SENSOR_AXES = Mount(MountSettings(push="+y", up="+z"))  # turns nothing
_WANTED = f"a rest of {WINDOW_S:g} s and at least two moves, better a whole push and a whole retract"


class Verdict(StrEnum):
    """How much of the mount a recording determines."""

    DETERMINED = "determined"
    SIGN_UNDETERMINED = "sign undetermined"  # of the push; all else is known
    UNDETERMINED = "undetermined"


@dataclass(slots=True, frozen=True)
class Axis:
    """A direction of the support as the sensor sees it."""

    direction: Vector  # unit vector, sensor axes
    sigma_deg: float  # of each of the two angles that turn it
    name: str  # nearest signed axis: "+y"; "±y" if the sign is undetermined
    off_deg: float  # angle to that axis

    @property
    def is_sure(self) -> bool:
        """Whether no other axis can be the nearest one."""
        return self.off_deg + SURE_SIGMAS * self.sigma_deg < BETWEEN_AXES_DEG


@dataclass(slots=True, frozen=True)
class MountEstimate:
    """How the sensor sits, as far as a recording tells."""

    verdict: Verdict
    why: str = ""  # one sentence: what is missing or doubtful, and what to do about it
    up: Axis | None = None
    push: Axis | None = None
    bursts_found: int = 0
    bursts: int = 0  # used
    chi_square: float = float("nan")  # of their agreement on one line
    degrees_of_freedom: int = 0
    sign_from: str = ""  # "displacement sensor" or "nominal speeds"


class MountCalibration:
    """Feed it every record of a recording in order, as the pipeline gets them; then ask for the estimate.

    Args:
        support: nominal speeds, which tell a push from a retract where no displacement sensor does.
        imu_on: which of the moves the sensor feels, see `MountSettings`.
    """

    def __init__(
        self, support: SupportSettings | None = None, imu_on: Literal["both", "link", "base"] = "both"
    ) -> None:
        self._support = support or SupportSettings()
        self._imu_on = imu_on
        self._cutter = BlockCutter()
        self._blocks = array("d")  # end [s], length [s], acceleration, rate; since the last gap
        self._stretches: list[Stretch] = []
        self._readings = array("d")  # time [s], displacement [m]
        self._references = array("d")

    def feed(self, record: Record) -> None:
        """Take one record."""
        if isinstance(record, ImuSample):
            gap_s, step = self._cutter.add(record, _SENSOR_AXES)
            if gap_s:
                self._close_stretch()
            if step is not None:
                self._blocks.extend((step.t_ns * 1e-9, step.dt_s, *step.accel, *step.gyro))
        elif isinstance(record, Displacement):
            if record.valid:
                readings = self._references if record.is_reference else self._readings
                readings.extend((record.t_ns * 1e-9, record.value_m))
        elif isinstance(record, SensorChange):
            # Another part may sit another way; only the last one can still be looked at.
            self._cutter, self._blocks, self._stretches = BlockCutter(), array("d"), []

    def estimate(self) -> MountEstimate:
        """What all that was fed tells."""
        self._close_stretch()
        still = stillness(self._stretches)
        doubt = _doubt_of_rest(still)
        if doubt:
            return MountEstimate(Verdict.UNDETERMINED, doubt)
        up = _up(still)
        steps = [step for stretch in self._stretches for step in velocity_steps(stretch, still.gyro_bias(stretch.t_s))]
        found = MountEstimate(Verdict.UNDETERMINED, up=up, bursts_found=len(steps))
        if not up.is_sure:
            lies = f"up lies {up.off_deg:.0f}° off {up.name}, too near another axis"
            return replace(found, why=f"{lies}: turn the sensor so that one of its axes points up")
        if len(steps) < LEAST_STEPS:
            return replace(found, why=f"clear bursts: {len(steps)}, too few to tell the push: record {_WANTED}")
        line = burst_line(steps)
        push = _unsigned_push(line, up)
        found = replace(
            found, bursts=len(line.steps), chi_square=line.chi_square, degrees_of_freedom=line.degrees_of_freedom
        )
        doubt = _doubt_of_push(line, push, up)
        return replace(found, why=doubt) if doubt else self._signed(replace(found, push=push), line)

    def _close_stretch(self) -> None:
        if self._blocks:
            table = np.array(self._blocks).reshape(-1, 8)
            self._stretches.append(Stretch.from_blocks(table[:, 0], table[:, 1], table[:, 2:5], table[:, 5:8]))
            self._blocks = array("d")

    def _signed(self, found: MountEstimate, line: BurstLine) -> MountEstimate:
        """Which way along the line the push goes: by the first witness that is sure, if none contradicts it."""
        readings = [np.array(values).reshape(-1, 2) for values in (self._readings, self._references)]
        odds = {
            "displacement sensor": sum(odds_from_displacement(line.sizes, line.steps, table) for table in readings),
            "nominal speeds": odds_from_speeds(line.sizes, line.steps, self._support, self._imu_on),
        }
        sure = {witness: nats for witness, nats in odds.items() if abs(nats) > DECISIVE_NATS}
        signs = {nats > 0 for nats in sure.values()}
        if len(signs) == 1 and found.push is not None:
            direction = line.direction if signs.pop() else -line.direction
            push = _axis(direction, found.push.sigma_deg, found.push.name[1])
            return replace(found, verdict=Verdict.DETERMINED, push=push, sign_from=next(iter(sure)))
        if sure:
            why = (
                "the displacement sensor and the nominal speeds contradict each other about which moves are pushes: "
                "check `scale` in [can.displacement] and the speeds in [support]"
            )
        else:
            why = (
                "nothing tells the pushes from the retracts: record with the displacement sensor, or a whole push "
                "and a whole retract with their true speeds in [support]"
            )
        return replace(found, verdict=Verdict.SIGN_UNDETERMINED, why=why)


def _doubt_of_rest(still: Stillness) -> str:
    """What forbids to take the mean force for gravity."""
    if not len(still):
        return f"there is no rest in it: record {_WANTED}"
    size = float(np.linalg.norm(still.force, axis=1).mean())
    if not GRAVITY_M_S2[0] < size < GRAVITY_M_S2[1]:
        return f"at rest the sensor feels {size:.2f} m/s² instead of 9.81: check its scale and units"
    if _spread_deg(still) > TURNED_DEG:
        return "the sensor was turned in the course of it: record anew, now that it is fixed"
    return ""


def _up(still: Stillness) -> Axis:
    force = still.force.mean(axis=0)
    size = float(np.linalg.norm(force))
    return _axis(force / size, hypot(degrees(ACCEL_BIAS_M_S2 / size), _spread_deg(still)))


def _spread_deg(still: Stillness) -> float:
    """How far gravity turned between the still times, rms of an angle."""
    directions = still.force / np.linalg.norm(still.force, axis=1, keepdims=True)
    away = directions - directions.mean(axis=0)
    return degrees(float(np.sqrt(np.mean(np.sum(away**2, axis=1)) / 2)))


def _unsigned_push(line: BurstLine, up: Axis) -> Axis:
    axis = _axis(line.direction, hypot(degrees(line.sigma_rad), PUSH_FLOOR_DEG), "xyz".replace(up.name[1], ""))
    return replace(axis, name=f"±{axis.name[1]}")


def _doubt_of_push(line: BurstLine, push: Axis, up: Axis) -> str:
    """What forbids to take the line of the bursts for that of the push."""
    if not line.agrees:
        return (
            f"the {len(line.steps)} bursts do not lie on one line (chi-square {line.chi_square:.0f} of "
            f"{line.degrees_of_freedom}): record {_WANTED}, while nothing else moves the support"
        )
    climb_deg = degrees(asin(min(abs(float(np.dot(push.direction, up.direction))), 1.0)))
    if climb_deg > STEEPEST_DEG:
        return f"the bursts point {climb_deg:.0f}° out of the horizontal: that is no push"
    if not push.is_sure:
        return (
            f"the push lies {push.off_deg:.0f} ± {push.sigma_deg:.0f}° off {push.name}, which does not exclude another "
            "axis: record more moves, or turn the sensor so that one of its axes lies along the push"
        )
    return ""


def _axis(direction: Array, sigma_deg: float, letters: str = "xyz") -> Axis:
    """A unit vector with the nearest of the signed axes `letters`."""
    components = {letter: float(value) for letter, value in zip("xyz", direction, strict=True) if letter in letters}
    letter = max(components, key=lambda name: abs(components[name]))
    size = components[letter]
    x, y, z = (float(value) for value in direction)
    return Axis((x, y, z), sigma_deg, f"{'+' if size > 0 else '-'}{letter}", degrees(acos(min(abs(size), 1.0))))
