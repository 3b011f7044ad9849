"""`ramstroke align`."""

from __future__ import annotations

import argparse
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING

from daemon.commands import align_benchmark, align_tables, choices

if TYPE_CHECKING:
    from daemon.imu.roles import Role
    from daemon.offline.alignment.rest import Rest
    from daemon.settings import Settings
    from estimation.alignment.earth import Place

HELP = (
    "Initial alignment of the inertial sensor (paper B): level and heading of the support's axes from a rest at the "
    "beginning of a recording, or now beside the running daemon, each with its sigma, the limit that the sensor sets, "
    "and whether it was observed. A JY901 recorded beside the sensor is aligned too, and both are compared. "
    "--benchmark aligns virtual sensors of several grades beside what theory allows and paper B prints."
)
EXAMPLE = (
    "ramstroke align shift1.mcap --latitude 39.84 --heading 35 --save ramstroke.toml\n"
    "  ramstroke align --live --config ramstroke.toml --latitude 39.84 --duration 60"
)
LIVE_S = 60.0  # of rest, where --duration does not say


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("file", type=Path, nargs="?", help="the recording")
    parser.add_argument(
        "--live", action="store_true", help="the next --duration seconds (60) of what the running daemon records"
    )
    parser.add_argument("--config", type=Path, help="configuration of that daemon; without it the default's socket")
    parser.add_argument(
        "--grade",
        metavar="NAME",
        help="how good the sensor is (default adis16448_in_run, or jy901 if that is the sensor); `list` shows",
    )
    parser.add_argument("--beside-grade", default="jy901", metavar="NAME", help="of the one beside (default jy901)")
    parser.add_argument("--grades", type=Path, metavar="FILE", help="sensor grades of your own, a TOML file")
    parser.add_argument("--latitude", type=float, metavar="DEG", help="of the place [deg]")
    parser.add_argument(
        "--height", type=float, default=0.0, metavar="M", help="of the place, negative below sea level [m]"
    )
    parser.add_argument(
        "--heading",
        type=float,
        metavar="DEG",
        help="of the push, counter-clockwise from north, from the survey [deg]; default: heading_deg in [mount]",
    )
    parser.add_argument("--duration", type=float, default=inf, metavar="S", help="of rest to use at most [s]")
    parser.add_argument(
        "--save", type=Path, metavar="CONFIG", help="write the tilt, and the heading if known, into this configuration"
    )
    parser.add_argument("--benchmark", action="store_true", help="virtual sensors instead, AL-1 to AL-9")
    parser.add_argument("--runs", type=int, default=200, help="of each setting of the benchmark (default 200)")
    parser.add_argument("--seed", type=int, default=1, help="of the benchmark (default 1)")
    parser.add_argument(
        "--method",
        metavar="NAME",
        help="how to align; of the benchmark, which process noise: one method only; `list` shows all",
    )
    parser.add_argument(
        "--plot",
        type=Path,
        metavar="DIR",
        help="pictures into this folder: angles over time, or figures of paper B",
    )
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")


def run(arguments: argparse.Namespace) -> int:
    """Align, or show what alignment can do."""
    from daemon import terminal
    from daemon.errors import UsageError
    from daemon.offline.alignment.align import METHODS, align
    from daemon.offline.alignment.course_plot import draw_course
    from daemon.offline.alignment.grades import load_grades
    from daemon.offline.alignment.saving import save

    grades = load_grades(arguments.grades)
    if arguments.grade == "list":
        align_tables.print_grades(grades)
        return 0
    if arguments.method == "list":
        align_tables.print_methods(METHODS)
        align_benchmark.print_methods()
        return 0
    if arguments.benchmark:
        return align_benchmark.run(arguments)
    place = _place(arguments)
    if arguments.method in align_benchmark.methods() and arguments.method not in METHODS:
        raise UsageError(f"--method {arguments.method} is one of --benchmark: for a recording see --method list")
    method = choices.known("--method", arguments.method or "ours", METHODS)
    if arguments.grade is not None:
        choices.known("--grade", arguments.grade, grades)
    choices.known("--beside-grade", arguments.beside_grade, grades)
    path, settings, rests = _rests(arguments)
    names = {"main": arguments.grade or _default_grade(settings), "beside": arguments.beside_grade}
    heading_deg = settings.mount.heading_deg if arguments.heading is None else arguments.heading
    found = {role: align(rest, grades[names[role]], place, heading_deg, method) for role, rest in rests.items()}
    picture = None
    if arguments.plot is not None:
        choices.picture_folder("--plot", arguments.plot)
        picture = draw_course(found, align_tables.names_of(settings), path.name, arguments.plot)
    if arguments.json:
        align_tables.print_json(path, names, place, method, found, picture)
    else:
        align_tables.print_all(settings, names, found, heading_deg)
        if picture is not None:
            terminal.say(f"Picture: {picture}")
    if arguments.save is not None:
        was_there = arguments.save.exists()
        save(arguments.save, path, settings, found, heading_deg)
        if not arguments.json:
            align_tables.say_saved(arguments.save, was_there=was_there)
    return 0


def _place(arguments: argparse.Namespace) -> Place:
    """Where the sensor is, once all options are known to fit each other. Raises UsageError."""
    from math import isfinite

    from daemon.errors import UsageError
    from estimation.alignment.earth import Place

    if arguments.live and arguments.file is not None:
        raise UsageError("--live aligns on what the daemon records now: name no recording beside it")
    if not arguments.live and arguments.file is None:
        raise UsageError("name the recording to align on, or --live, or --benchmark")
    if arguments.config is not None and not arguments.live:
        raise UsageError("--config names the running daemon: it goes with --live")
    if arguments.latitude is None:
        raise UsageError("--latitude is needed: gravity and the Earth's rate depend on it")
    if not arguments.duration > 0:
        raise UsageError("--duration must be above 0 s")
    if arguments.heading is not None and not isfinite(arguments.heading):
        raise UsageError("--heading must be a finite number of degrees")
    try:
        return Place(arguments.latitude, arguments.height)
    except ValueError as error:
        raise UsageError(str(error)) from error


def _rests(arguments: argparse.Namespace) -> tuple[Path, Settings, dict[Role, Rest]]:
    """The recording, the settings that it was made with, the rests of its sensors."""
    from math import isinf

    from daemon import terminal
    from daemon.configuration import load
    from daemon.offline.alignment.live_rest import live_rests
    from daemon.offline.alignment.rest import rests_at_beginning
    from daemon.offline.replaying.replay import settings_of
    from daemon.recording.reader import Recording
    from daemon.settings import Settings

    if arguments.live:
        settings = load(arguments.config) if arguments.config else Settings()
        seconds = LIVE_S if isinf(arguments.duration) else arguments.duration
        with terminal.progress("seconds of rest", seconds) as progress:
            path, rests = live_rests(settings.service.socket, seconds, progress)
    else:
        path = arguments.file
        with terminal.progress(f"reading {path.name}") as progress:
            rests = rests_at_beginning(path, arguments.duration, progress)
    return path, settings_of(Recording(path)), rests


def _default_grade(settings: Settings) -> str:
    return "jy901" if settings.jy901.use == "instead" else "adis16448_in_run"
