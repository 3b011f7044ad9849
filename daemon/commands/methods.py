"""The option `--method`, common to replay, review and evaluate."""

from __future__ import annotations

import argparse

OURS = "mskf"


def configure(parser: argparse.ArgumentParser, *, several: bool = False) -> None:
    """Add the option."""
    names = "names separated by commas, `all`, or `list` to see them" if several else "`list` shows them"
    parser.add_argument("--method", default=OURS, metavar="NAME", help=f"how to estimate (default {OURS}): {names}")


def known(name: str) -> str:
    """The name, if there is such a method. Raises UsageError."""
    from difflib import get_close_matches

    from daemon.errors import UsageError
    from estimation.methods.registry import METHODS

    if name in METHODS:
        return name
    near = get_close_matches(name, METHODS, n=1)
    hint = f"did you mean {near[0]}?" if near else "--method list shows what there is"
    raise UsageError(f"--method {name} is unknown; {hint}")


def show() -> int:
    """Print them."""
    from daemon import terminal
    from estimation.methods.registry import METHODS

    made = terminal.table("Methods", "name", "what", "uses the displacement sensor")
    for name, method in METHODS.items():
        made.add_row(name, method.about, "yes" if method.reads_displacement or method.course is None else "no")
    terminal.OUT.print(made)
    return 0
