"""The virtual support as a program of its own, in real time."""

from __future__ import annotations

import asyncio
import logging
import signal
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

from daemon.settings import Settings
from daemon.simulation.virtual import (
    ControllerTransmitter,
    virtual_controller,
    virtual_line,
    virtual_part,
    virtual_support,
)
from drivers.clock import SystemClock
from drivers.virtual.faults import FaultScript
from drivers.virtual.jy901_terminal import SerialTerminal
from drivers.virtual.spi_socket import SpiSocketServer

_log = logging.getLogger(__name__)


async def simulate(settings: Settings, faults: FaultScript | None = None) -> dict[str, Any]:
    """Serve sensor and controller until SIGTERM or SIGINT; returns what was done, for exact accounting.

    Raises:
        OSError: the socket cannot be served.
        CanConfigError: settings and script do not fit each other.
    """
    clock = SystemClock()
    start_ns = clock.now_ns()
    support = virtual_support(settings, start_ns=start_ns)
    sender = None
    if settings.can.enabled:
        sender = ControllerTransmitter(settings, virtual_controller(settings, support, faults), clock)
    part = server = line = terminal = None
    if settings.jy901.use != "instead":
        Path(settings.imu.socket_path).parent.mkdir(parents=True, exist_ok=True)
        part = virtual_part(support, clock, faults)
        server = SpiSocketServer(settings.imu.socket_path, part)
    if settings.jy901.use != "no":
        line = virtual_line(settings, support, faults)
        terminal = SerialTerminal(settings.jy901.port, line, clock)
    for served in (server, terminal):
        if served is not None:
            served.start()
    stopping = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stopping.set)
    sending = None if sender is None else asyncio.ensure_future(sender.run())
    ports = (server and settings.imu.socket_path, terminal and settings.jy901.port)
    _log.info("virtual support %d on %s", settings.simulation.seed, " and ".join(port for port in ports if port))
    try:
        await stopping.wait()
    finally:
        for served in (server, terminal):
            if served is not None:
                served.close()
        if sending is not None:
            sending.cancel()
            with suppress(asyncio.CancelledError):
                await sending
    duration_s = (clock.now_ns() - start_ns) * 1e-9
    played = [] if faults is None else [fault for fault in faults.in_order if fault.at_s < duration_s]
    account = {
        "duration_s": duration_s,
        "part": None if part is None else asdict(part.account()),
        "socket": None if server is None else asdict(server.served),
        "jy901": None
        if line is None or terminal is None
        else asdict(line.account) | {"groups": line.part.groups, "unread": terminal.overflowed},
        "can": {
            "sent": 0 if sender is None else sender.sent,
            "failed": 0 if sender is None else sender.failed,
            "sent_by_kind": {} if sender is None else dict(sender.sent_by_kind),
        },
        "faults": [fault.model_dump() for fault in played],
    }
    _log.info("virtual support ends: %s", _in_words(account))
    return account


def _in_words(account: dict[str, Any]) -> str:
    part, served, serial, frames = account["part"], account["socket"], account["jy901"], account["can"]
    kinds = ", ".join(f"{count} {kind}" for kind, count in sorted(frames["sent_by_kind"].items())) or "none"
    words = [f"{account['duration_s']:.1f} s"]
    if part is not None:
        words += [
            f"{part['updates']} samples; {served['edges']} edges told, "
            f"{part['edges_lost_by_script']} lost and {part['edges_added_by_script']} added by script",
            f"{served['frames']} SPI frames, {served['failed_frames']} of them failed by script",
        ]
    if serial is not None:
        words.append(
            f"{serial['groups']} JY901 samples; {serial['bytes']} bytes, {serial['lost_by_script']} lost, "
            f"{serial['flipped_by_script']} changed and {serial['added_by_script']} added by script, "
            f"{serial['unread']} read by nobody"
        )
    words += [f"CAN frames sent: {kinds}; {frames['failed']} not sent", f"{len(account['faults'])} faults played"]
    return "; ".join(words)
