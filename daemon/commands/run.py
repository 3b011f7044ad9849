"""`ramstroke run`."""

from __future__ import annotations

import argparse
from pathlib import Path

HELP = (
    "The daemon: reads the inertial sensor and the controller's displacement, estimates the stroke, records "
    "everything, serves viewers. Ends cleanly on SIGTERM or Ctrl-C."
)
EXAMPLE = "ramstroke run --config /etc/ramstroke/ramstroke.toml"


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--config", type=Path, help="configuration file (default: all defaults)")
    parser.add_argument("-v", "--verbose", action="store_true", help="log more")


def run(arguments: argparse.Namespace) -> int:
    """Run until stopped."""
    import asyncio

    from daemon.configuration import load
    from daemon.logs import configure_logging
    from daemon.service.application import Application
    from daemon.settings import Settings

    settings = load(arguments.config) if arguments.config else Settings()
    configure_logging(verbose=arguments.verbose)

    async def main() -> None:
        await Application(settings).run()

    asyncio.run(main())
    return 0
