"""The virtual ADIS16448's output registers through time: one update per data-ready edge."""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from drivers.adis16448.registers import BASE_RATE_HZ
from drivers.virtual.adis16448_signal import CHANNELS, FRAME_BYTES, HISTORY, FilterPath, quantise
from drivers.virtual.inertial_input import Floats, InertialBlock, InertialInput, Times
from drivers.virtual.sensor_errors import SensorErrors

_REMEMBERED = 16  # past updates: a request may be answered as of a few milliseconds ago
_BEYOND_RANGE = 1e9  # in any unit


@dataclass(slots=True, frozen=True)
class SignalSettings:
    """What the registers say about the way from the sensors to the output."""

    taps_exponent: int
    decimation_exponent: int
    gyro_range_dps: int
    offsets: tuple[float, ...]  # gyro xyz [rad/s], accel xyz [m/s^2]
    has_clock: bool  # False: the clock input is selected, and nothing is connected to it


@dataclass(slots=True, frozen=True)
class Saturation:
    """A time in which one channel (gyro xyz, accel xyz) is beyond its range."""

    start_ns: int
    end_ns: int
    channel: int


@dataclass(slots=True, frozen=True)
class OutputRegisters:
    """What the output registers hold from one update on."""

    t_ns: int
    frame: bytes  # XGYRO_OUT..TEMP_OUT
    checksum: bytes  # their CRC
    number: int  # of the internal sample that completed them


class Updates:
    """Turns the input into updates of the output registers, a block at a time for speed.

    Updates already computed are computed again when the settings change.
    """

    def __init__(
        self,
        inertial_input: InertialInput,
        errors: SensorErrors | None,
        settings: SignalSettings,
        saturations: tuple[Saturation, ...] = (),
    ) -> None:
        self.count = 0  # updates so far
        self.is_frozen = False  # registers keep what they hold, updates are counted all the same
        self._present = OutputRegisters(0, bytes(FRAME_BYTES), b"\xa4\xe5", 0)
        self._past: deque[OutputRegisters] = deque(maxlen=_REMEMBERED)  # the present one included
        self._input = inertial_input
        self._errors = errors
        self._settings = settings
        self._saturations = saturations
        self._paused_until_ns = 0
        self._ended = False

        self._block: InertialBlock | None = None
        self._block_t: Times = np.empty(0, dtype=np.int64)
        self._block_first = 0  # number of its first internal sample
        self._block_end_ns = -(1 << 62)
        self._samples: Floats = np.empty((0, CHANNELS))  # HISTORY rows, then the block
        self._path: FilterPath | None = None

        self._times: list[int] = []
        self._numbers: list[int] = []
        self._frames = b""
        self._checksums = b""
        self._overrange: list[bool] = []
        self._cursor = 0  # the first update to come
        self._load_block()
        if self._times:
            self._present = self._row(0)

    @property
    def exhausted(self) -> bool:
        """Whether the last update is past."""
        return self._ended and self._cursor >= len(self._times)

    @property
    def next_ns(self) -> int | None:
        """Time of the next update, as far as loaded."""
        return self._times[self._cursor] if self._cursor < len(self._times) else None

    def load_until(self, t_ns: int) -> None:
        """Have the next update at hand if there is one by `t_ns`."""
        while self._cursor >= len(self._times) and not self._ended and self._block_end_ns <= t_ns:
            self._load_block()

    def advance(self, now_ns: int) -> tuple[list[int], bool]:
        """Bring the registers to `now_ns`; return the times of the updates passed and any overrange."""
        passed: list[int] = []
        overrange = False
        while True:
            first, end = self._cursor, bisect_right(self._times, now_ns, self._cursor)
            if end > first:
                passed += self._times[first:end]
                overrange |= any(self._overrange[first:end])
                self._cursor = end
                self._pass(max(first, end - _REMEMBERED), end)
            self.load_until(now_ns)
            if self.next_ns is None or self.next_ns > now_ns:
                self.count += len(passed)
                return passed, overrange

    def at(self, t_ns: int) -> OutputRegisters:
        """The registers at `t_ns`: a few updates ago, now, or ahead within what is loaded."""
        if self._past and t_ns < self._past[-1].t_ns:
            return next((past for past in reversed(self._past) if past.t_ns <= t_ns), self._past[0])
        row = bisect_right(self._times, t_ns) - 1
        return self._present if row < self._cursor or self.is_frozen else self._row(row)

    def next_after(self, t_ns: int) -> int | None:
        """Time of the first update after `t_ns`, as far as remembered and loaded."""
        return next((past.t_ns for past in self._past if past.t_ns > t_ns), self.next_ns)

    def change(self, settings: SignalSettings, now_ns: int, paused_until_ns: int) -> None:
        """Compute what follows `now_ns` with new settings; no updates before `paused_until_ns`."""
        self._settings = settings
        self._paused_until_ns = paused_until_ns
        if len(self._block_t):
            first = int(np.searchsorted(self._block_t, now_ns, side="right"))
            self._path = self._new_path(first)
            self._compute(self._path, first)

    def exchange_sensor(self, errors: SensorErrors, now_ns: int) -> None:
        """Let another sensor feel what follows `now_ns`; takes effect with the next `change`."""
        self._errors = errors
        block = self._block
        if block is None:
            return
        first = int(np.searchsorted(block.t_ns, now_ns, side="right"))
        if first < len(block.t_ns):
            rest = InertialBlock(
                block.t_ns[first:], block.gyro[first:], block.accel[first:], block.temperature_c[first:]
            )
            self._samples[HISTORY + first :] = self._sensed(rest, _mean_step_s(block))
            self._samples[: HISTORY + first] = self._samples[HISTORY + first]

    def _sensed(self, block: InertialBlock, step_s: float) -> Floats:
        """What the sensor makes of a block (n, CHANNELS)."""
        gyro, accel = block.gyro, block.accel
        if self._errors is not None:
            gyro, accel = self._errors.apply(step_s, gyro, accel, block.temperature_c)
        return np.column_stack([gyro, accel, block.temperature_c])

    def _new_path(self, first: int) -> FilterPath:
        settings = self._settings
        history = self._samples[first : first + HISTORY]
        return FilterPath(settings.taps_exponent, settings.decimation_exponent, history)

    def _load_block(self) -> None:
        block = self._input.block()
        if block is None:
            self._ended = True
            return
        is_first = self._block is None
        step_s = _mean_step_s(block) if is_first else (int(block.t_ns[-1]) - self._block_end_ns) / 1e9 / len(block.t_ns)
        samples = self._sensed(block, step_s)
        history = np.repeat(samples[:1], HISTORY, axis=0) if is_first else self._samples[-HISTORY:]
        self._samples = np.concatenate([history, samples])
        self._block_first += len(self._block_t)
        self._block, self._block_t = block, block.t_ns
        self._block_end_ns = int(block.t_ns[-1])
        self._path = self._path or self._new_path(0)
        self._compute(self._path, 0)

    def _compute(self, path: FilterPath, first: int) -> None:
        """The updates from row `first` of the block on."""
        settings = self._settings
        rows, values = path.feed(self._samples[HISTORY + first :])
        rows = rows + first
        happens = (self._block_t[rows] >= self._paused_until_ns) & settings.has_clock
        rows, values = rows[happens], values[happens]
        times = self._block_t[rows]
        for saturation in self._saturations:
            within = (times >= saturation.start_ns) & (times < saturation.end_ns)
            values[within, saturation.channel] = _BEYOND_RANGE
        outputs = quantise(values, settings.gyro_range_dps, settings.decimation_exponent, np.array(settings.offsets))
        self._times = times.tolist()
        self._numbers = (self._block_first + rows).tolist()
        self._frames, self._checksums = outputs.frames, outputs.checksums
        self._overrange = outputs.overrange
        self._cursor = 0

    def _pass(self, first: int, end: int) -> None:
        for row in range(first, end):
            self._present = replace(self._present, t_ns=self._times[row]) if self.is_frozen else self._row(row)
            self._past.append(self._present)

    def _row(self, row: int) -> OutputRegisters:
        start = FRAME_BYTES * row
        return OutputRegisters(
            self._times[row],
            self._frames[start : start + FRAME_BYTES],
            self._checksums[2 * row : 2 * row + 2],
            self._numbers[row],
        )


def _mean_step_s(block: InertialBlock) -> float:
    """Mean distance of the samples within a block."""
    steps = len(block.t_ns) - 1
    return int(block.t_ns[-1] - block.t_ns[0]) / 1e9 / steps if steps else 1 / BASE_RATE_HZ
