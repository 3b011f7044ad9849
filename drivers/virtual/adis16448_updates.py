"""The virtual ADIS16448's output registers through time: one update per data-ready edge."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass

import numpy as np

from drivers.adis16448.registers import BASE_RATE_HZ
from drivers.virtual.adis16448_signal import CHANNELS, FRAME_BYTES, HISTORY, FilterPath, quantise
from drivers.virtual.inertial_input import Floats, InertialInput, Times
from drivers.virtual.sensor_errors import SensorErrors


@dataclass(slots=True, frozen=True)
class SignalSettings:
    """What the registers say about the way from the sensors to the output."""

    taps_exponent: int
    decimation_exponent: int
    gyro_range_dps: int
    offsets: tuple[float, ...]  # gyro xyz [rad/s], accel xyz [m/s^2]
    has_clock: bool  # False: the clock input is selected, and nothing is connected to it


class Updates:
    """Turns the input into updates of the output registers, a block at a time for speed.

    Updates already computed are computed again when the settings change.
    """

    def __init__(self, inertial_input: InertialInput, errors: SensorErrors | None, settings: SignalSettings) -> None:
        self.frame = bytes(FRAME_BYTES)  # present XGYRO_OUT..TEMP_OUT
        self.checksum = b"\xa4\xe5"  # and their CRC
        self.number = 0  # of the internal sample that completed them
        self.newest_ns = 0  # time of the last update
        self._input = inertial_input
        self._errors = errors
        self._settings = settings
        self._paused_until_ns = 0
        self._ended = False

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
            self._hold(0)

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

    def advance(self, now_ns: int) -> tuple[int, bool]:
        """Bring the registers to `now_ns`; return the number of updates passed and any overrange."""
        passed, overrange = 0, False
        while True:
            cursor = bisect_right(self._times, now_ns, self._cursor)
            if cursor > self._cursor:
                passed += cursor - self._cursor
                overrange |= any(self._overrange[self._cursor : cursor])
                self._cursor = cursor
                self._hold(cursor - 1)
            self.load_until(now_ns)
            if self.next_ns is None or self.next_ns > now_ns:
                return passed, overrange

    def shown_at(self, t_ns: int) -> tuple[bytes, bytes]:
        """Frame and checksum in the registers at `t_ns`, now or within what is loaded."""
        row = bisect_right(self._times, t_ns) - 1
        return self._row(row) if row >= self._cursor else (self.frame, self.checksum)

    def change(self, settings: SignalSettings, now_ns: int, paused_until_ns: int) -> None:
        """Compute what follows `now_ns` with new settings; no updates before `paused_until_ns`."""
        self._settings = settings
        self._paused_until_ns = paused_until_ns
        if len(self._block_t):
            first = int(np.searchsorted(self._block_t, now_ns, side="right"))
            self._path = self._new_path(first)
            self._compute(self._path, first)

    def _new_path(self, first: int) -> FilterPath:
        settings = self._settings
        history = self._samples[first : first + HISTORY]
        return FilterPath(settings.taps_exponent, settings.decimation_exponent, history)

    def _load_block(self) -> None:
        block = self._input.block()
        if block is None:
            self._ended = True
            return
        is_first = not len(self._block_t)
        gyro, accel = block.gyro, block.accel
        if self._errors is not None:
            if is_first:
                span_ns, steps = int(block.t_ns[-1] - block.t_ns[0]), len(block.t_ns) - 1
            else:
                span_ns, steps = int(block.t_ns[-1]) - self._block_end_ns, len(block.t_ns)
            dt_s = span_ns / 1e9 / steps if steps else 1 / BASE_RATE_HZ
            gyro, accel = self._errors.apply(dt_s, gyro, accel, block.temperature_c)
        samples = np.column_stack([gyro, accel, block.temperature_c])
        history = np.repeat(samples[:1], HISTORY, axis=0) if is_first else self._samples[-HISTORY:]
        self._samples = np.concatenate([history, samples])
        self._block_first += len(self._block_t)
        self._block_t = block.t_ns
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
        outputs = quantise(values, settings.gyro_range_dps, settings.decimation_exponent, np.array(settings.offsets))
        self._times = self._block_t[rows].tolist()
        self._numbers = (self._block_first + rows).tolist()
        self._frames, self._checksums = outputs.frames, outputs.checksums
        self._overrange = outputs.overrange
        self._cursor = 0

    def _hold(self, row: int) -> None:
        self.frame, self.checksum = self._row(row)
        self.number = self._numbers[row]
        self.newest_ns = self._times[row]

    def _row(self, row: int) -> tuple[bytes, bytes]:
        start = FRAME_BYTES * row
        return self._frames[start : start + FRAME_BYTES], self._checksums[2 * row : 2 * row + 2]
