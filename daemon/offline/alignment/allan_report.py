"""The noise of a recorded sensor in the units of data sheets: for JSON, for people, and as a sensor grade to paste."""

from __future__ import annotations

import json
from dataclasses import dataclass
from math import degrees
from typing import Any

from daemon.offline.alignment.allan import HELD, Allan, Axis
from estimation.alignment.sensor import G_M_S2

SHAKEN = 1.5  # times the white noise, and it is told


@dataclass(frozen=True)
class Units:
    """How one kind of sensor is told."""

    title: str
    walk: str
    rate: str
    walk_field: str
    rate_field: str
    per_walk: float  # of a density in SI
    per_rate: float


GYRO = Units("Gyroscopes", "deg/√h", "deg/h", "deg_sqrt_h", "deg_h", degrees(1) * 60, degrees(1) * 3600)
ACCEL = Units("Accelerometers", "m/s/√h", "mg", "m_s_sqrt_h", "mg", 60.0, 1e3 / G_M_S2)


def row(found: Allan) -> dict[str, Any]:
    """All of it, for JSON."""
    grade, curve = found.grade(), found.gyro[0].noise.curve
    return {
        "start_s": found.start_s,
        "rest_s": found.rest_s,
        "rate_hz": 1 / found.period_s,
        "samples": found.samples,
        "missing": found.missing,
        "tau_s": curve.tau_s.tolist(),
        "clusters": curve.clusters.tolist(),
        "relative_sigma": curve.relative_sigma.tolist(),
        "axes": [_axis_row(axis, units) for axes, units in ((found.gyro, GYRO), (found.accel, ACCEL)) for axis in axes],
        "grade": None if grade is None else grade.model_dump(),
        "obstacles": found.obstacles,
    }


def _axis_row(axis: Axis, units: Units) -> dict[str, Any]:
    noise, white, floor = axis.noise, axis.noise.white, axis.noise.instability
    return {
        "axis": axis.name,
        f"white_{units.walk_field}": None if white is None else white.density * units.per_walk,
        f"white_sigma_{units.walk_field}": None if white is None else white.sigma * units.per_walk,
        "white_from_s": None if white is None else white.from_s,
        "white_to_s": None if white is None else white.to_s,
        f"instability_{units.rate_field}": None if floor is None else floor.value * units.per_rate,
        "instability_tau_s": None if floor is None else floor.tau_s,
        "instability_reached": None if floor is None else floor.reached,
        "held": noise.held,
        "excess": axis.excess,
        f"deviation_{units.rate_field}": (noise.curve.deviation * units.per_rate).tolist(),
    }


def cells(axis: Axis, units: Units) -> tuple[str, ...]:
    """Cells of a table: axis, white noise, its sigma, where it holds, bias instability, where it was read."""
    white, floor = axis.noise.white, axis.noise.instability
    walk = ("–",) * 3
    if white is not None:
        walk = (
            f"{white.density * units.per_walk:.4g}",
            f"{white.sigma * units.per_walk:.2g}",
            f"{white.from_s:.2g} to {white.to_s:.2g}",
        )
    bias = ("–",) * 2
    if floor is not None:
        at_most = "" if floor.reached else "at most "
        bias = (f"{at_most}{floor.value * units.per_rate:.3g}", f"{floor.tau_s:.2g}")
    return (axis.name, *walk, *bias)


def remarks(found: Allan) -> list[str]:
    """What must be known about the figures, a sentence each."""
    said = []
    for axis in (*found.gyro, *found.accel):
        if axis.noise.constant:
            said.append(
                f"{axis.name} reads the same in every sample: a dead band, or a dead sensor; not without noise."
            )
        elif axis.hidden:
            said.append(
                f"{axis.name} reads the same in {axis.noise.held:.1%} of the samples (more than {HELD:.0%}): a dead "
                "band or coarse steps hide its noise; it is not in the grade."
            )
    if any(axis.noise.instability and not axis.noise.instability.reached for axis in (*found.gyro, *found.accel)):
        said.append(
            f"At most: the floor was not reached in {found.rest_s:.0f} s; the lowest value, one sigma added. "
            "A longer rest tells."
        )
    shaken = [axis for axis in (*found.gyro, *found.accel) if axis.excess > SHAKEN]
    if shaken:
        said.append(
            f"Something shakes ({', '.join(axis.name for axis in shaken)}): up to "
            f"{max(axis.excess for axis in shaken):.1f} times the white noise, which is read at the longer times; "
            "the grade does not hold the vibration."
        )
    return said


def grade_lines(found: Allan) -> list[str]:
    """The grade as TOML, or why there is none."""
    grade = found.grade()
    if grade is None:
        return [f"No grade: {sentence}" for sentence in found.obstacles]
    return [
        f"# For `ramstroke align --grades FILE --grade {found.name}`: worst axes, {found.rest_s:.0f} s of rest.",
        "# Turn-on biases are not in it: the sensor has others each time it starts.",
        f"[{found.name}]",
        f"gyro_bias_deg_h = {grade.gyro_bias_deg_h:.4g}{_bound(found.gyro)}",
        f"angle_walk_deg_sqrt_h = {grade.angle_walk_deg_sqrt_h:.4g}",
        f"accel_bias_mg = {grade.accel_bias_mg:.4g}{_bound(found.accel)}",
        f"velocity_walk_m_s_sqrt_h = {grade.velocity_walk_m_s_sqrt_h:.4g}",
        f"source = {_quoted(grade.source)}",
    ]


def _bound(axes: tuple[Axis, ...]) -> str:
    """A comment, if the largest instability is only a bound."""
    worst = max(
        (axis.noise.instability for axis in axes if axis.noise.instability is not None and not axis.hidden),
        key=lambda floor: floor.value,
    )
    return "" if worst.reached else "  # at most"


def _quoted(text: str) -> str:
    return json.dumps("".join(one if one.isprintable() else "_" for one in text), ensure_ascii=False)
