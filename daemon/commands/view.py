"""`ramstroke view`."""

from __future__ import annotations

import argparse
from pathlib import Path

HELP = (
    "The live page: the stroke moving, what is ill and since when, recordings and their reports, for browsers. "
    "It reads the daemon's socket and may run as any user of the group ramstroke. Ends on Ctrl-C and SIGTERM."
)
EXAMPLE = (
    "ramstroke view   # then open http://127.0.0.1:8448/\n"
    "  ramstroke view --listen 0.0.0.0   # for other computers, with a token\n"
    "  ramstroke view --foxglove         # then open ws://127.0.0.1:8765 in Foxglove or Lichtblick"
)
PORT, FOXGLOVE_PORT = 8448, 8765
POLITENESS = 10  # the daemon and its sensors come first


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--config", type=Path, help="the daemon's configuration (places of socket and recordings)")
    parser.add_argument(
        "--listen", metavar="ADDRESS", default="127.0.0.1", help="default 127.0.0.1: this computer only"
    )
    parser.add_argument("--port", type=_port, metavar="N", help=f"default {PORT}, or {FOXGLOVE_PORT} with --foxglove")
    parser.add_argument("--token-file", type=Path, metavar="FILE", help="the secret that browsers must know")
    parser.add_argument(
        "--foxglove", action="store_true", help="serve Foxglove and Lichtblick in place of browsers, this computer only"
    )


def run(arguments: argparse.Namespace) -> int:
    """Serve until stopped."""
    return _serve_foxglove(arguments) if arguments.foxglove else _serve_page(arguments)


def _serve_foxglove(arguments: argparse.Namespace) -> int:
    import os

    from daemon.configuration import load
    from daemon.errors import UsageError
    from daemon.settings import Settings
    from daemon.view.foxglove.server import serve

    if arguments.token_file is not None:
        raise UsageError("--token-file is for the page: Foxglove's protocol knows no token")
    settings = load(arguments.config) if arguments.config else Settings()

    def tell(address: str) -> None:
        print(f"for Foxglove and Lichtblick: {address}", flush=True)

    os.nice(POLITENESS)
    serve(settings.service.socket, arguments.listen, arguments.port or FOXGLOVE_PORT, tell)
    return 0


def _serve_page(arguments: argparse.Namespace) -> int:
    import asyncio
    import os
    import sys
    import tempfile

    from daemon.configuration import load
    from daemon.errors import CommandError
    from daemon.extras import needs
    from daemon.settings import Settings
    from daemon.view import token as tokens
    from daemon.view.guard import Guard, is_loopback
    from daemon.view.server import ViewServer, serve

    try:
        import aiohttp as _  # noqa: F401  # a missing extra is told before anything is begun
    except ImportError as error:
        raise CommandError(needs("the live page", "aiohttp", "view")) from error

    settings = load(arguments.config) if arguments.config else Settings()
    port = arguments.port or PORT
    loopback = is_loopback(arguments.listen)
    token = tokens.read(arguments.token_file) if arguments.token_file else None if loopback else tokens.made()
    is_made = token is not None and not arguments.token_file
    address = f"http://{_host(arguments.listen)}:{port}/" + (f"?token={token}" if is_made else "")

    async def main() -> None:
        import signal

        stopping = asyncio.Event()
        for number in (signal.SIGTERM, signal.SIGINT):
            asyncio.get_running_loop().add_signal_handler(number, stopping.set)
        with tempfile.TemporaryDirectory(prefix="ramstroke-view-") as scratch:
            server = ViewServer(
                settings.service.socket,
                settings.recording.directory,
                Path(scratch),
                Guard(token, loopback=loopback, port=port),
            )
            await serve(server, arguments.listen, port, stopping, tell)

    def tell() -> None:
        print(f"the live page: {address}", flush=True)
        if not _may_read(settings.service.socket):
            print(
                f"ramstroke: no right to read {settings.service.socket}: "
                "`sudo usermod -aG ramstroke $USER`, then log in anew",
                file=sys.stderr,
            )

    os.nice(POLITENESS)
    asyncio.run(main())
    return 0


def _port(text: str) -> int:
    port = int(text)
    if not 1 <= port <= 65535:
        raise argparse.ArgumentTypeError(f"{text} is no port: 1 to 65535")
    return port


def _host(address: str) -> str:
    """As browsers reach it: an address that stands for all is shown as this computer's name."""
    import socket

    if address in ("0.0.0.0", "::"):
        return socket.gethostname()
    return f"[{address}]" if ":" in address else address


def _may_read(path: Path) -> bool:
    """Whether a socket that is there is ours to connect to."""
    import os

    try:
        path.stat()
    except PermissionError:
        return False
    except OSError:
        return True  # no daemon yet
    return os.access(path, os.R_OK | os.W_OK)
