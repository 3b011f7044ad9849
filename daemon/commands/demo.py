"""`ramstroke demo`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

HELP = (
    "Measure one push and one retract of a virtual roof support in simulated time, by the same driver, bus, "
    "estimator and recorder that a real support would use. Writes demo.mcap and demo.png."
)
EXAMPLE = "ramstroke demo --seed 7 --out /tmp/demo"


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--seed", type=int, default=1, help="which virtual support (default 1)")
    parser.add_argument("--out", type=Path, default=Path("demo"), help="folder for the results (default demo)")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")


def run(arguments: argparse.Namespace) -> int:
    """Play the demo; 1 if not every move was found."""
    from daemon import terminal
    from daemon.demo import demo_settings, run_demo
    from daemon.errors import CommandError, UsageError
    from daemon.plots import plot_demo
    from daemon.virtual import virtual_support

    if arguments.seed < 0:
        raise UsageError("--seed must not be negative")
    try:
        arguments.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CommandError(
            f"cannot make the folder {arguments.out} ({error.strerror}): choose another --out"
        ) from error
    recording, picture = arguments.out / "demo.mcap", arguments.out / "demo.png"
    settings = demo_settings(arguments.seed)
    with terminal.progress("virtual cycle", 1.0) as progress:
        result = run_demo(settings, recording, progress)
    plot_demo(picture, virtual_support(settings, cycles=1).truth(), result.settled, result.observed)

    rows: list[dict[str, Any]] = []
    for move, true in zip(result.moves, result.truth, strict=False):
        rows.append(
            terminal.move_row(move)
            | {
                "truth_mm": true.end_m * 1e3,
                "error_mm": (move.end_m - true.end_m) * 1e3,
                "error_before_stop_mm": (move.end_before_stop_m - true.end_m) * 1e3,
            }
        )
    found = len(result.moves) == len(result.truth)
    if arguments.json:
        terminal.print_json(
            {
                "seed": arguments.seed,
                "moves": rows,
                "moves_expected": len(result.truth),
                "recording": str(recording),
                "picture": str(picture),
            }
        )
        return 0 if found else 1
    made = terminal.table(
        f"Virtual support {arguments.seed}, first cycle, nothing learned before",
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
    terminal.say(f"recording {recording}, picture {picture}")
    if not found:
        terminal.ERR.print(f"{len(result.moves)} of {len(result.truth)} moves were found", style="bold red")
    return 0 if found else 1
