"""The option `--method`, common to replay, review and evaluate."""

from __future__ import annotations

import argparse

from daemon.commands import choices

OURS = "mskf"


def configure(parser: argparse.ArgumentParser, *, several: bool = False) -> None:
    """Add the option."""
    names = "names separated by commas, `all`, or `list` to see them" if several else "`list` shows them"
    parser.add_argument("--method", default=OURS, metavar="NAME", help=f"how to estimate (default {OURS}): {names}")


def known(name: str) -> str:
    """The name, if there is such a method. Raises UsageError."""
    from estimation.methods.registry import METHODS

    return choices.known("--method", name, METHODS)


def several(names: str | None) -> list[str]:
    """The batch methods of a list such as `kf2,kf3`. Raises UsageError."""
    from daemon.errors import UsageError
    from estimation.methods.registry import METHODS

    found = list(dict.fromkeys(name.strip() for name in (names or "").split(",") if name.strip()))
    for name in found:
        if METHODS[choices.known("--methods", name, METHODS)].course is None:
            raise UsageError(f"--methods {name}: that one is in the report anyway; name others")
    return found


def show() -> int:
    """Print them."""
    from daemon import terminal
    from estimation.methods.registry import METHODS

    made = terminal.table("Methods", "name", "what", "uses the displacement sensor")
    for name, method in METHODS.items():
        made.add_row(name, method.about, "yes" if method.reads_displacement or method.course is None else "no")
    terminal.OUT.print(made)
    return 0
