"""`ramstroke recover`."""

from __future__ import annotations

import argparse
from pathlib import Path

HELP = "Make a complete file from a cut or damaged recording, with every message that can still be read."
EXAMPLE = "ramstroke recover cut.mcap -o whole.mcap"


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("file", type=Path, help="the damaged recording")
    parser.add_argument("-o", "--output", type=Path, required=True, help="the complete file to write")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")


def run(arguments: argparse.Namespace) -> int:
    """Recover."""
    from daemon import terminal
    from daemon.recording.recover import recover

    with terminal.progress(f"reading {arguments.file.name}") as progress:
        report = recover(arguments.file, arguments.output, progress)
    if arguments.json:
        terminal.print_json({"messages": report.messages, "lost": report.lost, "damage": report.damage})
        return 0
    terminal.say(f"{report.messages} messages saved, {report.lost} known to be lost, in {arguments.output}")
    for sentence in report.damage:
        terminal.say(f"- {sentence}")
    return 0
