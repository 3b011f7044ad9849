"""`ramstroke watch`."""

from __future__ import annotations

import argparse
from pathlib import Path

HELP = (
    "The running daemon live at a terminal: stroke, ram, history, parts, moves, events. Keys: q quits, p pauses. Where "
    "standard output is no terminal, a line a second and one for everything that happens."
)
EXAMPLE = "ramstroke watch --config /etc/ramstroke/ramstroke.toml"


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--config", type=Path, help="the daemon's configuration (for the place of its socket)")
    parser.add_argument("--language", choices=("en", "zh"), default="en", help="of the view (default en)")
    parser.add_argument("--ascii", action="store_true", help="draw without Unicode; chosen by itself by the locale")
    parser.add_argument("--json", action="store_true", help="the daemon's own lines, one JSON object each")


def run(arguments: argparse.Namespace) -> int:
    """Watch until told to stop."""
    import asyncio
    import os
    import sys

    from daemon.configuration import load
    from daemon.service.live_client import LiveLink
    from daemon.settings import Settings
    from daemon.watch.glyphs import ASCII, UNICODE, knows_unicode
    from daemon.watch.plain import pass_on, tell
    from daemon.watch.screen import Screen
    from daemon.watch.view import View
    from daemon.watch.words import Words

    settings = load(arguments.config) if arguments.config else Settings()
    link = LiveLink(settings.service.socket)
    glyphs = ASCII if arguments.ascii or not knows_unicode() else UNICODE
    words = Words("en" if glyphs.is_ascii else arguments.language)
    if arguments.json:
        asyncio.run(pass_on(link))
    elif sys.stdout.isatty() and os.environ.get("TERM", "dumb") not in ("dumb", "unknown", ""):
        keyboard = sys.stdin.fileno() if sys.stdin.isatty() else None

        async def view() -> None:
            await View(link, Screen(sys.stdout, keyboard), keyboard, words, glyphs).run()

        asyncio.run(view())
    else:
        asyncio.run(tell(link, words, glyphs))
    return 0
