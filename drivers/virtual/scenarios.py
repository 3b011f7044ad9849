"""Named distributions of virtual supports, and the scripts that they play."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from drivers.virtual.controller import SensorSpread
from drivers.virtual.motion import BurstSpread, PlannedMove, Scenario, Script, full_cycle

PUSH_M_S, RETRACT_M_S = 0.01453, 0.03519

SCENARIOS: dict[str, Scenario] = {
    "nominal": Scenario(),
    "lab_bench": Scenario(vibration_m_s2=(0.005, 0.02), tilt_deg=(0.003, 0.01), tilt_step_deg=0.002),
}

WEAK_START = BurstSpread((1.5, 3.0), (0.5, 0.95), (0.3, 0.75))


@dataclass(frozen=True)
class World:
    """A kind of support together with its displacement sensor."""

    support: Scenario = field(default_factory=Scenario)
    sensor: SensorSpread = field(default_factory=SensorSpread)


# Another maker's supports: nothing that the estimator assumes was taken from these.
FOREIGN = World(
    Scenario(
        start=BurstSpread((3.5, 12.0), (0.06, 0.40), (0.03, 0.20)),
        hard_stop=BurstSpread((4.0, 16.0), (0.06, 0.40), (0.02, 0.10)),
        valve_ramp_s=(0.05, 0.25),
        vibration_at_rest=0.5,
        vibration_band_hz=(4.0, 40.0),
        tilt_step_deg=0.06,
        speed_sigma_machine=0.04,
        speed_sigma_cycle=0.03,
        ripple=0.015,
        ripple_time_s=1.5,
        ripple_tone=(0.005, 0.02),
        ripple_tone_hz=(2.0, 12.0),
        end_stop_sigma_m=0.0008,
    ),
    SensorSpread(
        rate_hz=(6.0, 25.0),
        sigma_m=(0.001, 0.007),
        offset_sigma_m=0.0025,
        short_m=(0.0, 0.012),
        latency_s=(0.020, 0.050),
        dropouts_per_s=0.05,
    ),
)


def partial(stroke_m: float = 0.33) -> Script:
    """A push that the operator ends, and the way back."""
    return (PlannedMove(10.0, stroke_m, PUSH_M_S, hard_stop=False), PlannedMove(20.0, 0.0, RETRACT_M_S))


def interrupted() -> Script:
    """A push in two parts, and the way back."""
    return (
        PlannedMove(10.0, 0.215, PUSH_M_S, hard_stop=False),
        PlannedMove(6.0, 0.5, PUSH_M_S),
        PlannedMove(20.0, 0.0, RETRACT_M_S),
    )


def two_cycles() -> Script:
    """A full cycle, then a push of 420 mm."""
    return (*full_cycle(), PlannedMove(10.0, 0.42, PUSH_M_S, hard_stop=False))


def short_moves() -> Script:
    """Taps: pushes of 30, 60 and 160 mm, retracts of 35 and 215 mm."""
    return (
        PlannedMove(10.0, 0.03, PUSH_M_S, hard_stop=False),
        PlannedMove(6.0, 0.09, PUSH_M_S, hard_stop=False),
        PlannedMove(6.0, 0.25, PUSH_M_S, hard_stop=False),
        PlannedMove(6.0, 0.215, RETRACT_M_S, hard_stop=False),
        PlannedMove(6.0, 0.0, RETRACT_M_S),
    )


def rest(seconds: float) -> Script:
    """No move at all but a last one, which ends the wait."""
    return (PlannedMove(seconds, 0.5, PUSH_M_S),)


def louder_rest(world: World, share: float) -> World:
    """The same with neighbours and conveyor shaking the resting support."""
    return replace(world, support=replace(world.support, vibration_at_rest=share))
