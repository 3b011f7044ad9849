"""`ramstroke sim`."""

from __future__ import annotations

import argparse
from pathlib import Path

HELP = (
    "A virtual support in real time for another process: the virtual ADIS16448 on the Unix socket "
    "imu.socket_path, the virtual controller on the CAN interface, both from one motion."
)
EXAMPLE = (
    "ramstroke sim --config config/trial.toml   # and in another terminal: ramstroke run --config config/trial.toml"
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--config", type=Path, required=True, help="the configuration that `run` uses too")


def run(arguments: argparse.Namespace) -> int:
    """Simulate until stopped."""
    import asyncio

    from daemon.configuration import load
    from daemon.errors import UsageError
    from daemon.logs import configure_logging
    from daemon.simulation import simulate

    settings = load(arguments.config)
    if settings.imu.transport != "socket":
        raise UsageError(f'{arguments.config}: sim serves imu.transport = "socket", not "{settings.imu.transport}"')
    if settings.can.enabled and settings.can.interface == "virtual":
        raise UsageError(
            f'{arguments.config}: can.interface = "virtual" stays within one process: '
            'with sim choose "udp_multicast" or "socketcan", or set can.enabled = false'
        )
    configure_logging(verbose=False)
    asyncio.run(simulate(settings))
    return 0
