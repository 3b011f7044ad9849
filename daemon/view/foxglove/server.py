"""A Foxglove WebSocket server that passes the lines of the daemon's Unix socket on."""

from __future__ import annotations

import asyncio
import contextlib
import ipaddress
import json
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from daemon.errors import CommandError, UsageError
from daemon.extras import needs
from daemon.service.live_client import Gone, LiveLink, Silent
from daemon.view.foxglove.channels import LOG_TOPIC, SCHEMAS, TOPICS

if TYPE_CHECKING:
    from foxglove import Channel
    from foxglove.websocket import WebSocketServer

PORT = 8765  # what the viewers propose
# Messages that wait for one client; of a client that reads too slowly the oldest are dropped.
BACKLOG = 256
INFO, WARNING = 2, 3  # of foxglove.Log
_NO_DAEMON = "no-daemon"


def serve(socket: Path, host: str = "127.0.0.1", port: int = PORT, say: Callable[[str], None] = print) -> None:
    """Serve until SIGINT or SIGTERM; `say` hears the address once clients may come.

    Raises:
        UsageError: `host` is no loopback address.
        CommandError: the port cannot be served, the package is missing, or this user may not read the daemon.
    """
    refuse_beyond_loopback(host, port)
    asyncio.run(_serve(socket, host, port, say))


def refuse_beyond_loopback(host: str, port: int) -> None:
    """The protocol knows neither password nor token. Raises UsageError."""
    with contextlib.suppress(ValueError):
        if host == "localhost" or ipaddress.ip_address(host).is_loopback:
            return
    raise UsageError(
        f"--listen {host}: Foxglove's protocol knows no password, so only this computer is served; from another one: "
        f"ssh -L {port}:127.0.0.1:{port} USER@THIS_COMPUTER, and open ws://127.0.0.1:{port} there"
    )


async def _serve(socket: Path, host: str, port: int, say: Callable[[str], None]) -> None:
    with contextlib.closing(_Publisher(host, port)) as publisher:
        say(f"ws://{host}:{publisher.port}")
        working = asyncio.ensure_future(publisher.work(LiveLink(socket)))
        for number in (signal.SIGINT, signal.SIGTERM):
            asyncio.get_running_loop().add_signal_handler(number, working.cancel)
        with contextlib.suppress(asyncio.CancelledError):
            await working


class _Publisher:
    """The server and its channels."""

    def __init__(self, host: str, port: int) -> None:
        try:
            import foxglove
        except ModuleNotFoundError as error:
            raise CommandError(needs("this", "the package foxglove-sdk", "foxglove")) from error
        self._context = context = foxglove.Context()  # closes its channels when it goes
        self._status_levels = foxglove.websocket.StatusLevel
        self._channels: dict[str, Channel] = {
            topic: foxglove.Channel(topic, schema=schema, context=context) for topic, schema in SCHEMAS.items()
        }
        try:
            self._server: WebSocketServer = foxglove.start_server(
                name="ramstroke", host=host, port=port, context=context, message_backlog_size=BACKLOG
            )
        except (OSError, RuntimeError, ValueError) as error:
            raise CommandError(f"cannot serve {host}, port {port} ({error}): choose another --port") from error
        self.port: int = self._server.port

    async def work(self, link: LiveLink) -> None:
        """Publish for ever. Raises ForbiddenError."""
        trouble = ""
        async for told in link.follow():
            if isinstance(told, Gone | Silent):
                why = told.why if isinstance(told, Gone) else "the daemon is connected, but silent"
                if why != trouble:
                    trouble = why
                    self._tell(WARNING, why)
                    self._server.publish_status(why, self._status_levels.Warning, _NO_DAEMON)
                continue
            if trouble:
                trouble = ""
                self._tell(INFO, "the daemon is back")
                self._server.remove_status([_NO_DAEMON])
            topic = TOPICS.get(told.kind)
            if topic is not None:
                self._channels[topic].log(told.raw.rstrip(b"\n"))
            if told.kind == "event":
                self._tell(INFO, str(told.content.get("what", "")))

    def _tell(self, level: int, text: str) -> None:
        """A line for the viewer's log panel."""
        sec, nsec = divmod(time.time_ns(), 1_000_000_000)
        line = {"timestamp": {"sec": sec, "nsec": nsec}, "level": level, "message": text}
        line |= {"name": "ramstroke", "file": "", "line": 0}
        self._channels[LOG_TOPIC].log(json.dumps(line).encode())

    def close(self) -> None:
        """Hang up on everybody."""
        self._server.stop()
