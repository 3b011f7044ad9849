"""`ramstroke sim`."""

from __future__ import annotations

import argparse
from pathlib import Path

HELP = (
    "A virtual support in real time for another process: the virtual ADIS16448 on the Unix socket "
    "imu.socket_path, a JY901 on a pseudo-terminal under the name jy901.port, the virtual controller on the CAN "
    "interface, all from one motion. With --faults they go wrong as a script says."
)
EXAMPLE = (
    "ramstroke sim --config config/trial.toml   # and in another terminal: ramstroke run --config config/trial.toml\n"
    "  ramstroke sim --config config/trial.toml --faults config/faults/wet_cable.toml"
)

_SWITCH_INTERVAL_S = 0.0005


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--config", type=Path, required=True, help="the configuration that `run` uses too")
    parser.add_argument("--faults", type=Path, help="fault script, such as config/faults/wet_cable.toml")
    parser.add_argument(
        "--json", action="store_true", help="at the end one JSON object on standard output: what it has done"
    )


def run(arguments: argparse.Namespace) -> int:
    """Simulate until stopped."""
    import asyncio
    import json
    import sys

    from daemon.configuration import load
    from daemon.errors import UsageError
    from daemon.logs import configure_logging
    from daemon.simulation.fault_file import load_faults, refuse_unplayable
    from daemon.simulation.server import simulate

    settings = load(arguments.config)
    if settings.jy901.use != "instead" and settings.imu.transport != "socket":
        raise UsageError(f'{arguments.config}: sim serves imu.transport = "socket", not "{settings.imu.transport}"')
    if settings.jy901.use != "no" and settings.jy901.transport != "serial":
        raise UsageError(f'{arguments.config}: sim serves jy901.transport = "serial", not "virtual"')
    if settings.can.enabled and settings.can.interface == "virtual":
        raise UsageError(
            f'{arguments.config}: can.interface = "virtual" stays within one process: '
            'with sim choose "udp_multicast" or "socketcan", or set can.enabled = false'
        )
    faults = None if arguments.faults is None else load_faults(arguments.faults)
    if faults is not None:
        refuse_unplayable(faults, settings.jy901.use)
    configure_logging(verbose=False)
    # The thread that tells of an edge must not wait for the one that computes the motion.
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    account = asyncio.run(simulate(settings, faults))
    if arguments.json:
        print(json.dumps(account, indent=2))
    return 0
