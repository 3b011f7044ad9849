"""Synthetic records of the virtual support for the estimator's tests, without the register-level twin."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from drivers.adis16448.registers import ACCEL_LSB, GYRO_LSB_DPS
from drivers.virtual.motion import PlannedMove, TrueMove
from drivers.virtual.scenarios import SCENARIOS
from drivers.virtual.support import VirtualSupport
from estimation.pipeline import Pipeline
from estimation.records import Displacement, Estimate, Event, ImuSample, Move, Output, Record, Tier
from estimation.settings import MountSettings, SignedAxis, SupportSettings

Floats = NDArray[np.float64]

# The part's default filter: two averages of four samples in cascade.
FILTER = np.convolve(np.full(4, 0.25), np.full(4, 0.25))
# A short support: the same bursts, less time between them.
SHORT = (PlannedMove(10.0, 0.12, 0.01453), PlannedMove(10.0, 0.0, 0.03519))
SHORT_SUPPORT = SupportSettings(stroke_mm=120)


@dataclass(frozen=True)
class Run:
    """One run of the virtual support as the estimator receives it, and the truth."""

    t_ns: NDArray[np.int64]  # of the inertial samples
    gyro: Floats
    accel: Floats
    readings: tuple[Displacement, ...]
    true_t_s: Floats
    true_m: Floats
    moves: tuple[TrueMove, ...]
    to_sensor: Floats = field(default_factory=lambda: np.eye(3))  # (3, 3), support axes to sensor axes

    @cached_property
    def samples(self) -> tuple[ImuSample, ...]:
        """The inertial samples."""
        return tuple(
            ImuSample(t, (a, b, c), (x, y, z))
            for t, (a, b, c), (x, y, z) in zip(self.t_ns.tolist(), self.gyro.tolist(), self.accel.tolist(), strict=True)
        )

    def records(self, readings: Iterable[Displacement] | None = None) -> list[Record]:
        """Everything in order of time; `readings` replaces what the displacement sensor said."""
        return merged(self.samples, self.readings if readings is None else readings)

    def truth_m(self, t_ns: int | NDArray[np.int64]) -> Floats:
        """True displacement."""
        return np.asarray(np.interp(np.asarray(t_ns) * 1e-9, self.true_t_s, self.true_m))


def merged(*streams: Iterable[Record]) -> list[Record]:
    """Streams of records as one, in order of time."""
    return sorted((record for stream in streams for record in stream), key=lambda record: record.t_ns)


def direction(axis: SignedAxis) -> Floats:
    """Unit vector of a signed axis."""
    return np.array([(1.0 if axis[0] == "+" else -1.0) * (name == axis[1]) for name in "xyz"])


def make_run(
    seed: int,
    scenario: str = "nominal",
    script: tuple[PlannedMove, ...] | None = None,
    cycles: int = 1,
    mount: MountSettings | None = None,
) -> Run:
    """One seed's run; sensor errors, filter and quantisation of the part included."""
    mount = mount or MountSettings()
    push, up = direction(mount.push), direction(mount.up)
    axes = np.column_stack([np.cross(push, up), push, up])
    support = VirtualSupport(seed, SCENARIOS[scenario], cycles=cycles, script=script, sensor_axes=axes)
    blocks = []
    source = support.inertial_input()
    while (block := source.block()) is not None:
        blocks.append(block)
    t_ns = np.concatenate([block.t_ns for block in blocks])
    gyro, accel = support.sensor_errors.apply(
        1.0 / support.sample_rate_hz,
        np.concatenate([block.gyro for block in blocks]),
        np.concatenate([block.accel for block in blocks]),
        np.concatenate([block.temperature_c for block in blocks]),
    )
    truth = support.truth()
    readings = tuple(Displacement(t, value) for t, value in support.observations())
    return Run(
        t_ns=t_ns,
        gyro=_sensed(gyro, np.radians(GYRO_LSB_DPS[1000])),
        accel=_sensed(accel, ACCEL_LSB),
        readings=readings,
        true_t_s=truth.t_s,
        true_m=truth.displacement_m,
        moves=support.true_moves(),
        to_sensor=support.to_sensor,
    )


run_of = cache(make_run)  # for seeds that several tests share


def _sensed(values: Floats, lsb: float) -> Floats:
    padded = np.vstack([np.repeat(values[:1], len(FILTER) - 1, axis=0), values])
    filtered = np.column_stack([np.convolve(column, FILTER, "valid") for column in padded.T])
    return np.asarray(np.rint(filtered / lsb) * lsb)


def rest_samples(seconds: float, seed: int, *, rate_hz: float = 819.2, start_ns: int = 0) -> list[ImuSample]:
    """A level sensor at rest: white noise of the data sheet's size."""
    rng = np.random.default_rng(seed)
    n = int(seconds * rate_hz)
    accel = rng.normal((0.0, 0.0, 9.80665), 0.0456, (n, 3))
    gyro = rng.normal(0.0, np.radians(0.0135) * np.sqrt(rate_hz / 2), (n, 3))
    return [
        ImuSample(start_ns + round(i / rate_hz * 1e9), (a, b, c), (x, y, z))
        for i, ((a, b, c), (x, y, z)) in enumerate(zip(gyro.tolist(), accel.tolist(), strict=True))
    ]


@dataclass(frozen=True)
class Told:
    """What a pipeline said."""

    outputs: tuple[Output, ...]

    @property
    def provisional(self) -> list[Estimate]:
        return [o for o in self.outputs if isinstance(o, Estimate) and o.tier is Tier.PROVISIONAL]

    @property
    def settled(self) -> list[Estimate]:
        return [o for o in self.outputs if isinstance(o, Estimate) and o.tier is Tier.SETTLED]

    @property
    def moves(self) -> list[Move]:
        """The last word on each move."""
        return list({o.number: o for o in self.outputs if isinstance(o, Move)}.values())

    @property
    def events(self) -> list[Event]:
        return [o for o in self.outputs if isinstance(o, Event)]

    def words(self) -> str:
        """All events as one text."""
        return "\n".join(event.what for event in self.events)


def ramp_response(frequency_hz: float, damping: float, ramp_s: float, t_s: Floats) -> Floats:
    """Second-order response to a unit ramp that begins at time zero, integrated numerically; times evenly spaced."""
    w = 2 * np.pi * frequency_hz
    command = np.clip(t_s / ramp_s, 0.0, 1.0)
    _, response, _ = signal.lsim(([w * w], [1.0, 2 * damping * w, w * w]), command, t_s - t_s[0])
    return np.asarray(response, dtype=np.float64)


def told(pipeline: Pipeline, records: Sequence[Record]) -> Told:
    """Feed everything and finish."""
    outputs: list[Output] = []
    for record in records:
        outputs += pipeline.feed(record)
    return Told((*outputs, *pipeline.finish()))
