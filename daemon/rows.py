"""Estimates, moves and what was learned in the words and units that leave the program."""

from __future__ import annotations

import math
from typing import Any

from estimation.learned import Flow, Learned
from estimation.records import Displacement, Estimate, Move


def estimate_row(estimate: Estimate) -> dict[str, Any]:
    """The present state, for viewers and health."""
    return {
        "t_s": estimate.t_ns * 1e-9,
        "displacement_mm": round(estimate.displacement_m * 1e3, 3),
        "sigma_mm": round(estimate.sigma_m * 1e3, 3),
        "velocity_mm_s": round(estimate.velocity_m_s * 1e3, 3),
        "segment": str(estimate.segment),
        "can_state": str(estimate.can_state),
        "move": estimate.move,
    }


def live_row(estimate: Estimate, observed: Displacement | None) -> dict[str, Any]:
    """The present state with what its plots show; `observed`: the newest valid reading of the displacement sensor."""
    row = estimate_row(estimate) | {
        "velocity_sigma_mm_s": round(estimate.velocity_sigma_m_s * 1e3, 3),
        "acceleration_m_s2": round(estimate.acceleration_m_s2, 5),
        "chart_lower_m_s2": round(estimate.chart_lower_m_s2, 5),
        "chart_upper_m_s2": round(estimate.chart_upper_m_s2, 5),
        "observed_s": None if observed is None else observed.t_ns * 1e-9,
        "observed_mm": None if observed is None else round(observed.value_m * 1e3, 3),
    }
    return {
        name: None if isinstance(value, float) and not math.isfinite(value) else value for name, value in row.items()
    }


def move_row(move: Move) -> dict[str, Any]:
    """A finished move."""
    return {
        "kind": str(move.kind),
        "onset_s": move.onset_ns * 1e-9,
        "stop_s": move.stop_ns * 1e-9,
        "start_mm": move.start_m * 1e3,
        "end_mm": move.end_m * 1e3,
        "sigma_mm": move.sigma_m * 1e3,
        "end_before_stop_mm": move.end_before_stop_m * 1e3,
        "sigma_before_stop_mm": move.sigma_before_stop_m * 1e3,
        "velocity_mm_s": move.velocity_m_s * 1e3,
        "can_state": str(move.can_state),
        "tier": str(move.tier),
    }


def learned_row(learned: Learned | None) -> dict[str, Any] | None:
    """What outlasts a run; None if nothing was learned yet."""
    if learned is None:
        return None
    sensor: dict[str, Any] = {}
    for name, unit, factor in (
        ("scale", "percent", 1e2),
        ("offset", "mm", 1e3),
        ("bow", "mm", 1e3),
        ("latency", "ms", 1e3),
    ):
        mean, sigma = learned.value(name)
        sensor |= {f"{name}_{unit}": round(mean * factor, 4), f"{name}_sigma_{unit}": round(sigma * factor, 4)}
    return {
        "push": _flow_row(learned.push),
        "retract": _flow_row(learned.retract),
        "sensor": sensor | {"noise_mm": round(learned.noise_m * 1e3, 4), "calibrations": learned.calibrations},
    }


def _flow_row(flow: Flow) -> dict[str, Any]:
    return {
        "speed_mm_s": round(flow.speed_m_s * 1e3, 4),
        "sigma_mm_s": round(flow.sigma_m_s * 1e3, 4),
        "moves": flow.moves,
    }


def learned_words(row: dict[str, Any] | None) -> str:
    """`learned_row` as people read it."""
    if row is None:
        return "nothing learned yet"
    words = [
        f"{name} {row[name]['speed_mm_s']:.2f} ± {row[name]['sigma_mm_s']:.2f} mm/s "
        f"(from {row[name]['moves']} {'move' if row[name]['moves'] == 1 else 'moves'})"
        for name in ("push", "retract")
    ]
    sensor = row["sensor"]
    for name, unit, sign in (
        ("scale", "percent", "%"),
        ("offset", "mm", "mm"),
        ("bow", "mm", "mm"),
        ("latency", "ms", "ms"),
    ):
        words.append(f"{name} {sensor[f'{name}_{unit}']:+.1f} ± {sensor[f'{name}_sigma_{unit}']:.1f} {sign}")
    words[2] = f"sensor {words[2]}"
    return ", ".join(words)


def finite(value: Any) -> Any:
    """The same with None for NaN and infinity, which JSON does not know."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return value
