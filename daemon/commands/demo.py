"""`ramstroke demo`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from daemon.simulation.demo import DemoResult
    from drivers.virtual.faults import FaultScript

HELP = (
    "Measure one push and one retract of a virtual roof support in simulated time, by the same driver, bus, "
    "estimator and recorder that a real support would use. Writes demo.mcap and demo.png. With --faults the "
    "virtual devices go wrong as a script says."
)
EXAMPLE = "ramstroke demo --seed 7 --out /tmp/demo"


SENSORS = {"adis16448": "ADIS16448", "jy901": "JY901", "both": "ADIS16448 with a JY901 beside"}


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--seed", type=int, default=1, help="which virtual support (default 1)")
    parser.add_argument(
        "--imu",
        choices=("adis16448", "jy901", "both"),
        default="adis16448",
        help="inertial sensor: ADIS16448 (default), JY901, or the first with the second recorded beside it",
    )
    parser.add_argument(
        "--rest", type=float, default=10.0, metavar="S", help="of rest before the push, for `align` and --allan [s]"
    )
    parser.add_argument("--out", type=Path, default=Path("demo"), help="folder for the results (default demo)")
    parser.add_argument("--faults", type=Path, help="fault script, such as config/faults/wet_cable.toml")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")


def run(arguments: argparse.Namespace) -> int:
    """Play the demo; 1 if not every move was found although nothing went wrong by script."""
    from daemon import terminal
    from daemon.errors import CommandError, UsageError
    from daemon.offline.plots import plot_demo
    from daemon.simulation.demo import demo_settings, run_demo
    from daemon.simulation.fault_file import load_faults, refuse_unplayable
    from daemon.simulation.virtual import virtual_support

    if arguments.seed < 0:
        raise UsageError("--seed must not be negative")
    if not 5.0 <= arguments.rest <= 3600.0:
        raise UsageError("--rest must lie between 5 and 3600 s")
    faults = None if arguments.faults is None else load_faults(arguments.faults)
    try:
        arguments.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CommandError(
            f"cannot make the folder {arguments.out} ({error.strerror}): choose another --out"
        ) from error
    recording, picture = arguments.out / "demo.mcap", arguments.out / "demo.png"
    settings = demo_settings(arguments.seed, arguments.imu)
    if faults is not None:
        refuse_unplayable(faults, settings.jy901.use)
    with terminal.progress("virtual cycle") as progress:
        result = run_demo(settings, recording, progress, faults, arguments.rest)
    truth = virtual_support(settings, cycles=1, rest_s=arguments.rest).truth()
    plot_demo(picture, truth, result.settled, result.observed)

    rows = _rows(result)
    code = 0 if len(rows) == len(result.truth) or faults is not None else 1
    if arguments.json:
        report: dict[str, Any] = {
            "seed": arguments.seed,
            "moves": rows,
            "moves_expected": len(result.truth),
            "recording": str(recording),
            "picture": str(picture),
        }
        if faults is not None:
            report["faults"] = [fault.model_dump() for fault in faults.in_order]
            report["events"] = [{"t_s": event.t_ns * 1e-9, "what": event.what} for event in result.events]
        terminal.print_json(report)
        return code
    _print_table(arguments.seed, SENSORS[arguments.imu], rows)
    if faults is not None:
        for t_s, what in _history(result, faults):
            terminal.say(f"{t_s:8.2f} s  {what}")
    terminal.say(f"recording {recording}, picture {picture}")
    if len(rows) < len(result.truth):
        terminal.ERR.print(f"{len(rows)} of {len(result.truth)} moves were found", style="bold red")
    return code


def _rows(result: DemoResult) -> list[dict[str, Any]]:
    """The moves that were found, each beside the truth."""
    from daemon import terminal

    rows: list[dict[str, Any]] = []
    for true in result.truth:
        move = result.move_of(true)
        if move is not None:
            rows.append(
                terminal.move_row(move)
                | {
                    "truth_mm": true.end_m * 1e3,
                    "error_mm": (move.end_m - true.end_m) * 1e3,
                    "error_before_stop_mm": (move.end_before_stop_m - true.end_m) * 1e3,
                }
            )
    return rows


def _print_table(seed: int, sensors: str, rows: list[dict[str, Any]]) -> None:
    from daemon import terminal

    made = terminal.table(
        f"Virtual support {seed}, {sensors}, first cycle, nothing learned before",
        "move",
        "estimate mm",
        "± 1σ mm",
        "truth mm",
        "error mm",
        "error before stop mm",
        "CAN",
    )
    for row in rows:
        made.add_row(
            row["kind"],
            *(f"{row[key]:.1f}" for key in ("end_mm", "sigma_mm", "truth_mm")),
            *(f"{row[key]:+.1f}" for key in ("error_mm", "error_before_stop_mm")),
            row["can_state"],
        )
    terminal.OUT.print(made)


def _history(result: DemoResult, faults: FaultScript) -> list[tuple[float, str]]:
    """What went wrong by script and what the estimator said, in order of time."""
    told = [(event.t_ns * 1e-9, f"estimator: {event.what}") for event in result.events]
    end_s = result.duration_s
    told += [(fault.at_s, f"script: {fault.sentence}") for fault in faults.fault if fault.at_s < end_s]
    late = sum(fault.at_s >= end_s for fault in faults.fault)
    return sorted(told) + ([(end_s, f"the demo ends here; {late} faults of the script come later")] if late else [])
