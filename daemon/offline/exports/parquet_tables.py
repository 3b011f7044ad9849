"""Tables as Parquet files. pyarrow is heavy and loads only here, on use."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from daemon.errors import CommandError
from daemon.extras import needs
from daemon.offline.exports.tables import Cell, Kind, Table
from daemon.offline.whole_file import whole_file

_BATCH = 20_000  # rows in memory


class ParquetError(CommandError):
    """A table cannot be written; one sentence."""


class ParquetWriter:
    """Writes `NAME.parquet` for each table."""

    def __init__(self, files: dict[str, Any]) -> None:
        self._files = files
        self._waiting: dict[str, list[tuple[Cell, ...]]] = {name: [] for name in files}

    def add(self, table: Table, *row: Cell) -> None:
        """Append a row; None is null."""
        waiting = self._waiting[table.name]
        waiting.append(row)
        if len(waiting) == _BATCH:
            self._write(table)

    def finish(self, tables: Sequence[Table]) -> None:
        """The rows that still wait."""
        for table in tables:
            self._write(table)

    def _write(self, table: Table) -> None:
        import pyarrow as pa

        waiting, file = self._waiting[table.name], self._files[table.name]
        if not waiting:
            return
        columns = [
            pa.array([_value(kind, cell) for cell in column], type=field.type)
            for kind, column, field in zip(table.columns.values(), zip(*waiting, strict=True), file.schema, strict=True)
        ]
        file.write_table(pa.Table.from_arrays(columns, schema=file.schema))
        waiting.clear()


@contextmanager
def parquet_tables(folder: Path, tables: Sequence[Table]) -> Iterator[ParquetWriter]:
    """Open them; all appear at the end of the block, or none. Raises ParquetError or RecordingError."""
    require_pyarrow()
    import pyarrow as pa
    from pyarrow import parquet

    types = {"time": pa.float64(), "thousandth": pa.float64(), "real": pa.float64(), "whole": pa.int64()}
    files: dict[str, Any] = {}
    with ExitStack() as stack:
        for table in tables:
            part = stack.enter_context(whole_file(folder / f"{table.name}.parquet"))
            stream = stack.enter_context(part.open("wb"))
            schema = pa.schema([(name, types.get(kind, pa.string())) for name, kind in table.columns.items()])
            files[table.name] = stack.enter_context(parquet.ParquetWriter(stream, schema, compression="zstd"))
        writer = ParquetWriter(files)
        yield writer
        writer.finish(tables)


def require_pyarrow() -> None:
    """Raises ParquetError where it is not installed."""
    try:
        import pyarrow  # noqa: F401  # only whether it is there
    except ImportError as error:
        raise ParquetError(needs("--parquet", "pyarrow", "parquet")) from error


def _value(kind: Kind, cell: Cell) -> Cell:
    if cell is None or isinstance(cell, str):
        return cell
    if kind == "time":
        return cell / 1e9
    return cell * 1e3 if kind == "thousandth" else cell
