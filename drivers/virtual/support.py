"""The virtual support: one motion, felt by the virtual inertial sensor and reported by the virtual controller."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from itertools import chain, repeat

import numpy as np
from numpy.typing import NDArray

from drivers.virtual.controller import (
    Observation,
    ObservedDisplacement,
    SensorParameters,
    SensorSpread,
    exact_observations,
)
from drivers.virtual.inertial_input import InertialBlock
from drivers.virtual.motion import (
    RATE_HZ,
    FloatArray,
    Machine,
    Scenario,
    Script,
    Trajectory,
    TrueMove,
    full_cycle,
)
from drivers.virtual.sensor_errors import JY901, SensorErrors

MOUNTING_ERROR_DEG = 3.0
CLOCK_ERROR = 0.03  # data sheet: 819.2 Hz +- 3 %
BLOCK_SAMPLES = 256
END_STILLNESS_S = 1.0  # after the last cycle, so that a rest can be recognised to its end


@dataclass(frozen=True)
class PlacedTrajectory:
    """A trajectory at its place in the run's time."""

    trajectory: Trajectory
    start_s: float

    @property
    def t_s(self) -> FloatArray:
        """Times of the samples on the run's clock, relative to the run's start."""
        return self.trajectory.t_s + self.start_s


class VirtualSupport:
    """Everything that the twins need, drawn from one seed.

    Args:
        seed: of machine, sensors and noise; each has its own stream, so that one does not disturb another.
        scenario: distributions of the motion.
        displacement_sensor: distributions of the controller's displacement sensor.
        start_ns: when the motion begins.
        cycles: how many times the script is played; None = for ever.
        script: moves of one cycle; None = a full push and retract.
        warm_up: as many full cycles are played before.
        clock_error: of the inertial sensor's sample rate, as a share; None = drawn.
        sensor_axes: (3, 3), turns support axes (x across, y push, z up) into nominal sensor axes.
    """

    def __init__(
        self,
        seed: int,
        scenario: Scenario | None = None,
        *,
        displacement_sensor: SensorSpread | None = None,
        start_ns: int = 0,
        cycles: int | None = None,
        script: Script | None = None,
        warm_up: int = 0,
        clock_error: float | None = None,
        sensor_axes: FloatArray | None = None,
    ) -> None:
        machine, sensor, controller, mounting, clock, second = np.random.default_rng(seed).spawn(6)
        self.start_ns = start_ns
        self.sensor_errors = SensorErrors(sensor)
        drawn = clock.uniform(-CLOCK_ERROR, CLOCK_ERROR)
        self.sample_rate_hz = RATE_HZ * (1 + (drawn if clock_error is None else clock_error))
        self.controller_parameters = SensorParameters.draw(controller, displacement_sensor)
        self._controller_rng = controller
        axes = np.eye(3) if sensor_axes is None else sensor_axes
        self.to_sensor = _mounted(mounting, axes)  # (3, 3), support axes to true sensor axes
        self.jy901_errors = SensorErrors(second, JY901)
        self._jy901_mounting = second
        played = repeat(script or full_cycle(), *(() if cycles is None else (cycles,)))
        count = None if cycles is None else warm_up + cycles
        scripts = chain(repeat(full_cycle(), warm_up), played)
        self.machine = Machine(machine, scenario or Scenario())
        self._cycles = _Cycles(self.machine.play(scripts, END_STILLNESS_S), count)

    def true_moves(self) -> tuple[TrueMove, ...]:
        """What really happened in the first cycle, times relative to the start."""
        placed = self._cycles.get(0)
        return () if placed is None else placed.trajectory.moves

    def placed(self, number: int) -> PlacedTrajectory:
        """Cycle `number` of a run with an end, at its place in time. Raises ValueError if there is none."""
        placed = self._cycles.get(number)
        if placed is None:
            raise ValueError(f"the virtual support makes no cycle {number}")
        return placed

    def truth(self) -> Trajectory:
        """The first cycle. Raises ValueError if there is none."""
        placed = self._cycles.get(0)
        if placed is None:
            raise ValueError("a virtual support without cycles has no truth")
        return placed.trajectory

    def inertial_input(self) -> SupportInput:
        """What the inertial sensor feels, sample by sample of its own clock."""
        return SupportInput(self._cycles, self.start_ns, self.sample_rate_hz, self.to_sensor)

    def jy901_input(self, axes: FloatArray) -> SupportInput:
        """What a JY901 feels on the same support, mounted for itself; `axes` as `sensor_axes`."""
        to_sensor = _mounted(self._jy901_mounting, axes)
        return SupportInput(self._cycles, self.start_ns, self.sample_rate_hz, to_sensor)

    def observations(self) -> Iterator[Observation]:
        """Readings of the controller's displacement sensor, times on the run's clock."""
        sensor = ObservedDisplacement(self.controller_parameters, self._controller_rng)
        for placed in self._cycles:
            for t_ns, value_m in sensor.observations(placed.t_s, placed.trajectory.displacement_m):
                yield t_ns + self.start_ns, value_m

    def reference(self) -> Iterator[Observation]:
        """Readings of a laboratory sensor beside it."""
        for placed in self._cycles:
            for t_ns, value_m in exact_observations(placed.t_s, placed.trajectory.displacement_m):
                yield t_ns + self.start_ns, value_m


class SupportInput:
    """Inertial input of the twin: the motion at the instants of a clock of its own."""

    def __init__(self, cycles: _Cycles, start_ns: int, rate_hz: float, to_sensor: FloatArray) -> None:
        self._cycles = cycles
        self._start_ns = start_ns
        self._rate_hz = rate_hz
        self._to_sensor = to_sensor
        self._cycle = 0
        self._sample = 0

    def block(self) -> InertialBlock | None:
        """The next samples; None after the last cycle."""
        while True:
            placed = self._cycles.get(self._cycle)
            if placed is None:
                return None
            t_s = (self._sample + np.arange(BLOCK_SAMPLES)) / self._rate_hz
            t_s = t_s[t_s <= placed.start_s + placed.trajectory.t_s[-1]]
            if len(t_s):
                break
            self._cycle += 1
        self._sample += len(t_s)
        local_s = t_s - placed.start_s
        truth = placed.trajectory
        return InertialBlock(
            t_ns=self._start_ns + np.rint(t_s * 1e9).astype(np.int64),
            gyro=_at(local_s, truth.gyro_rad_s) @ self._to_sensor.T,
            accel=_at(local_s, truth.accel_m_s2) @ self._to_sensor.T,
            temperature_c=np.interp(local_s, truth.t_s, truth.temperature_c),
        )


class _Cycles:
    """Trajectories by number, made one ahead in a thread of their own: making one takes longer than a sample."""

    def __init__(self, made: Iterator[Trajectory], count: int | None) -> None:
        self._count = count
        self._made = made
        self._start_s = 0.0
        self._lock = threading.Lock()
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="virtual-motion")
        self._futures: dict[int, Future[PlacedTrajectory]] = {}
        self._submitted = 0

    def get(self, number: int) -> PlacedTrajectory | None:
        """Trajectory `number`, None beyond the last; remembers the last three of an endless run."""
        if self._count is not None and number >= self._count:
            return None
        with self._lock:
            end = number + 2 if self._count is None else min(number + 2, self._count)
            while self._submitted < end:  # in order: each goes on where the last one ended
                self._futures[self._submitted] = self._worker.submit(self._make)
                self._submitted += 1
            if self._count is None:
                self._futures.pop(number - 3, None)
            future = self._futures[number]
        return future.result()

    def __iter__(self) -> Iterator[PlacedTrajectory]:
        number = 0
        while (placed := self.get(number)) is not None:
            yield placed
            number += 1

    def _make(self) -> PlacedTrajectory:
        placed = PlacedTrajectory(next(self._made), self._start_s)
        self._start_s += len(placed.trajectory.t_s) / RATE_HZ
        return placed


def _at(local_s: FloatArray, values: NDArray[np.float64]) -> FloatArray:
    """Rows (n, 3) at fractional positions of the sample grid, straight in between."""
    position = np.clip(local_s * RATE_HZ, 0, len(values) - 1)
    left = np.minimum(position.astype(np.int64), len(values) - 2)
    share = (position - left)[:, None]
    return np.asarray(values[left] + share * (values[left + 1] - values[left]))


def _mounted(rng: np.random.Generator, axes: FloatArray) -> FloatArray:
    """(3, 3), support axes to those of a sensor that sits a little askew."""
    tilt = np.radians(rng.uniform(-MOUNTING_ERROR_DEG, MOUNTING_ERROR_DEG, 3))
    return np.asarray(_small_rotation(tilt) @ axes)


def _small_rotation(angles: FloatArray) -> FloatArray:
    """Rotation matrix of three small angles about x, y, z, in this order."""
    a, b, c = angles
    x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    z = np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
    return np.asarray(z @ y @ x)
