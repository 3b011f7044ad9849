"""Turning a table of inertial samples (CSV) into a recording that replay and review can read."""

from __future__ import annotations

import csv
import gzip
import io
import math
import os
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import BinaryIO, TextIO, cast

from daemon.recording.errors import RecordingError, failed, refuse_same_file
from daemon.recording.metadata import describe
from daemon.recording.topics import IMU_SAMPLE, OBSERVED, REFERENCE, RecordedDisplacement
from daemon.recording.writer import RecordingWriter
from estimation.records import Displacement, ImuSample, TimeKind

TIME = "t_s"
MOTION = ("gyro_x_rad_s", "gyro_y_rad_s", "gyro_z_rad_s", "accel_x_m_s2", "accel_y_m_s2", "accel_z_m_s2")
TEMPERATURE = "temperature_c"
DISPLACEMENTS = {"observed_mm": OBSERVED, "reference_mm": REFERENCE}

_LONGEST_LINE = 64 * 1024  # characters; a table of ours has some 200
_END_OF_TIME_S = Decimal(2**63 - 1) / 10**9
_PROGRESS_EVERY = 10_000


class CsvError(RecordingError):
    """A CSV file cannot be imported; one sentence that names the file and what to do."""


@dataclass(slots=True, frozen=True)
class ImportReport:
    """What became of the rows of a table.

    dropped: rows left out, by reason; dropped_values: unusable optional values in rows that were kept, by
    column; ignored: columns of the file that mean nothing here.
    """

    rows: int
    dropped: dict[str, int]
    dropped_values: dict[str, int]
    ignored: list[str]
    duration_s: float
    rate_hz: float  # mean, NaN for a single row


def import_csv(
    source: Path,
    target: Path,
    settings_json: str,
    *,
    sensor: str = "",
    progress: Callable[[float], None] | None = None,
) -> ImportReport:
    """Read the table `source` (.csv or .csv.gz) into the recording `target`, row by row.

    The numbers are kept as given: values as the nearest float, times exact to the nanosecond. A displacement
    follows the inertial sample of its row. progress: told the share of the file that has been read, now and then.
    Raises `CsvError` or `RecordingError`; `target` is written whole or not at all.
    """
    refuse_same_file(source, target)
    with _open_table(source) as (lines, share_read):
        table = _Table(source, lines)
        with RecordingWriter(target, describe("import", settings_json, sensor=sensor)) as writer:
            for row in table.rows():
                writer.write(IMU_SAMPLE, row.sample)
                for topic, reading in row.displacements:
                    writer.write(topic, RecordedDisplacement(reading, decoded=False))
                if progress is not None and table.line % _PROGRESS_EVERY == 0:
                    progress(share_read())
            if table.last_ns is None:
                raise CsvError(f"{source} holds no usable row: {_reasons(table.dropped)}")
    return table.report()


@dataclass(slots=True, frozen=True)
class _Row:
    sample: ImuSample
    displacements: list[tuple[str, Displacement]]


class _Table:
    """A table being read: its columns, and the count of what was left out."""

    def __init__(self, source: Path, lines: Iterator[str]) -> None:
        self.dropped: Counter[str] = Counter()
        self.dropped_values: Counter[str] = Counter()
        self.line = 1
        self.last_ns: int | None = None
        self._first_ns = 0
        self._kept = 0
        self._source = source
        self._rows = csv.reader(lines, strict=True)
        header = next(self._rows, None)
        if header is None:
            raise CsvError(f"{source} is empty: a table with a header row is needed")
        self._columns = self._place_columns([name.strip() for name in header])
        self._width = len(header)
        known = {TIME, *MOTION, TEMPERATURE, *DISPLACEMENTS}
        self._ignored = [name.strip() for name in header if name.strip() not in known]

    def _place_columns(self, names: Sequence[str]) -> dict[str, int]:
        missing = [name for name in (TIME, *MOTION) if name not in names]
        if missing:
            raise CsvError(
                f"{self._source} lacks the column{'s' if len(missing) > 1 else ''} {', '.join(missing)}: "
                "the first row must name the columns, separated by commas"
            )
        twice = sorted(name for name, count in Counter(names).items() if count > 1)
        if twice:
            raise CsvError(f"{self._source} has the column {twice[0]} more than once: remove or rename one")
        return {name: place for place, name in enumerate(names)}

    def rows(self) -> Iterator[_Row]:
        """Usable rows."""
        motion = [self._columns[name] for name in MOTION]
        for fields in self._rows:
            self.line += 1
            if not fields:
                continue
            if len(fields) != self._width:
                self.dropped["as many values as columns are needed"] += 1
                continue
            try:
                gx, gy, gz, ax, ay, az = values = [float(fields[place]) for place in motion]
                t_ns = self._time_ns(fields[self._columns[TIME]])
            except (ValueError, InvalidOperation):
                self.dropped["a required value is missing or not a number"] += 1
                continue
            if not all(map(math.isfinite, values)):
                self.dropped["a required value is not finite"] += 1
                continue
            if self.last_ns is None:
                self._first_ns = t_ns
            elif t_ns <= self.last_ns:
                self.dropped["time does not increase"] += 1
                continue
            self.last_ns = t_ns
            self._kept += 1
            temperature = self._optional(TEMPERATURE, fields)
            sample = ImuSample(t_ns, (gx, gy, gz), (ax, ay, az), temperature, TimeKind.IMPORTED)
            yield _Row(sample, self._displacements(t_ns, fields))

    def _time_ns(self, text: str) -> int:
        time_s = Decimal(text)
        if not time_s.is_finite():
            raise ValueError("not a time")
        if not 0 <= time_s <= _END_OF_TIME_S:
            raise CsvError(
                f"{self._source}, row {self.line}: {TIME} = {text.strip()[:40]} must be between 0 and "
                f"{_END_OF_TIME_S:.0f} s: shift the times"
            )
        return int((time_s * 10**9).to_integral_value())

    def _optional(self, column: str, fields: Sequence[str]) -> float:
        """Value of an optional column, NaN when there is none."""
        place = self._columns.get(column)
        text = "" if place is None else fields[place].strip()
        if not text:
            return math.nan
        try:
            value = float(text)
        except ValueError:
            value = math.inf
        if math.isinf(value):
            self.dropped_values[column] += 1
            return math.nan
        return value

    def _displacements(self, t_ns: int, fields: Sequence[str]) -> list[tuple[str, Displacement]]:
        found: list[tuple[str, Displacement]] = []
        for column, topic in DISPLACEMENTS.items():
            value_mm = self._optional(column, fields)
            if not math.isnan(value_mm):
                reading = Displacement(t_ns, value_mm / 1000, is_reference=topic == REFERENCE)
                found.append((topic, reading))
        return found

    def report(self) -> ImportReport:
        """Summary of the rows read so far."""
        duration_s = ((self.last_ns or 0) - self._first_ns) / 1e9
        rate_hz = (self._kept - 1) / duration_s if duration_s else math.nan
        return ImportReport(
            self._kept, dict(self.dropped), dict(self.dropped_values), self._ignored, duration_s, rate_hz
        )


def _reasons(dropped: Counter[str]) -> str:
    if not dropped:
        return "there is nothing below its header"
    return "; ".join(f"{reason} ({count} rows)" for reason, count in dropped.items())


@contextmanager
def _open_table(source: Path) -> Iterator[tuple[Iterator[str], Callable[[], float]]]:
    """Lines of the table, and which share of the file has been read.

    Whatever may be wrong with the file while it is read becomes a `CsvError`.
    """
    try:
        with ExitStack() as stack:
            raw = stack.enter_context(source.open("rb"))
            size = max(os.fstat(raw.fileno()).st_size, 1)
            plain = stack.enter_context(gzip.GzipFile(fileobj=raw)) if source.suffix == ".gz" else raw
            stream = stack.enter_context(io.TextIOWrapper(cast(BinaryIO, plain), encoding="utf-8-sig", newline=""))
            yield _bounded_lines(source, stream), lambda: min(raw.tell() / size, 1.0)
    except UnicodeDecodeError as error:
        raise CsvError(f"{source} is not text in UTF-8: save it as CSV in UTF-8") from error
    except csv.Error as error:
        raise CsvError(f"{source} is not a proper CSV table ({error}): check quotes and separators") from error
    except (gzip.BadGzipFile, EOFError, zlib.error) as error:
        raise CsvError(f"{source} is damaged or not compressed by gzip: fetch or unpack it again") from error
    except OSError as error:
        raise failed("read", source, error) from error


def _bounded_lines(source: Path, stream: TextIO) -> Iterator[str]:
    while line := stream.readline(_LONGEST_LINE):
        if len(line) == _LONGEST_LINE:
            raise CsvError(f"{source} has a line of more than {_LONGEST_LINE} characters: it is no table")
        yield line
