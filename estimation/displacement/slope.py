"""Speed of the observed displacement over the last two seconds: a second opinion on whether the ram moves."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

WINDOW_S = 2.0
READINGS_WANTED = 10
OTHER_SPEED_SHARE, OTHER_SPEED_SIGMAS = 0.3, 5.5
MOVING_SHARE, STANDING_SHARE = 0.4, 0.3  # of the usual or expected speed


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

    def moves(self, noise_m: float, usual_speed_m_s: float) -> float | None:
        """The slope [m/s], if it is as large as a moving ram's."""
        fit = self.fit(noise_m)
        if fit is None or abs(fit[0]) < max(MOVING_SHARE * usual_speed_m_s, 4.0 * fit[1]):
            return None
        return fit[0]

    def stands(self, noise_m: float, expected_m_s: float) -> bool:
        """Whether the source stands while a speed of `expected_m_s` is believed."""
        fit = self.fit(noise_m)
        if fit is None:
            return False
        return abs(fit[0]) < STANDING_SHARE * abs(expected_m_s) and abs(fit[0] - expected_m_s) > 5.0 * fit[1]

    def disagrees(self, noise_m: float, expected_m_s: float) -> bool:
        """Whether the source is much faster than is believed, or goes the other way; a slower one may come to rest."""
        fit = self.fit(noise_m)
        if fit is None:
            return False
        share = fit[0] / expected_m_s
        off = abs(fit[0] - expected_m_s)
        return not -OTHER_SPEED_SHARE < share < 1.0 + OTHER_SPEED_SHARE and off > OTHER_SPEED_SIGMAS * fit[1]

    def middle_ns(self) -> int:
        """Mean time of the readings in the window."""
        return sum(t_ns for t_ns, _ in self.readings) // len(self.readings)

    def fresh(self, since_ns: int | None) -> bool:
        """Whether the window holds nothing of what ended at `since_ns`."""
        return since_ns is None or self.since_ns > since_ns

    @property
    def since_ns(self) -> int:
        """Time of the oldest reading in the window."""
        return self.readings[0][0] if self.readings else 0
