"""`ramstroke status`."""

from __future__ import annotations

import argparse
from pathlib import Path

HELP = "Ask the running daemon what it sees: stroke, sensors, recorder, viewers."
EXAMPLE = "ramstroke status --json"


# Just below 1/√12, the sigma of a stroke that may be anything between the stops.
UNDETERMINED_SHARE = 0.28


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--config", type=Path, help="the daemon's configuration (for the place of its socket)")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")


def run(arguments: argparse.Namespace) -> int:
    """Print the status; 1 if no daemon answers."""
    from rich.markup import escape

    from daemon import terminal
    from daemon.configuration import load
    from daemon.live_client import first_line
    from daemon.settings import Settings

    settings = load(arguments.config) if arguments.config else Settings()
    status = first_line(settings.service.socket)
    if arguments.json:
        terminal.print_json(status)
        return 0
    estimate = status["estimate"]
    if estimate is None:
        stroke = "no estimate yet"
    elif estimate["sigma_mm"] >= UNDETERMINED_SHARE * status["stroke_mm"]:
        stroke = f"undetermined (± {estimate['sigma_mm']:.0f} mm, 1σ), sensor {estimate['can_state']}"
    else:
        stroke = (
            f"{estimate['displacement_mm']:.1f} ± {estimate['sigma_mm']:.1f} mm (1σ), "
            f"{estimate['velocity_mm_s']:+.1f} mm/s, {estimate['segment']}, sensor {estimate['can_state']}"
        )
    made = terminal.table(f"ramstroke {status['version']}", "part", "state")
    made.columns[1].justify = "left"
    made.add_row("stroke", stroke)
    for part in ("imu", "can", "recorder"):
        made.add_row(part, escape(_describe(status[part])))
    live = status["live"]
    made.add_row("viewers", f"{live['viewers']} connected, {live['dropped']} lines dropped")
    terminal.OUT.print(made)
    return 0


def _describe(part: dict[str, object]) -> str:
    """State first, then the counters that are not zero."""
    words = [str(part["state"])]
    for name, value in part.items():
        if name != "state" and value and not isinstance(value, list | dict):
            words.append(f"{name.replace('_', ' ')} {value}")
        elif isinstance(value, dict):
            words.extend(f"{kind} {count}" for kind, count in value.items() if count)
    return "; ".join(words)
