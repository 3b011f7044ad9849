"""`ramstroke install-service`."""

from __future__ import annotations

import argparse
from pathlib import Path

HELP = (
    "Make this installation the service of this computer, or bring it up to date: unit, user, rights of the devices, "
    "and a configuration if there is none. What stands there already stays. Needs root."
)
EXAMPLE = "ramstroke install-service --start   # as root: sudo"


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--start", action="store_true", help="enable and start it, now and at every start")
    parser.add_argument("--realtime", action="store_true", help="let realtime_priority in [imu] be up to 50")
    parser.add_argument(
        "--root", type=Path, default=Path("/"), metavar="DIR", help="only write the files, below this folder"
    )


def run(arguments: argparse.Namespace) -> int:
    """Install."""
    from daemon import terminal
    from daemon.service import installer

    host = installer.Host(arguments.root, terminal.say)
    installer.install(host, realtime=arguments.realtime)
    if arguments.start:
        installer.start(host)
    else:
        terminal.say(f"look through /{installer.CONFIGURATION}, then: sudo ramstroke install-service --start")
    return 0
