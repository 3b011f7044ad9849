"""`ramstroke check-config`."""

from __future__ import annotations

import argparse
from pathlib import Path

HELP = "Check a configuration file, its DBC files included; each fault is one sentence with file, line and key."
EXAMPLE = "ramstroke check-config /etc/ramstroke/ramstroke.toml"


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("file", type=Path, help="the configuration file (TOML)")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")


def run(arguments: argparse.Namespace) -> int:
    """Check; 2 if the file cannot be used."""
    from daemon import terminal
    from daemon.configuration import ConfigurationError, load
    from daemon.errors import MISUSED

    try:
        load(arguments.file)
    except ConfigurationError as error:
        if not arguments.json:
            raise
        terminal.print_json({"file": str(arguments.file), "good": False, "faults": error.sentences})
        return MISUSED
    if arguments.json:
        terminal.print_json({"file": str(arguments.file), "good": True, "faults": []})
    else:
        terminal.say(f"{arguments.file}: good")
    return 0
