"""The scenarios of `ramstroke evaluate`: which support, which script, and what becomes of the displacement sensor."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from drivers.virtual.motion import Scenario, Script, TrueMove, full_cycle
from drivers.virtual.scenarios import (
    FOREIGN,
    SCENARIOS,
    WEAK_START,
    World,
    interrupted,
    louder_rest,
    partial,
    rest,
    short_moves,
    two_cycles,
)

# Takes the time since the first onset of the judged cycle [s] and a reading [m]; None = no reading comes.
Tampering = Callable[[float, float], float | None]


@dataclass(frozen=True)
class EvaluationScenario:
    """One row of an evaluation."""

    about: str
    world: World = field(default_factory=World)
    script: Script = field(default_factory=full_cycle)
    tampering: Callable[[], Tampering] | None = None  # makes a new one for each support
    imu_on: Literal["both", "link", "base"] = "both"
    clock_error: float | None = None  # of the inertial sensor's sample rate; None = drawn
    turned_deg: float = 0.0  # the sensor about the vertical
    time_tolerance_s: float = 0.3  # an onset or stop farther off is a failure
    only_rest: bool = False  # the wait is judged: a move found before the script's first is a false one

    @property
    def modes(self) -> tuple[str, ...]:
        """With and without the displacement sensor; what is done to its readings needs it."""
        return ("fused", "inertial") if self.tampering is None else ("fused",)

    def felt(self, move: TrueMove) -> bool:
        """Whether the part that carries the inertial sensor takes part in that move."""
        return self.imu_on == "both" or (self.imu_on == "link") == (move.speed_m_s > 0)


def _always(tampering: Tampering) -> Callable[[], Tampering]:
    """For what remembers nothing."""
    return lambda: tampering


def _dead(since_s: float, value_m: float) -> float | None:
    return None if since_s >= 12.0 else value_m


class _Stuck:
    """The value of the first reading after 15 s, until 27 s."""

    def __init__(self) -> None:
        self._held_m: float | None = None

    def __call__(self, since_s: float, value_m: float) -> float:
        if not 15.0 <= since_s < 27.0:
            return value_m
        if self._held_m is None:
            self._held_m = value_m
        return self._held_m


def _jump(since_s: float, value_m: float) -> float:
    return value_m + 0.03 if since_s >= 15.0 else value_m


def _drift(since_s: float, value_m: float) -> float:
    return value_m + 0.015 * min(since_s - 12.0, 4.0) if since_s >= 12.0 else value_m


def _lie(since_s: float, value_m: float) -> float:
    return 0.25 + 0.2 * math.sin(37.0 * since_s) if 12.0 <= since_s < 20.0 else value_m


def _world(**changes: Any) -> World:
    return World(Scenario(**changes))


_ROUGH = _world(
    vibration_m_s2=(0.25, 0.5), tilt_deg=(0.2, 0.5), tilt_step_deg=0.08, dips_per_s=0.02, dip_depth=(0.3, 0.65)
)
_NOISY = louder_rest(World(), 1.0)

SCENARIOS_OF_EVALUATION: dict[str, EvaluationScenario] = {
    "nominal": EvaluationScenario("a full push and retract of 500 mm"),
    "lab_bench": EvaluationScenario("the same on a quiet bench, as in the papers", World(SCENARIOS["lab_bench"])),
    "partial": EvaluationScenario("a push that its valve ends at 330 mm", script=partial()),
    "interrupted": EvaluationScenario("a push that pauses at 215 mm", script=interrupted()),
    "two_cycles": EvaluationScenario("a cycle, then a push of 420 mm", script=two_cycles()),
    "short_moves": EvaluationScenario("taps of 30, 60 and 160 mm, 35 and 215 mm back", script=short_moves()),
    "short_moves_noisy": EvaluationScenario("the same with a noisy rest", _NOISY, short_moves()),
    "noisy_rest_50": EvaluationScenario("neighbours shake the resting support half as hard", louder_rest(World(), 0.5)),
    "noisy_rest_100": EvaluationScenario("neighbours shake the resting support as hard as a moving one", _NOISY),
    "low_frequency_rest": EvaluationScenario(
        "a noisy rest that reaches down to 2 Hz", _world(vibration_at_rest=1.0, vibration_band_hz=(2.0, 60.0))
    ),
    "rough_floor": EvaluationScenario("hard vibration, large tilts, a pump that falters", _ROUGH),
    "weak_burst": EvaluationScenario(
        "soft starts, of most of a second", _world(start=WEAK_START), time_tolerance_s=0.5
    ),
    "temperature": EvaluationScenario("8 degrees warmer at the end", _world(temperature_rise_c=8.0)),
    "creep": EvaluationScenario("a leaking valve: up to 0.1 mm/s at rest", _world(creep_m_s=1e-4)),
    "mount_off_3": EvaluationScenario("the sensor turned by 3 degrees about the vertical", turned_deg=3.0),
    "clock_off_2": EvaluationScenario("the sensor samples 2 % too slowly", clock_error=-0.02),
    "can_late": EvaluationScenario("readings 30 ms old", World(sensor=replace(World().sensor, latency_s=(0.03, 0.03)))),
    "can_unbiased": EvaluationScenario(
        "readings with noise of 4.7 mm and no other error, as paper A must have had them",
        World(sensor=replace(World().sensor, sigma_m=(0.0047, 0.0047), offset_sigma_m=0.0, short_m=(0.0, 0.0))),
    ),
    "can_dead": EvaluationScenario("no reading after 12 s of the push", tampering=_always(_dead)),
    "can_stuck": EvaluationScenario("the reading stands from 15 to 27 s of the push", tampering=_Stuck),
    "can_jump": EvaluationScenario("30 mm more from 15 s of the push on", tampering=_always(_jump)),
    "can_drift": EvaluationScenario("the reading runs away by 15 mm/s for 4 s in the push", tampering=_always(_drift)),
    "can_lies": EvaluationScenario("nonsense from 12 to 20 s of the push, marked as valid", tampering=_always(_lie)),
    "retract_not_felt": EvaluationScenario(
        "the sensor sits on the link, which stands while the support advances", _world(felt="push"), imu_on="link"
    ),
    "push_not_felt": EvaluationScenario(
        "the sensor sits on the base, which stands while the conveyor is pushed", _world(felt="retract"), imu_on="base"
    ),
    "blows": EvaluationScenario("blows against the resting support", _world(blows_per_s=0.05)),
    "leaning": EvaluationScenario("a neighbour tilts the resting support", _world(leans_per_s=0.03)),
    "switching": EvaluationScenario("a machine nearby starts and stops", _world(switches_per_s=0.05)),
    "foreign": EvaluationScenario("another maker's support, which no assumption was taken from", FOREIGN),
    "foreign_partial": EvaluationScenario("the same, with a push of 330 mm", FOREIGN, partial()),
    "quiet_rest": EvaluationScenario("ten minutes of rest", script=rest(600.0), only_rest=True),
    "noisy_rest": EvaluationScenario("ten minutes of noisy rest", _NOISY, rest(600.0), only_rest=True),
}
