"""Cuts the stream of samples into steps: eight samples, counted from the start and after each gap."""

from __future__ import annotations

from dataclasses import dataclass, field

from estimation.mount.axes import Mount
from estimation.records import ImuSample
from estimation.track import Step
from estimation.wavelet import CausalSmoother

SAMPLES_PER_STEP = 8
GAP_S = 0.05  # longer than any jitter, shorter than any burst
PERIOD_MEMORY = 2000  # samples
SHORTER_IN_ROW, LONGER_IN_ROW = 4, 40  # samples so far apart prove a wrong idea of the period
GAP_PERIODS = 4.0  # of the source itself, if that is slow
LEAST_PERIOD_S = 1e-4  # no inertial sensor is that fast: samples that touch are no time of their own


@dataclass(slots=True)
class BlockCutter:
    """Streaming mean over eight samples, in support axes."""

    smoother: CausalSmoother = field(default_factory=CausalSmoother)
    count: int = 0
    # Acceleration, then rate, in sensor axes: integral over the block so far, and the last sample.
    integral: list[float] = field(default_factory=lambda: [0.0] * 6)
    last: list[float] = field(default_factory=list)
    last_ns: int | None = None
    step_end_ns: int | None = None
    period_s: float = 0.0  # of the samples, running mean
    periods: int = 0
    shorter_in_row: int = 0
    longer_in_row: int = 0
    backward: int = 0  # samples dropped because their time was not later than the last one's, or next to nothing

    def add(self, sample: ImuSample, mount: Mount) -> tuple[float, Step | None]:
        """Take one sample; returns the gap before it [s] (0 = none) and the step that it completes."""
        gap_s = 0.0
        if self.last_ns is not None:
            dt_s = (sample.t_ns - self.last_ns) * 1e-9
            if dt_s < LEAST_PERIOD_S:
                self.backward += 1
                return 0.0, None
            # The very first interval is all that is known of the period.
            if self.periods and dt_s > max(GAP_S, GAP_PERIODS * self.period_s):
                gap_s = dt_s
                self._start_anew()
            else:
                self._learn_period(dt_s)
        if self.step_end_ns is None:
            # The first block after a start or a gap begins one period before its first sample.
            self.step_end_ns = sample.t_ns - round(self.period_s * 1e9)
        self.smoother.add(sample.accel)
        self._integrate((*sample.accel, *sample.gyro), sample.t_ns)
        self.last_ns = sample.t_ns
        self.count += 1
        return gap_s, self._cut(mount) if self.count == SAMPLES_PER_STEP else None

    def _learn_period(self, dt_s: float) -> None:
        """Mean distance of neighbouring samples. One much shorter or longer says nothing, a row of them all."""
        if self.periods and 0.6 * self.period_s <= dt_s < 1.6 * self.period_s:
            self.shorter_in_row = self.longer_in_row = 0
            self.periods = min(self.periods + 1, PERIOD_MEMORY)
            self.period_s += (dt_s - self.period_s) / self.periods
            return
        if dt_s < self.period_s:
            self.shorter_in_row, self.longer_in_row = self.shorter_in_row + 1, 0
        else:
            # Between them samples may have been lost.
            self.shorter_in_row, self.longer_in_row = 0, self.longer_in_row + 1
        if not self.periods or self.shorter_in_row >= SHORTER_IN_ROW or self.longer_in_row >= LONGER_IN_ROW:
            self.period_s, self.periods = dt_s, 1
            self.shorter_in_row = self.longer_in_row = 0

    def _cut(self, mount: Mount) -> Step:
        assert self.last_ns is not None
        assert self.step_end_ns is not None
        dt_s = (self.last_ns - self.step_end_ns) * 1e-9
        ax, ay, az, gx, gy, gz = (total / dt_s for total in self.integral)
        # The mount is linear: turning the mean spares turning each sample.
        step = Step(
            t_ns=self.last_ns,
            dt_s=dt_s,
            accel=mount.to_support((ax, ay, az)),
            gyro=mount.to_support((gx, gy, gz)),
            smooth=mount.to_support(self.smoother.value()),
        )
        self.step_end_ns = self.last_ns
        self._clear()
        return step

    def _start_anew(self) -> None:
        self.smoother.clear()
        self._clear()
        self.step_end_ns = None
        self.last = []

    def _clear(self) -> None:
        self.count, self.integral = 0, [0.0] * 6

    def _integrate(self, values: tuple[float, ...], t_ns: int) -> None:
        """Straight from sample to sample: where one was lost, its neighbours tell best what it was."""
        assert self.step_end_ns is not None
        integral = self.integral
        if self.last and self.last_ns is not None:
            half_s = (t_ns - self.last_ns) * 0.5e-9
            for i, (before, now) in enumerate(zip(self.last, values, strict=True)):
                integral[i] += half_s * (before + now)
        else:
            dt_s = (t_ns - self.step_end_ns) * 1e-9
            for i, now in enumerate(values):
                integral[i] += dt_s * now
        self.last = list(values)
