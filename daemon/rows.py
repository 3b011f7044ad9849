"""Estimates and moves in the words and units that leave the program."""

from __future__ import annotations

import math
from typing import Any

from estimation.records import Estimate, Move


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


def finite(value: Any) -> Any:
    """The same with None for NaN and infinity, which JSON does not know."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return value
