"""Shewhart chart for individuals on the levelled push acceleration, limits from a running rest baseline.

Paper C, eq. (11) as it can work: the mean *absolute* moving range between successive values gives the spread
(sigma = MR / 1.128), and centre and spread come from rest alone, not from the whole record.
"""

from __future__ import annotations

from dataclasses import dataclass

D2 = 1.128  # expected range of two normal values, in sigmas
TIME_CONSTANT_S = 5.0
SIGMA_FLOOR_M_S2 = 0.004  # half an LSB of the sensor; a noiseless source would call everything a change


@dataclass(slots=True)
class ControlChart:
    """Centre line and limits; learn() only at rest."""

    centre: float = 0.0
    moving_range: float = 0.0
    last: float | None = None
    seen_s: float = 0.0

    def learn(self, value: float, dt_s: float) -> None:
        """Take one value of rest into the baseline."""
        self.seen_s = min(self.seen_s + dt_s, TIME_CONSTANT_S)
        gain = dt_s / self.seen_s
        self.centre += gain * (value - self.centre)
        if self.last is not None:
            self.moving_range += gain * (abs(value - self.last) - self.moving_range)
        self.last = value

    @property
    def sigma(self) -> float:
        """Spread of the individuals [m/s^2]."""
        return max(self.moving_range / D2, SIGMA_FLOOR_M_S2)

    @property
    def limits(self) -> tuple[float, float]:
        """Lower and upper control limit [m/s^2]: three sigmas around the centre."""
        return self.centre - 3.0 * self.sigma, self.centre + 3.0 * self.sigma
