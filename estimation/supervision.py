"""Watches for motion that no model explains, and for the calm after it."""

from __future__ import annotations

from dataclasses import dataclass

from estimation.belief import Phase
from estimation.track import Step, Track

UPSET_STEP = 2.5  # times the fastest usual speed
UPSET_ACCELERATION_M_S2 = 5.0  # filtered; a ram's burst stays below
UPSET_RATE_RAD_S = 0.35
# rms; no step can be told from so much. A move that is known already may shake more: a rough floor reaches 1.2 m/s^2.
UPSET_VIBRATION_M_S2, UPSET_VIBRATION_MOVING_M_S2 = 1.2, 1.8
CALM_S = 0.7
CALM_SIGMAS = 6.0  # of the chart's rest baseline
CALM_ACCELERATION_M_S2 = 0.08
CALM_RATE_RAD_S = 0.03
AVERAGE_S = 0.25


@dataclass(slots=True)
class Supervisor:
    """Remembers how lively the sensor has been."""

    since_lively_ns: int = 0
    mean: tuple[float, float, float] = (0.0, 0.0, 0.0)
    limit_m_s2: float = CALM_ACCELERATION_M_S2

    def see(self, step: Step) -> None:
        """Take one step in: lively = smooth acceleration away from its recent mean, or turning."""
        gain = min(step.dt_s / AVERAGE_S, 1.0)
        deviation = max(abs(a - m) for a, m in zip(step.smooth, self.mean, strict=True))
        x, y, z = (m + gain * (a - m) for a, m in zip(step.smooth, self.mean, strict=True))
        self.mean = (x, y, z)
        if deviation > self.limit_m_s2 or max(map(abs, step.gyro)) > CALM_RATE_RAD_S:
            self.since_lively_ns = step.t_ns

    def calm(self, t_ns: int, since_ns: int, can_moves: bool) -> bool:
        """Has all been quiet for long enough to speak of rest?"""
        return not can_moves and t_ns - max(self.since_lively_ns, since_ns) > CALM_S * 1e9

    def upset(self, step: Step, track: Track) -> bool:
        """Is this a motion that no ram makes?"""
        vibration_m_s2 = UPSET_VIBRATION_MOVING_M_S2
        if track.phase is Phase.REST:
            self.limit_m_s2 = max(CALM_ACCELERATION_M_S2, CALM_SIGMAS * track.chart.sigma)
            vibration_m_s2 = UPSET_VIBRATION_M_S2
        fastest = max(track.usual_speed(1), track.usual_speed(-1))
        return (
            abs(step.step_m_s) > UPSET_STEP * fastest
            or abs(track.acceleration_m_s2 - track.chart.centre) > UPSET_ACCELERATION_M_S2
            or max(map(abs, step.gyro)) > UPSET_RATE_RAD_S
            or step.vibration_m_s2 > vibration_m_s2
        )
