"""`ramstroke doctor`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from daemon.doctor.report import Check, Verdict

HELP = (
    "Look at everything that goes wrong on a real support: configuration, wires, sensor, data-ready line, CAN, disk, "
    "clock, rights, service. Each fault is told with what to do; the first one is the one to mend first. Sends "
    "nothing on CAN. Sensors that a running daemon reads are left alone."
)
EXAMPLE = "ramstroke doctor --config /etc/ramstroke/ramstroke.toml"
INSTALLED = Path("/etc/ramstroke/ramstroke.toml")


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--config", type=Path, help=f"configuration file (default: {INSTALLED} if it is there)")
    parser.add_argument(
        "--scan-lines",
        action="store_true",
        help="if the data-ready line is silent, watch the other lines of the GPIO chip too: makes them inputs",
    )
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")


def run(arguments: argparse.Namespace) -> int:
    """Look; 1 if anything is at fault, 2 if the configuration cannot be used."""
    from daemon.configuration import ConfigurationError, load
    from daemon.doctor.examination import examine
    from daemon.doctor.patient import admit
    from daemon.doctor.report import Verdict, fault, worst
    from daemon.errors import FAILED, MISUSED
    from daemon.settings import Settings

    file = arguments.config or (INSTALLED if INSTALLED.exists() else None)
    try:
        settings = load(file) if file else Settings()
    except ConfigurationError as error:
        if not arguments.json:
            raise
        found = "; ".join(error.sentences)
        _print_json([fault("configuration", found, "correct that file; ramstroke check-config looks at it again")])
        return MISUSED
    with _progress() as say:
        checks = examine(admit(settings, file, say=say, scan_lines=arguments.scan_lines))
    if arguments.json:
        _print_json(checks)
    else:
        _print(checks)
    return FAILED if worst(checks) is Verdict.FAULT else 0


def _print_json(checks: list[Check]) -> None:
    from daemon import terminal
    from daemon.doctor.report import worst

    terminal.print_json({"checks": [check.row() for check in checks], "worst": str(worst(checks))})


def _print(checks: list[Check]) -> None:
    """What was found as a table, then what to do, the faults first."""
    from rich.markup import escape

    from daemon import terminal
    from daemon.doctor.report import ASK_AS, Verdict

    made = terminal.table("What was found", "check", "verdict", "found")
    made.columns[1].justify = made.columns[2].justify = "left"
    for (verdict, found, _), alike in groupby(checks, key=_alike):
        first, *more = alike
        name = f"{first.name} and {len(more)} more" if more else first.name
        follows = f" (follows from {first.follows_from})" if first.follows_from else ""
        made.add_row(escape(name), str(verdict), escape(found + follows))
    terminal.OUT.print(made)
    for verdict, title in ((Verdict.FAULT, "To mend, the first one first:"), (Verdict.WARNING, "Better:")):
        bad = [check for check in checks if check.verdict is verdict and not check.follows_from]
        if bad:
            terminal.say(title)
        for number, check in enumerate(bad, start=1):
            terminal.say(f"  {number}. {check.name}: {check.advice}")
    if not any(check.verdict in (Verdict.FAULT, Verdict.WARNING) for check in checks):
        terminal.say("Nothing is at fault.")
    for command in sorted({check.advice for check in checks if check.advice.startswith(ASK_AS)}):
        terminal.say(f"What was not checked for want of rights: {command}")


def _alike(check: Check) -> tuple[Verdict, str, str]:
    """What one fault hides is one row."""
    from daemon.doctor.report import Verdict

    return check.verdict, check.found, "" if check.verdict is Verdict.NOT_CHECKED else check.name


@contextmanager
def _progress() -> Iterator[Callable[[str], None]]:
    """What is being done, on one line of standard error; silent when that is no terminal.

    No spinner: its thread would make the reader late for samples.
    """
    if not sys.stderr.isatty():
        yield lambda _: None
        return

    def write(text: str) -> None:
        sys.stderr.write(f"\r\x1b[2K{text}")
        sys.stderr.flush()

    try:
        yield lambda what: write(f"{what} ...")
    finally:
        write("")
