"""Velocity steps seen by the bank of matched kernels, at every block of the stream."""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from dataclasses import dataclass, field
from functools import lru_cache
from math import sqrt
from typing import Annotated

import numpy as np
from pydantic import PlainSerializer, PlainValidator

from estimation.arrays import FloatArray, Rolling, RollingWindow
from estimation.noise import ACCEL_NOISE
from estimation.recognition.burst import BurstView
from estimation.recognition.kernels import (
    PRE_LONG_S,
    PRE_SHORT_S,
    SPECS,
    VIBRATION_LEVELS_M_S2,
    KernelBank,
    longest_window,
    post_steps,
)
from estimation.recognition.spectrum import WHITE_SECOND_DIFFERENCE, WINDOW, VibrationSpectrum

HISTORY_S = 3.6  # how far back a decision may look
OWN_RMS_TIME_S = 30.0
OWN_RMS_DELAY_S = 2.6  # a burst must have been recognised before its own steps count as rest
VIBRATION_TIME_S = 0.5
LEVEL_TIME_S = 3.0
VIBRATION_FAST_TIME_S = 0.25
BRIDGE_FROM_S = 0.5
UNDISTURBED_S = 1.5  # after an event: before, its own ringing would count as vibration

LOOK_AFTER = 8.0  # windows
OTHER_VIBRATION = 0.025  # share of the power in another band that asks for other kernels: little of it hides a step

_KERNELS = np.arange(len(SPECS))


@dataclass(frozen=True)
class Steps:
    """Statistics of one moment: `x` [m/s] and `sigma` [m/s] per kernel."""

    x: tuple[float, ...]
    sigma: tuple[float, ...]


@dataclass(frozen=True)
class Block:
    """Block mean in support axes: acceleration along the push, rate about the x axis, size of gravity."""

    t_ns: int
    push_m_s2: float
    tilt_rate_rad_s: float
    gravity_m_s2: float


@dataclass
class _Banks:
    """Kernels with a long and a short look back, in vibration of one autocovariance."""

    long: KernelBank
    short: KernelBank

    @classmethod
    def of(cls, dt_s: float, lags: FloatArray) -> _Banks:
        return cls(KernelBank(dt_s, PRE_LONG_S, lags), KernelBank(dt_s, PRE_SHORT_S, lags))


# Follow from the rest of the state: never in a snapshot, made when first wanted.
_Derived = Annotated[_Banks | None, PlainValidator(lambda _: None), PlainSerializer(lambda _: None)]


@dataclass(slots=True)
class VibrationNoise:
    """Vibration of one kind of time, rest or motion, and the kernels for it."""

    spectrum: VibrationSpectrum
    lags: list[float] = field(default_factory=list)  # autocovariance in use; empty = as designed
    band_shares: list[float] = field(default_factory=list)  # of the spectrum they come from
    gain: float = 0.0  # of the second difference, for those lags
    look_at: float = 1.0  # windows, when to look whether they still hold
    undisturbed: int = 0  # blocks since the last window was learned, or since a disturbance
    banks: _Derived = None

    def follow(self, window: FloatArray) -> None:
        """One more undisturbed block, the last of `window` (256,)."""
        self.undisturbed += 1
        if self.undisturbed < WINDOW or len(window) < WINDOW:
            return  # a slow source shows too little of a vibration to learn from
        self.undisturbed = WINDOW // 2  # windows overlap by half
        self.spectrum.learn(window)
        if self.spectrum.windows < self.look_at:
            return
        self.look_at = min(2.0 * self.spectrum.windows, self.spectrum.windows + LOOK_AFTER)
        dt_s = self.spectrum.dt_s
        n = longest_window(dt_s)
        now = self.spectrum.band_shares()
        in_use = self.band_shares or VibrationSpectrum(dt_s).band_shares()
        if max(abs(a - b) for a, b in zip(now, in_use, strict=True)) > OTHER_VIBRATION:
            self.band_shares, self.lags = now, self.spectrum.lags(n).tolist()
            self.gain, self.banks = self.spectrum.second_difference_gain(), None

    @property
    def measured(self) -> bool:
        """Whether it is anything else than assumed."""
        return bool(self.lags)

    def kernels(self) -> _Banks:
        """The kernels for it."""
        if self.banks is None:
            dt_s = self.spectrum.dt_s
            self.banks = _Banks.of(dt_s, np.array(self.lags)) if self.lags else _designed(dt_s)
        return self.banks

    def second_difference_gain(self) -> float:
        """Mean square of the second difference, per mean square."""
        return self.gain if self.lags else _designed_gain(self.spectrum.dt_s)


@lru_cache(maxsize=4)
def _designed(dt_s: float) -> _Banks:
    return _Banks.of(dt_s, VibrationSpectrum(dt_s).lags(longest_window(dt_s)))


@lru_cache(maxsize=4)
def _designed_gain(dt_s: float) -> float:
    return VibrationSpectrum(dt_s).second_difference_gain()


@dataclass(slots=True)
class StepBank:
    """Feeds blocks to the kernels and keeps what they said; `dt_s` is the block period it was built for."""

    dt_s: float
    push_m_s2: Rolling = field(default_factory=lambda: RollingWindow(np.zeros(0)))  # along the push
    tilt_rad: Rolling = field(default_factory=lambda: RollingWindow(np.zeros(0)))  # about x, as the gyro says
    blocks: int = 0
    clock_ns: int = 0  # where the last block lies on a time that no loss shortens
    x: Rolling = field(default_factory=lambda: RollingWindow(np.zeros((0, len(SPECS)))))
    sigma: Rolling = field(default_factory=lambda: RollingWindow(np.zeros((0, len(SPECS)))))
    times_ns: deque[int] = field(default_factory=deque)
    vibration: deque[float] = field(default_factory=deque)
    vibration_slow: float = 0.0
    vibration_fast: float = 0.0
    own_square: list[float] = field(default_factory=lambda: [0.0] * len(SPECS))
    rest_s: float = 0.0
    level_at_rest_m_s2: float = 0.0  # vibration of the last rest
    rest_noise: VibrationNoise | None = None
    move_noise: VibrationNoise | None = None
    # Of the last block: what turns the tilt into acceleration.
    gravity_m_s2: float = 9.8
    gyro_bias_rad_s: float = 0.0

    def __post_init__(self) -> None:
        window, depth = longest_window(self.dt_s), self.depth
        if not len(self.push_m_s2.values):
            self.push_m_s2, self.tilt_rad = RollingWindow(np.zeros(window)), RollingWindow(np.zeros(window))
            self.x = RollingWindow(np.zeros((depth, len(SPECS))))
            self.sigma = RollingWindow(np.ones((depth, len(SPECS))))
        if self.rest_noise is None or self.move_noise is None:
            self.rest_noise = VibrationNoise(VibrationSpectrum(self.dt_s))
            self.move_noise = VibrationNoise(VibrationSpectrum(self.dt_s))
        shapes = {self.push_m_s2.values.shape, self.tilt_rad.values.shape}
        if shapes != {(window,)} or {self.x.values.shape, self.sigma.values.shape} != {(depth, len(SPECS))}:
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
        banks = _designed(self.dt_s)
        for level in range(len(VIBRATION_LEVELS_M_S2)):
            banks.long.prepare(level)
            banks.short.prepare(level)

    @property
    def post_steps(self) -> tuple[int, ...]:
        """Blocks between a step and the moment each kernel sees it whole."""
        return post_steps(self.dt_s)

    @property
    def levelled_m_s2(self) -> FloatArray:
        """The window (n,) of acceleration along the push, gravity taken out relative to now, newest last."""
        push, tilt = self.push_m_s2.values, self.tilt_rad.values
        drift = self.gyro_bias_rad_s * self.dt_s
        since = np.arange(1 - len(push), 1)
        levelled = push - self.gravity_m_s2 * (tilt - tilt[-1] - drift * since)
        return np.asarray(levelled - levelled[-1])

    def least_vibration_m_s2(self, window_s: float) -> float:
        """The lowest level within that time."""
        return min(list(self.vibration)[-max(round(window_s / self.dt_s), 1) :], default=0.0)

    def vibration_lately_m_s2(self, window_s: float) -> float:
        """Its rms within just that time: the running mean without what it still remembers of before."""
        blocks = min(max(round(window_s / self.dt_s), 1), len(self.vibration) - 1)
        if blocks < 1:
            return self.vibration_m_s2
        left = (1.0 - min(self.dt_s / VIBRATION_TIME_S, 1.0)) ** blocks
        square = (self.vibration[-1] ** 2 - left * self.vibration[-1 - blocks] ** 2) / (1.0 - left)
        return sqrt(max(square, 0.0))

    def add(self, block: Block, gyro_bias_rad_s: float, *, since_event_s: float, resting: bool) -> Steps:
        """Take one block mean.

        `since_event_s`: since the last onset or stop: kernels look back less far soon after one.
        """
        if self.blocks == 0:
            self.push_m_s2.fill(block.push_m_s2)
            self.tilt_rad.fill(0.0)
        self.gravity_m_s2, self.gyro_bias_rad_s = block.gravity_m_s2, gyro_bias_rad_s
        self.push_m_s2.add(block.push_m_s2)
        self.tilt_rad.add(float(self.tilt_rad.values[-1]) + block.tilt_rate_rad_s * self.dt_s)
        self.blocks += 1
        levelled = self.levelled_m_s2
        noise = self._noise(resting)
        self._follow_vibration(noise)
        self.times_ns.append(block.t_ns)
        at_rest, in_motion = self._noises()
        if since_event_s > UNDISTURBED_S and self.blocks > 1:
            (at_rest if resting else in_motion).follow(levelled[-WINDOW:])
        else:
            at_rest.undisturbed = in_motion.undisturbed = 0

        banks = noise.kernels()
        bank = banks.short if since_event_s < RECENT_S or self.blocks < len(levelled) else banks.long
        x, sigma = np.zeros(len(SPECS)), np.ones(len(SPECS))
        if self.blocks >= banks.short.window:
            levels = self._levels(bank.post_steps)
            for level in set(levels):
                bank.prepare(level)
            x = bank.weights[levels, _KERNELS] @ levelled[-bank.window :]
            sigma = bank.sigma[levels, _KERNELS]
            self._follow_own_rms(resting)
            if self.rest_s > 2.0:
                sigma = np.maximum(sigma, np.sqrt(self.own_square))
        self.x.add(x)
        self.sigma.add(sigma)
        return Steps(tuple(x.tolist()), tuple(sigma.tolist()))

    def view(self, resting: bool, delay_s: float) -> BurstView:
        """What a fit of the last few seconds needs."""
        noise = self._noise(resting)
        w = self.push_m_s2.values
        second = np.concatenate([[0.0], w[2:] - 2 * w[1:-1] + w[:-2], [0.0]])
        white = WHITE_SECOND_DIFFERENCE * ACCEL_NOISE**2 / self.dt_s
        squares = (second**2 - white) / noise.second_difference_gain()
        return BurstView(
            self.dt_s,
            np.fromiter(self.times_ns, dtype=np.int64),
            self.levelled_m_s2,
            squares,
            noise.kernels().long.lags,
            delay_s=delay_s,
        )

    def _noise(self, resting: bool) -> VibrationNoise:
        at_rest, in_motion = self._noises()
        return in_motion if not resting and in_motion.measured else at_rest

    def _noises(self) -> tuple[VibrationNoise, VibrationNoise]:
        assert self.rest_noise is not None  # since __post_init__
        assert self.move_noise is not None
        return self.rest_noise, self.move_noise

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
        push = float(np.median(self.push_m_s2.values[-recent:]))
        turn = float(np.median(np.diff(self.tilt_rad.values[-recent - 1 :])))
        last_ns = self.times_ns[-1]
        x, sigma = self.x.values[-1].copy(), self.sigma.values[-1].copy()
        for i in range(1, blocks + 1):
            self.push_m_s2.add(push)
            self.tilt_rad.add(float(self.tilt_rad.values[-1]) + turn)
            self.x.add(x)
            self.sigma.add(sigma)
            self.times_ns.append(last_ns + i * (until_ns - last_ns) // (blocks + 1))
            self.vibration.append(self.vibration_m_s2)

    def event_time_ns(self, kernel: int, ago: int = 0) -> int:
        """Time of the step that kernel `kernel` judged `ago` blocks before now."""
        back = self.post_steps[kernel] + ago
        return self.times_ns[-1 - back] if back < len(self.times_ns) else self.times_ns[0]

    def _follow_vibration(self, noise: VibrationNoise) -> None:
        w = self.push_m_s2.values
        second = float(w[-1] - 2 * w[-2] + w[-3])
        white = WHITE_SECOND_DIFFERENCE * ACCEL_NOISE**2 / self.dt_s
        square = (second * second - white) / noise.second_difference_gain()
        self.vibration_slow += min(self.dt_s / VIBRATION_TIME_S, 1.0) * (square - self.vibration_slow)
        self.vibration_fast += min(self.dt_s / VIBRATION_FAST_TIME_S, 1.0) * (square - self.vibration_fast)
        self.vibration.append(max(self.vibration_slow, 0.0) ** 0.5)

    def _levels(self, posts: tuple[int, ...]) -> list[int]:
        """Vibration level per kernel: from before the step, raised if it has grown since, within reason."""
        now, last = sqrt(max(self.vibration_fast, 0.0)), len(self.vibration) - 1
        found: dict[int, int] = {}
        for post in posts:
            if post not in found:
                before = self.vibration[max(last - post, 0)]
                level = max(before, min(now, 4 * before + 0.06))
                found[post] = min(bisect_left(VIBRATION_LEVELS_M_S2, 0.8 * level), len(VIBRATION_LEVELS_M_S2) - 1)
        return [found[post] for post in posts]

    def _follow_own_rms(self, resting: bool) -> None:
        delay = min(round(OWN_RMS_DELAY_S / self.dt_s), self.depth)
        if not resting:
            self.rest_s = -OWN_RMS_DELAY_S
            return
        # The first seconds after a move count for nothing, by the delay alone.
        if self.rest_s > 0:
            before = self.vibration[max(len(self.vibration) - 1 - delay, 0)]
            self.level_at_rest_m_s2 += min(self.dt_s / LEVEL_TIME_S, 1.0) * (before - self.level_at_rest_m_s2)
        self.rest_s = min(self.rest_s + self.dt_s, OWN_RMS_TIME_S)
        if self.rest_s > 0:
            gain = self.dt_s / self.rest_s
            past = self.x.values[-delay].tolist()
            self.own_square = [own + gain * (x * x - own) for own, x in zip(self.own_square, past, strict=True)]


RECENT_S = 3.0  # kernels look back less far so soon after an event
