"""Speed of the observed displacement over the last two seconds: a second opinion on whether the ram moves."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

WINDOW_S = 2.0
READINGS_WANTED = 10


@dataclass(slots=True)
class Slope:
    """Least-squares line through recent readings."""

    readings: deque[tuple[int, float]] = field(default_factory=deque)  # time [ns], value [m]

    def add(self, t_ns: int, value_m: float) -> None:
        """Take one usable reading."""
        self.readings.append((t_ns, value_m))
        while t_ns - self.readings[0][0] > WINDOW_S * 1e9:
            self.readings.popleft()

    def clear(self) -> None:
        """Forget: the source proved wrong."""
        self.readings.clear()

    def fit(self, noise_m: float) -> tuple[float, float] | None:
        """Slope and its sigma [m/s], or None while the readings span less than most of the window."""
        n = len(self.readings)
        if n < READINGS_WANTED or self.readings[-1][0] - self.readings[0][0] < 0.8 * WINDOW_S * 1e9:
            return None
        origin = self.readings[0][0]
        t = [(reading[0] - origin) * 1e-9 for reading in self.readings]
        mean_t = sum(t) / n
        mean_y = sum(reading[1] for reading in self.readings) / n
        spread = sum((a - mean_t) ** 2 for a in t)
        moment = sum((a - mean_t) * (b[1] - mean_y) for a, b in zip(t, self.readings, strict=True))
        return moment / spread, noise_m / spread**0.5

    def mean(self) -> float:
        """Mean value [m]."""
        return sum(value for _, value in self.readings) / len(self.readings)
