"""`ramstroke install-service`."""

from __future__ import annotations

import argparse
from pathlib import Path

HELP = (
    "Make this installation the service of this computer, or bring it up to date: unit, user, rights of the devices, "
    "and a configuration if there is none. What stands there already stays. Needs root."
)
EXAMPLE = "ramstroke install-service --start   # as root: sudo"

_END_OF_TRIAL = "sudo ramstroke install-service --no-trial"


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--start", action="store_true", help="enable and start it, now and at every start")
    parser.add_argument("--realtime", action="store_true", help="let realtime_priority in [imu] be up to 50")
    parser.add_argument(
        "--trial",
        action=argparse.BooleanOptionalAction,
        help="let the service work with a virtual support on vcan0, as /etc/ramstroke/trial.toml says; "
        "--no-trial: with the real one again",
    )
    parser.add_argument(
        "--root", type=Path, default=Path("/"), metavar="DIR", help="only write the files, below this folder"
    )


def run(arguments: argparse.Namespace) -> int:
    """Install."""
    from daemon import terminal
    from daemon.service import installer

    host = installer.Host(arguments.root, terminal.say)
    installer.install(host, realtime=arguments.realtime, trial=arguments.trial)
    configuration = installer.configuration_in_use(host)
    if configuration != installer.CONFIGURATION:
        terminal.say(f"on trial, with a virtual support (/{configuration}), until: {_END_OF_TRIAL}")
    if arguments.start:
        installer.start(host)
    else:
        terminal.say(f"look through /{configuration}, then: sudo ramstroke install-service --start")
    return 0
