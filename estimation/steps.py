"""Velocity steps seen by the bank of matched kernels, at every block of the stream."""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from dataclasses import dataclass, field
from math import sqrt
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import PlainSerializer, PlainValidator

from estimation.kernels import (
    ACCEL_NOISE,
    PRE_LONG_S,
    PRE_SHORT_S,
    SPECS,
    VIBRATION_LEVELS_M_S2,
    KernelBank,
    kernel_bank,
)

# Lists in a snapshot, arrays in the program.
Array = Annotated[
    NDArray[np.float64],
    PlainValidator(lambda values: np.array(values, dtype=np.float64)),
    PlainSerializer(lambda a: a.tolist(), return_type=list),
]

HISTORY_S = 3.6  # how far back a decision may look
OWN_RMS_TIME_S = 8.0
OWN_RMS_DELAY_S = 2.2  # a burst must have been recognised before its own steps count as rest
VIBRATION_TIME_S = 0.5
BRIDGE_FROM_S = 0.5
VIBRATION_FAST_TIME_S = 0.25
# Mean square of the second difference per mean square of band noise (5-60 Hz, 102.4 Hz blocks), and of white noise.
SECOND_DIFFERENCE_GAIN = 3.8
SECOND_DIFFERENCE_WHITE = 6.0


_KERNELS = list(range(len(SPECS)))


@dataclass(frozen=True)
class Steps:
    """Statistics of one moment: `x` [m/s] and `sigma` [m/s] per kernel of `kernels.SPECS`."""

    x: tuple[float, ...]
    sigma: tuple[float, ...]


@dataclass(frozen=True)
class Block:
    """Block mean in support axes: acceleration along the push, rate about the x axis, size of gravity."""

    t_ns: int
    push_m_s2: float
    tilt_rate_rad_s: float
    gravity_m_s2: float


@dataclass(slots=True)
class StepBank:
    """Feeds blocks to the kernels and keeps what they said; `dt_s` is the block period it was built for."""

    dt_s: float
    push_m_s2: Array = field(default_factory=lambda: np.zeros(0))  # along the push, newest last
    tilt_rate_rad_s: Array = field(default_factory=lambda: np.zeros(0))  # about x: what turns gravity into push
    levelled_m_s2: Array = field(default_factory=lambda: np.zeros(0))  # gravity taken out, relative to now
    blocks: int = 0
    clock_ns: int = 0  # where the last block lies on a time that no loss shortens
    x: Array = field(default_factory=lambda: np.zeros((0, len(SPECS))))  # newest last
    sigma: Array = field(default_factory=lambda: np.zeros((0, len(SPECS))))
    times_ns: deque[int] = field(default_factory=deque)
    vibration: deque[float] = field(default_factory=deque)
    vibration_slow: float = 0.0
    vibration_fast: float = 0.0
    own_square: Array = field(default_factory=lambda: np.zeros(len(SPECS)))
    rest_s: float = 0.0

    def __post_init__(self) -> None:
        depth = self.depth
        if not len(self.push_m_s2):
            self.push_m_s2, self.tilt_rate_rad_s, self.levelled_m_s2 = np.zeros((3, self._long.window))
            self.x = np.zeros((depth, len(SPECS)))
            self.sigma = np.ones((depth, len(SPECS)))
        windows, histories = (self._long.window,), (depth, len(SPECS))
        shapes = {self.push_m_s2.shape, self.tilt_rate_rad_s.shape, self.levelled_m_s2.shape}
        if shapes != {windows} or {self.x.shape, self.sigma.shape} != {histories}:
            raise ValueError("windows and histories do not fit the block period")
        self.times_ns = deque(self.times_ns, maxlen=depth)
        self.vibration = deque(self.vibration, maxlen=depth)

    @property
    def vibration_m_s2(self) -> float:
        """Present vibration level, rms."""
        return self.vibration[-1] if self.vibration else 0.0

    @property
    def depth(self) -> int:
        """Blocks of history."""
        return round(HISTORY_S / self.dt_s)

    def prepare(self) -> None:
        """Compute the kernels now rather than at the first block: that takes a good part of a second."""
        _ = self._long, self._short

    @property
    def _long(self) -> KernelBank:
        return kernel_bank(self.dt_s, PRE_LONG_S)

    @property
    def _short(self) -> KernelBank:
        return kernel_bank(self.dt_s, PRE_SHORT_S)

    @property
    def post_steps(self) -> tuple[int, ...]:
        """Blocks between a step and the moment each kernel sees it whole."""
        return self._long.post_steps

    def add(self, block: Block, gyro_bias_rad_s: float, *, recent_event: bool, resting: bool) -> Steps:
        """Take one block mean; `recent_event` asks for the kernels that look back less far."""
        for window, value in (
            (self.push_m_s2, block.push_m_s2),
            (self.tilt_rate_rad_s, block.tilt_rate_rad_s),
        ):
            window[:-1] = window[1:]
            window[-1] = value
            if self.blocks == 0:
                window[:] = value
        self.blocks += 1
        # The level cancels in the kernels; taking it out first keeps rounding out too.
        tilt = np.cumsum((self.tilt_rate_rad_s - gyro_bias_rad_s) * self.dt_s)
        self.levelled_m_s2 = self.push_m_s2 - block.gravity_m_s2 * tilt
        self.levelled_m_s2 -= self.levelled_m_s2[-1]
        self._follow_vibration()
        self.times_ns.append(block.t_ns)

        short = recent_event or self.blocks < self._long.window
        bank = self._short if short else self._long
        x = np.zeros(len(SPECS))
        sigma = np.ones(len(SPECS))
        if self.blocks >= self._short.window:
            levels = [self._level(post) for post in bank.post_steps]
            x = bank.weights[levels, _KERNELS] @ self.levelled_m_s2[-bank.window :]
            sigma = bank.sigma[levels, _KERNELS]
            self._follow_own_rms(resting)
            if self.rest_s > 2.0:
                np.maximum(sigma, np.sqrt(self.own_square), out=sigma)
        self.x[:-1] = self.x[1:]
        self.x[-1] = x
        self.sigma[:-1] = self.sigma[1:]
        self.sigma[-1] = sigma
        return Steps(tuple(x.tolist()), tuple(sigma.tolist()))

    def keep_pace(self, t_ns: int, period_s: float) -> None:
        """Before a block that ends at `t_ns`: put fillers where samples were lost, so that the kernels' time is true.

        `period_s`: how far apart this source's blocks are when nothing is lost.
        """
        if not self.blocks:
            self.clock_ns = t_ns
            return
        period_ns = period_s * 1e9
        missing = min(round((t_ns - self.clock_ns) / period_ns) - 1, self.depth)
        if missing > 0:
            self._bridge(missing, t_ns)
        # Half a block ahead or behind is kept, so that small losses add up to a filler and no more.
        ahead_ns = t_ns + round(0.5 * period_ns)
        self.clock_ns = min(self.clock_ns + round((max(missing, 0) + 1) * period_ns), ahead_ns)

    def _bridge(self, blocks: int, until_ns: int) -> None:
        """Fill with the recent middle: a single block, repeated, would add up to a step."""
        recent = max(round(BRIDGE_FROM_S / self.dt_s), 1)
        push, tilt_rate = (np.median(w[-recent:]) for w in (self.push_m_s2, self.tilt_rate_rad_s))
        last_ns = self.times_ns[-1]
        for i in range(1, blocks + 1):
            for window in (self.push_m_s2, self.tilt_rate_rad_s, self.x, self.sigma):
                window[:-1] = window[1:]
            self.push_m_s2[-1], self.tilt_rate_rad_s[-1] = push, tilt_rate
            self.times_ns.append(last_ns + i * (until_ns - last_ns) // (blocks + 1))
            self.vibration.append(self.vibration_m_s2)

    def event_time_ns(self, kernel: int, ago: int = 0) -> int:
        """Time of the step that kernel `kernel` judged `ago` blocks before now."""
        back = self.post_steps[kernel] + ago
        return self.times_ns[-1 - back] if back < len(self.times_ns) else self.times_ns[0]

    def _follow_vibration(self) -> None:
        w = self.push_m_s2
        second = float(w[-1] - 2 * w[-2] + w[-3])
        white = SECOND_DIFFERENCE_WHITE * ACCEL_NOISE**2 / self.dt_s
        square = second * second - white
        self.vibration_slow += min(self.dt_s / VIBRATION_TIME_S, 1.0) * (square - self.vibration_slow)
        self.vibration_fast += min(self.dt_s / VIBRATION_FAST_TIME_S, 1.0) * (square - self.vibration_fast)
        self.vibration.append((max(self.vibration_slow, 0.0) / SECOND_DIFFERENCE_GAIN) ** 0.5)

    def _level(self, post: int) -> int:
        """Vibration level for a kernel: from before the step, raised if it has grown since, within reason."""
        before = self.vibration[max(len(self.vibration) - 1 - post, 0)]
        now = sqrt(max(self.vibration_fast, 0.0) / SECOND_DIFFERENCE_GAIN)
        level = max(before, min(now, 4 * before + 0.06))
        return min(bisect_left(VIBRATION_LEVELS_M_S2, 0.8 * level), len(VIBRATION_LEVELS_M_S2) - 1)

    def _follow_own_rms(self, resting: bool) -> None:
        delay = round(OWN_RMS_DELAY_S / self.dt_s)
        if not resting:
            self.rest_s = -OWN_RMS_DELAY_S
            return
        # The first seconds after a move count for nothing, by the delay alone.
        self.rest_s = min(self.rest_s + self.dt_s, OWN_RMS_TIME_S)
        if self.rest_s > 0:
            gain = self.dt_s / self.rest_s
            self.own_square += gain * (self.x[-delay] ** 2 - self.own_square)
