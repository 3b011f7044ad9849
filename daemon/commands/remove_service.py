"""`ramstroke remove-service`."""

from __future__ import annotations

import argparse
from pathlib import Path

HELP = (
    "Stop the service of this computer and take it away. Configuration, recordings and what was learned stay, unless "
    "--purge says otherwise. Needs root."
)
EXAMPLE = "ramstroke remove-service   # as root: sudo"


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--purge", action="store_true", help="delete configuration, recordings and learned state too")
    parser.add_argument(
        "--root", type=Path, default=Path("/"), metavar="DIR", help="only delete the files, below this folder"
    )


def run(arguments: argparse.Namespace) -> int:
    """Remove."""
    import sys

    from daemon import terminal
    from daemon.service import installer

    installer.remove(installer.Host(arguments.root, terminal.say), purge=arguments.purge)
    terminal.say(f"the program itself is in {sys.prefix}: delete that folder to be rid of it")
    return 0
