"""The electro-hydraulic controller's twin: a crude stroke sensor and the frames that report it."""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.can import cia406
from drivers.can.dbc import DisplacementSignal, find_signal
from drivers.can.frame import Frame
from drivers.can.settings import DisplacementSettings

FloatArray = NDArray[np.float64]
Observation = tuple[int, float]  # time the frame is sent [ns], value [m]; NaN = the sensor knows it is ill

LABORATORY_SENSOR = DisplacementSettings(
    preset="support_controller", message="LaboratorySensor", signal="reference_stroke"
)

_LARGEST_CLASSIC_FRAME = 8  # bytes; more make it CAN FD
_LEVER_M = 0.9  # distance of the sensor's anchor from the retracted piston, along the push
_FULL_STROKE_M = 0.5
_NO_MAGNET = (0x5000, 0x01)  # CiA 301: device hardware, generic error
_NO_EMERGENCY = (0x0000, 0x00)


@dataclass(slots=True, frozen=True)
class SensorSpread:
    """Distributions from which a controller's displacement sensor is drawn; by default such as supports have."""

    rate_hz: tuple[float, float] = (10.0, 20.0)
    sigma_m: tuple[float, float] = (0.002, 0.005)
    offset_sigma_m: float = 0.0015
    short_m: tuple[float, float] = (0.005, 0.01475)
    latency_s: tuple[float, float] = (0.005, 0.030)
    dropouts_per_s: float = 0.02


@dataclass(slots=True, frozen=True)
class SensorParameters:
    """How one controller's displacement differs from the truth; by default only by its whole millimetres."""

    rate_hz: float = 15.0
    resolution_m: float = 0.001
    sigma_m: float = 0.0  # white noise of each reading
    offset_m: float = 0.0
    short_at_full_stroke_m: float = 0.0  # how much too little the oblique sensor shows at 500 mm
    latency_s: float = 0.0  # from measuring to sending
    dropouts_per_s: float = 0.0
    dropout_s: tuple[float, float] = (0.2, 1.0)

    @classmethod
    def draw(cls, rng: np.random.Generator, spread: SensorSpread | None = None) -> SensorParameters:
        """A sensor such as supports have: noisy, late, oblique by up to 14.75 mm, now and then silent."""
        spread = spread or SensorSpread()
        return cls(
            rate_hz=rng.uniform(*spread.rate_hz),
            sigma_m=rng.uniform(*spread.sigma_m),
            offset_m=rng.normal(0.0, spread.offset_sigma_m),
            short_at_full_stroke_m=rng.uniform(*spread.short_m),
            latency_s=rng.uniform(*spread.latency_s),
            dropouts_per_s=spread.dropouts_per_s,
        )


class ObservedDisplacement:
    """Readings of an oblique displacement sensor.

    y = √((p+B)² + h²) − √(B² + h²) + offset + noise, quantised; B = 900 mm.

    Args:
        parameters: of this sensor.
        rng: source of phase, noise and drop-outs.
    """

    def __init__(self, parameters: SensorParameters, rng: np.random.Generator) -> None:
        self.parameters = parameters
        self._rng = rng
        self._phase_s = rng.uniform(0.0, 1.0 / parameters.rate_hz)
        self._origin_s: float | None = None
        self._taken = 0  # readings since the origin, drop-outs included
        self._silent_until_s = -math.inf

    def shown(self, displacement_m: FloatArray) -> FloatArray:
        """What a noiseless sensor of this geometry shows at the true `displacement_m`, any shape."""
        distance = _oblique_distance(self.parameters.short_at_full_stroke_m)
        shown: FloatArray = (
            np.hypot(displacement_m + _LEVER_M, distance) - math.hypot(_LEVER_M, distance) + self.parameters.offset_m
        )
        return shown

    def observations(self, t_s: FloatArray, displacement_m: FloatArray) -> list[Observation]:
        """Readings taken within the true motion, in order.

        Args:
            t_s: times of the truth [s], increasing, shape (n,); a further call goes on where the last ended.
            displacement_m: true displacement at these times, shape (n,).
        """
        taken_s = self._reading_times(t_s)
        value_m = self.shown(np.interp(taken_s, t_s, displacement_m))
        value_m += self._rng.normal(0.0, self.parameters.sigma_m, taken_s.size)
        value_m = np.round(value_m / self.parameters.resolution_m) * self.parameters.resolution_m
        alive = ~self._silent(taken_s, float(t_s[0]), float(t_s[-1]))
        sent_ns = np.round((taken_s[alive] + self.parameters.latency_s) * 1e9).astype(np.int64)
        return list(zip(sent_ns.tolist(), value_m[alive].tolist(), strict=True))

    def _reading_times(self, t_s: FloatArray) -> FloatArray:
        if self._origin_s is None:
            self._origin_s = float(t_s[0]) + self._phase_s
        due = math.floor((float(t_s[-1]) - self._origin_s) * self.parameters.rate_hz) + 1
        indices = np.arange(self._taken, max(self._taken, due))
        self._taken += indices.size
        times: FloatArray = self._origin_s + indices / self.parameters.rate_hz
        return times

    def _silent(self, taken_s: FloatArray, start_s: float, end_s: float) -> NDArray[np.bool_]:
        """Which readings fall into a drop-out."""
        count = self._rng.poisson(self.parameters.dropouts_per_s * (end_s - start_s))
        starts = self._rng.uniform(start_s, end_s, count)
        ends = starts + self._rng.uniform(*self.parameters.dropout_s, count)
        silent = taken_s < self._silent_until_s
        for start, end in zip(starts, ends, strict=True):
            silent |= (taken_s >= start) & (taken_s < end)
        self._silent_until_s = max([self._silent_until_s, *ends.tolist()])
        return silent


def exact_observations(t_s: FloatArray, displacement_m: FloatArray, rate_hz: float = 50.0) -> list[Observation]:
    """Readings of a laboratory sensor: exact to 0.01 mm, without delay, from the first time on.

    Args:
        t_s: times of the truth [s], increasing, shape (n,).
        displacement_m: true displacement at these times, shape (n,).
        rate_hz: readings per second.
    """
    taken_s = np.arange(t_s[0], t_s[-1], 1.0 / rate_hz)
    value_m = np.round(np.interp(taken_s, t_s, displacement_m), 5)
    return list(zip(np.round(taken_s * 1e9).astype(np.int64).tolist(), value_m.tolist(), strict=True))


class VirtualController:
    """Sends observations as frames of a preset or an own DBC file (integer signals, not multiplexed).

    A NaN observation goes out as the source would say it: validity signal off, on CANopen an emergency with
    the last position repeated, else a value far out of range.

    Args:
        observations: the displacement readings, in order of time; may be endless.
        settings: the frame they go into.
        reference: readings of the laboratory sensor, in order of time.
        reference_settings: the frame those go into.

    Raises:
        CanConfigError: the settings do not fit the DBC file.
    """

    def __init__(
        self,
        observations: Iterable[Observation],
        settings: DisplacementSettings | None = None,
        reference: Iterable[Observation] = (),
        reference_settings: DisplacementSettings = LABORATORY_SENSOR,
    ) -> None:
        observed = _FrameWriter(find_signal(settings or DisplacementSettings()))
        laboratory = _FrameWriter(find_signal(reference_settings))
        self._frames = heapq.merge(
            observed.frames(observations), laboratory.frames(reference), key=lambda frame: frame.t_ns
        )
        self._next = next(self._frames, None)

    @property
    def next_t_ns(self) -> int | None:
        """When the next frame is due, None after the last."""
        return None if self._next is None else self._next.t_ns

    def due(self, t_ns: int) -> list[Frame]:
        """The frames sent up to and including `t_ns` that were not returned before, in order of time."""
        frames = []
        while self._next is not None and self._next.t_ns <= t_ns:
            frames.append(self._next)
            self._next = next(self._frames, None)
        return frames


class _FrameWriter:
    """Encodes readings into the frames that carry one displacement signal."""

    def __init__(self, source: DisplacementSignal) -> None:
        self._source = source
        self._raw = 0
        self._sent = 0
        self._is_ill = False
        signal = source.signal
        self._lowest = -(1 << signal.length - 1) if signal.is_signed else 0
        self._highest = self._lowest + (1 << signal.length) - 1
        if source.lowest_code is not None:
            self._highest = source.lowest_code - 1

    def frames(self, observations: Iterable[Observation]) -> Iterator[Frame]:
        """The frames of each observation, an emergency first where the sensor falls ill or recovers."""
        for t_ns, value_m in observations:
            is_ill = math.isnan(value_m)
            if self._source.node_id is not None and is_ill != self._is_ill:
                yield self._emergency(t_ns, *(_NO_MAGNET if is_ill else _NO_EMERGENCY))
            self._is_ill = is_ill
            yield self._reading(t_ns, value_m)

    def _reading(self, t_ns: int, value_m: float) -> Frame:
        source = self._source
        is_ill = math.isnan(value_m)
        if not is_ill:
            physical = value_m * source.units_per_metre
            raw = round((physical - source.signal.offset) / source.signal.scale)
            self._raw = max(self._lowest, min(self._highest, raw))
        elif source.valid_signal is None and source.node_id is None:
            self._raw = self._highest
        values = {signal.name: 0 for signal in source.message.signals}
        values[source.signal.name] = self._raw
        if source.valid_signal is not None:
            values[source.valid_signal.name] = source.valid_value ^ int(is_ill)
        if source.counter is not None:
            values[source.counter.name] = source.counter.lowest + self._sent % source.counter.numbers
        self._sent += 1
        data = bytearray(source.message.encode(values, scaling=False, strict=False))
        if source.checksum is not None:
            data[source.checksum.place] = source.checksum.of(bytes(data))
        is_fd = len(data) > _LARGEST_CLASSIC_FRAME
        if is_fd:
            data.extend(bytes(source.padded_length - len(data)))
        frame_id = source.frame_id
        return Frame(t_ns, frame_id.arbitration_id, bytes(data), is_extended=frame_id.is_extended, is_fd=is_fd)

    def _emergency(self, t_ns: int, code: int, register: int) -> Frame:
        assert self._source.node_id is not None
        data = code.to_bytes(2, "little") + bytes([register]) + bytes(5)
        return Frame(t_ns, cia406.emergency_id(self._source.node_id).arbitration_id, data)


def _oblique_distance(short_m: float) -> float:
    """Distance h of the sensor's anchor beside the push line that makes it `short_m` short at full stroke.

    From √((L+B)² + h²) − √(B² + h²) = L − short, solved for h.
    """
    shown = _FULL_STROKE_M - short_m
    far_squared = (_FULL_STROKE_M + _LEVER_M) ** 2
    anchor = (far_squared - _LEVER_M**2 - shown**2) / (2 * shown)  # √(B² + h²)
    return math.sqrt(max(0.0, anchor**2 - _LEVER_M**2))
