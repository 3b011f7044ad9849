"""What `ramstroke align` prints of a rest."""

from __future__ import annotations

from collections.abc import Mapping
from math import degrees, hypot, isnan, nan
from pathlib import Path
from typing import TYPE_CHECKING, Any

from estimation.alignment.verdict import Verdict

if TYPE_CHECKING:
    from daemon.imu.roles import Role
    from daemon.offline.alignment.align import Alignment
    from daemon.settings import Settings
    from estimation.alignment.earth import Place
    from estimation.alignment.sensor import SensorGrade

NO_LIMIT_DEG = 70.0  # of a heading: that is anything


def print_grades(grades: Mapping[str, SensorGrade]) -> None:
    """All of them."""
    from daemon import terminal

    made = terminal.table("Sensor grades", "name", "gyro bias deg/h", "accelerometer bias mg", "from")
    for name, grade in grades.items():
        made.add_row(name, f"{grade.gyro_bias_deg_h:g}", f"{grade.accel_bias_mg:g}", grade.source)
    terminal.OUT.print(made)


def print_methods(methods: Mapping[str, str]) -> None:
    """Those for a recording."""
    from daemon import terminal

    made = terminal.table("Methods for a recording", "name", "what it does")
    made.columns[1].justify = "left"
    for name, about in methods.items():
        made.add_row(name, about)
    terminal.OUT.print(made)


def print_json(
    path: Path,
    grades: Mapping[str, str],
    place: Place,
    method: str,
    found: Mapping[Role, Alignment],
    picture: Path | None,
) -> None:
    """One object: the sensor's alignment, and with one beside it that one's and the comparison."""
    from daemon import terminal

    answer = {
        "file": str(path),
        "gravity_m_s2": place.gravity_m_s2,
        "method": method,
        "picture": None if picture is None else str(picture),
        **_row(found["main"], grades["main"]),
        "beside": None,
        "comparison": None,
    }
    if "beside" in found:
        answer["beside"] = _row(found["beside"], grades["beside"])
        answer["comparison"] = _comparison(found)
    terminal.print_json(answer)


def print_all(
    settings: Settings, grades: Mapping[str, str], found: Mapping[Role, Alignment], heading_deg: float | None
) -> None:
    """Tables, and what must be known about them."""
    from daemon import terminal

    names = names_of(settings)
    for role, alignment in found.items():
        _print_one(alignment, f"{names[role]} as {grades[role]}: ")
        for fault in alignment.faults:
            terminal.say(f"Doubtful: {fault}.")
        if alignment.faults and grades[role] == "adis16448_in_run":
            terminal.say("For an ADIS16448 whose turn-on biases have not been taken out: --grade adis16448_turn_on.")
    if "beside" in found:
        _print_comparison(_comparison(found))
        if Verdict.DOUBTFUL in [angle.verdict for one in found.values() for angle in one.angles]:
            terminal.say("One of them is doubtful as it is: a sigma of the difference means little.")
    elif settings.jy901.use == "beside":
        terminal.say("The JY901 beside it brings too few samples in this rest.")
    if found["main"].angles[2].verdict.startswith("refused") and heading_deg is None:
        terminal.say("The heading must come from the face survey: --heading DEG.")


def names_of(settings: Settings) -> dict[Role, str]:
    """The sensors, for people; what else was imported counts as the first."""
    return {"main": "JY901" if settings.jy901.use == "instead" else "ADIS16448", "beside": "JY901 beside"}


def say_saved(path: Path, *, was_there: bool) -> None:
    """Where it went."""
    from daemon import terminal

    made = "" if was_there else ", a new file with the settings of the recording: look through it"
    terminal.say(f"saved in {path}{made}; `ramstroke run --config {path}` takes the tilt off")


def _row(found: Alignment, grade: str) -> dict[str, Any]:
    return {
        "grade": grade,
        "rest_s": found.rest_s,
        "shocks": found.shocks,
        "angles": [
            {
                "angle": angle.name,
                "value_deg": degrees(angle.value),
                "sigma_deg": degrees(angle.sigma),
                "limit_deg": degrees(angle.limit),
                "of_prior": angle.sigma / angle.prior_sigma,
                "verdict": str(angle.verdict),
            }
            for angle in found.angles
        ],
        "gyro_bias_deg_s": found.gyro_bias_deg_s.tolist(),
        "gyro_bias_removed": found.bias_removed,
        "nis": found.nis,
        "faults": found.faults,
    }


def _comparison(found: Mapping[Role, Alignment]) -> list[dict[str, Any]]:
    """Angle by angle, sensor less the one beside, which err each for itself; NaN where both have it from elsewhere."""
    rows = []
    for main, beside in zip(found["main"].angles, found["beside"].angles, strict=True):
        off, sigma = degrees(main.value - beside.value), degrees(hypot(main.sigma, beside.sigma))
        if main.name == "heading":
            off = (off + 180) % 360 - 180
            if Verdict.NOT_OBSERVED in (main.verdict, beside.verdict):
                off = nan
        sigma = nan if isnan(off) else sigma
        rows.append({"angle": main.name, "difference_deg": off, "sigma_deg": sigma})
    return rows


def _print_one(found: Alignment, name: str) -> None:
    from daemon import terminal

    left_out = f", {found.shocks} tenths of a second with shocks left out" if found.shocks else ""
    made = terminal.table(
        f"{name}{found.rest_s:.1f} s of rest{left_out}",
        "angle",
        "deg",
        "± 1σ",
        "limit",
        "of prior",
        "verdict",
    )
    for angle in found.angles:
        limit_deg, unknown = degrees(angle.limit), isnan(angle.sigma) or isnan(angle.value)
        made.add_row(
            angle.name,
            "–" if isnan(angle.value) else f"{degrees(angle.value):.4f}",
            "–" if unknown else f"{degrees(angle.sigma):.4f}",
            f"{limit_deg:.4f}" if limit_deg < NO_LIMIT_DEG else "none",
            "–" if unknown else f"{angle.sigma / angle.prior_sigma:.2f}",
            angle.verdict,
        )
    terminal.OUT.print(made)
    bias = ", ".join(f"{one:+.4f}" for one in found.gyro_bias_deg_s.tolist())
    terminal.say(f"Gyroscopes at rest: {bias} deg/s (across, push, up).")


def _print_comparison(rows: list[dict[str, Any]]) -> None:
    from daemon import terminal

    made = terminal.table("One less the other", "angle", "difference deg", "± 1σ", "in sigmas")
    for row in rows:
        off, sigma = row["difference_deg"], row["sigma_deg"]
        unknown = isnan(off) or isnan(sigma)
        made.add_row(
            row["angle"],
            "–" if isnan(off) else f"{off:+.4f}",
            "–" if unknown else f"{sigma:.4f}",
            "–" if unknown else f"{abs(off) / sigma:.1f}",
        )
    terminal.OUT.print(made)
