"""Tables as CSV files."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from math import isnan
from pathlib import Path
from typing import Any

from daemon.offline.exports.tables import Cell, Kind, Table
from daemon.offline.whole_file import whole_file

FORMATS: dict[Kind, Callable[[Any], str]] = {
    "time": lambda t_ns: f"{t_ns // 1_000_000_000}.{t_ns % 1_000_000_000:09d}",
    "thousandth": lambda metres: f"{metres * 1e3:.6f}",
    "real": lambda value: repr(float(value)),
    "whole": str,
    "text": str,
}


class CsvWriter:
    """Writes `NAME.csv` for each table."""

    def __init__(self, rows: dict[str, Any]) -> None:
        self._rows = rows

    def add(self, table: Table, *row: Cell) -> None:
        """Append a row; None and NaN are empty cells."""
        cells = zip(table.columns.values(), row, strict=True)
        self._rows[table.name].writerow([_text(kind, cell) for kind, cell in cells])


def _text(kind: Kind, cell: Cell) -> str:
    is_missing = cell is None or (isinstance(cell, float) and isnan(cell))
    return "" if is_missing else FORMATS[kind](cell)


@contextmanager
def csv_tables(folder: Path, tables: Sequence[Table]) -> Iterator[CsvWriter]:
    """Open them; all appear at the end of the block, or none. Raises RecordingError."""
    rows: dict[str, Any] = {}
    with ExitStack() as stack:
        for table in tables:
            part = stack.enter_context(whole_file(folder / f"{table.name}.csv"))
            stream = stack.enter_context(part.open("w", newline="", encoding="utf-8"))
            rows[table.name] = csv.writer(stream, lineterminator="\n")
            rows[table.name].writerow(table.columns)
        yield CsvWriter(rows)
