"""What people see at the terminal: tables and JSON on standard output, progress on standard error."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import isnan
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from daemon.rows import finite
from daemon.rows import move_row as move_row
from estimation.records import Move

# A pipe or a file has no width of its own: wide enough for every table.
OUT = Console(soft_wrap=True, width=None if sys.stdout.isatty() else 160)
ERR = Console(stderr=True, soft_wrap=True)


def print_json(value: dict[str, Any]) -> None:
    """One object on standard output; NaN and infinity become null."""
    sys.stdout.write(json.dumps(finite(value), indent=2) + "\n")


def say(text: str) -> None:
    """One line on standard output, as it is: a path may hold what looks like markup."""
    OUT.print(text, highlight=False, markup=False)


@contextmanager
def progress(what: str, total: float = 1.0) -> Iterator[Callable[[float], None]]:
    """A bar on standard error; call it with how much of `total` is done. Silent when standard error is no terminal."""
    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:.0f} %"),
        TimeRemainingColumn(),
        console=ERR,
        transient=True,
        disable=not ERR.is_terminal,
    )
    with bar:
        task = bar.add_task(what, total=total)
        yield lambda done: bar.update(task, completed=done)


def table(title: str, *columns: str) -> Table:
    """A table with its first column left, the others right."""
    made = Table(title=title, title_justify="left")
    for i, column in enumerate(columns):
        made.add_column(column, justify="left" if i == 0 else "right")
    return made


def print_moves(moves: list[Move]) -> None:
    """Moves as a table."""
    made = table(
        "Moves",
        "kind",
        "onset s",
        "stop s",
        "start mm",
        "end mm",
        "± 1σ mm",
        "before stop mm",
        "± 1σ mm",
        "mm/s",
        "CAN",
    )
    for move in moves:
        row = move_row(move)
        made.add_row(
            row["kind"],
            *(f"{row[key]:.2f}" for key in ("onset_s", "stop_s")),
            *(
                "–" if isnan(row[key]) else f"{row[key]:.1f}"
                for key in ("start_mm", "end_mm", "sigma_mm", "end_before_stop_mm", "sigma_before_stop_mm")
            ),
            f"{row['velocity_mm_s']:.2f}",
            row["can_state"],
        )
    OUT.print(made if moves else "No moves were found.")
