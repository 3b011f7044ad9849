"""`ramstroke status`."""

from __future__ import annotations

import argparse
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

HELP = "Ask the running daemon what it sees: stroke, sensors, recorder, viewers."
EXAMPLE = "ramstroke status --json"
PARTS = ("imu", "jy901", "can", "displacement", "estimator", "recorder", "loop")
PAST = ("moves", "events")  # of the greeting: for viewers that show them


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--config", type=Path, help="the daemon's configuration (for the place of its socket)")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")


def run(arguments: argparse.Namespace) -> int:
    """Print the status; 1 if no daemon answers."""
    from rich.markup import escape

    from daemon import terminal
    from daemon.configuration import load
    from daemon.rows import learned_words
    from daemon.service.health import UNDETERMINED_SHARE
    from daemon.service.live_client import first_line
    from daemon.settings import Settings

    settings = load(arguments.config) if arguments.config else Settings()
    greeting = first_line(settings.service.socket)
    status = {name: value for name, value in greeting.items() if name not in PAST}
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
    made = terminal.table(f"ramstroke {status['version']}", "part", "state", "counted")
    made.columns[1].justify = made.columns[2].justify = "left"
    made.add_row("stroke", stroke)
    for part in (one for one in PARTS if one != "jy901" or status["jy901"]["state"] != "off"):
        made.add_row(part, escape(_state(status[part], status["t_s"])), escape(_counters(status[part])))
    made.add_row("learned", learned_words(status["learned"]))
    live = status["live"]
    made.add_row("viewers", f"{live['viewers']} connected", f"lines dropped {live['dropped']}")
    terminal.OUT.print(made)
    return 0


def _state(part: dict[str, Any], now_s: float) -> str:
    """The word, and for a part that is ill since when, why, and what to do."""
    if not part["what"]:
        return str(part["state"])
    began = datetime.now() - timedelta(seconds=now_s - part["since_s"])
    return f"{part['state']} since {began:%H:%M:%S}: {part['what']}; {part['advice']}"


def _counters(part: dict[str, Any]) -> str:
    """What was counted, without zeros."""
    words: list[str] = []
    for name, value in part.items():
        if name in ("state", "since_s", "what", "advice") or not value or isinstance(value, list):
            continue
        counts = value.items() if isinstance(value, dict) else [(name, value)]
        words.extend(f"{kind.replace('_', ' ')} {count}" for kind, count in counts if count)
    return ", ".join(words)
