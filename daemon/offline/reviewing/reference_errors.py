"""Errors against the reference sensor of a recording, settled and smoothed."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from math import isnan, nan, sqrt

from estimation.records import Displacement
from estimation.smoothing.settled_smoother import SmoothedStep

SIGMAS_95 = 1.96


@dataclass(slots=True)
class ReferenceErrors:
    """Estimate minus reference, at the reference's readings."""

    readings: int
    mean_mm: float
    rms_mm: float
    worst_mm: float
    inside_95: float  # share within the stated 95 %; NaN where no sigma is stated


@dataclass(slots=True)
class _Tally:
    readings: int = 0
    sum_mm: float = 0.0
    squares_mm2: float = 0.0
    worst_mm: float = 0.0
    inside: float = 0.0

    def add(self, error_m: float, sigma_m: float) -> None:
        error_mm = error_m * 1e3
        self.readings += 1
        self.sum_mm += error_mm
        self.squares_mm2 += error_mm**2
        self.worst_mm = max(self.worst_mm, error_mm, key=abs)
        self.inside += nan if isnan(sigma_m) else abs(error_m) <= SIGMAS_95 * sigma_m

    def errors(self) -> ReferenceErrors | None:
        n = self.readings
        if n == 0:
            return None
        return ReferenceErrors(n, self.sum_mm / n, sqrt(self.squares_mm2 / n), self.worst_mm, self.inside / n)


@dataclass(slots=True)
class ReferenceComparison:
    """Takes readings and steps in order of time, the readings first; draws the estimate straight between steps."""

    _readings: deque[Displacement] = field(default_factory=deque)
    _before: SmoothedStep | None = None
    _settled: _Tally = field(default_factory=_Tally)
    _smoothed: _Tally = field(default_factory=_Tally)

    def add_reading(self, reading: Displacement) -> None:
        """Remember a reading until the steps around it have come."""
        if reading.valid:
            self._readings.append(reading)

    def add_step(self, step: SmoothedStep) -> None:
        """Compare the readings since the last step; one that is not smoothed is NaN there."""
        before, self._before = self._before, step
        while self._readings and self._readings[0].t_ns <= step.settled.t_ns:
            reading = self._readings.popleft()
            if before is not None and reading.t_ns > before.settled.t_ns:
                self._compare(reading, before, step)

    def settled(self) -> ReferenceErrors | None:
        """Of the settled estimate; None without a reading."""
        return self._settled.errors()

    def smoothed(self) -> ReferenceErrors | None:
        """Of the smoothed estimate; None without a reading."""
        return self._smoothed.errors()

    def _compare(self, reading: Displacement, before: SmoothedStep, after: SmoothedStep) -> None:
        share = (reading.t_ns - before.settled.t_ns) / (after.settled.t_ns - before.settled.t_ns)
        for tally, a, b in ((self._settled, before.settled, after.settled), (self._smoothed, before, after)):
            estimate_m = a.displacement_m + share * (b.displacement_m - a.displacement_m)
            if not isnan(estimate_m):
                tally.add(estimate_m - reading.value_m, max(a.sigma_m, b.sigma_m))
