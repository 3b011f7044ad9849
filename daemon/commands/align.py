"""`ramstroke align`."""

from __future__ import annotations

import argparse
from math import degrees, inf
from pathlib import Path
from typing import Any

from daemon.commands import align_benchmark, choices

HELP = (
    "Initial alignment of the inertial sensor (paper B): level and heading of the support's axes from a rest at the "
    "beginning of a recording, each with its sigma, the limit that the sensor sets, and whether it was observed. "
    "--benchmark aligns virtual sensors of five grades beside what theory allows and paper B prints."
)
NO_LIMIT_DEG = 70.0  # of a heading: that is anything
EXAMPLE = "ramstroke align shift1.mcap --latitude 39.84 --heading 35"


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("file", type=Path, nargs="?", help="the recording")
    parser.add_argument(
        "--grade", default="adis16448_in_run", metavar="NAME", help="how good the sensor is; `list` shows"
    )
    parser.add_argument("--grades", type=Path, metavar="FILE", help="sensor grades of your own, a TOML file")
    parser.add_argument("--latitude", type=float, metavar="DEG", help="of the place [deg]")
    parser.add_argument(
        "--height", type=float, default=0.0, metavar="M", help="of the place, negative below sea level [m]"
    )
    parser.add_argument(
        "--heading", type=float, metavar="DEG", help="of the push, counter-clockwise from north, from the survey [deg]"
    )
    parser.add_argument("--duration", type=float, default=inf, metavar="S", help="of rest to use at most [s]")
    parser.add_argument("--benchmark", action="store_true", help="virtual sensors instead, AL-1 to AL-9")
    parser.add_argument("--runs", type=int, default=200, help="of each setting of the benchmark (default 200)")
    parser.add_argument("--seed", type=int, default=1, help="of the benchmark (default 1)")
    parser.add_argument(
        "--method", metavar="NAME", help="process noise of the benchmark by one method only; `list` shows all"
    )
    parser.add_argument("--plot", type=Path, metavar="DIR", help="figures 5 and 7 of paper B, into this folder")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")


def run(arguments: argparse.Namespace) -> int:
    """Align, or show what alignment can do."""
    from math import isfinite

    from daemon import terminal
    from daemon.errors import UsageError
    from daemon.offline.alignment import align
    from daemon.offline.grades import load_grades
    from estimation.alignment.earth import Place

    grades = load_grades(arguments.grades)
    if arguments.grade == "list":
        made = terminal.table("Sensor grades", "name", "gyro bias deg/h", "accelerometer bias mg", "from")
        for name, grade in grades.items():
            made.add_row(name, f"{grade.gyro_bias_deg_h:g}", f"{grade.accel_bias_mg:g}", grade.source)
        terminal.OUT.print(made)
        return 0
    if arguments.benchmark or arguments.method == "list":
        return align_benchmark.run(arguments)
    if arguments.method is not None or arguments.plot is not None:
        raise UsageError("--method and --plot are for the benchmark: add --benchmark")
    if arguments.file is None:
        raise UsageError("name the recording to align on, or --benchmark")
    if arguments.latitude is None:
        raise UsageError("--latitude is needed: gravity and the Earth's rate depend on it")
    if not arguments.duration > 0:
        raise UsageError("--duration must be above 0 s")
    if arguments.heading is not None and not isfinite(arguments.heading):
        raise UsageError("--heading must be a finite number of degrees")
    grade = grades[choices.known("--grade", arguments.grade, grades)]
    try:
        place = Place(arguments.latitude, arguments.height)
    except ValueError as error:
        raise UsageError(str(error)) from error
    with terminal.progress("messages") as progress:
        found = align(arguments.file, grade, place, arguments.heading, arguments.duration, progress)
    angles = [
        {
            "angle": angle.name,
            "value_deg": degrees(angle.value),
            "sigma_deg": degrees(angle.sigma),
            "limit_deg": degrees(angle.limit),
            "of_prior": angle.sigma / angle.prior_sigma,
            "verdict": str(angle.verdict),
        }
        for angle in found.angles
    ]
    if arguments.json:
        terminal.print_json(
            {
                "file": str(arguments.file),
                "grade": arguments.grade,
                "gravity_m_s2": place.gravity_m_s2,
                "rest_s": found.rest_s,
                "shocks": found.shocks,
                "angles": angles,
                "gyro_bias_deg_s": found.gyro_bias_deg_s.tolist(),
                "gyro_bias_removed": found.bias_removed,
                "nis": found.nis,
                "faults": found.faults,
            }
        )
        return 0
    _print(angles, found.rest_s, found.shocks, [*found.gyro_bias_deg_s.tolist()], arguments.heading)
    for fault in found.faults:
        terminal.say(f"Doubtful: {fault}.")
    if found.faults and arguments.grade == "adis16448_in_run":
        terminal.say("For an ADIS16448 whose turn-on biases have not been taken out: --grade adis16448_turn_on.")
    return 0


def _print(
    angles: list[dict[str, Any]], rest_s: float, shocks: int, gyro_bias_deg_s: list[float], heading_deg: float | None
) -> None:
    from math import isnan

    from daemon import terminal

    left_out = f", {shocks} tenths of a second with shocks left out" if shocks else ""
    made = terminal.table(
        f"Alignment on {rest_s:.1f} s of rest{left_out}", "angle", "deg", "± 1σ", "limit", "of prior", "verdict"
    )
    for angle in angles:
        made.add_row(
            angle["angle"],
            "–" if isnan(angle["value_deg"]) else f"{angle['value_deg']:.4f}",
            f"{angle['sigma_deg']:.4f}",
            f"{angle['limit_deg']:.4f}" if angle["limit_deg"] < NO_LIMIT_DEG else "none",
            f"{angle['of_prior']:.2f}",
            angle["verdict"],
        )
    terminal.OUT.print(made)
    terminal.say(f"Gyroscopes at rest: {', '.join(f'{one:+.4f}' for one in gyro_bias_deg_s)} deg/s (across, push, up).")
    if angles[2]["verdict"].startswith("refused") and heading_deg is None:
        terminal.say("The heading must come from the face survey: --heading DEG.")
